# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Rows of faults of a running planner: inputs, clocks, other participants, no feasible plan."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.event_handler import SubscriptionEventCallbacks

from benchmarks.faults import stimulus
from benchmarks.faults.harness import STEP, Harness
from benchmarks.faults.injection import MIDWAY, RUNNING, TIMES, Fault, injecting
from benchmarks.faults.matrix import FaultCase
from benchmarks.faults.monitor import Monitor, complaint
from benchmarks.faults.stimulus import HUGE, Spoiler, shifted, with_field
from orbimpc_ros.loop.planner import FALLBACK_TICKS
from orbimpc_ros.mpc.outcome import Fallback
from orbimpc_ros.ros.messages import ERROR
from orbimpc_ros.ros.process import LATCHED, qos

STALE = 0.3  # [s] odom_timeout: 1.5 steps
LADDER = FALLBACK_TICKS * STEP  # [s] that a shifted plan may be flown
LOST = 0.4 + LADDER  # [s] goal_timeout of the harness, plus the last plan
REPORT = 5.0  # ticks in which a mismatch must be reported
MEET = 0.6  # [s] for discovery
TURNED = 30.0  # ticks in which a wrong velocity frame must be reported, after a turn
NAN, INF = math.nan, math.inf
BEYOND = (NAN, INF, -INF, 1e300)
TO_ONE = 1.0  # [s] first time of a reset clock
WALLED_IN = [-50.0, -50.0, 50.0, 50.0]  # a box that contains all positions
ELSEWHERE = [10.0, 10.0, 11.0, 11.0]  # a box off the circle


def _odometry(name: str, spoil: Spoiler, **more: Any) -> Fault:
    return Fault(name, lambda each: each.spoiling('odometry', spoil), **{'wait': STALE} | more)


def _goal(name: str, spoil: Spoiler) -> Fault:
    return Fault(name, lambda each: each.spoiling('goal', spoil), wait=LOST)


# At each injection anew: a message from long ago would seem to come from another clock. Not at the
# start, where the first one repeats nothing.
REPEATED = Fault(
    'the same stamp', lambda at: at.spoiling('odometry', stimulus.repeated()), STALE, times=RUNNING
)


@contextmanager
def _jumped(by: float, harness: Harness) -> Iterator[None]:
    harness.jump += max(by, TO_ONE - 1e-9 * harness.now)
    yield


def _jump(name: str, by: float) -> Fault:
    return Fault(name, partial(_jumped, by), strict=False, times=RUNNING)


@contextmanager
def _walled(harness: Harness) -> Iterator[None]:
    """Enclose the vehicle in a box: no plan is feasible, and fallbacks must end."""
    harness.set_live(obstacles=WALLED_IN)
    yield
    harness.set_live(obstacles=ELSEWHERE)


def _reported(monitor: Monitor, since: float) -> float:
    """Return the time by which a safe command was sent and reported."""
    ticks = (tick for tick in monitor.ticks if Fallback.SAFE_COMMAND in tick.values['fallback'])
    stated = next((tick.at for tick in ticks if tick.at >= since), math.inf)
    return max(stated, monitor.first_safe(since))


@contextmanager
def _mismatched(harness: Harness) -> Iterator[None]:
    """Subscribe to commands with latched QoS, which is incompatible with theirs."""
    quiet = SubscriptionEventCallbacks(incompatible_qos=lambda _event: None)
    made = harness.node.create_subscription(
        TwistStamped, 'cmd_vel', lambda _message: None, LATCHED, event_callbacks=quiet
    )
    yield
    harness.node.destroy_subscription(made)


@contextmanager
def _doubled(harness: Harness) -> Iterator[None]:
    """Add a publisher of odometry: neither may be trusted."""
    second = harness.node.create_publisher(Odometry, 'odom', qos())
    yield
    harness.node.destroy_publisher(second)


FAULT_CASES = (
    FaultCase('odometry', 'stale odometry', 1.0, injecting(
        _odometry('no odometry', stimulus.lost), short=RUNNING)),
    FaultCase('goal', 'stale goal', 1.0, injecting(_goal('no goal', stimulus.lost))),
    FaultCase('stamps', 'future, repeated, malformed stamps', 1.0, injecting(
        _odometry('future stamps', shifted(5.0, 1e6)),
        _odometry('nanosec >= 1e9', with_field('header.stamp.nanosec', 10**9, 2**32 - 1)),
        _odometry('sec < 0', with_field('header.stamp.sec', -1, -(2**31))),
        REPEATED, short=RUNNING)),
    # At the start an unset stamp might be the zero of simulated time.
    FaultCase('unset', 'stamps that are not set, after good ones', 1.0, injecting(
        _odometry('stamps not set', with_field('header.stamp', Time()), times=RUNNING))),
    FaultCase('garbage', 'bytes that are no message', 1.0, injecting(
        _odometry('no odometry message', stimulus.garbled),
        _goal('no goal message', stimulus.garbled))),
    FaultCase('contents', 'NaN, Inf, quaternions, frames, huge strings', 1.0, injecting(
        _odometry('position', with_field('pose.pose.position.x', *BEYOND)),
        _odometry('orientation', with_field('pose.pose.orientation.w', *BEYOND)),
        _odometry('quaternion not unit', stimulus.scaled_quaternion),
        _odometry('velocity', with_field('twist.twist.linear.x', *BEYOND)),
        _odometry('rate', with_field('twist.twist.angular.z', *BEYOND)),
        _odometry('frame', with_field('header.frame_id', 'map', '', 'x' * HUGE)),
        _odometry('child frame', with_field('child_frame_id', 'map', '', '\x00' * HUGE)),
        _goal('goal position', with_field('pose.position.y', *BEYOND)),
        _goal('goal orientation', with_field('pose.orientation.x', *BEYOND)),
        _goal('goal quaternion not unit', stimulus.scaled_quaternion),
        _goal('goal frame', with_field('header.frame_id', 'map', 'x' * HUGE)),
        _goal('goal stamp in the future', shifted(5.0, 1e6)),
        _goal('goal stamp sec < 0', with_field('header.stamp.sec', -1)), short=TIMES)),
    FaultCase('frozen', 'clock frozen: safe after odom_timeout', 1.0, injecting(
        Fault('frozen', Harness.frozen, wait=STALE, times=RUNNING), simulated=True)),
    FaultCase('jumps', 'clock jumps or is reset', 1.0, injecting(
        _jump('back 0.5 s', -0.5), _jump('back 900 s', -900.0), _jump('reset to 1 s', -INF),
        _jump('forward 600 s', 600.0), short=(MIDWAY, MIDWAY), simulated=True)),
    FaultCase('twist', 'velocities in the wrong frame: reported', TURNED, injecting(
        _odometry('of the world', stimulus.in_the_world, wait=0.0, strict=False, times=(MIDWAY,),
                  event=complaint('see velocity_frame')))),
    FaultCase('infeasible', 'no plan: shifted plan, then safe', 1.0, injecting(
        Fault('walled in', _walled, wait=LADDER, event=_reported, times=RUNNING))),
    FaultCase('qos', 'a quality of service that does not match: reported', REPORT, injecting(
        Fault('latched cmd_vel', _mismatched, strict=False, times=(MIDWAY,),
              event=complaint('does not match', ERROR)))),
    FaultCase('sources', 'two publishers of odometry', 1.0, injecting(
        Fault('another', _doubled, wait=MEET, times=RUNNING))),
)  # fmt: skip
