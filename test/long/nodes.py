# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""How many nodes a tick can take: the worst over a whole box of states and goals, by sampling.

    python test/long/nodes.py --count 100000 --seed 1
    python test/long/nodes.py --row wing --count 10000

Draws states and goals evenly from a box, solves each, and climbs from the worst ones to worse ones
nearby. Where none of n draws takes more than M nodes, then with a confidence of 95 % less than 3/n
of the box does. Times are CPU times of the whole solve.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))  # of benchmarks, which are not installed

from benchmarks.bench.problems import FULL, RATE, ROUND
from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.problem import Floor, Problem, State
from orbimpc_ros.mpc.problem.scaling import weighed
from orbimpc_ros.mpc.solve.solver import Solver

PATIENCE = 2.0  # [s] of computing, of a solve
QUANTILES = (0.5, 0.99, 0.999, 0.9999)
WORST, AROUND, SHRINK = 20, 40, 0.9  # draws climbed from, steps of each, and how those get smaller


class Row(NamedTuple):
    """A problem and the box that is drawn from.

    Attributes:
        problem: what is solved.
        gap: relative, to which it is proved.
        half: of the box's edges: goal [m], its velocity [m/s], disturbance [m/s] (two each), and
            heading [rad].
        most: nodes of the whole tree; infinite where splits go on for ever.
    """

    problem: Problem
    gap: float
    half: np.ndarray
    most: float


def rows() -> dict[str, Row]:
    square = Problem(floor=Floor('polygon', 4, math.sqrt(0.3)))
    wing = Problem(horizon=12, step=0.5, forward=FULL, floor=ROUND, max_rate=RATE)
    return {
        'square': Row(square, 1e-4, np.array([6.0, 6.0, 1.0, 1.0, 0.0, 0.0, math.pi]),
                      sum(4.0**k for k in range(6))),
        'wing': Row(weighed(wing, 'time'), 1e-3,
                    np.array([150.0, 150.0, 8.0, 8.0, 5.0, 5.0, 0.0]), math.inf),
    }  # fmt: skip


class Took(NamedTuple):
    """What a solve took."""

    nodes: float
    time: float
    proved: bool


def examiner(row: Row) -> Callable[[np.ndarray], Took]:
    """Return what solves the instance at a place of the box, in units of its half edges."""
    solver = Solver(row.problem, gap_tolerance=row.gap)
    ahead = row.problem.step * np.arange(1.0, row.problem.horizon + 1.0)[:, None]

    def examined(place: np.ndarray) -> Took:
        at = place * row.half
        state = State.at(np.zeros(2), exp(at[6:]), disturbance=at[4:6])
        begun = time.process_time()
        try:
            plan = solver.solve(state, at[:2] + ahead * at[2:4], None,
                                lambda: time.process_time() > begun + PATIENCE)  # fmt: skip
        except OrbimpcError:
            return Took(math.inf, PATIENCE, False)
        return Took(plan.nodes, time.process_time() - begun, plan.gap <= row.gap)

    return examined


def climbed(
    examined: Callable[[np.ndarray], Took], rng: np.random.Generator, place: np.ndarray, took: Took
) -> Took:
    """Return the worst that a walk uphill comes to."""
    size = 0.1
    for _ in range(AROUND):
        there = np.clip(place + size * rng.normal(size=len(place)), -1.0, 1.0)
        found = examined(there)
        if found.nodes > took.nodes:
            place, took = there, found
        else:
            size *= SHRINK
    return took


def told(row: Row, took: list[Took], worst: list[Took]) -> str:
    """The row of the table."""
    nodes, times, proved = (np.array(each) for each in zip(*took, strict=True))
    n, top = len(nodes), max(took)
    quantiles = ', '.join(
        f'{100.0 * q:g} %: {a:g} ({1e3 * t:.2f} ms)'
        for q, a, t in zip(QUANTILES, np.quantile(nodes, QUANTILES), np.quantile(times, QUANTILES),
                           strict=True)
    )  # fmt: skip
    up = max(worst)
    pace = up.time / up.nodes
    whole = f'; the whole tree has {row.most:g}, {1e3 * pace * row.most:.3g} ms'
    return (
        f'  nodes (and times): {quantiles}\n'
        f'  most of {n} draws: {top.nodes:g} ({1e3 * top.time:.1f} ms): with 95 % confidence more '
        f'in less than {3.0 / n:.2g} of the box\n'
        f'  climbing from the {len(worst)} worst: {up.nodes:g} ({1e3 * up.time:.1f} ms), '
        f'{1e6 * pace:.1f} us a node{whole if row.most < math.inf else ""}\n'
        f'  proved: {100.0 * proved.mean():.3f} %'
    )


def main() -> int:
    """Print the rows and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--count', type=int, default=10000, help='draws')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--row', choices=rows(), action='append')
    args = parser.parse_args()
    for name in args.row or rows():
        row, rng = rows()[name], np.random.default_rng(args.seed)
        examined = examiner(row)
        places = rng.uniform(-1.0, 1.0, size=(args.count, len(row.half)))
        took = [examined(each) for each in places]
        order = np.argsort([-each.nodes for each in took])[:WORST]
        worst = [climbed(examined, rng, places[i], took[i]) for i in order]
        print(f'{name}, seed {args.seed}\n{told(row, took, worst)}', flush=True)
    return 0


if __name__ == '__main__':
    sys.exit(main())
