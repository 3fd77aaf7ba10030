# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The other ends of the planner's topics: rivals, and QoS or types that do not match."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, qos_check_compatible
from rclpy.subscription import Subscription

from orbimpc_ros.ros.process import full_name

ERROR = 'ERROR: '  # how rclpy begins what makes two profiles incompatible


class EndpointMonitor:
    """Who is at the other ends of a planner's topics.

    They are looked at one topic at a time: each look is short, so that no odometry waits for it.
    DDS reports mismatches in events, too. But handlers of events lengthen every wait of the node,
    and no event reports the end of a mismatch.

    Args:
        node: whose topics to look at.
        odometry: its subscription to odometry.
        velocity: its publisher of commands; None if it commands nothing.

    Attributes:
        sources: that more than one publishes odometry, in words; empty if none or one does.
        rivals: that somebody else commands the vehicle as well, in words; empty if nobody does.
    """

    def __init__(self, node: Node, odometry: Subscription, velocity: Publisher | None) -> None:
        self._node, self._odometry, self._velocity = node, odometry, velocity
        self._rota: list[Any] = []
        self._mismatched: dict[str, str] = {}
        self.sources = self.rivals = ''

    @property
    def mismatches(self) -> list[str]:
        """Return which topics connect to somebody who cannot hear, or be heard, and why."""
        return [self._mismatched[topic] for topic in sorted(self._mismatched)]

    def look(self) -> None:
        """Look who else publishes odometry and commands, and at the ends of one more topic."""
        self.sources = self.rivals = ''
        where, count = self._odometry.topic_name, self._odometry.get_publisher_count()
        if count > 1:
            self.sources = f'{count} publishers on {where}, of which only one can be right'
        if self._velocity is not None:
            where = self._velocity.topic_name
            if (count := self._node.count_publishers(where)) > 1:
                self.rivals = f'{count} publishers on {where}: the vehicle hears them all'
        self._rota = self._rota or [*self._node.publishers, *self._node.subscriptions]
        end = self._rota.pop()
        self._mismatched.pop(end.topic_name, None)
        if mismatch := _mismatch(self._node, end):
            self._mismatched[end.topic_name] = mismatch


def _mismatch(node: Node, end: Publisher | Subscription) -> str:
    """Return who cannot hear ``end`` or be heard by it, and why; empty if there is nobody."""
    topic = end.topic_name
    message: Any = end.msg_type
    kind = f'{message.__module__.split(".")[0]}/msg/{message.__name__}'
    ends = node.get_publishers_info_by_topic(topic), node.get_subscriptions_info_by_topic(topic)
    same, others = ends if isinstance(end, Publisher) else ends[::-1]
    # DDS shows its view of one's own profile as of any other, its defaults filled in.
    own = [each.qos_profile for each in same if each.node_name == node.get_name()]
    for other in others if own else ():
        who = f'{topic} of {full_name(other)}'
        if other.topic_type != kind:
            return f'{who} is a {other.topic_type}, not a {kind}'
        pair = (own[0], other.qos_profile)
        verdict, why = qos_check_compatible(*(pair if same is ends[0] else pair[::-1]))
        if verdict == QoSCompatibility.ERROR:
            errors = [each for each in why.split(';') if each.startswith(ERROR)]
            return f'{who} does not match: {", ".join(e.removeprefix(ERROR) for e in errors)}'
    return ''
