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

from orbimpc_ros.lab.machine import machine
from orbimpc_ros.mpc.errors import BadInput, OrbimpcError

if TYPE_CHECKING:
    from orbimpc_ros.lab.faults.fixtures import Lab
    from orbimpc_ros.lab.faults.outcome import Outcome, Row, Trial

DEFAULT_SOAK = 30.0  # [min]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument('--long', action='store_true', help='every case: about 25 minutes')
    parser.add_argument('--only', nargs='+', metavar='ROW', help='rows by name; see --list')
    parser.add_argument('--list', action='store_true', help='list the rows and do nothing')
    parser.add_argument('--json', metavar='FILE', help='write the rows and cases there')
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
    _require_folder(args.json)
    if find_spec('rclpy') is None:
        hint = "install ROS 2, or pip install 'orbimpc_ros[ros]'"
        raise BadInput.stating('orbimpc faults', 'rclpy is missing', hint)
    if args.soak is not None:
        from orbimpc_ros.lab.faults.soak import soaked

        return soaked(args.soak)
    trials = _wanted(args.only)
    if args.list:
        print('\n'.join(f'{trial.name:<12}{trial.title}' for trial in trials))
        return 0
    rows = tried(trials, args.long)
    _write(args.json, rows)
    return 0 if all(row.ok for row in rows) else 1


def _require_folder(file: str | None) -> None:
    if file and not Path(file).resolve().parent.is_dir():
        raise BadInput('--json', file, 'a file in a folder that exists')


def _wanted(only: Sequence[str] | None) -> list[Trial]:
    from orbimpc_ros.lab.faults.matrix import MATRIX

    names = [trial.name for trial in MATRIX]
    for name in only or ():
        if name not in names:
            raise BadInput('--only', name, ' | '.join(names))
    return [trial for trial in MATRIX if not only or trial.name in only]


def tried(trials: Sequence[Trial], long: bool) -> list[Row]:
    """Return the rows of trials and print them; all processes are gone at the end."""
    from orbimpc_ros.lab.faults.fixtures import Lab
    from orbimpc_ros.lab.faults.outcome import Row, table

    rows = [Row(trial) for trial in trials]
    try:
        with tempfile.TemporaryDirectory() as folder, Lab(Path(folder)) as lab, _terminated():
            _try_all(rows, lab, long)
    finally:
        print(table([row for row in rows if row.outcomes]))
    return rows


def _try_all(rows: Sequence[Row], lab: Lab, long: bool) -> None:
    from orbimpc_ros.tool.run.progress import Progress

    progress = Progress(len(rows))
    for number, row in enumerate(rows):
        begin = time.monotonic()
        for outcome in _outcomes(row.trial, lab, long):
            row.outcomes.append(outcome)
            row.seconds = time.monotonic() - begin
            progress.show(number, f'{row.trial.title}: {len(row.outcomes)} cases')
    progress.close()


def _outcomes(trial: Trial, lab: Lab, long: bool) -> Iterator[Outcome]:
    """Yield a row's outcomes; a planner that is past help ends the row, not the matrix."""
    from orbimpc_ros.lab.faults.outcome import Outcome

    try:
        yield from trial.cases(lab, long)
    except OrbimpcError as error:
        yield Outcome('then', failure=str(error))
        lab.clear()


@contextmanager
def _terminated() -> Iterator[None]:
    """Take SIGTERM like Ctrl-C, so that both leave in order."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _write(file: str | None, rows: Sequence[Row]) -> None:
    if file:
        result = {'machine': machine(), 'rows': [row.as_json() for row in rows]}
        Path(file).write_text(json.dumps(result, indent=1, allow_nan=False) + '\n')
