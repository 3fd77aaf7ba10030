# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Translation models: linear maps from the thrust along R e1 to position and velocity.

A model is a few numbers, registered under a value of ``translation_order``. It is, along every axis
of the world,

    y_{k+1} = A y_k + b (R_k e1) + c (R_{k+1} e1) + e w,   y = (s) or (s, p),

with A = (1) or (1, h; 0, kept): the motion does not depend on the position. w is the disturbance,
the same at every step: a wind, or an acceleration, which acts as a constant thrust would. Rollouts,
maps, the convex programs, the check and natural units follow from A, b, c and e. Proofs compute
them in fractions, too: no number of these models is rounded to a double.

Mathematics: docs/mathematics.md, 1.1.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed


class Translation(NamedTuple):
    """The coefficients of a model of the motion due to R e1.

    A model with a velocity in y is inertial, and R e1 a thrust: full thrust z for a step changes
    y = (s, p) by the order of (h^2 z, h z). Otherwise y = (s), full speed z changes it by (h z),
    and the velocity is z R e1.

    Attributes:
        push: b is that change divided by these, entry by entry of y; where b is 0, so are these.
        follow: the same for c, which is zero unless the turn within a step affects that step.
        degree: of the motion of s within a step, as a polynomial of time.
        kept: share of the velocity that remains after a step.
    """

    push: tuple[int, ...]
    follow: tuple[int, ...]
    degree: int = 1
    kept: float = 1.0

    @property
    def inertial(self) -> bool:
        """Return True if the velocity p is part of the state."""
        return len(self.push) == 2


# Explicit Euler; R e1 on the chord from R_k e1 to R_{k+1} e1 during a step; R_{k+1} e1 attained at
# the start of the step and held, so that s moves along a parabola.
TRANSLATIONS = {1: Translation((1,), (0,)), 2: Translation((0, 1), (0, 0))}
EXACT = {1: Translation((2,), (2,), degree=2), 2: Translation((3, 2), (6, 2), degree=3)}
HELD = {2: Translation((0, 0), (2, 1), degree=2)}
DISCRETISATIONS = {'euler': TRANSLATIONS, 'exact': EXACT, 'held': HELD}


STARTED = [0, -2, -1]  # columns of R_0 e1, p_0 and w in the maps of a horizon


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


@lru_cache(maxsize=256, typed=True)  # one entry for fractions, one for floats
def step_of(model: Translation, step: float, forward: float) -> Step:
    """Return a step of a model; cached."""

    def moved(divisors: tuple[int, ...], full: float) -> Array:
        sizes = (step * step * full, step * full)[-len(divisors) :]
        pairs = zip(sizes, divisors, strict=True)
        return np.array([size / by if by else 0.0 for size, by in pairs])

    transition = np.array([[1.0, step], [0.0, model.kept]]) if model.inertial else np.eye(1)
    push, follow = moved(model.push, forward), moved(model.follow, forward)
    blow = moved(model.push, 1) + moved(model.follow, 1)
    return Step(*map(sealed, (transition, push, follow, blow)))


def controls(degree: int, step: float, positions: Array, velocities: Array) -> Array:
    """Return the control points of each step, shape (N, degree + 1, ...).

    A step of explicit Euler moves along a straight line, one that is integrated exactly along a
    curve of degree 2 or 3, determined by positions and velocities at its ends (Bernstein, Bezier).
    It stays in the hull of its control points (3.7). Those are s_0..s_N and p_0..p_N, shape
    (N + 1, ...) each.
    """
    begin, end = positions[:-1], positions[1:]
    leave, arrive = step / degree * velocities[:-1], step / degree * velocities[1:]
    between = [[], [begin + leave], [begin + leave, end - arrive]][degree - 1]
    return np.stack([begin, *between, end], axis=1)


class Maps:
    """The maps of a model over a horizon of N steps.

    Attributes:
        places: coefficients of R_0 e1..R_N e1, p_0 and the disturbance w in s_0..s_N, less s_0,
            shape (N + 1, N + 3).
        speeds: the same in p_0..p_N, without inertia in the velocities z R_k e1 + w.
        reach: those of R_0 e1..R_N e1 in s_1..s_N, shape (N, N + 1) [m].
        controls: those of R_1 e1..R_N e1 in the control points of steps, less s_0, shape
            (N, degree + 1, N).
        started: those of R_0 e1, p_0 and w in the same, shape (N, degree + 1, 3).
        arrival: those of R_0 e1..R_N e1 in s_N, and with inertia in p_N, shape (m, N + 1).
        lasting: share of a step for which each R_j e1 acts, shape (N + 1,).
        unit: a step's length, the longest from rest: h z, or h^2 z with inertia [m].
    """

    def __init__(self, model: Translation, horizon: int, step: float, forward: float) -> None:
        once = step_of(model, step, forward)
        # A rollout of unit vectors: one for each of R_0 e1..R_N e1, one for p_0 and one for w.
        *axes, speed, wind = np.eye(horizon + 3)
        rolled = np.zeros((horizon + 1, len(once.push), horizon + 3))
        if model.inertial:
            rolled[0, 1] = speed
        for k in range(horizon):
            pushed = np.outer(once.push, axes[k]) + np.outer(once.follow, axes[k + 1])
            rolled[k + 1] = once.transition @ rolled[k] + pushed + np.outer(once.blow, wind)
        self.places = rolled[:, 0].copy()
        self.speeds = rolled[:, 1].copy() if model.inertial else forward * np.array(axes) + wind
        self.reach = self.places[1:, :-2].copy()
        points = controls(model.degree, step, self.places, self.speeds)
        self.controls, self.started = points[:, :, 1:-2], points[:, :, STARTED]
        self.arrival = rolled[-1, :, :-2].copy()
        late = once.follow[-1] / (once.push[-1] + once.follow[-1])
        self.lasting = np.ones(horizon + 1)
        self.lasting[[0, -1]] = 1.0 - late, late
        for each in vars(self).values():
            sealed(each)
        self.unit = step * (step * forward) if model.inertial else step * forward


maps_of = lru_cache(maxsize=256)(Maps)
