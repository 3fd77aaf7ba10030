# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The wait for planner and readers before a simulated flight begins."""

from __future__ import annotations

import math
from typing import Any

from rclpy.publisher import Publisher
from rclpy.subscription import Subscription

from orbimpc_ros.ros.lifecycle import Managed
from orbimpc_ros.sim.parameters import SimSettings

SILENT = 2.0  # [s] of waiting are not worth a word
MEETING = 1.5  # [s] that DDS may take to have planner and readers meet, which nobody else can see
TRANSITIONS = 'transition_event'  # a topic of every managed node
UNKNOWN = '_NODE_NAME_UNKNOWN_'  # of a reader that is known before its node is


class Waiting:
    """Waits for a planner and for readers of topics, and logs for whom whenever that changes.

    Args:
        node: that waits.
        settings: how many subscribers of odometry, the planner among them, and how many readers
            of topics beside planner and ``node``.
        odometry: its publisher.
        goal: the publisher of goals, which a planner that is ready subscribes to.
        commands: the subscription to what a planner publishes, by which it is known.
    """

    def __init__(
        self,
        node: Managed,
        settings: SimSettings,
        odometry: Publisher,
        goal: Publisher,
        commands: Subscription,
    ) -> None:
        self._node, self._settings = node, settings
        self._odometry, self._goal, self._commands = odometry, goal, commands
        self.restart()

    def restart(self) -> None:
        """Wait anew."""
        self._since = self._counted_from = self._node.steady_now()
        self._announced, self._met_at = '', math.inf

    @property
    def lasted(self) -> float:
        """Return how long it has lasted, the configuration of a planner left out [s]."""
        return self._node.steady_now() - self._counted_from

    def for_readers(self) -> str:
        """Return which readers are missing; empty if none is."""
        return self._announce(self._readers_lacking())

    def for_all(self) -> str:
        """Return what is missing of planner and readers; empty if nothing is."""
        coming = self._planner_being_configured()
        if coming:  # its first start compiles, for as long as that takes
            self._counted_from = self._node.steady_now()
            return self._announce(f'{coming} to be configured: it may be compiling machine code')
        return self._announce(self._readers_lacking() or self.planner_lacking)

    @property
    def planner_lacking(self) -> str:
        """Return what is missing of a planner; empty if nothing is."""
        if not self._goal.get_subscription_count():
            return 'a subscriber of goal'
        return '' if self._commands.get_publisher_count() else 'a planner on cmd_vel'

    def _announce(self, awaited: str) -> str:
        lasts = self._node.steady_now() - self._since > SILENT
        if awaited and awaited != self._announced and lasts:
            self._announced = awaited
            self._node.get_logger().info(f'waits for {awaited}')
        return awaited

    def _readers_lacking(self) -> str:
        found, wanted = self._odometry.get_subscription_count(), self._settings.wait_subscribers
        if found < wanted:
            return f'subscribers of odom: {wanted} (there are {found})'
        readers = self._settings.wait_for
        counts = {topic: self._count(topic) for topic in readers}
        missing = [
            f'{count} of {topic} (there are {counts[topic]})'
            for topic, count in readers.items()
            if counts[topic] < count
        ]
        if missing:
            self._met_at = math.inf
            return f'readers: {", ".join(missing)}'
        self._met_at = min(self._met_at, self._node.steady_now())
        waited = not readers or self._node.steady_now() - self._met_at >= MEETING
        return '' if waited else 'the planner to meet its readers'

    def _count(self, topic: str) -> int:
        """Return how many read a topic beside planner and this node."""
        vehicle = {self._node.get_fully_qualified_name(), *self._planners()}
        found = self._node.get_subscriptions_info_by_topic(topic)
        return sum(e.node_name != UNKNOWN and _name(e) not in vehicle for e in found)

    def _planner_being_configured(self) -> str:
        """Return the name of a planner that does not subscribe to the goal yet; empty for none.

        Only a managed node is known to be on its way: others may read goals by another node.
        """
        readers = map(_name, self._node.get_subscriptions_info_by_topic(self._goal.topic_name))
        found = self._planners() - {*readers}
        managed = (name for name in found if self._node.count_publishers(f'{name}/{TRANSITIONS}'))
        return min(managed, default='')

    def _planners(self) -> set[str]:
        return {*map(_name, self._node.get_publishers_info_by_topic(self._commands.topic_name))}


def _name(endpoint: Any) -> str:
    return f'{endpoint.node_namespace.rstrip("/")}/{endpoint.node_name}'
