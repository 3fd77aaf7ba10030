# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Rows on nonsense in parameters: at the start, and of a running planner."""

from __future__ import annotations

import math
import random
import time
from collections.abc import Iterator
from typing import Any

from rcl_interfaces.srv import GetParameters

from benchmarks.faults.harness import PATIENCE, Fixtures, Harness, Session
from benchmarks.faults.injection import recovered
from benchmarks.faults.monitor import Limits
from benchmarks.faults.outcome import FaultCase, Outcome
from orbimpc_ros.ros.entry import PACKAGES
from orbimpc_ros.ros.parameters import PLANNER
from orbimpc_ros.ros.parameters.spec import ParameterSpec
from orbimpc_ros.sim.parameters import SIM

LEAVE = 2.0  # [s] in which a node with nonsense for parameters must have ended
BAD_INPUT = 2
SETS = (4, 200)  # short, long


def nonsense(row: ParameterSpec, draw: random.Random) -> Any:
    """Return a value that a parameter must not have."""
    wrong: list[Any] = [math.nan, math.inf, -math.inf, 'nonsense']
    if row.choices:
        return draw.choice(['nonsense', 'x' * 1000, 3, True])
    if isinstance(row.default, bool):
        return draw.choice([3, 0.5, 'nonsense'])
    if isinstance(row.default, str):
        return draw.choice([3, 0.5, True])
    if isinstance(row.default, tuple):
        return draw.choice([[math.nan] * 3, [1e300] * 3, 'nonsense', 7, [1.0, math.inf, 2.0, 3.0]])
    if math.isfinite(row.high):
        wrong.append(type(row.default)(row.high + max(1.0, abs(row.high))))
    if math.isfinite(row.low):
        wrong.append(type(row.default)(row.low - max(1.0, abs(row.low))))
    return draw.choice(wrong)


def _starts(fixtures: Fixtures, long: bool) -> Iterator[Outcome]:
    """Nodes that are started with one bad value: one line, code 2, no command."""
    with Session(fixtures.place(), Limits(1.0, math.pi)) as session:
        for number in range(SETS[long]):
            yield _started(session, number)
        session.spin(0.5)
        yield Outcome('commands of all of them', len(session.monitor.commands))


def _started(session: Session, number: int) -> Outcome:
    draw = random.Random(number)
    node, rows = draw.choice((('planner', PLANNER), ('sim', SIM)))
    row = draw.choice(rows)
    value = nonsense(row, draw)
    begin = time.monotonic()
    process = session.launch(PACKAGES[node], {row.name: value})
    code = process.wait(PATIENCE)  # a busy machine is late, and no more
    took = time.monotonic() - begin
    process.stop()
    failure = '' if code == BAD_INPUT else f'exit code {code}'
    lines = process.output.strip().splitlines()
    if len(lines) != 1 or row.name not in process.output:
        failure = f'{failure} said {lines[:3]}'.strip()
    return Outcome(f'{node} {row.name} = {str(value)[:20]}', 0, took, failure)


def _live(fixtures: Fixtures, long: bool) -> Iterator[Outcome]:
    """Nonsense for a running planner: refused, and nothing changes."""
    harness = fixtures.shared('plain')
    harness.until_planned()
    names = [row.name for row in PLANNER]
    before, begin = _values(harness, names), time.monotonic()
    for number in range(SETS[long]):
        draw = random.Random(number)
        row = draw.choice(PLANNER)
        value = nonsense(row, draw)
        failure = '' if harness.set_parameters({row.name: value}) else 'accepted'
        yield Outcome(f'{row.name} = {str(value)[:20]}', 0, math.nan, failure)
    changed = [n for n, a, b in zip(names, before, _values(harness, names), strict=True) if a != b]
    failure, unsafe = f'changed: {changed}' if changed else '', harness.monitor.broken(begin)
    yield recovered(harness, Outcome('all of them', unsafe, math.nan, failure))


def _values(harness: Harness, names: list[str]) -> list[Any]:
    request = GetParameters.Request(names=names)
    return list(harness.call(GetParameters, '/planner/get_parameters', request).values)


FAULT_CASES = (
    FaultCase('starts', 'nonsense parameters: exit code 2, no command', LEAVE, _starts, 's'),
    FaultCase('live', 'nonsense parameters live: refused', 0.0, _live),
)
