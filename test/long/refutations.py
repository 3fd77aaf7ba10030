# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Random problems that a method says nothing satisfies: how many of them are refuted exactly.

    python test/long/refutations.py --count 200 --seed 1

Of each kind in turn, the next problem that is said to be infeasible. Exit code 1 if a refutation
is found of one that has a plan.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
from collections import Counter, defaultdict
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import refutable

from orbimpc_ros.mpc.errors import Infeasible, OrbimpcError
from orbimpc_ros.mpc.problem.case import Case
from orbimpc_ros.mpc.problem.sought import Sought
from orbimpc_ros.mpc.proof.document import verified
from orbimpc_ros.mpc.proof.prove import Unproved
from orbimpc_ros.mpc.proof.reading import parsed
from orbimpc_ros.mpc.proof.refute import refutation_of
from orbimpc_ros.mpc.solve.solver import Solver

PATIENCE = 10.0  # [s] of a method


def said_of(case: Case) -> str:
    """Return what a method says of a problem: infeasible, solved, or nothing."""
    solver = Solver(case.problem, coasting=case.state.coasted is not None, patient=True)
    end = time.perf_counter() + PATIENCE
    try:
        solver.solve(case.state, case.goals, None, lambda: time.perf_counter() > end)
    except Infeasible:
        return 'infeasible'
    except OrbimpcError:
        return 'nothing'
    return 'solved'


def refuted(case: Case) -> tuple[str, int]:
    """Return what becomes of a refutation, and how many leaves it has."""
    try:
        made = refutation_of(Sought(*case))
    except Unproved:
        return 'not refuted', 0
    verdict = verified(parsed(made.text().encode()))
    return 'refuted' if verdict.holds else 'refused', verdict.leaves


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--count', type=int, default=200)
    parser.add_argument('--seed', type=int, default=1)
    args = parser.parse_args()
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    done, wrong, seconds, leaves = 0, 0, [], []
    for index in itertools.count():
        kind = list(refutable.KINDS)[index % len(refutable.KINDS)]
        case = refutable.KINDS[kind](np.random.default_rng([args.seed, index]))
        said, begun = said_of(case), time.process_time()
        outcome, count = refuted(case)
        counts[kind][f'{said}, {outcome}'] += 1
        wrong += said == 'solved' and outcome == 'refuted'
        if said == 'infeasible':
            done += 1
            seconds.append(time.process_time() - begun)
            leaves.append(count)
        if done == args.count:
            break
    for kind, each in counts.items():
        print(f'{kind:<28}' + ', '.join(f'{n} {what}' for what, n in sorted(each.items())))
    total = sum(counts.values(), Counter())
    print(f'{"all":<28}' + ', '.join(f'{n} {what}' for what, n in sorted(total.items())))
    print(f'leaves: median {np.median(leaves):g}, most {max(leaves)}')
    print(f'seconds: median {np.median(seconds):.3g}, most {max(seconds):.3g}')
    return 1 if wrong else 0


if __name__ == '__main__':
    sys.exit(main())
