"""The row on commands that a vehicle must not obey: a simulator, and somebody hostile."""

from __future__ import annotations

import math
import random
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry

from orbimpc_ros.lab.faults import stimulus
from orbimpc_ros.lab.faults.fixtures import Fixtures
from orbimpc_ros.lab.faults.harness import RATE, STEP
from orbimpc_ros.lab.faults.monitor import Limits
from orbimpc_ros.lab.faults.outcome import FaultCase, Outcome
from orbimpc_ros.lab.faults.session import Session
from orbimpc_ros.lab.faults.stimulus import Spoiler, shifted, with_field
from orbimpc_ros.ros.process import qos

REPORT = 1.5  # [s] in which a refusal must be reported; the simulator does so once a second
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


class Target(Session):
    """A simulator in real time that nobody else commands, until closed."""

    def __init__(self, folder: Path, domain: int) -> None:
        super().__init__(folder, domain, Limits(1.0, math.pi / STEP))
        self.places: list[tuple[float, float]] = []
        self.test_node.subscribe(Odometry, 'odom', self._on_odometry)
        self.publisher = self.test_node.node.create_publisher(TwistStamped, 'cmd_vel', qos())
        values = {'clock': 'wall', 'step': STEP, 'max_ticks': 100_000}
        self.sim = self.launch('orbimpc_ros.ros.sim', values)

    def _on_odometry(self, message: Odometry) -> None:
        place = message.pose.pose.position
        self.places.append((place.x, place.y))

    def until_connected(self) -> None:
        """Listen until the simulator hears and is heard."""
        own = 1  # subscription of the monitor
        heard = self.publisher.get_subscription_count
        self.until(lambda: bool(self.places) and heard() > own, 'the simulator')


def _hostile(fixtures: Fixtures, long: bool) -> Iterator[Outcome]:
    with Target(*fixtures.place()) as target:
        target.until_connected()
        for name, spoil in list(HOSTILE.items())[: None if long else 3]:
            for seed in (1, 2, 3) if long else (1,):
                yield _commanded(target, name, spoil, random.Random(f'{name} {seed}'))


def _commanded(target: Target, name: str, spoil: Spoiler, draw: random.Random) -> Outcome:
    """Send one kind of bad command again and again: the vehicle stays where it is."""
    begin, before = time.monotonic(), target.places[-1]
    while time.monotonic() < begin + LASTS:
        for each in spoil(_sound(), draw):
            target.publisher.publish(each)
        target.spin(1.0 / RATE)
    moved = sum(place != before for place in target.places)
    reported = target.monitor.first_complaint(begin, 'refused') - begin
    return Outcome(name, moved, reported, '' if target.sim.running else 'the simulator has ended')


def _sound() -> Any:
    message = TwistStamped(header=stimulus.odometry_at(0.0, time.time_ns()).header)
    message.twist.linear.x = 0.5
    return message


FAULT_CASES = (
    FaultCase(
        'commands', 'hostile commands to the simulator: refused and told', REPORT, _hostile, 's'
    ),
)
