# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Random problems of every kind that certificates are of, each bound verified exactly.

    python test/long/certificates.py --count 1000 --seed 1 --mutants 500

Problems are dealt out to the kinds in turn. Exit code 1 if a bound does not hold, or a mutant of a
certificate does.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter, defaultdict
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import certified

from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.mpc.proof.document import verified
from orbimpc_ros.mpc.proof.prove import Unproved, certificate_of
from orbimpc_ros.mpc.proof.reading import Refused, parsed
from orbimpc_ros.mpc.solve.solver import Solver

PATIENCE = 5.0  # [s] of computing, of a solve


def examined(kind: str, seed: int, index: int, longest: int) -> tuple[str, dict]:
    """Return what became of a problem, with its certificate, times and excess."""
    case = certified.case(kind, np.random.default_rng([seed, index]), longest)
    try:
        solver = Solver(case.problem, coasting=case.state.coasted is not None, patient=True)
        end = time.process_time() + PATIENCE
        plan = solver.solve(case.state, case.goals, None, lambda: time.process_time() > end)
        solved = time.process_time()
        made = certificate_of(*case, plan.proof)
    except Unproved as error:
        return ('unproved', {'words': str(error)})
    except OrbimpcError:
        return ('unsolved', {})
    proved, text = time.process_time(), made.text()
    verdict = verified(parsed(text.encode()))
    took = proved - solved, time.process_time() - proved
    excess = (verdict.claimed - verdict.proved) / (verdict.claimed or 1.0)
    found = {'document': made.document(), 'took': took, 'excess': excess, 'leaves': verdict.leaves}
    return ('holds' if verdict.holds else 'FAILS', found)


def standing(known: dict, rng: np.random.Generator) -> str:
    """Return the name of a mutant that was taken for a proof; empty if it was not."""
    name, text = certified.mutant(known, rng)
    try:
        return name if verified(parsed(text.encode())).holds else ''
    except Refused:
        return ''


def main() -> int:
    """Examine, print a row for each kind, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--count', type=int, default=1000)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--longest', type=int, default=20, help='horizon')
    parser.add_argument('--mutants', type=int, default=500)
    limited = certified.LIMITED | certified.TIED | certified.PACED
    every = list(certified.KINDS | limited | certified.LEFT)
    parser.add_argument('--kinds', nargs='+', choices=every, default=every, metavar='KIND')
    args = parser.parse_args()
    kinds = args.kinds
    rows, known = defaultdict(list), []
    for index in range(args.count):
        kind = kinds[index % len(kinds)]
        outcome, found = examined(kind, args.seed, index, args.longest)
        rows[kind].append((outcome, found))
        if outcome in ('FAILS', 'unproved'):
            print(f'{kind}, seed {args.seed} index {index}: {outcome}', found.get('words', ''))
        made = found.pop('document', None)
        if made and made['lower_bound'] > 0.0:
            known.append(made)
    for kind, some in rows.items():
        print(row(kind, some))
    rng = np.random.default_rng(args.seed)
    taken = [standing(known[int(rng.integers(len(known)))], rng) for _ in range(args.mutants)]
    print(f'{args.mutants} mutants, taken for proofs: {dict(Counter(filter(None, taken)))}')
    failed = any(outcome == 'FAILS' for some in rows.values() for outcome, _ in some)
    return 1 if failed or any(taken) else 0


def row(kind: str, some: list) -> str:
    """Return counts, the largest excess, medians of times and the most leaves."""
    counts = Counter(outcome for outcome, _ in some)
    made = [found for _, found in some if 'took' in found]
    if not made:
        return f'{kind:<24}{dict(counts)}'
    prove, verify = np.median([found['took'] for found in made], axis=0)
    return (
        f'{kind:<24}{dict(counts)}  excess at most {max(f["excess"] for f in made):.1e}, '
        f'{1e3 * prove:.0f} ms to prove, {1e3 * verify:.0f} ms to verify, '
        f'{max(f["leaves"] for f in made)} leaves at most'
    )


if __name__ == '__main__':
    sys.exit(main())
