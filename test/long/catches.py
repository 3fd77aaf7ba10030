# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Certified catches against the closed form of Dubins interception, as steps get shorter.

    python test/long/catches.py --count 200 --seed 1

Constant airspeed, a limited turn rate, a constant wind, a goal that moves straight on, any heading
at the end. At every length of the steps: by how much the earliest catch that is found is later
than the closed form, at the end of a step and, with ``--between``, where it is known where the goal
is in between; and how often the step before is proved to have none. Exit code 1 if a catch is
sooner than the closed form by more than a step.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
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

    ``later`` is infinite without a catch, ``missed`` in radii of a catch; ``between`` is by how
    much the catch between the ends of steps is later [s], nan where none is looked for.
    """

    step: float
    time: float
    later: float
    missed: float
    never: bool
    between: float = math.nan


def row(chase: chases.Chase, step: float, between: bool) -> Row | None:
    """Catch at the first step that ends after the closed form, or soon; None if it is too far."""
    exact = earliest(chase)[0]
    end = math.ceil(exact / step - 1e-9)
    if end + TRIES > MOST:
        return None
    finer = math.nan
    if between:
        finer = chases.catch(chase, step, end + TRIES, between=True).time - exact
    before = chases.tried(chase, step, end - 1, _deadline())
    if before.miss <= 1.0:
        return Row(step, exact, (end - 1) * step - exact, before.miss, before.never, finer)
    tries = range(end, end + TRIES)
    caught = next((k for k in tries if chases.tried(chase, step, k, _deadline()).miss <= 1.0), None)
    later = math.inf if caught is None else caught * step - exact
    return Row(step, exact, later, before.miss, before.never, finer)


def _deadline():
    until = time.process_time() + PATIENCE
    return lambda: time.process_time() > until


def told(name: str, rows: list[Row]) -> str:
    """A line on the rows of one length of the steps."""
    later = np.array([each.later for each in rows])
    share = 100.0 * later / np.array([each.time for each in rows])
    found = np.isfinite(later)
    if not found.any():
        return f'{name}: no catches'
    return _told_between(rows) + (
        f'{name}: {found.sum()} of {len(rows)} caught, later than the closed form by '
        f'{np.median(later[found]):.3f} s in the median, {later[found].min():+.3f} to '
        f'{later[found].max():+.3f} s; {np.median(share[found]):.2f} %, at most '
        f'{share[found].max():.2f} %; the step before has none: proved in '
        f'{sum(each.never for each in rows)}, missed in {sum(each.missed > 1.0 for each in rows)}'
    )


def _told_between(rows: list[Row]) -> str:
    """A line on the catches between the ends of steps; empty without any."""
    later = np.array([each.between for each in rows])
    share = 100.0 * np.abs(later) / np.array([each.time for each in rows])
    found = np.isfinite(later)
    if not found.any():
        return ''
    return (
        f'between the ends of steps {found.sum()} of {len(rows)}, later by '
        f'{np.median(later[found]):+.4f} s in the median, {later[found].min():+.4f} to '
        f'{later[found].max():+.4f} s; off by {np.median(share[found]):.2f} %, at most '
        f'{share[found].max():.2f} %\n'
    )


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument('--count', type=int, default=200)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--between', action='store_true')
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    sets = {
        'of others': [known.chase for known in chases.references()],
        'at random': [chases.drawn(rng, SHORTEST, LONGEST) for _ in range(args.count)],
    }
    sooner = 0
    for name, chased in sets.items():
        for step in STEPS:
            rows = [each for chase in chased if (each := row(chase, step, args.between))]
            print(told(f'{name}, {step:g} s', rows), flush=True)
            sooner += sum(each.later < -step for each in rows)
    return 1 if sooner else 0


if __name__ == '__main__':
    sys.exit(main())
