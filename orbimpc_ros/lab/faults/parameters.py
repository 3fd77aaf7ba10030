"""Rows on nonsense in parameters: at the start, and of a running planner."""

from __future__ import annotations

import math
import random
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from geometry_msgs.msg import TwistStamped
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.parameter import Parameter

from orbimpc_ros.lab.faults.fixtures import Lab
from orbimpc_ros.lab.faults.harness import Stand
from orbimpc_ros.lab.faults.injection import recovered
from orbimpc_ros.lab.faults.outcome import Outcome, Trial
from orbimpc_ros.lab.faults.test_node import Ears
from orbimpc_ros.ros.parameters import PLANNER, SIM, Row
from orbimpc_ros.tool.io import settings
from orbimpc_ros.tool.run.processes import Process

LEAVE = 2.0  # [s] in which a node with nonsense for parameters must have ended
BAD_INPUT = 2
SETS = (4, 200)  # short, long


def nonsense(row: Row, draw: random.Random) -> Any:
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


def _starts(lab: Lab, long: bool) -> Iterator[Outcome]:
    """Nodes that are started with one bad value: one line, code 2, no command."""
    folder, domain = lab.place()
    ears, heard = Ears(domain), list[TwistStamped]()

    ears.listen(TwistStamped, 'cmd_vel', heard.append)
    for number in range(SETS[long]):
        yield _started(folder, domain, number)
    ears.hear(0.5)
    ears.close()
    yield Outcome('commands of all of them', len(heard))


def _started(folder: Path, domain: int, number: int) -> Outcome:
    draw = random.Random(number)
    node, rows = draw.choice((('planner', PLANNER), ('sim', SIM)))
    row = draw.choice(rows)
    value = nonsense(row, draw)
    file = folder / f'{number}.yaml'
    settings.write(file, {row.name: value})
    begin = time.monotonic()
    process = Process(f'orbimpc_ros.ros.{node}', file, file.with_suffix('.log'), domain)
    code = process.wait(5 * LEAVE)
    took = time.monotonic() - begin
    process.stop()
    failure = '' if code == BAD_INPUT else f'exit code {code}'
    lines = process.output.strip().splitlines()
    if len(lines) != 1 or row.name not in process.output:
        failure = f'{failure} said {lines[:3]}'.strip()
    return Outcome(f'{node} {row.name} = {str(value)[:20]}', 0, took, failure)


def _live(lab: Lab, long: bool) -> Iterator[Outcome]:
    """A running planner is told nonsense, alone and among sense: refused, and nothing changes."""
    stand = lab.shared('plain')
    stand.until_planned()
    names = [row.name for row in PLANNER]
    before, begin = _values(stand, names), time.monotonic()
    for number in range(SETS[long]):
        draw = random.Random(number)
        row = draw.choice(PLANNER)
        value = nonsense(row, draw)
        accepted = _set(stand, {row.name: value})
        failure = 'accepted' if accepted else ''
        yield Outcome(f'{row.name} = {str(value)[:20]}', 0, math.nan, failure)
    changed = [n for n, a, b in zip(names, before, _values(stand, names), strict=True) if a != b]
    failure = f'changed: {changed}' if changed else ''
    yield recovered(stand, Outcome('all of them', stand.watch.broken(begin), math.nan, failure))


def _set(stand: Stand, values: dict[str, Any]) -> bool:
    messages = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
    request = SetParameters.Request(parameters=messages)
    results = stand.call(SetParameters, '/planner/set_parameters', request).results
    return all(result.successful for result in results)


def _values(stand: Stand, names: list[str]) -> list[Any]:
    request = GetParameters.Request(names=names)
    return list(stand.call(GetParameters, '/planner/get_parameters', request).values)


TRIALS = (
    Trial('starts', 'nonsense parameters: exit code 2, no command', LEAVE, _starts, 's'),
    Trial('live', 'nonsense parameters live: refused', 0.0, _live),
)
