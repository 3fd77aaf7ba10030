# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Translation models: what thrust along R e1 does to position and velocity, as maps.

A model is one class, registered under the value of ``translation_order`` that selects it. Along
every axis of the world it says

    y_{k+1} = A y_k + b (R_k e1) + c (R_{k+1} e1) + e w,   y = (s) or (s, p),

with A upper triangular and A_11 = 1: where a vehicle is has no influence on how it moves. w is the
disturbance, the same at every step: a wind, or an acceleration. Rollouts, maps, the convex
programs, the check and natural units follow from A, b, c and e. Proofs have them in fractions, too:
the models here state no number that a double rounds.

Mathematics: docs/mathematics.md, 1.1.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed


class Translation(ABC):
    """How a vehicle is pushed along R e1.

    Attributes:
        inertial: whether the velocity p is part of the state, y = (s, p), and R e1 a thrust.
            Otherwise y = (s), and the velocity is z R e1.
        degree: of the motion of s within a step, as a polynomial of time.
    """

    inertial: bool
    degree: int = 1

    @abstractmethod
    def transition(self, step: float) -> Array:
        """Return A for steps of h [s], shape (m, m).

        In other units of length and time it must describe the same motion: entry (1, 2) is a time,
        the diagonal has no unit.
        """

    @abstractmethod
    def push(self, step: float, forward: float) -> Array:
        """Return b for full speed or thrust z, shape (m,) [m], [m/s]."""

    def follow(self, step: float, forward: float) -> Array:
        """Return c, shape (m,) [m], [m/s]; zero unless the turn within a step is felt in it."""
        return np.zeros(len(self.push(step, forward)))

    def blow(self, step: float) -> Array:
        """Return e, shape (m,) [s], or [s^2], [s]; by default w acts as a steady thrust would."""
        return self.push(step, 1) + self.follow(step, 1)


class FirstOrder(Translation):
    """Order 1: s_{k+1} = s_k + h (z R_k e1 + w)."""

    inertial = False

    def transition(self, step: float) -> Array:
        """Return (1)."""
        return np.eye(1)

    def push(self, step: float, forward: float) -> Array:
        """Return (h z)."""
        return np.array([step * forward])


class SecondOrder(Translation):
    """Order 2: p_{k+1} = p_k + h (z R_k e1 + w) and s_{k+1} = s_k + h p_k."""

    inertial = True

    def transition(self, step: float) -> Array:
        """Return (1, h; 0, 1)."""
        return np.array([[1.0, step], [0.0, 1.0]])

    def push(self, step: float, forward: float) -> Array:
        """Return (0, h z)."""
        return np.array([0.0, step * forward])


class FirstOrderExact(FirstOrder):
    """Order 1, R e1 on the chord from R_k e1 to R_{k+1} e1 during the step."""

    degree = 2

    def push(self, step: float, forward: float) -> Array:
        """Return (h z / 2)."""
        return np.array([step * forward / 2])

    def follow(self, step: float, forward: float) -> Array:
        """Return (h z / 2)."""
        return np.array([step * forward / 2])


class SecondOrderExact(SecondOrder):
    """Order 2, R e1 on the chord from R_k e1 to R_{k+1} e1 during the step."""

    degree = 3

    def push(self, step: float, forward: float) -> Array:
        """Return (h^2 z / 3, h z / 2)."""
        return np.array([step * step * forward / 3, step * forward / 2])

    def follow(self, step: float, forward: float) -> Array:
        """Return (h^2 z / 6, h z / 2)."""
        return np.array([step * step * forward / 6, step * forward / 2])


class SecondOrderHeld(SecondOrder):
    """Order 2, R_{k+1} e1 attained as the step begins, and held: s moves along a parabola."""

    degree = 2

    def push(self, step: float, forward: float) -> Array:
        """Return (0, 0): what the vehicle has been commanded before is over."""
        return np.zeros(2)

    def follow(self, step: float, forward: float) -> Array:
        """Return (h^2 z / 2, h z)."""
        return np.array([step * step * forward / 2, step * forward])


TRANSLATIONS: dict[int, Translation] = {1: FirstOrder(), 2: SecondOrder()}
EXACT: dict[int, Translation] = {1: FirstOrderExact(), 2: SecondOrderExact()}
HELD: dict[int, Translation] = {2: SecondOrderHeld()}
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
    made = (
        model.transition(step),
        model.push(step, forward),
        model.follow(step, forward),
        model.blow(step),
    )
    return Step(*map(sealed, made))


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
