# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Clocks that jump or stand still, ticks that take too long, and what is made of them."""

import pytest

pytest.importorskip('rclpy')

import numpy as np

from orbimpc_ros.loop.planner import Decision
from orbimpc_ros.mpc.command import stop
from orbimpc_ros.mpc.outcome import Fallback, Status
from orbimpc_ros.ros.clock import Drift
from orbimpc_ros.ros.planner.core import Timing
from orbimpc_ros.ros.reports import ERROR, OK, WARN, Report, condition


@pytest.mark.parametrize('by', [5.0, -5.0])
def test_a_clock_that_is_set_is_told(by):
    drift, offset = Drift(), 1e6
    for k in range(10):
        offset += by if k == 5 else 1e-6  # and slewed meanwhile
        jump = drift.jump(k, k + offset, k + 1e-4)
        assert jump == pytest.approx(by if k == 5 else 0.0, abs=1e-3)


def test_a_pause_between_two_looks_at_clocks_is_no_jump():
    drift = Drift()
    assert drift.jump(0.0, 100.0, 0.0) == 0.0
    assert drift.jump(1.0, 101.8, 2.0) == 0.0  # read somewhere in between
    assert drift.jump(3.0, 103.0, 3.0) == 0.0


def test_misses_and_overruns_are_counted_and_a_stray_one_is_not_expected():
    timing = Timing()
    assert timing.expected == 0.0
    for duration in (0.01, 0.01, 0.3, 0.06, 0.01):
        timing.took(duration, deadline=0.05, period=0.1)
    assert (timing.misses, timing.overruns) == (2, 1)
    assert timing.expected == 0.01


def test_ticks_that_come_late_are_counted():
    timing = Timing()
    for clock in (1.0, 1.1, 1.2, 1.45, 1.55):
        timing.began(clock, period=0.1)
    assert timing.late == 1


def reported(status, reason='', fallback=Fallback.NONE):
    return Report(Decision(status, reason, None, None, stop(np.eye(2)), fallback))


def safe(reason):
    return reported(Status.FAILED, reason, Fallback.SAFE_COMMAND)


PLANNING = reported(Status.OPTIMAL)


@pytest.mark.parametrize(
    ('wrong', 'waiting', 'report', 'notices', 'expected'),
    [
        (('', ''), '', None, ('',), (OK, 'ready')),
        (('', ''), '', PLANNING, ('',), (OK, 'planning')),
        (('', ''), '', PLANNING, ('', 'odom refused'), (WARN, 'planning; odom refused')),
        (('', ''), '', reported(Status.OPTIMAL, 'far away'), (), (WARN, 'far away')),
        (('', ''), '', reported(Status.FEASIBLE, 'gap'), (), (WARN, 'gap')),
        (('', ''), '', safe('old'), ('odom refused',), (ERROR, 'old; odom refused')),
        (('', ''), 'disabled', safe('disabled'), (), (WARN, 'disabled')),
        (('two sources', ''), 'disabled', PLANNING, (), (ERROR, 'two sources')),
        (('two sources', 'mismatch'), '', None, (), (ERROR, 'two sources; mismatch')),
    ],
)
def test_the_worst_is_told(wrong, waiting, report, notices, expected):
    level, parts = condition(wrong, waiting, report, notices)
    assert (level, '; '.join(parts)) == expected
