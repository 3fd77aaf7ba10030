# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner's condition on /diagnostics: every second, and at once when its level changes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from diagnostic_msgs.msg import DiagnosticArray

from orbimpc_ros.ros.process import Guarded, qos
from orbimpc_ros.ros.reports import ERROR, OK, WARN, Report, health_message

PERIOD = 1.0  # [s] between messages, at most
Condition = tuple[bytes, str]


def condition(
    wrong: Sequence[str], waiting: str, report: Report | None, notices: Sequence[str]
) -> Condition:
    """Return a planner's condition: a level with a message.

    Args:
        wrong: what is wrong around it, in words; empty ones do not count.
        waiting: why it does not plan, in words; empty if it does.
        report: of the last tick, if there was one.
        notices: what to warn of while all goes well; empty ones do not count.
    """
    if any(wrong):
        return ERROR, '; '.join(filter(None, wrong))
    if waiting:
        return WARN, '; '.join(filter(None, (waiting, *notices)))
    level, message = OK, 'ready'
    if report is not None:
        level, message = report.level, report.tick.reason or 'planning'
    if level == OK and any(notices):
        level = WARN
    return level, '; '.join(filter(None, (message, *notices)))


class Health:
    """Publishes the condition of a planner.

    Args:
        node: whose health.
        asked: for the condition.
        values: asked for, the counts behind it.
    """

    def __init__(
        self,
        node: Guarded,
        asked: Callable[[], Condition],
        values: Callable[[], Mapping[str, object]],
    ) -> None:
        self._node, self._asked, self._values = node, asked, values
        self._shown: Condition = (OK, '')
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', qos())
        # Whatever the node is just doing: an inactive planner says that it is.
        node.create_timer(PERIOD, node.guard(self.show), clock=node.steady)

    def show(self) -> None:
        """Publish how it is."""
        self._publish(self._asked())

    def show_changes(self) -> None:
        """Publish how it is if the level has changed."""
        asked = self._asked()
        if asked[0] != self._shown[0]:
            self._publish(asked)

    def _publish(self, shown: Condition) -> None:
        level, message = shown
        self._shown = shown
        now, name = self._node.get_clock().now().nanoseconds, self._node.get_fully_qualified_name()
        told = health_message(now, name, 'condition', level, message, self._values())
        self._publisher.publish(told)
