# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The interleaved run: every solver on the same instance before the next instance comes."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from benchmarks import collector
from benchmarks.bench.instances import Instance
from benchmarks.bench.solvers import Declined, Solution, Solver
from orbimpc_ros.mpc.arrays import Array

OURS = 'orbimpc'
WARM = 1.0  # [s] after which no further warm-up begins


@dataclass
class Samples:
    """The results of one solver, by instance.

    Attributes:
        times: solve times [ms].
        solutions: what came out.
        refused: why it takes no part (any more); empty if it does.
    """

    times: dict[int, float] = field(default_factory=dict)
    solutions: dict[int, Solution] = field(default_factory=dict)
    refused: str = ''

    @property
    def spent(self) -> float:
        """Return the time it has used up [s]."""
        return 1e-3 * sum(self.times.values())


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

    The order alternates from instance to instance, so that no solver always comes second to a
    warm cache. A solver that has used up ``budget`` [s] stops taking part, and all but ours meet
    only the first of ``every`` so many instances.
    """
    samples = {name: Samples() for name in solvers}
    for name, contender in solvers.items():
        _warm(contender, instances[0], samples[name], warm_up)
    with collector.paused():
        for i, instance in enumerate(instances):
            for name in list(solvers)[:: 1 if i % 2 else -1]:
                meets = name == OURS or i % every == 0
                if meets and not samples[name].refused and samples[name].spent < budget:
                    _run(solvers[name], instance, samples[name], i)
            show(i + 1)
    return samples


def _warm(contender: Solver, instance: Instance, into: Samples, count: int) -> None:
    """Solve an instance a few times, but not for long."""
    end = time.perf_counter() + WARM
    for _ in range(count):
        if time.perf_counter() < end and not into.refused:
            _run(contender, instance, into, None)


def _run(contender: Solver, instance: Instance, into: Samples, number: int | None) -> None:
    begin = time.perf_counter()
    try:
        contender.solve(*instance)
    except Declined as refusal:
        into.refused = str(refusal)
        return
    except (
        Exception
    ) as error:  # a solver that breaks must not end the run: the table has the reason
        into.refused = f'failed: {type(error).__name__}: {error}'
        return
    elapsed = time.perf_counter() - begin
    if number is not None:
        into.times[number] = 1e3 * elapsed
        into.solutions[number] = contender.solution()


def percentiles(times: Sequence[float]) -> tuple[float, float]:
    """Return median and 99th percentile."""
    p50, p99 = np.percentile(times, [50, 99])
    return float(p50), float(p99)


def differences(theirs: Samples, ours: Samples) -> Array:
    """Return (theirs - ours) / |ours| of the objectives of common instances."""
    common = sorted(theirs.solutions.keys() & ours.solutions.keys())
    pairs = [(theirs.solutions[i].objective, ours.solutions[i].objective) for i in common]
    return np.array([(a - b) / max(1e-9, abs(b)) for a, b in pairs])
