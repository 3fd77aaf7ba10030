"""The row on commands that a vehicle must not obey: a simulator, and somebody hostile."""

from __future__ import annotations

import math
import random
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry

from orbimpc_ros.lab.faults import stimulus as feed
from orbimpc_ros.lab.faults.fixtures import Lab
from orbimpc_ros.lab.faults.harness import PATIENCE, RATE, STEP
from orbimpc_ros.lab.faults.monitor import Limits, Watch
from orbimpc_ros.lab.faults.outcome import Outcome, Trial
from orbimpc_ros.lab.faults.stimulus import Spoiler, shifted, with_field
from orbimpc_ros.lab.faults.test_node import Ears
from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.ros.process import qos
from orbimpc_ros.tool.io import settings
from orbimpc_ros.tool.run.processes import Process

TOLD = 1.5  # [s] in which a refusal must be told; they are told once a second
LASTS = 2.0  # [s]
HOSTILE: dict[str, Spoiler] = {
    'speed not finite': with_field('twist.linear.x', math.nan, math.inf, 1e300),
    'rate not finite': with_field('twist.angular.z', math.nan, -math.inf),
    'too fast': with_field('twist.linear.x', 1.1, 100.0),
    'backwards': with_field('twist.linear.x', -0.1, -100.0),
    'too fast a turn': with_field('twist.angular.z', 1.1 * math.pi / STEP, -100.0),
    'stamp of the future': shifted(5.0, 1e6),
    'nanosec >= 1e9': with_field('header.stamp.nanosec', 10**9),
    'sec < 0': with_field('header.stamp.sec', -1),
}


class Target:
    """A simulator in real time that nobody else commands, until closed."""

    def __init__(self, lab: Lab) -> None:
        folder, domain = lab.place()
        self.watch = Watch(Limits(1.0, math.pi / STEP))
        self.places: list[tuple[float, float]] = []
        self.ears = Ears(domain)
        self.ears.listen(DiagnosticArray, '/diagnostics', self.watch.on_health)
        self.ears.listen(Odometry, 'odom', self._on_odometry)
        self.publisher = self.ears.node.create_publisher(TwistStamped, 'cmd_vel', qos())
        file = folder / 'sim.yaml'
        settings.write(file, {'clock': 'wall', 'step': STEP, 'max_ticks': 100_000})
        self.sim = Process('orbimpc_ros.ros.sim', file, folder / 'sim.log', domain)

    def _on_odometry(self, message: Odometry) -> None:
        place = message.pose.pose.position
        self.places.append((place.x, place.y))

    def until_connected(self) -> None:
        """Listen until the simulator is there.

        Raises:
            OrbimpcError: it is not.
        """
        end = time.monotonic() + PATIENCE
        self.ears.hear_until(end, lambda: bool(self.places) and self._heard)
        if not self.places or not self._heard:
            raise OrbimpcError(f'waited {PATIENCE:g} s in vain for the simulator')

    @property
    def _heard(self) -> bool:
        return self.publisher.get_subscription_count() > 0

    def close(self) -> None:
        """Stop the simulator."""
        self.sim.stop()
        self.ears.close()


@contextmanager
def _target(lab: Lab) -> Iterator[Target]:
    target = Target(lab)
    try:
        target.until_connected()
        yield target
    finally:
        target.close()


def _hostile(lab: Lab, long: bool) -> Iterator[Outcome]:
    with _target(lab) as target:
        for name, spoil in list(HOSTILE.items())[: None if long else 3]:
            for seed in (1, 2, 3) if long else (1,):
                yield _commanded(target, name, spoil, random.Random(f'{name} {seed}'))


def _commanded(target: Target, name: str, spoil: Spoiler, draw: random.Random) -> Outcome:
    """Send one kind of bad command again and again: the vehicle stays where it is."""
    begin, before = time.monotonic(), target.places[-1]
    while time.monotonic() < begin + LASTS:
        for each in spoil(_sound(), draw):
            target.publisher.publish(each)
        target.ears.hear_until(time.monotonic() + 1.0 / RATE)
    moved = sum(place != before for place in target.places)
    told = target.watch.first_complaint(begin, 'refused') - begin
    return Outcome(name, moved, told, '' if target.sim.running else 'the simulator has ended')


def _sound() -> Any:
    message = TwistStamped(header=feed.odometry_at(0.0, time.time_ns()).header)
    message.twist.linear.x = 0.5
    return message


TRIALS = (
    Trial('commands', 'hostile commands to the simulator: refused and told', TOLD, _hostile, 's'),
)
