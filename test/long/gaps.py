# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""What only proved gaps can tell: when relaxing a floor is enough, and what local optima cost.

    python test/long/gaps.py --count 1000

For consecutive ticks of flights: how often the optimum without the floor obeys the floor all the
same, how many of its steps are below where it does not, and how much its bound lacks, beside how
often the package's first relaxation, which has the floor, is enough. Then how often IPOPT, started
from the present heading or from the last tick's optimum moved on, ends in a worse optimum, and by
how much. Exit code 1 if IPOPT undercuts a bound.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))  # of benchmarks, which are not installed

from benchmarks.bench.instances import Instance, circling, landings, winged
from benchmarks.bench.problems import FULL, LANDER, RATE, ROUND
from benchmarks.bench.solvers.ipopt import OPTIONS, NonlinearProgram
from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import Floor, Problem
from orbimpc_ros.mpc.problem.scaling import weighed
from orbimpc_ros.mpc.solve.solver import Solver

PATIENCE = 2.0  # [s] of computing, of a solve
PROVED = 1e-3  # relative gap
BELOW = 1e-6  # share of full speed that a floor is missed by
WORSE, MUCH = 1e-3, 1e-1  # relative costs by which a local optimum is worse, and much worse
UNDERCUT = 1e-6
ROPE, CONSTANT = Floor('circle', fraction=math.sqrt(0.3)), Floor('circle', fraction=1.0)


class Solved(NamedTuple):
    """A tick with its proved optimum, and the optimum without a floor."""

    instance: Instance
    plan: Plan
    relaxed: Plan


class Row(NamedTuple):
    """Flights of one problem."""

    problem: Problem
    flights: Callable[[Problem, int], list[Instance]]


def wing(horizon: int, step: float, rate: float) -> Row:
    """Wings that follow goals that are slower than they."""
    problem = Problem(horizon=horizon, step=step, forward=FULL, floor=ROUND, max_rate=rate)
    return Row(weighed(problem, 'time'), winged)


def lander() -> Row:
    """Powered descents: what lossless convexification is about."""
    problem = Problem(dimension=3, translation_order=2, horizon=30, step=0.3, forward=20.0,
                      weights=LANDER, terminal='constraint', discretisation='exact',
                      floor=Floor('circle', fraction=0.3))  # fmt: skip
    return Row(weighed(problem, 'time'), landings)


ROWS = {
    'rope, N = 5, floor 0.55': Row(Problem(floor=ROPE), circling),
    'rope, N = 10, floor 0.55': Row(Problem(horizon=10, floor=ROPE), circling),
    'rope, N = 5, constant speed': Row(Problem(floor=CONSTANT), circling),
    'wing, N = 10, floor 0.67': wing(10, 1.0, 0.0),
    'wing, N = 12, floor 0.67, turn rate': wing(12, 0.5, RATE),
    'lander, N = 30, thrust 0.3': lander(),
}


def solved(row: Row, count: int) -> Iterator[Solved]:
    """Yield the ticks that were proved."""
    exact = Solver(row.problem, gap_tolerance=PROVED)
    convex = Solver(replace(row.problem, floor=Floor('none')), gap_tolerance=PROVED)
    for instance in row.flights(row.problem, count):
        end = time.process_time() + PATIENCE

        def late(end: float = end) -> bool:
            return time.process_time() > end

        try:
            plan = exact.solve(*instance, None, late)
            relaxed = convex.solve(*instance)
        except OrbimpcError:
            continue
        if plan.gap <= PROVED and relaxed.gap <= PROVED:
            yield Solved(instance, plan, relaxed)


def relaxation(row: Row, ticks: list[Solved]) -> str:
    """How tight it is to leave the floor out."""
    floor = row.problem.floor.fraction - BELOW
    below = np.array([(each.relaxed.speed_fraction[1:] < floor).sum() for each in ticks])
    lacks = np.array([1.0 - each.relaxed.lower_bound / each.plan.objective for each in ticks])
    loose = below > 0
    n = row.problem.dimension * row.problem.translation_order
    once = 100.0 * np.mean([each.plan.nodes == 1 for each in ticks])
    told = (
        f'{len(ticks)} ticks, {once:.1f} % proved by one relaxation; without the floor: '
        f'obeys it on {100.0 * (~loose).mean():.1f} %'
    )
    if not loose.any():
        return told
    return (
        f'{told}; else steps below: '
        f'{np.median(below[loose]):.0f} in the median, {below.max()} at most '
        f'(n_x - 1 = {n - 1}: {100.0 * (below <= n - 1).mean():.1f} % within); '
        f'bound lacks {100.0 * np.median(lacks[loose]):.2g} %, {100.0 * lacks.max():.2g} % at most'
    )


def local(row: Row, ticks: list[Solved]) -> Iterator[tuple[str, bool]]:
    """Yield what IPOPT comes to from each kind of start, and whether it undercut a bound."""
    program, steps = NonlinearProgram(row.problem, OPTIONS), row.problem.horizon
    for words in ('present heading', 'last optimum'):
        excess, last = [], None
        for instance, plan, _ in ticks:
            held = np.tile(instance.state.attitude[:, 0], (steps, 1))
            start = held if last is None or words == 'present heading' else last
            value = program.solve(*instance, start)[1]
            excess.append((value - plan.objective, value - plan.lower_bound, plan.objective))
            axes = plan.rotations[1:, :, 0]
            last = np.concatenate([axes[1:], axes[-1:]])
        over, above, cost = np.array(excess).T
        share = over / cost
        failed, worse, much = np.isnan(share), share > WORSE, share > MUCH
        counts = [100.0 * each.mean() for each in (worse, much, failed)]
        text = 'IPOPT from the {}: worse on {:.1f} %, by a tenth on {:.1f} %, none on {:.1f} %'
        most = np.nanmax(share)
        undercut = bool((above < -UNDERCUT * cost).any())
        yield f'{text.format(words, *counts)}; at most {most:.2g} times the cost more', undercut


def main() -> int:
    """Print the rows and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--count', type=int, default=1000, help='ticks of each row')
    args = parser.parse_args()
    undercut = False
    for name, row in ROWS.items():
        ticks = list(solved(row, args.count))
        print(f'{name}\n  {relaxation(row, ticks)}', flush=True)
        if row.flights is landings:
            continue
        for words, less in local(row, ticks):
            print(f'  {words}{"; UNDERCUTS A BOUND" if less else ""}', flush=True)
            undercut = undercut or less
    return int(undercut)


if __name__ == '__main__':
    sys.exit(main())
