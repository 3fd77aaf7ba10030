# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc faults``: the fault matrix, with real nodes as processes of their own over DDS."""

from __future__ import annotations

import argparse
import json
import signal
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.machine import machine
from orbimpc_ros.install import command_for_extra
from orbimpc_ros.mpc.errors import BadInput, OrbimpcError
from orbimpc_ros.tool.files import require_writable

if TYPE_CHECKING:
    from benchmarks.faults.harness import Fixtures
    from benchmarks.faults.outcome import FaultCase, MatrixRow, Outcome

DEFAULT_SOAK = 30.0  # [min]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument('--long', action='store_true', help='every case: about 25 minutes')
    parser.add_argument('--only', nargs='+', metavar='ROW', help='rows by name; see --list')
    parser.add_argument('--list', action='store_true', help='list the rows and do nothing')
    parser.add_argument('--json', metavar='FILE', help='write the rows and cases there')
    parser.add_argument(
        '--executor',
        choices=('wait_set', 'events'),
        default='wait_set',
        help='of the nodes: their parameter of that name (default: wait_set)',
    )
    parser.add_argument(
        '--soak',
        nargs='?',
        type=float,
        const=DEFAULT_SOAK,
        metavar='MINUTES',
        help='instead: one planner at 20 Hz on odometry at 1 kHz (default: 30 minutes)',
    )


def run(args: argparse.Namespace) -> int:
    """Try every row, print the table; 1 if a command was unsafe or a reaction late."""
    if args.json:
        require_writable('--json', Path(args.json).resolve())
    if find_spec('rclpy') is None:
        hint = f'install ROS 2, or {command_for_extra("ros")}'
        raise BadInput.stating('orbimpc faults', 'rclpy is missing', hint)
    if args.soak is not None:
        from benchmarks.faults.soak import soaked

        return soaked(args.soak, args.executor)
    cases = _wanted(args.only)
    if args.list:
        print('\n'.join(f'{case.name:<12}{case.title}' for case in cases))
        return 0
    rows = tried(cases, args.long, args.executor)
    _write(args.json, rows)
    return 0 if all(row.ok for row in rows) else 1


def _wanted(only: Sequence[str] | None) -> list[FaultCase]:
    from benchmarks.faults.matrix import MATRIX

    names = [case.name for case in MATRIX]
    for name in only or ():
        if name not in names:
            raise BadInput('--only', name, ' | '.join(names))
    return [case for case in MATRIX if not only or case.name in only]


def tried(cases: Sequence[FaultCase], long: bool, executor: str = 'wait_set') -> list[MatrixRow]:
    """Return the rows of fault cases and print them; all processes are gone at the end.

    Args:
        cases: to try.
        long: whether to try each at several moments.
        executor: of the nodes.
    """
    from benchmarks.faults.harness import Fixtures
    from benchmarks.faults.outcome import MatrixRow, table

    rows = [MatrixRow(case) for case in cases]
    try:
        with (
            tempfile.TemporaryDirectory() as name,
            _terminated(),
            Fixtures(Path(name), executor) as made,
        ):
            _try_all(rows, made, long)
    finally:
        print(table([row for row in rows if row.outcomes]))
    return rows


def _try_all(rows: Sequence[MatrixRow], fixtures: Fixtures, long: bool) -> None:
    from orbimpc_ros.tool.run.progress import ProgressLine

    progress = ProgressLine(len(rows))
    for number, row in enumerate(rows):
        begin = time.monotonic()
        for outcome in _outcomes(row.case, fixtures, long):
            row.outcomes.append(outcome)
            row.seconds = time.monotonic() - begin
            progress.show(number, f'{row.case.title}: {len(row.outcomes)} cases')
    progress.close()


def _outcomes(case: FaultCase, fixtures: Fixtures, long: bool) -> Iterator[Outcome]:
    """Yield a row's outcomes; a planner that cannot be recovered ends the row, not the matrix."""
    from benchmarks.faults.outcome import Outcome

    try:
        yield from case.cases(fixtures, long)
    except OrbimpcError as error:
        yield Outcome('then', failure=str(error))
        fixtures.clear()


@contextmanager
def _terminated() -> Iterator[None]:
    """Take SIGTERM like Ctrl-C, so that both leave in order."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _write(file: str | None, rows: Sequence[MatrixRow]) -> None:
    if file:
        result = {'machine': machine(), 'rows': [row.as_json() for row in rows]}
        Path(file).write_text(json.dumps(result, indent=1, allow_nan=False) + '\n')
