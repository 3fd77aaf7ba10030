# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The fault matrix: what its monitor detects, how rows are judged, and its short form."""

import json
import math
from functools import partial
from types import SimpleNamespace

import pytest
from harness import orbimpc

from benchmarks.faults import inputs, processes
from benchmarks.faults.harness import STEP, Harness
from benchmarks.faults.matrix import FaultCase, Outcome, table
from benchmarks.faults.monitor import HeardCommand, Monitor

MATRIX = (*inputs.FAULT_CASES, *processes.FAULT_CASES)
NAN, INF = math.nan, math.inf


# --- the monitor


@pytest.mark.parametrize(
    ('speed', 'rates', 'broken'),
    [
        (1.0, (0.0, 0.0, 3.0), False), (0.0, (0.0, 0.0, 0.0), False),
        (NAN, (0.0, 0.0, 0.0), True), (0.5, (INF, 0.0, 0.0), True), (0.5, (0.0, 0.0, NAN), True),
        (1.1, (0.0, 0.0, 0.0), True), (-0.1, (0.0, 0.0, 0.0), True),
        (0.5, (0.0, 0.0, -3.1), True), (0.5, (2.0, 2.0, 2.0), True),
    ],
)  # fmt: skip
def test_the_monitor_notices_commands_beyond_limits(speed, rates, broken):
    monitor = Monitor(speed=1.0, rate=3.0, commands=[HeardCommand(0.0, speed, rates)])
    assert monitor.broken() == broken


def test_what_came_before_a_fault_may_be_flown_until_it_is_out_of_date():
    """A busy planner may be safe at first, and then plan from valid odometry in its queue."""
    due = 1.0 + 0.3

    def unsafe(*commands):
        monitor = Monitor(speed=1.0, rate=3.0)
        monitor.commands += [HeardCommand(at, speed, (0.0, 0.0, w)) for at, speed, w in commands]
        return monitor.moving_again(due, due + STEP)

    busy = [(1.05, 0.0, 0.0), (1.1, 0.5, 0.1), (1.2, 0.5, 0.1)]
    stopped = [(due + 0.1, 0.0, 0.0), (due + 0.3, 0.0, 0.0)]
    assert unsafe(*busy, *stopped) == 0
    again = (*busy, *stopped, (due + 0.5, 0.5, 0.1))
    assert unsafe(*again) == 1
    assert unsafe(*busy, (due + 0.1, 0.5, 0.1), (due + 0.3, 0.5, 0.1)) == 1


# --- rows


def test_the_message_that_is_repeated_is_the_first_of_each_injection():
    """One from long ago would seem to come from another clock, and could be flown when it came."""
    fed = SimpleNamespace()
    fed.spoiling = partial(Harness.spoiling, fed)
    for first in (1, 2):
        with inputs.REPEATED.imposed(fed):
            spoil = fed._spoiled['odometry']
            assert [spoil(each, None) for each in (first, 7)] == [[first], [first]]


def row(*outcomes):
    return FaultCase('row', 'a row', 1.0, None, outcomes=list(outcomes))


@pytest.mark.parametrize(
    ('outcome', 'ok'),
    [
        (Outcome('fine'), True),
        (Outcome('in time', reaction=1.0), True),
        (Outcome('late', reaction=1.1), False),
        (Outcome('never', reaction=INF), False),
        (Outcome('unsafe', unsafe=1), False),
        (Outcome('wrong', failure='exit code 3'), False),
    ],
)
def test_a_row_is_as_good_as_its_worst_case(outcome, ok):
    found = row(Outcome('first', reaction=0.5), outcome, Outcome('last', reaction=0.2))
    assert found.ok == ok
    assert bool(found.failures) != ok
    assert all(outcome.case in text for text in found.failures)
    text = table([found])
    assert ('NO' in text) != ok
    json.dumps(found.as_json(), allow_nan=False)


# --- the command


@pytest.fixture(scope='module')
def short(tmp_path_factory):
    """Return the finished short form, and its rows by name."""
    file = tmp_path_factory.mktemp('faults') / 'rows.json'
    done = orbimpc('faults', '--json', file)
    return done, {found['name']: found for found in json.loads(file.read_text())['rows']}


@pytest.mark.parametrize('name', [case.name for case in MATRIX])
def test_under_every_fault_commands_are_safe(short, name):
    """However busy the machine is; whether reactions are in time, the command itself judges."""
    done, rows = short
    found = rows[name]
    assert found['cases'], done.stderr
    assert found['unsafe'] == 0, found['failures']
    assert [case['failure'] for case in found['cases'] if case['failure']] == []
    assert all(case['reaction'] != 'never' for case in found['cases']), found['failures']


def test_the_table_says_what_the_rows_say(short):
    done, rows = short
    assert done.returncode == (0 if all(found['ok'] for found in rows.values()) else 1)
    assert all(found['title'] in done.stdout for found in rows.values())
    assert 'Traceback' not in done.stderr
