"""Rows on who else is there: other publishers, other qualities of service, a flood."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from geometry_msgs.msg import TwistStamped
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy

from orbimpc_ros.lab.faults import injection as onsets
from orbimpc_ros.lab.faults.fixtures import Lab
from orbimpc_ros.lab.faults.harness import STEP, Stand
from orbimpc_ros.lab.faults.injection import AFTER
from orbimpc_ros.lab.faults.outcome import Outcome, Trial
from orbimpc_ros.ros.process import qos

TOLD = 1.0  # [s] in which a mismatch must be told
MEET = 0.6  # [s] that discovery may take
FLOOD = 5000.0  # [Hz]
SETTLED = 1.0  # [s] after which a flood has been discovered
LATE = 5.0  # [ms] beyond a period


def _mismatch(lab: Lab, long: bool) -> Iterator[Outcome]:
    """Somebody subscribes to commands as latched, which they are not: no command would come."""
    for seed in onsets.SEEDS if long else onsets.SEEDS[:1]:
        stand = lab.shared('plain')
        stand.draw.seed(seed)
        stand.until_planned()
        stand.spin(stand.draw.uniform(0.0, STEP))
        begin = time.monotonic()
        latched = qos(1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        quiet = SubscriptionEventCallbacks(incompatible_qos=lambda _event: None)
        wrong = stand.node.create_subscription(
            TwistStamped, 'cmd_vel', lambda _message: None, latched, event_callbacks=quiet
        )
        stand.spin_until_error(begin)
        told = stand.watch.first_error(begin) - begin
        stand.node.destroy_subscription(wrong)
        yield onsets.recovered(stand, Outcome('latched cmd_vel', stand.watch.broken(begin), told))


def _two_sources(lab: Lab, long: bool) -> Iterator[Outcome]:
    """A second publisher of odometry: whom to believe?"""
    for onset in onsets.ONSETS[1:] if long else onsets.ONSETS[1:2]:
        for seed in onsets.SEEDS if long else onsets.SEEDS[:1]:
            stand = onsets.stand_for(lab, onset)
            stand.draw.seed(seed)
            begin = onsets.set_in(stand, onset, stand.add_source)
            stand.spin(MEET + STEP)
            stand.spin_until_safe(begin)
            stand.spin(AFTER * STEP)
            reaction = onsets.reaction(stand.watch.first_safe(begin), begin)
            again = stand.watch.moving_again(begin + MEET, begin + MEET + STEP)
            unsafe = stand.watch.broken(begin) + again
            stand.remove_source()
            yield onsets.recovered(stand, Outcome(f'another, {onset}', unsafe, reaction))


@contextmanager
def flooded(stand: Stand, rate: float) -> Iterator[Path]:
    """Have another process take over a stand's odometry, at a rate [Hz]; gives its log."""
    stand.mute()
    log = stand.folder / 'flood.log'
    words = [sys.executable, '-m', 'orbimpc_ros.lab.faults.flood', str(rate)]
    with log.open('wb') as stream:
        child = subprocess.Popen(
            words, env=stand.environment, stdin=subprocess.DEVNULL, stdout=stream
        )
    try:
        # Until it has started there is no odometry at all, and stops are right.
        stand.until(lambda: stand.node.count_publishers('odom') > 0, 'the flood')
        stand.spin(SETTLED)
        yield log
    finally:
        child.kill()
        child.wait()
        stand.unmute()


def _flood(lab: Lab, long: bool) -> Iterator[Outcome]:
    with lab.stand() as stand:
        stand.until_planned()
        with flooded(stand, FLOOD):
            begin = time.monotonic()
            stand.until_planned()
            settled = time.monotonic()
            stand.spin(30.0 if long else 4.0)
            times = [tick.at for tick in stand.watch.ticks if tick.at >= settled]
        if len(times) < 2:
            yield Outcome('5 kHz', stand.watch.broken(begin), failure='no ticks')
            return
        late = 1e3 * (np.percentile(np.diff(times), 99) - STEP)
        still = sum(each.safe for each in stand.watch.commands if each.at >= settled)
        failure = f'{still} safe commands' if 2 * still > len(times) else ''
        yield Outcome('5 kHz', stand.watch.broken(begin), max(0.0, late), failure)


TRIALS = (
    Trial('qos', 'a quality of service that does not match: told', TOLD, _mismatch, 's'),
    Trial('sources', 'two publishers of odometry', 1.0 + MEET / STEP, _two_sources),
    Trial('flood', 'odometry at 5 kHz: p99 of ticks beyond the period', LATE, _flood, 'ms'),
)
