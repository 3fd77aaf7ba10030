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
from benchmarks.faults.injection import MIDWAY, RUNNING, SOLVING, START, Fault, fault_case
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


def _spoiled(name: str, topic: str, spoil: Spoiler, **more: Any) -> Fault:
    return Fault(name, lambda harness: harness.spoiling(topic, spoil), **more)


def _odometry(name: str, spoil: Spoiler, **more: Any) -> Fault:
    return _spoiled(name, 'odometry', spoil, wait=STALE, **more)


def _goal(name: str, spoil: Spoiler, **more: Any) -> Fault:
    return _spoiled(name, 'goal', spoil, wait=LOST, **more)


def _stamps() -> list[Fault]:
    return [
        _odometry('future stamps', shifted(5.0, 1e6)),
        _odometry('nanosec >= 1e9', with_field('header.stamp.nanosec', 10**9, 2**32 - 1)),
        _odometry('sec < 0', with_field('header.stamp.sec', -1, -(2**31))),
        # at each injection anew: one from long ago would seem to come from another clock
        Fault(
            'the same stamp',
            lambda harness: harness.spoiling('odometry', stimulus.repeated()),
            wait=STALE,
        ),
    ]


def _contents() -> list[Fault]:
    return [
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
        _goal('goal stamp sec < 0', with_field('header.stamp.sec', -1)),
    ]


def _jumps() -> list[Fault]:
    jumps = {'back 0.5 s': -0.5, 'back 900 s': -900.0, 'reset to 1 s': -INF, 'forward 600 s': 600.0}

    @contextmanager
    def jumped(by: float, harness: Harness) -> Iterator[None]:
        harness.jump += max(by, TO_ONE - 1e-9 * harness.now)
        yield

    return [Fault(name, partial(jumped, by), strict=False, times=RUNNING)
            for name, by in jumps.items()]  # fmt: skip


def _infeasible() -> list[Fault]:
    """Return a box that encloses the vehicle: no plan is feasible, and fallbacks must end."""

    def reported(monitor: Monitor, since: float) -> float:
        """Return the time by which a safe command was sent and reported."""
        ticks = (tick for tick in monitor.ticks if Fallback.SAFE_COMMAND in tick.values['fallback'])
        stated = next((tick.at for tick in ticks if tick.at >= since), math.inf)
        return max(stated, monitor.first_safe(since))

    @contextmanager
    def walled(harness: Harness) -> Iterator[None]:
        harness.set_live(obstacles=WALLED_IN)
        yield
        harness.set_live(obstacles=ELSEWHERE)

    return [Fault('walled in', walled, wait=LADDER, event=reported, times=RUNNING)]


def _mismatch() -> list[Fault]:
    """Return a subscription with latched QoS, which is incompatible with commands."""
    quiet = SubscriptionEventCallbacks(incompatible_qos=lambda _event: None)

    @contextmanager
    def subscribed(harness: Harness) -> Iterator[None]:
        made = harness.node.create_subscription(
            TwistStamped, 'cmd_vel', lambda _message: None, LATCHED, event_callbacks=quiet
        )
        yield
        harness.node.destroy_subscription(made)

    return [Fault('latched cmd_vel', subscribed, strict=False, event=complaint(level=ERROR),
                  times=(MIDWAY,))]  # fmt: skip


def _sources() -> list[Fault]:
    """Return a second publisher of odometry: neither may be trusted."""

    @contextmanager
    def published(harness: Harness) -> Iterator[None]:
        second = harness.node.create_publisher(Odometry, 'odom', qos())
        yield
        harness.node.destroy_publisher(second)

    return [Fault('another', published, wait=MEET, times=RUNNING)]


FAULT_CASES = (
    fault_case('odometry', 'stale odometry', lambda: [_odometry('no odometry', stimulus.lost)],
               RUNNING),
    fault_case('goal', 'stale goal', lambda: [_goal('no goal', stimulus.lost)]),
    fault_case('stamps', 'future, repeated, malformed stamps', _stamps, RUNNING),
    # At the start an unset stamp might be the zero of simulated time.
    fault_case('unset', 'stamps that are not set, after good ones', lambda: [
        _odometry('stamps not set', with_field('header.stamp', Time()), times=RUNNING)]),
    fault_case('garbage', 'bytes that are no message', lambda: [
        _odometry('no odometry message', stimulus.garbled),
        _goal('no goal message', stimulus.garbled)]),
    fault_case('contents', 'NaN, Inf, quaternions, frames, huge strings', _contents,
               (START, MIDWAY, SOLVING)),
    fault_case('frozen', 'clock frozen: safe after odom_timeout', lambda: [
        Fault('frozen', Harness.frozen, wait=STALE, times=RUNNING)], simulated=True),
    fault_case('jumps', 'clock jumps or is reset', _jumps, (MIDWAY, MIDWAY), simulated=True),
    fault_case('twist', 'velocities in the wrong frame: reported', lambda: [
        _spoiled('of the world', 'odometry', stimulus.in_the_world, times=(MIDWAY,),
                 strict=False, event=complaint('see velocity_frame'))],
               allowed=TURNED),
    fault_case('infeasible', 'no plan: shifted plan, then safe', _infeasible),
    fault_case('qos', 'a quality of service that does not match: reported', _mismatch,
               allowed=REPORT),
    fault_case('sources', 'two publishers of odometry', _sources),
)  # fmt: skip
