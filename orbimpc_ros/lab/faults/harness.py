"""A test stand: one planner in a process of its own, what feeds it, and the watch on it."""

from __future__ import annotations

import math
import os
import random
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock

from orbimpc_ros.lab.faults import stimulus as feed
from orbimpc_ros.lab.faults.monitor import Limits, Watch
from orbimpc_ros.lab.faults.test_node import KEPT, Ears
from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.process import qos
from orbimpc_ros.tool.io import settings
from orbimpc_ros.tool.run.processes import Process

STEP = 0.2  # [s]
EPOCH = 1000.0  # [s] at which simulated time begins
RATE = 20.0  # [Hz] of odometry and goal
PATIENCE = 60.0  # [s] for anything awaited, on a busy machine too
PLANNER: dict[str, Any] = {
    'step': STEP,
    'floor.shape': 'polygon',
    'goal_timeout': 0.4,
    'goal_jump_limit': 5.0,
    'max_rate': 3.0,
    'safe_command': 'stop',  # with a floor it would be to circle, which is no sign to judge by
}  # [s], [m], [rad/s]


class Stand:
    """Feeds a planner at a steady rate and hears all that it says, until closed.

    Args:
        folder: takes parameters and logs.
        domain: of ROS, nobody else's.
        parameters: of the planner, beside those of all stands.
        simulated: whether to be the planner's clock as well.
        seed: of all that is drawn.
        module: of the planner.

    Attributes:
        folder: the same.
        watch: on the planner.
        planner: its process.
        spoiled: what is wrong with the feed.
        running: whether the clock runs; only where that is simulated.
        jump: what the clock is off [s].
        frozen_at: when the clock was stopped last, on the monotonic clock [s].
        fed: whether it is fed at all.
    """

    def __init__(
        self,
        folder: Path,
        domain: int,
        parameters: Mapping[str, Any] | None = None,
        *,
        simulated: bool = False,
        seed: int = 0,
        module: str = 'orbimpc_ros.ros.planner',
    ) -> None:
        self.folder, self._domain, self._simulated = folder, domain, simulated
        self._values = PLANNER | dict(parameters or {}) | {'use_sim_time': simulated}
        self._module = module
        self.draw = random.Random(seed)
        self.watch = Watch(Limits(1.0, self._values['max_rate']))
        self.spoiled = feed.Spoiled('nothing')
        self.running, self.jump, self.fed = True, 0.0, True
        self._begun, self._due, self._count = time.monotonic(), 0.0, 0
        self.frozen_at = 0.0
        self._connect()
        self.start()

    def _connect(self) -> None:
        self._ears = Ears(self._domain)
        self.node = self._ears.node
        listen = self._ears.listen
        listen(TwistStamped, 'cmd_vel', self.watch.on_command)
        listen(DiagnosticArray, 'tick', self.watch.on_tick)
        listen(DiagnosticArray, '/diagnostics', self.watch.on_health)
        self.odometry: Any = self.node.create_publisher(Odometry, 'odom', qos(KEPT))
        self.goal = self.node.create_publisher(PoseStamped, 'goal', qos(KEPT))
        self._clock = self.node.create_publisher(Clock, '/clock', qos(KEPT))

    def start(self) -> None:
        """Start a planner."""
        self._count += 1
        file = self.folder / f'planner-{self._count}.yaml'
        settings.write(file, {}, **self._values)
        log = file.with_suffix('.log')
        self.planner = Process(self._module, file, log, self._domain)

    # --- time

    @property
    def now(self) -> int:
        """Return the time that messages are stamped with [ns]."""
        if not self._simulated:
            return time.time_ns()
        at = time.monotonic() if self.running else self.frozen_at
        return round((EPOCH + at - self._begun + self.jump) * messages.SECOND)

    def freeze(self) -> None:
        """Stop the clock."""
        self.frozen_at, self.running = time.monotonic(), False

    def thaw(self) -> None:
        """Let the clock run on from where it stopped."""
        self.jump += self.frozen_at - time.monotonic()
        self.running = True

    def spin(self, seconds: float, done: Callable[[], bool] = lambda: False) -> None:
        """Feed and listen for a while, or until ``done``."""
        end = time.monotonic() + seconds
        while (now := time.monotonic()) < end and not done():
            if now >= self._due:
                self._due = max(self._due + 1.0 / RATE, now)
                self._feed()
            wait = min(self._due, end) - time.monotonic()
            self._ears.hear(wait)

    def until(self, done: Callable[[], bool], what: str) -> None:
        """Feed and listen until ``done``.

        Raises:
            OrbimpcError: it never is.
        """
        self.spin(PATIENCE, lambda: done() or not self.planner.running)
        if not done():
            self.planner.require_health()
            raise OrbimpcError(f'waited {PATIENCE:g} s in vain for {what}')

    def until_planned(self) -> None:
        """Feed a healthy planner until it commands to move."""
        since = time.monotonic()
        self.until(lambda: self.watch.planned_since(since), 'a plan')

    def until_heard(self) -> None:
        """Feed a planner until it says anything."""
        self.until(lambda: bool(self.watch.health), 'its diagnostics')

    def spin_until_safe(self, since: float) -> None:
        """Feed a planner until it has sent a safe command since a time [s], or in vain."""
        self.spin(PATIENCE, lambda: self.watch.first_safe(since) < math.inf)

    def spin_until_error(self, since: float) -> None:
        """Feed a planner until it has told of an error since a time [s], or in vain."""
        self.spin(PATIENCE, lambda: self.watch.first_error(since) < math.inf)

    def spin_until_complaint(self, since: float, word: str) -> None:
        """Feed a planner until it has complained of a word since a time [s], or in vain."""
        self.spin(PATIENCE, lambda: self.watch.first_complaint(since, word) < math.inf)

    def spin_until_gone(self, seconds: float) -> None:
        """Feed a planner until it has ended, ``seconds`` at most."""
        self.spin(seconds, lambda: not self.planner.running)

    def _feed(self) -> None:
        if self._simulated:
            self._clock.publish(Clock(clock=messages.time_message(self.now)))
        if not self.fed:
            return
        goal = feed.goal_at(time.monotonic() - self._begun, self.now)
        self._publish(self.goal, goal, self.spoiled.goal)
        if self.odometry is not None:
            self._publish(self.odometry, self.healthy_odometry(), self.spoiled.odometry)

    def healthy_odometry(self) -> Odometry:
        """Return what nothing is wrong with."""
        return feed.odometry_at(time.monotonic() - self._begun, self.now)

    def _publish(self, publisher: Any, message: Any, spoil: feed.Spoiler | None) -> None:
        for each in [message] if spoil is None else spoil(message, self.draw):
            publisher.publish(each)

    @property
    def environment(self) -> dict[str, str]:
        """Return the environment of a process that is to join."""
        return os.environ | {'ROS_DOMAIN_ID': str(self._domain)}

    def mute(self) -> None:
        """Leave odometry to another publisher."""
        self.node.destroy_publisher(self.odometry)
        self.odometry = None

    def unmute(self) -> None:
        """Publish odometry again."""
        self.odometry = self.node.create_publisher(Odometry, 'odom', qos(KEPT))

    def add_source(self) -> None:
        """Add a second publisher of odometry, a silent one."""
        self._second = self.node.create_publisher(Odometry, 'odom', qos())

    def remove_source(self) -> None:
        """Remove the second publisher."""
        self.node.destroy_publisher(self._second)

    def call(self, kind: Any, name: str, request: Any) -> Any:
        """Return the response of a service of the planner."""
        client = self.node.create_client(kind, name)
        self.until(client.service_is_ready, name)
        future = client.call_async(request)
        self.until(future.done, name)
        self.node.destroy_client(client)
        return future.result()

    def __enter__(self) -> Stand:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.planner.stop()
        self._ears.close()
