# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc bench``: side by side, in one run, with the solvers that are installed."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from benchmarks.bench import live
from benchmarks.bench.interleaved import OURS, interleaved_run
from benchmarks.bench.problems import CAP, COMPARISONS, PACKAGES, QUICK_CAP, Comparison
from benchmarks.bench.results import HULLS, BenchRow, Result, growth, rows_of
from benchmarks.bench.solvers import Solver
from orbimpc_ros.install import command
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool.files import require_writable
from orbimpc_ros.tool.run.progress import ProgressLine

WARM_UP = 3  # instances solved before the clock counts


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument('--json', metavar='FILE', help='write the result there')
    parser.add_argument('--picture', metavar='FILE', help='a PNG (default: beside the JSON)')
    parser.add_argument(
        '--only', nargs='+', metavar='PROBLEM', help=f'some of: {", ".join(names())}'
    )
    parser.add_argument('--quick', action='store_true', help='few instances, low time limits')


def names() -> list[str]:
    """Return the short names of everything that can be measured."""
    return [*dict.fromkeys(comparison.key for comparison in COMPARISONS), *live.NAMES]


def run(args: argparse.Namespace) -> int:
    """Measure, write as it goes, print, draw.

    Returns:
        1 if a requirement was missed, ours was beaten or a measurement failed.

    Raises:
        KeyboardInterrupt: somebody asked to stop; what was measured is kept.
    """
    wanted, result = _wanted(args.only), Result(*_files(args))
    try:
        for rows in measured(wanted, args.quick, result.rows):
            result.add(rows)
    finally:
        result.close()
    return int(any(r.beaten or r.failed or (r.measured and r.missed) for r in result.rows))


def _wanted(only: list[str] | None) -> list[str]:
    for name in only or ():
        if name not in names():
            raise BadInput('--only', name, ' | '.join(names()))
    return only or names()


def _files(args: argparse.Namespace) -> tuple[Path | None, Path | None]:
    """Return where rows and picture go, which must be writable."""
    file = Path(args.json).resolve() if args.json else None
    picture = Path(args.picture).resolve() if args.picture else file and file.with_suffix('.png')
    for name, path in (('--json', file), ('--picture', picture)):
        if path is not None:
            require_writable(name, path)
    return file, picture


def measured(
    wanted: list[str], quick: bool, before: Sequence[BenchRow]
) -> Iterator[list[BenchRow]]:
    """Yield the rows of each measurement as it is done; of one that fails, a row with the reason.

    Args:
        wanted: names of problems.
        quick: few instances, low time limits.
        before: what was measured before each.
    """
    for title, measure in _measurements(wanted, quick, before):
        try:
            rows = measure()
        except Exception as error:  # whatever it is, the others are still worth measuring
            note = f'failed: {type(error).__name__}: {error}'
            rows = [BenchRow(title, OURS, note=note, failed=True)]
        yield rows


def _measurements(
    wanted: list[str], quick: bool, before: Sequence[BenchRow]
) -> Iterator[tuple[str, Callable[[], list[BenchRow]]]]:
    for comparison in COMPARISONS:
        if comparison.key in wanted:
            yield comparison.title, partial(compared, comparison, quick)
    yield f'{HULLS}...: exponent of N', partial(growth, before)
    yield from live.measurements(wanted, quick)


def compared(comparison: Comparison, quick: bool) -> list[BenchRow]:
    """Return the rows of one comparison; solvers that are not installed are listed as absent."""
    cap, count = QUICK_CAP if quick else CAP, comparison.counts[0 if quick else 1]
    solvers, absent = _solvers(comparison, cap)
    instances = comparison.instances(comparison.problem, count)
    progress = ProgressLine(len(instances))
    samples = interleaved_run(
        solvers,
        instances,
        warm_up=WARM_UP,
        budget=comparison.budget(cap),
        every=comparison.every,
        show=lambda done: progress.show(done, comparison.title),
    )
    progress.close()
    return [*rows_of(comparison.title, samples, comparison.required, comparison.gap), *absent]


def _solvers(comparison: Comparison, cap: float) -> tuple[dict[str, Solver], list[BenchRow]]:
    """Return the solvers that take part, and rows of those that are not installed."""
    found = {name: _solver(comparison, name, cap) for name in (OURS, *comparison.rivals)}
    absent = [
        BenchRow(
            comparison.title,
            name,
            required=comparison.required.get(name),
            note=f'absent: {command(PACKAGES[name])}',
        )
        for name, contender in found.items()
        if contender is None
    ]
    return {name: each for name, each in found.items() if each is not None}, absent


def _solver(comparison: Comparison, name: str, cap: float) -> Solver | None:
    try:
        return comparison.solver(name, cap)
    except ImportError:
        if name not in PACKAGES:  # one of our own: that is no absence but a defect
            raise
        return None
