"""How the planner is, on /diagnostics: every second, and at once when it gets better or worse."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from diagnostic_msgs.msg import DiagnosticArray

from orbimpc_ros.ros.process import Guarded, qos
from orbimpc_ros.ros.reports import OK, diagnostics

PERIOD = 1.0  # [s] how often it is told, at least
Condition = tuple[bytes, str]


class Health:
    """Publishes a condition, a level with a message, and the counts behind it.

    Args:
        node: whose health.
        condition: asked for the level and the message.
        values: asked for the counts.
    """

    def __init__(
        self,
        node: Guarded,
        condition: Callable[[], Condition],
        values: Callable[[], Mapping[str, object]],
    ) -> None:
        self._node, self._condition, self._values = node, condition, values
        self._shown: Condition = (OK, '')
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', qos())
        node.every(PERIOD, self.show)

    def show(self) -> None:
        """Publish how it is."""
        self._publish(self._condition())

    def show_changes(self) -> None:
        """Publish how it is if the level has changed."""
        condition = self._condition()
        if condition[0] != self._shown[0]:
            self._publish(condition)

    def _publish(self, condition: Condition) -> None:
        level, message = condition
        if message != self._shown[1] and message.startswith('waits'):
            self._node.get_logger().info(message)
        self._shown = condition
        now, name = self._node.get_clock().now().nanoseconds, self._node.get_fully_qualified_name()
        self._publisher.publish(diagnostics(now, name, level, message, self._values()))
