# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Certified catches against the closed form of Dubins interception, as steps get shorter.

    python test/long/catches.py --count 200 --seed 1
    python test/long/catches.py --count 200 --seed 1 --between --steps 0.05

Constant airspeed, a limited turn rate, a constant wind, a goal that moves straight on, any heading
at the end. At every length of the steps: by how much the earliest catch that is found is later
than the closed form, and how often none is proved to be before. At ends of steps, one is looked for
at the step that ends just before the closed form, and at the three that end after it. With
``--between``, where it is known where the goal is in between, at every end from the first that the
goal is within reach of to the third after the closed form, and within the steps that may lead past
the goal: none is left out. There the catch is also held against the closed form of being within the
radius that counts as caught. Each row is printed as it is found. Exit code 1 if a catch is sooner
than the closed form by more than a step, or sooner than that of the radius.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import chases
from dubins import earliest, earliest_within

STEPS = (0.4, 0.2, 0.1, 0.05)  # [s]
MOST = 120  # steps: about as many as are searched in machine code
SHORTEST, LONGEST = 1.5, 6.0  # [s] of a chase at random
PATIENCE = 20.0  # [s] of processor time for a step's proof
HASTE = 5.0  # [s] of it for each of the hundred searches of a chase
SHARP = 1e-3  # [s] by which a catch may be sooner than the radius allows: it is known by points
TRIES = 3  # steps after the closed form at which a catch is looked for


class Row(NamedTuple):
    """What came of a chase: by how much the catch is later [s], and what is known of before.

    ``later`` is infinite without a catch, ``never`` whether none is proved to be at the end of the
    last step before the closed form, where the plan ``missed`` by so many radii; or, of catches
    between ends, at any end before the catch. These are ``over`` the closed form of being within
    the radius [s].
    """

    step: float
    time: float
    later: float
    never: bool
    missed: float = math.nan
    over: float = math.nan


def row(chase: chases.Chase, step: float, between: bool) -> Row | None:
    """Catch at the first step that ends after the closed form, or soon; None if it is too far."""
    exact = earliest(chase)[0]
    end = math.ceil(exact / step - 1e-9)
    if end + TRIES > MOST:
        return None
    if between:
        found = chases.soonest(chase, step, end + TRIES, lambda: _deadline(HASTE))
        caught = math.inf if math.isnan(found.time) else found.time
        over = caught - earliest_within(chase, chases.radius(chase, step))
        return Row(step, exact, caught - exact, found.bound >= found.time, over=over)
    before = chases.tried(chase, step, end - 1, _deadline(PATIENCE))
    if before.miss <= 1.0:
        return Row(step, exact, (end - 1) * step - exact, before.never, before.miss)
    caught = next((k for k in range(end, end + TRIES) if _is_caught(chase, step, k)), None)
    later = math.inf if caught is None else caught * step - exact
    return Row(step, exact, later, before.never, before.miss)


def _is_caught(chase: chases.Chase, step: float, end: int) -> bool:
    return chases.tried(chase, step, end, _deadline(PATIENCE)).miss <= 1.0


def _deadline(patience: float) -> Callable[[], bool]:
    until = time.process_time() + patience
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
    proved = f'proved in {sum(each.never for each in rows)}'
    if between:
        over = np.array([each.over for each in rows])[found]
        within = f'over that of the radius by {over.min():+.4f} to {over.max():+.4f} s'
        return f'{caught}; {within}; no end of a step before has a catch: {proved}'
    missed = sum(each.missed > 1.0 for each in rows)
    return f'{caught}; the step before has none: {proved}, missed in {missed}'


def shown(rows: Iterable[Row | None]) -> Iterator[Row]:
    """Print each row as it is found, for the last one may take hours."""
    for number, each in enumerate(rows):
        if each is not None:
            share, proof = each.later / each.time, 'proved' if each.never else 'not proved'
            caught = f'{each.time:.3f} s, later by {each.later:+.4f} s, {share:+.2%}'
            print(f'  {number}: {caught}; none before: {proof}', flush=True)
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
            sooner += sum(each.later < -step or each.over < -SHARP for each in rows)
    return 1 if sooner else 0


if __name__ == '__main__':
    sys.exit(main())
