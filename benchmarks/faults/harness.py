# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Harnesses of fault cases: nodes in their own DDS domain, a stimulus, and a monitor."""

from __future__ import annotations

import math
import random
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped
from harness import KEPT
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock

from benchmarks import session
from benchmarks.faults import stimulus
from benchmarks.faults.monitor import Event, Monitor, record
from benchmarks.session import PATIENCE, Session
from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.process import qos
from orbimpc_ros.tool.processes import Child

STEP = 0.2  # [s]
EPOCH = 1000.0  # [s] at which simulated time begins
RATE = 20.0  # [Hz] of odometry and goal
PLANNER: dict[str, Any] = {
    'step': STEP,
    'forward': 1.0,
    'floor.shape': 'polygon',
    'goal_timeout': 0.4,
    'goal_jump_limit': 5.0,
    'max_rate': 3.0,
    'safe_command': 'stop',  # by default it circles with a floor, which proves no reaction
}  # [s], [m/s], [m], [rad/s]


class Monitored(Session):
    """A session with a planner whose commands, ticks and diagnostics a monitor records.

    Args:
        nodes: their executor.
        values: of the planner's parameters, which limit commands.
        module: of the planner.

    Attributes:
        draw: generator of all random draws.
        planner: process of the planner that was started last.
    """

    draw = random.Random(0)
    planner: Child

    def __init__(
        self, nodes: str, values: Mapping[str, Any], module: str = session.PLANNER
    ) -> None:
        super().__init__(nodes)
        self._values, self._module = values, module
        fastest = values['max_rate'] or math.pi / values['step']
        self.monitor = Monitor(values['forward'], fastest)
        self.subscribe(TwistStamped, 'cmd_vel', self.monitor.on_command)
        self.subscribe(DiagnosticArray, 'tick', partial(record, self.monitor.ticks))
        self.subscribe(DiagnosticArray, '/diagnostics', partial(record, self.monitor.health))

    def start(self) -> None:
        """Start a planner."""
        self.planner = self.launch(self._module, self._values)

    def until_first(self, event: Event, since: float) -> float:
        """Spin until an event of the monitor since a time [s]; return its time, or infinity."""
        self.spin(PATIENCE, lambda: event(self.monitor, since) < math.inf)
        return event(self.monitor, since)


class Harness(Monitored):
    """Feeds a planner at a steady rate and records everything it publishes, until closed.

    Args:
        nodes: their executor.
        parameters: of the planner, in addition to those of all harnesses.
        simulated: whether to publish the planner's clock as well.
        module: of the planner.

    Attributes:
        jump: error of a simulated clock [s].
    """

    def __init__(
        self,
        nodes: str,
        parameters: Mapping[str, Any] | None = None,
        *,
        simulated: bool = False,
        module: str = session.PLANNER,
    ) -> None:
        values = PLANNER | dict(parameters or {}) | {'use_sim_time': simulated}
        super().__init__(nodes, values, module)
        self._simulated = simulated
        self._spoiled = dict[str, stimulus.Spoiler]()
        self.jump, self._frozen_at = 0.0, math.nan
        self._begun = time.monotonic()
        self._odometry: Any = self.node.create_publisher(Odometry, 'odom', qos(KEPT))
        self._goal = self.node.create_publisher(PoseStamped, 'goal', qos(KEPT))
        self._clock = self.node.create_publisher(Clock, '/clock', qos(KEPT))
        self.node.create_timer(1.0 / RATE, self._feed)
        self.start()

    @property
    def now(self) -> int:
        """Return the time for stamps [ns]."""
        if not self._simulated:
            return time.time_ns()
        at = time.monotonic() if math.isnan(self._frozen_at) else self._frozen_at
        return round((EPOCH + at - self._begun + self.jump) * messages.SECOND)

    @contextmanager
    def frozen(self) -> Iterator[None]:
        """Stop the clock within a context, and let it run on from there."""
        self._frozen_at = time.monotonic()
        yield
        self.jump += self._frozen_at - time.monotonic()
        self._frozen_at = math.nan

    @contextmanager
    def spoiling(self, topic: str, spoil: stimulus.Spoiler) -> Iterator[None]:
        """Alter ``odometry`` or ``goal`` messages before they are sent, within a context."""
        self._spoiled = {topic: spoil}
        yield
        self._spoiled = {}

    @contextmanager
    def muted(self) -> Iterator[None]:
        """Leave odometry to another publisher within a context."""
        self.node.destroy_publisher(self._odometry)
        self._odometry = None
        yield
        self._odometry = self.node.create_publisher(Odometry, 'odom', qos(KEPT))

    def until_planned(self) -> None:
        """Feed a healthy planner until it commands a motion."""
        since = time.monotonic()
        self.until(lambda: self.monitor.moving(since) > 0, 'a plan')

    def _feed(self) -> None:
        if self._simulated:
            self._clock.publish(Clock(clock=messages.time_message(self.now)))
        goal = stimulus.goal_at(time.monotonic() - self._begun, self.now)
        self._publish(self._goal, goal, 'goal')
        if self._odometry is not None:
            odometry = stimulus.odometry_at(time.monotonic() - self._begun, self.now)
            self._publish(self._odometry, odometry, 'odometry')

    def _publish(self, publisher: Any, message: Any, name: str) -> None:
        spoil = self._spoiled.get(name)
        for each in [message] if spoil is None else spoil(message, self.draw):
            publisher.publish(each)

    def set_live(self, **values: Any) -> None:
        """Set parameters of the running planner.

        Raises:
            OrbimpcError: they are refused.
        """
        parameters = [Parameter(k, value=v).to_parameter_msg() for k, v in values.items()]
        request = SetParameters.Request(parameters=parameters)
        results = self.call(SetParameters, '/planner/set_parameters', request).results
        refused = [result.reason for result in results if not result.successful]
        if refused:
            raise OrbimpcError(f'refused: {refused}')


class Bench(ExitStack):
    """Lends a healthy planner to one row after the other, and ends all when it is closed.

    Args:
        nodes: their executor.
    """

    def __init__(self, nodes: str) -> None:
        super().__init__()
        self.nodes, self._kept = nodes, dict[tuple[bool, bool], Harness]()

    @contextmanager
    def lent(self, slow: Mapping[str, Any], simulated: bool = False) -> Iterator[Harness]:
        """Lend a harness, slow or not; one on which an error was raised is lent no more."""
        harness = self._kept.pop((bool(slow), simulated), None)
        harness = harness or Harness(self.nodes, slow, simulated=simulated)
        self.callback(harness.close)
        for heard in (harness.monitor.commands, harness.monitor.ticks, harness.monitor.health):
            heard.clear()
        yield harness
        self._kept[bool(slow), simulated] = harness
