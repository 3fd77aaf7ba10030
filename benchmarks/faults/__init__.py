# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc faults``: the fault matrix, with real nodes in separate processes over DDS."""

from __future__ import annotations

import argparse
import signal
import time
from collections.abc import Sequence
from importlib.util import find_spec

from benchmarks.faults.matrix import FaultCase, Outcome, table
from benchmarks.machine import machine, require_known, writable, write
from orbimpc_ros.install import command_for_extra
from orbimpc_ros.mpc.errors import BadInput, OrbimpcError
from orbimpc_ros.tool.processes import ProgressLine


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    add = parser.add_argument
    add('--long', action='store_true', help='every case: about 35 minutes')
    add('--only', nargs='+', metavar='ROW', help='rows by name; see --list')
    add('--list', dest='show', action='store_true', help='list the rows and do nothing')
    add('--json', dest='file', metavar='FILE', help='write the rows and cases there')
    whose = 'of the nodes: their parameter of that name (default: %(default)s)'
    add('--executor', choices=('wait_set', 'events'), default='wait_set', help=whose)


def run(
    only: Sequence[str] | None, file: str | None, executor: str, *, long: bool, show: bool
) -> int:
    """Try every row and print the table; return 1 if a command was unsafe or a reaction late."""
    kept = writable(file)
    if find_spec('rclpy') is None:
        hint = f'install ROS 2, or {command_for_extra("ros")}'
        raise BadInput.stating('orbimpc faults', 'rclpy is missing', hint)
    from benchmarks.faults import inputs, processes

    matrix = (*inputs.FAULT_CASES, *processes.FAULT_CASES)
    require_known(only, [case.name for case in matrix])
    cases = [case for case in matrix if not only or case.name in only]
    if show:
        print('\n'.join(f'{case.name:<12}{case.title}' for case in cases))
        return 0
    head = {'machine': machine()}
    fill(cases, long, executor)
    write(kept, head, cases)
    return 0 if all(row.ok for row in cases) else 1


def fill(rows: Sequence[FaultCase], long: bool, executor: str) -> None:
    """Try the rows and print them; all processes have ended afterwards.

    A planner that never recovers ends only its own row. SIGTERM has the effect of Ctrl-C.

    Args:
        rows: to try.
        long: whether to try each at several moments.
        executor: of the nodes.
    """
    from benchmarks.faults.harness import Bench
    from orbimpc_ros.mpc.kernels.__main__ import PARTS

    progress, bench = ProgressLine(len(rows)), Bench(executor)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # which ends child processes
    try:
        for part in PARTS:  # a planner does not answer while it compiles
            part()
        for number, row in enumerate(rows):
            begin = time.monotonic()
            try:
                for outcome in row.cases(bench, long):
                    row.outcomes.append(outcome)
                    row.seconds = time.monotonic() - begin
                    progress.show(number, f'{row.title}: {len(row.outcomes)} cases')
            except OrbimpcError as error:
                row.outcomes.append(Outcome('then', failure=str(error)))
        progress.close()
    finally:
        bench.close()
        print(table([row for row in rows if row.outcomes]))
