# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Rows on the other participants: publishers, qualities of service, a flood."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy

from benchmarks.faults import injection
from benchmarks.faults.flood import excused, pauses
from benchmarks.faults.harness import STEP, Fixtures, Harness
from benchmarks.faults.injection import AFTER
from benchmarks.faults.outcome import FaultCase, Outcome
from orbimpc_ros.ros.process import qos

REPORT = 1.0  # [s] in which a mismatch must be reported
MEET = 0.6  # [s] that discovery may take
FLOOD = 5000.0  # [Hz]
SETTLED = 1.0  # [s] after which a flood has been discovered
LATE = 5.0  # [ms] beyond a period


def _mismatch(fixtures: Fixtures, long: bool) -> Iterator[Outcome]:
    """Somebody subscribes to commands as latched, which they are not: no command would come."""
    latched = qos(1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    quiet = SubscriptionEventCallbacks(incompatible_qos=lambda _event: None)
    for harness, when in injection.harnesses(fixtures, long):
        injection.until_due(harness, when)
        begin = time.monotonic()
        wrong = harness.node.create_subscription(
            TwistStamped, 'cmd_vel', lambda _message: None, latched, event_callbacks=quiet
        )
        reported = harness.until_first(harness.monitor.first_error, begin) - begin
        harness.node.destroy_subscription(wrong)
        unsafe = harness.monitor.broken(begin)
        yield injection.recovered(harness, Outcome('latched cmd_vel', unsafe, reported))


def _two_sources(fixtures: Fixtures, long: bool) -> Iterator[Outcome]:
    """A second publisher of odometry: neither may be believed."""
    for harness, when in injection.harnesses(fixtures, long, injection.TIMES[1:]):
        injection.until_due(harness, when)
        second = harness.node.create_publisher(Odometry, 'odom', qos())
        begin = time.monotonic()
        harness.spin(MEET + STEP)
        safe = harness.until_first(harness.monitor.first_safe, begin)
        harness.spin(AFTER * STEP)
        again = harness.monitor.moving_again(begin + MEET, begin + MEET + STEP)
        unsafe = harness.monitor.broken(begin) + again
        harness.node.destroy_publisher(second)
        outcome = Outcome(f'another, {when}', unsafe, injection.reaction(safe, begin))
        yield injection.recovered(harness, outcome)


@contextmanager
def flooded(harness: Harness, rate: float) -> Iterator[Path]:
    """Have another process take over a harness's odometry, at a rate [Hz]; gives its log."""
    harness.mute()
    log, domain = harness.folder / 'flood.log', {'ROS_DOMAIN_ID': str(harness.domain)}
    words = [sys.executable, '-m', 'benchmarks.faults.flood', str(rate)]
    with log.open('wb') as stream:
        child = subprocess.Popen(
            words, env=os.environ | domain, stdin=subprocess.DEVNULL, stdout=stream
        )
    try:
        # Until it has started there is no odometry at all, and stops are right.
        harness.until(lambda: harness.node.count_publishers('odom') > 0, 'the flood')
        harness.spin(SETTLED)
        yield log
    finally:
        child.kill()
        child.wait()
        harness.unmute()


def _flood(fixtures: Fixtures, long: bool) -> Iterator[Outcome]:
    with fixtures.harness() as harness:
        harness.until_planned()
        with flooded(harness, FLOOD) as log:
            begin = time.monotonic()
            harness.until_planned()
            settled = time.monotonic()
            harness.spin(30.0 if long else 4.0)
            # On a busy machine that may be too short for two plans.
            harness.until(lambda: len(_moves(harness, log, settled)) > 1, 'plans in a flood')
            moved = _moves(harness, log, settled)
        late = 1e3 * (np.percentile(np.diff(moved), 99) - STEP)
        yield Outcome('5 kHz', harness.monitor.broken(begin), max(0.0, late))


def _moves(harness: Harness, log: Path, since: float) -> list[float]:
    """Return when there were plans, or what excused that there was none [s]."""
    paused = [*pauses(log), *harness.pauses]
    # A planner that has no time to read what is new is right to stop, and late.
    return [
        each.at
        for each in harness.monitor.commands
        if each.at >= since and not (each.safe and not excused(each.at, paused, 2.0 * STEP))
    ]


FAULT_CASES = (
    FaultCase('qos', 'a quality of service that does not match: reported', REPORT, _mismatch, 's'),
    FaultCase('sources', 'two publishers of odometry', 1.0 + MEET / STEP, _two_sources),
    FaultCase(
        'flood',
        'odometry at 5 kHz: p99 from plan to plan, beyond the period',
        LATE,
        _flood,
        'ms',
    ),
)
