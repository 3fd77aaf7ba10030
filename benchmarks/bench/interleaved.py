# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The interleaved run: every solver solves an instance before the next instance is taken."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from benchmarks.bench.instances import Instance
from benchmarks.bench.solvers import Solution, Solver

OURS = 'orbimpc'
WARM = 1.0  # [s] after which no further warm-up begins


@dataclass
class Samples:
    """The results of one solver, by instance."""

    times: dict[int, float] = field(default_factory=dict)  # solve times [ms]
    solutions: dict[int, Solution] = field(default_factory=dict)  # results
    refused: str = ''  # reason for not taking part (any more), if any


def interleaved_run(
    solvers: Mapping[str, Solver],
    instances: Sequence[Instance],
    *,
    warm_up: int,
    budget: float,
    show: Callable[[int], None],
    every: int = 1,
) -> dict[str, Samples]:
    """Return the results of each solver on each instance, after a warm-up on the first one.

    The order alternates from instance to instance, so that no solver always has the advantage of a
    warm cache. A solver that has used up ``budget`` [s] stops taking part, and all but ours solve
    only one in ``every`` instances.
    """
    samples = {name: Samples() for name in solvers}
    for name, solver in solvers.items():
        end = time.perf_counter() + WARM
        for _ in range(warm_up):
            if time.perf_counter() < end and not samples[name].refused:
                _run(solver, instances[0], samples[name], None)
    gc.collect()
    gc.disable()  # its pauses would count as solve times
    try:
        for i, instance in enumerate(instances):
            for name in list(solvers)[:: 1 if i % 2 else -1]:
                into, meets = samples[name], name == OURS or i % every == 0
                if meets and not into.refused and sum(into.times.values()) < 1e3 * budget:
                    _run(solvers[name], instance, into, i)
            show(i + 1)
    finally:
        gc.enable()
    return samples


def _run(solver: Solver, instance: Instance, into: Samples, number: int | None) -> None:
    """Solve an instance; a solver's failure does not end the run, but is noted in the table."""
    try:
        solve = solver.ready(*instance)
        begin = time.perf_counter()
        solution = solve()
        elapsed = time.perf_counter() - begin
    except Exception as error:
        into.refused = f'failed: {type(error).__name__}: {error}'
    else:
        if number is not None:
            into.times[number], into.solutions[number] = 1e3 * elapsed, solution
