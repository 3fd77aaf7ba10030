"""Translation models: what thrust along R e1 does to position and velocity, as maps.

A model is one class, registered under the value of ``translation_order`` that selects it. Along
every axis of the world it says

    y_{k+1} = A y_k + b (R_k e1),   y = (s) or (s, p),

with A upper triangular and A_11 = 1: where a vehicle is has no influence on how it moves. Rollouts,
maps, the convex programs, the check and natural units follow from A and b.

Mathematics: docs/mathematics.md, 1.1.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import lru_cache

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed


class Translation(ABC):
    """How a vehicle is pushed along R e1.

    Attributes:
        inertial: whether the velocity p is part of the state, y = (s, p), and R e1 a thrust.
            Otherwise y = (s), and the velocity is z R e1.
    """

    inertial: bool

    @abstractmethod
    def transition(self, step: float) -> Array:
        """Return A for steps of h [s], shape (m, m).

        In other units of length and time it must describe the same motion: entry (1, 2) is a time,
        the diagonal has no unit.
        """

    @abstractmethod
    def push(self, step: float, forward: float) -> Array:
        """Return b for full speed or thrust z, shape (m,) [m], [m/s]."""


class FirstOrder(Translation):
    """Order 1: s_{k+1} = s_k + h z R_k e1."""

    inertial = False

    def transition(self, step: float) -> Array:
        """Return (1)."""
        return np.eye(1)

    def push(self, step: float, forward: float) -> Array:
        """Return (h z)."""
        return np.array([step * forward])


class SecondOrder(Translation):
    """Order 2: p_{k+1} = p_k + h z R_k e1 and s_{k+1} = s_k + h p_k."""

    inertial = True

    def transition(self, step: float) -> Array:
        """Return (1, h; 0, 1)."""
        return np.array([[1.0, step], [0.0, 1.0]])

    def push(self, step: float, forward: float) -> Array:
        """Return (0, h z)."""
        return np.array([0.0, step * forward])


TRANSLATIONS: dict[int, Translation] = {1: FirstOrder(), 2: SecondOrder()}


class Maps:
    """The maps of a model over a horizon, from the state at its start and R_0 e1..R_N e1.

    Attributes:
        reach: what each R_j e1 adds to s_1..s_N, shape (N, N + 1) [m].
        drift: what p_0 adds to s_1..s_N, shape (N, 1) [s]; zeros for a model without inertia.
        arrival: what each R_j e1 adds to y_N, shape (m, N + 1).
        carried: what p_0 adds to p_1..p_N, shape (N, 1).
        pushed: what each R_j e1 adds to p_1..p_N of an inertial model, shape (N, N + 1) [m/s].
        unit: what a step moves the vehicle at most, from rest [m].
    """

    def __init__(self, model: Translation, horizon: int, step: float, forward: float) -> None:
        transition, push = model.transition(step), model.push(step, forward)
        responses, powers = [push], [transition]  # A^k b and A^(k+1), k = 0..N-1
        for _ in range(horizon - 1):
            responses.append(transition @ responses[-1])
            powers.append(transition @ powers[-1])
        effect, moved = np.array(responses), np.array(powers)
        lag = np.arange(horizon)[:, None] - np.arange(horizon + 1)[None, :]
        every = np.where(lag[:, :, None] >= 0, effect[np.maximum(lag, 0)], 0.0)  # (N, N + 1, m)
        self.reach = sealed(every[:, :, 0].copy())
        self.arrival = sealed(every[-1].T.copy())
        self.pushed = sealed(every[:, :, -1].copy())
        still = np.zeros((horizon, 1))
        self.drift = sealed(moved[:, :1, 1].copy() if model.inertial else still)
        self.carried = sealed(moved[:, 1:, 1].copy() if model.inertial else still)
        self.unit = float(push[0] or (transition @ push)[0])


@lru_cache(maxsize=256)
def maps_of(model: Translation, horizon: int, step: float, forward: float) -> Maps:
    """Return the maps of a model; made once."""
    return Maps(model, horizon, step, forward)
