# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The readers that a flight waits for: recorders and viewers, beside its own two nodes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.validate_topic_name import validate_topic_name

from orbimpc_ros.mpc.errors import BadInput

TRANSITIONS = 'transition_event'  # a topic of every managed node
RECORDED = 'odom, goal, cmd_vel, rotation, plan, tick'  # read by whoever records everything
MEETING = 1.5  # [s] that DDS may take to have planner and readers meet, which nobody else can see


def wanted_readers(text: str) -> dict[str, int]:
    """Return how many readers each topic of a list such as ``tick, odom 2`` must have.

    Raises:
        BadInput: not such a list.
    """
    wanted: dict[str, int] = {}
    for entry in filter(None, (each.strip() for each in text.split(','))):
        topic, _, count = entry.partition(' ')
        try:
            validate_topic_name(topic)
        except InvalidTopicNameException:
            raise _malformed(text) from None
        if '//' in topic or topic in wanted or not (count or '1').strip().isdecimal():
            raise _malformed(text)
        wanted[topic] = int(count or 1)
    if not all(0 < count <= 100 for count in wanted.values()):
        raise _malformed(text)
    return wanted


def _malformed(text: str) -> BadInput:
    return BadInput('wait_for', text, 'topics, each with the number of its readers: tick, odom 2')


class Readers:
    """Counts readers of topics, those of the planner and of the node that counts apart.

    Args:
        node: that counts.
        wanted: readers, by topic.
        commands: the topic that the planner publishes, by which it is known.
    """

    def __init__(self, node: Node, wanted: Mapping[str, int], commands: str) -> None:
        self._node, self._wanted, self._commands = node, wanted, commands
        self._met_at: float | None = None

    def lacking(self, now: float) -> str:
        """Return which readers are missing at ``now`` [s], in words; empty if none is."""
        found = {topic: self._count(topic) for topic in self._wanted}
        missing = [
            f'{wanted} of {topic} (there are {found[topic]})'
            for topic, wanted in self._wanted.items()
            if found[topic] < wanted
        ]
        if missing:
            self._met_at = None
            return f'readers: {", ".join(missing)}'
        self._met_at = now if self._met_at is None else self._met_at
        waited = not self._wanted or now - self._met_at >= MEETING
        return '' if waited else 'the planner to meet its readers'

    def planner_without(self, goal: str) -> str:
        """Return the name of a planner that does not read the goal yet; empty if none is so far.

        Only a managed node is known to be on its way: others may read goals by another node.
        """
        readers = {*map(_name_of, self._node.get_subscriptions_info_by_topic(goal))}
        found = self._planners() - readers
        managed = (name for name in found if self._node.count_publishers(f'{name}/{TRANSITIONS}'))
        return min(managed, default='')

    def _count(self, topic: str) -> int:
        found = self._node.get_subscriptions_info_by_topic(topic)
        vehicle = {_name(self._node), *self._planners()}
        # A reader is known before its node is.
        return sum(_name_of(each) not in vehicle and _known(each) for each in found)

    def _planners(self) -> set[str]:
        return {_name_of(each) for each in self._node.get_publishers_info_by_topic(self._commands)}


def _name(node: Node) -> str:
    return node.get_fully_qualified_name()


def _name_of(endpoint: Any) -> str:
    return f'{endpoint.node_namespace.rstrip("/")}/{endpoint.node_name}'


def _known(endpoint: Any) -> bool:
    return endpoint.node_name != '_NODE_NAME_UNKNOWN_'
