# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc bench``: a comparison with the installed solvers, side by side in one run."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from importlib.util import find_spec

from benchmarks.bench.interleaved import OURS, interleaved_run
from benchmarks.bench.problems import CAP, COMPARISONS, PACKAGES, QUICK_CAP, Comparison
from benchmarks.bench.results import HULLS, BenchRow, growth, rows_of, table
from benchmarks.bench.solvers import Solver
from benchmarks.machine import machine, require_known, versions, writable, write
from orbimpc_ros.install import command
from orbimpc_ros.tool.processes import ProgressLine

WARM_UP = 3  # instances solved before measurements
SEVERAL = 5  # budget in time limits, where rivals solve few of the instances
NODES = ('start', 'latency', 'planners')  # measured over DDS
Measurement = tuple[str, Callable[[], list[BenchRow]]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument('--json', dest='file', metavar='FILE', help='write the result there')
    parser.add_argument(
        '--only', nargs='+', metavar='PROBLEM', help=f'some of: {", ".join(names())}'
    )
    parser.add_argument('--quick', action='store_true', help='few instances, low time limits')


def names() -> list[str]:
    """Return the short names of everything that can be measured."""
    return [*dict.fromkeys(comparison.key for comparison in COMPARISONS), *NODES]


def run(file: str | None, only: Sequence[str] | None, *, quick: bool) -> int:
    """Measure, writing each row at once; print the table.

    Returns:
        1 if a requirement was missed, our solver was beaten or a measurement failed.

    Raises:
        KeyboardInterrupt: the run was interrupted; the rows so far are kept.
    """
    require_known(only, names())
    kept, rows = writable(file), list[BenchRow]()
    head = {'machine': machine(), 'versions': versions()}
    try:
        for title, measure in _measurements(only or names(), quick, rows):
            try:
                rows += measure()
            except Exception as error:  # of any kind: continue with the others
                note = f'failed: {type(error).__name__}: {error}'
                rows.append(BenchRow(title, OURS, note=note, failed=True))
            write(kept, head, rows)
    finally:
        print(table(rows))
    return int(any(row.beaten or row.failed or row.missed for row in rows))


def _measurements(
    wanted: Sequence[str], quick: bool, before: Sequence[BenchRow]
) -> Iterator[Measurement]:
    for comparison in COMPARISONS:
        if comparison.key in wanted:
            yield comparison.title, partial(compared, comparison, quick)
    yield f'{HULLS}...: exponent of N', partial(growth, before)
    live = [name for name in NODES if name in wanted]
    if live and find_spec('rclpy') is None:
        note = 'absent: ROS 2 Jazzy, or the extra "ros" of this package'
        yield 'nodes', lambda: [BenchRow(f'node: {name}', OURS, note=note) for name in live]
    elif live:
        from benchmarks.bench.live import measurements

        yield from measurements(live, quick)


def compared(comparison: Comparison, quick: bool) -> list[BenchRow]:
    """Return the rows of one comparison; solvers that are not installed are listed as absent."""
    cap, count = QUICK_CAP if quick else CAP, comparison.counts[0 if quick else 1]
    solvers, absent = dict[str, Solver](), list[BenchRow]()
    for name in (OURS, *comparison.rivals):
        if name == OURS or find_spec(PACKAGES[name]) is not None:
            solvers[name] = comparison.solver(name, cap)
        else:
            required, note = comparison.required.get(name), f'absent: {command(PACKAGES[name])}'
            absent.append(BenchRow(comparison.title, name, required=required, note=note))
    instances = comparison.instances(comparison.problem, count)
    progress = ProgressLine(len(instances))
    samples = interleaved_run(
        solvers,
        instances,
        warm_up=WARM_UP,
        budget=cap if comparison.every == 1 else SEVERAL * cap,
        every=comparison.every,
        show=lambda done: progress.show(done, comparison.title),
    )
    progress.close()
    return [*rows_of(comparison.title, samples, comparison.required, comparison.gap), *absent]
