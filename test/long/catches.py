# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Certified catches against the closed form of Dubins interception, as steps get shorter.

    python test/long/catches.py --count 200 --seed 1
    python test/long/catches.py --count 200 --seed 1 --between --steps 0.05

Constant airspeed, a limited turn rate, a constant wind, a goal that moves straight on, any heading
at the end. At every length of the steps: by how much the earliest catch that is found is later
than the closed form, at the end of a step, and how often the step before is proved to have none;
or, with ``--between``, where it is known where the goal is in between. Exit code 1 if a catch is
sooner than the closed form by more than a step.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import chases
from dubins import earliest

STEPS = (0.4, 0.2, 0.1, 0.05)  # [s]
MOST = 120  # steps: about as many as are searched in machine code
SHORTEST, LONGEST = 1.5, 6.0  # [s] of a chase at random
PATIENCE = 20.0  # [s] of processor time for a step's proof
TRIES = 3  # steps after the closed form at which a catch is looked for


class Row(NamedTuple):
    """What came of a chase: by how much the catch is later [s], whether the step before has none.

    ``later`` is infinite without a catch, ``missed`` in radii of a catch; nothing is told of the
    step before where catches may be between the ends of steps.
    """

    step: float
    time: float
    later: float
    missed: float = math.nan
    never: bool = False


def row(chase: chases.Chase, step: float, between: bool) -> Row | None:
    """Catch at the first step that ends after the closed form, or soon; None if it is too far."""
    exact = earliest(chase)[0]
    end = math.ceil(exact / step - 1e-9)
    if end + TRIES > MOST:
        return None
    if between:
        found = chases.catch(chase, step, end + TRIES, between=True).time
        return Row(step, exact, math.inf if math.isnan(found) else found - exact)
    before = chases.tried(chase, step, end - 1, _deadline())
    if before.miss <= 1.0:
        return Row(step, exact, (end - 1) * step - exact, before.miss, before.never)
    tries = range(end, end + TRIES)
    caught = next((k for k in tries if chases.tried(chase, step, k, _deadline()).miss <= 1.0), None)
    later = math.inf if caught is None else caught * step - exact
    return Row(step, exact, later, before.miss, before.never)


def _deadline():
    until = time.process_time() + PATIENCE
    return lambda: time.process_time() > until


def told(name: str, rows: list[Row], between: bool) -> str:
    """A line on the rows of one length of the steps."""
    later = np.array([each.later for each in rows])
    share = 100.0 * np.abs(later) / np.array([each.time for each in rows])
    found = np.isfinite(later)
    if not found.any():
        return f'{name}: no catches'
    caught = (
        f'{name}: {found.sum()} of {len(rows)} caught, later than the closed form by '
        f'{np.median(later[found]):.3f} s in the median, {later[found].min():+.3f} to '
        f'{later[found].max():+.3f} s; off by {np.median(share[found]):.2f} %, at most '
        f'{share[found].max():.2f} %'
    )
    if between:
        return caught
    return (
        f'{caught}; the step before has none: proved in {sum(each.never for each in rows)}, '
        f'missed in {sum(each.missed > 1.0 for each in rows)}'
    )


def shown(rows: Iterable[Row | None]) -> Iterator[Row]:
    """Print each row as it is found, for the last one may take hours."""
    for number, each in enumerate(rows):
        if each is not None:
            print(f'  {number}: {each.time:.3f} s, later by {each.later:+.4f} s', flush=True)
            yield each


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument('--count', type=int, default=200)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--steps', type=float, nargs='+', default=STEPS)
    parser.add_argument('--between', action='store_true')
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    sets = {
        'of others': [known.chase for known in chases.references()],
        'at random': [chases.drawn(rng, SHORTEST, LONGEST) for _ in range(args.count)],
    }
    sooner = 0
    for name, chased in sets.items():
        for step in args.steps:
            rows = list(shown(row(chase, step, args.between) for chase in chased))
            print(told(f'{name}, {step:g} s', rows, args.between), flush=True)
            sooner += sum(each.later < -step for each in rows)
    return 1 if sooner else 0


if __name__ == '__main__':
    sys.exit(main())
