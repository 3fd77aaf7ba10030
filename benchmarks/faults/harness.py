# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Harnesses of fault cases: nodes in a domain of their own, their stimulus, and a monitor."""

from __future__ import annotations

import math
import random
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped
from harness import KEPT, Observer
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock

from benchmarks.faults import stimulus
from benchmarks.faults.monitor import Limits, Monitor
from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.process import qos
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.run import discovery
from orbimpc_ros.tool.run.processes import Process, Processes

Some = TypeVar('Some', bound='Session')
PATIENCE = 60.0  # [s] for anything awaited, on a busy machine too
STEP = 0.2  # [s]
EPOCH = 1000.0  # [s] at which simulated time begins
RATE = 20.0  # [Hz] of odometry and goal
NODE = 'orbimpc_ros.ros.planner'
PLANNER: dict[str, Any] = {
    'step': STEP,
    'floor.shape': 'polygon',
    'goal_timeout': 0.4,
    'goal_jump_limit': 5.0,
    'max_rate': 3.0,
    'safe_command': 'stop',  # with a floor it would be to circle, which is no sign to judge by
}  # [s], [m], [rad/s]


class Session(Observer):
    """Processes that are stopped when the session ends.

    Args:
        fixtures: give it a folder, a DDS domain and the executor of nodes.
        limits: of commands.

    Attributes:
        folder: takes parameters and logs.
        monitor: of commands, ticks and diagnostics.
    """

    def __init__(self, fixtures: Fixtures, limits: Limits) -> None:
        self.folder = Path(tempfile.mkdtemp(dir=fixtures.root))
        self.executor = fixtures.executor
        self.monitor = Monitor(limits)
        super().__init__(discovery.isolate(self.folder))
        self.subscribe(TwistStamped, 'cmd_vel', self.monitor.on_command)
        self.subscribe(DiagnosticArray, 'tick', self.monitor.on_tick)
        self.subscribe(DiagnosticArray, '/diagnostics', self.monitor.on_health)
        self._processes = Processes()

    def launch(self, module: str, values: Mapping[str, Any]) -> Process:
        """Return a new process of a node's module with parameters."""
        name = f'{module.rpartition(".")[2]}-{len(self._processes) + 1}'
        file = self.folder / f'{name}.yaml'
        file.write_text(settings.text({**values, 'executor': self.executor}))
        return self._processes.start(module, file, file.with_suffix('.log'), self.domain)

    def until(self, done: Callable[[], Any], what: str = '') -> None:
        """Spin until ``done``.

        Raises:
            OrbimpcError: it never is, or the last process has ended.
        """
        self.spin(PATIENCE, lambda: bool(done()) or not self._processes[-1].running)
        if not done():
            self._processes[-1].require_health()
            raise OrbimpcError(f'waited {PATIENCE:g} s in vain for {what}')

    def until_first(self, event: Callable[[Monitor, float], float], since: float) -> float:
        """Spin until an event of the monitor since a time [s]; return when, infinite for never."""
        self.spin(PATIENCE, lambda: event(self.monitor, since) < math.inf)
        return event(self.monitor, since)

    def __enter__(self: Some) -> Some:
        return self

    def __exit__(self, *_error: object) -> None:
        self._processes.__exit__()
        self.close()


class Harness(Session):
    """Feeds a planner at a steady rate and records all that it publishes, until closed.

    Args:
        fixtures: of the session.
        parameters: of the planner, beside those of all harnesses.
        simulated: whether to be the planner's clock as well.
        seed: of all draws.
        module: of the planner.

    Attributes:
        planner: its process.
        draw: generator of all draws.
        spoiled: changes of ``odometry`` and ``goal`` on their way; what is not in it is healthy.
        jump: error of the clock [s]; only where that is simulated.
    """

    def __init__(
        self,
        fixtures: Fixtures,
        parameters: Mapping[str, Any] | None = None,
        *,
        simulated: bool = False,
        seed: int = 0,
        module: str = NODE,
    ) -> None:
        self._values = PLANNER | dict(parameters or {}) | {'use_sim_time': simulated}
        super().__init__(fixtures, Limits(1.0, self._values['max_rate']))
        self._simulated, self._module = simulated, module
        self.draw, self.spoiled = random.Random(seed), dict[str, stimulus.Spoiler]()
        self.jump, self._frozen_at = 0.0, math.nan
        self._begun = self._due = time.monotonic()
        self.odometry: Any = self.node.create_publisher(Odometry, 'odom', qos(KEPT))
        self.goal = self.node.create_publisher(PoseStamped, 'goal', qos(KEPT))
        self._clock = self.node.create_publisher(Clock, '/clock', qos(KEPT))
        self.start()

    def start(self) -> None:
        """Start a planner."""
        self.planner = self.launch(self._module, self._values)

    @property
    def now(self) -> int:
        """Return the time for stamps [ns]."""
        if not self._simulated:
            return time.time_ns()
        at = time.monotonic() if math.isnan(self._frozen_at) else self._frozen_at
        return round((EPOCH + at - self._begun + self.jump) * messages.SECOND)

    def freeze(self) -> None:
        """Stop the clock."""
        self._frozen_at = time.monotonic()

    def thaw(self) -> None:
        """Let the clock run on from where it stopped."""
        self.jump += self._frozen_at - time.monotonic()
        self._frozen_at = math.nan

    def spin(self, seconds: float, done: Callable[[], bool] = lambda: False) -> None:
        """Feed and listen for a while, or until ``done``."""
        end = time.monotonic() + seconds
        while (now := time.monotonic()) < end and not done():
            if now >= self._due:
                self._due = max(self._due + 1.0 / RATE, now)
                self._feed()
            self.spin_once(min(self._due, end) - time.monotonic())

    def until_planned(self) -> None:
        """Feed a healthy planner until it commands to move."""
        since = time.monotonic()
        self.until(lambda: self.monitor.moving(since) > 0, 'a plan')

    def _feed(self) -> None:
        if self._simulated:
            self._clock.publish(Clock(clock=messages.time_message(self.now)))
        goal = stimulus.goal_at(time.monotonic() - self._begun, self.now)
        self._publish(self.goal, goal, 'goal')
        if self.odometry is not None:
            odometry = stimulus.odometry_at(time.monotonic() - self._begun, self.now)
            self._publish(self.odometry, odometry, 'odometry')

    def _publish(self, publisher: Any, message: Any, name: str) -> None:
        spoil = self.spoiled.get(name)
        for each in [message] if spoil is None else spoil(message, self.draw):
            publisher.publish(each)

    def mute(self) -> None:
        """Leave odometry to another publisher."""
        self.node.destroy_publisher(self.odometry)
        self.odometry = None

    def unmute(self) -> None:
        """Publish odometry again."""
        self.odometry = self.node.create_publisher(Odometry, 'odom', qos(KEPT))

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


class Fixtures(NamedTuple):
    """Makes harnesses, each for its user to close."""

    root: Path  # takes a folder of parameters and logs for each session
    executor: str = 'wait_set'  # of the nodes

    def harness(self, parameters: Mapping[str, Any] | None = None, **more: Any) -> Harness:
        """Return a new harness."""
        return Harness(self, parameters, **more)
