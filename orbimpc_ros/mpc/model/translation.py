# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Translation models: what thrust along R e1 does to position and velocity, as maps.

A model is a few numbers, registered under the value of ``translation_order`` that selects it. Along
every axis of the world it says

    y_{k+1} = A y_k + b (R_k e1) + c (R_{k+1} e1) + e w,   y = (s) or (s, p),

with A = (1) or (1, h; 0, kept): where a vehicle is has no influence on how it moves. w is the
disturbance, the same at every step: a wind, or an acceleration, which acts as a steady thrust
would. Rollouts, maps, the convex programs, the check and natural units follow from A, b, c and e.
Proofs have them in fractions, too: the models here state no number that a double rounds.

Mathematics: docs/mathematics.md, 1.1.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed


class Translation(NamedTuple):
    """How a vehicle is pushed along R e1.

    With a velocity in y it is inertial, and R e1 a thrust: y = (s, p), which full thrust z for all
    of a step changes by the order of (h^2 z, h z). Otherwise y = (s), which full speed z changes by
    (h z), and the velocity is z R e1.

    Attributes:
        push: what that is divided by to make b, for each entry of y; 0 where b is zero.
        follow: the same for c, which is zero unless the turn within a step is felt in it.
        degree: of the motion of s within a step, as a polynomial of time.
        kept: share of the velocity that is left after a step.
    """

    push: tuple[int, ...]
    follow: tuple[int, ...]
    degree: int = 1
    kept: float = 1.0

    @property
    def inertial(self) -> bool:
        """Return whether the velocity p is part of the state."""
        return len(self.push) == 2


# Explicit Euler; R e1 on the chord from R_k e1 to R_{k+1} e1 during the step; R_{k+1} e1 attained
# as the step begins, and held: s then moves along a parabola.
TRANSLATIONS = {1: Translation((1,), (0,)), 2: Translation((0, 1), (0, 0))}
EXACT = {1: Translation((2,), (2,), degree=2), 2: Translation((3, 2), (6, 2), degree=3)}
HELD = {2: Translation((0, 0), (2, 1), degree=2)}
DISCRETISATIONS = {'euler': TRANSLATIONS, 'exact': EXACT, 'held': HELD}


class Step(NamedTuple):
    """One step of a model: y_{k+1} = A y_k + b (R_k e1) + c (R_{k+1} e1) + e w.

    Attributes:
        transition: A, shape (m, m).
        push: b, shape (m,).
        follow: c, shape (m,).
        blow: e, shape (m,).
    """

    transition: Array
    push: Array
    follow: Array
    blow: Array


@lru_cache(maxsize=256, typed=True)  # in fractions and in floats
def step_of(model: Translation, step: float, forward: float) -> Step:
    """Return a step of a model; made once."""

    def moved(divisors: tuple[int, ...], full: float) -> Array:
        sizes = (step * step * full, step * full)[-len(divisors) :]
        pairs = zip(sizes, divisors, strict=True)
        return np.array([size / by if by else 0.0 for size, by in pairs])

    transition = np.array([[1.0, step], [0.0, model.kept]]) if model.inertial else np.eye(1)
    push, follow = moved(model.push, forward), moved(model.follow, forward)
    blow = moved(model.push, 1) + moved(model.follow, 1)
    return Step(*map(sealed, (transition, push, follow, blow)))


class Maps:
    """The maps of a model over a horizon, from the state at its start and R_0 e1..R_N e1.

    Attributes:
        reach: what each R_j e1 adds to s_1..s_N, shape (N, N + 1) [m].
        drift: what p_0 adds to s_1..s_N, shape (N, 1) [s]; zeros for a model without inertia.
        blown: what w adds to s_1..s_N, shape (N, 1) [s] or [s^2].
        arrival: what each R_j e1 adds to y_N, shape (m, N + 1).
        carried: what p_0 adds to p_1..p_N, shape (N, 1).
        pushed: what each R_j e1 adds to p_1..p_N of an inertial model, shape (N, N + 1) [m/s].
        hastened: what w adds to p_1..p_N of an inertial model, shape (N, 1) [s].
        lasting: for how much of a step each R_j e1 pushes, shape (N + 1,).
        unit: what a step moves the vehicle at most, from rest: h z, or h^2 z with inertia [m].
    """

    def __init__(self, model: Translation, horizon: int, step: float, forward: float) -> None:
        once = step_of(model, step, forward)
        pushes = [_responses(once.transition, each, horizon) for each in once[1:]]
        after = np.zeros((horizon, horizon + 1, len(once.push)))
        after[:, 1:] = _lagged(pushes[1])[:, :horizon]
        every = _lagged(pushes[0]) + after
        self.reach = sealed(every[:, :, 0].copy())
        self.arrival = sealed(every[-1].T.copy())
        self.pushed = sealed(every[:, :, -1].copy())
        blown = np.cumsum(pushes[2], axis=0)
        self.blown = sealed(blown[:, :1].copy())
        self.hastened = sealed(blown[:, -1:].copy())
        still = np.zeros((horizon, 1))
        moved = _responses(once.transition, once.transition, horizon)  # A^k, k = 1..N
        self.drift = sealed(moved[:, :1, 1].copy() if model.inertial else still)
        self.carried = sealed(moved[:, 1:, 1].copy() if model.inertial else still)
        self.lasting = sealed(_shares(once, horizon))
        self.unit = step * (step * forward) if model.inertial else step * forward


def _responses(transition: Array, first: Array, horizon: int) -> Array:
    """Return A^k times the first response, k = 0..N-1, shape (N, ...)."""
    responses = [first]
    for _ in range(horizon - 1):
        responses.append(transition @ responses[-1])
    return np.array(responses)


def _lagged(responses: Array) -> Array:
    """Return what a push at step j = 0..N adds to y_1..y_N, shape (N, N + 1, m)."""
    horizon = len(responses)
    lag = np.arange(horizon)[:, None] - np.arange(horizon + 1)[None, :]
    return np.where(lag[:, :, None] >= 0, responses[np.maximum(lag, 0)], 0.0)


def _shares(once: Step, horizon: int) -> Array:
    """Return for how much of a step each R_j e1 pushes: what it adds to the last entry of y."""
    late = once.follow[-1] / (once.push[-1] + once.follow[-1])
    shares = np.ones(horizon + 1)
    shares[0], shares[-1] = 1.0 - late, late
    return shares


@lru_cache(maxsize=256)
def maps_of(model: Translation, horizon: int, step: float, forward: float) -> Maps:
    """Return the maps of a model; made once."""
    return Maps(model, horizon, step, forward)
