# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planar problem in z_k = R_k e1, k = 1..N, as mixed-integer solvers take it.

For n = 2 and orders (1, 1), with s_k = s_1 + h z sum_{j<k} R_j e1 (and, without boxes and an
arrival, with a wind),

    cost = sum_i z_i^T Q z_i + q_i^T z_i + c + l h z sum_{k=1..N-1} |z_k|    (i: coordinates),

Q the same at every tick; state and goals only enter q, c and the arrival's right-hand side.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.bench.solvers import Declined
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.faces import normals
from orbimpc_ros.mpc.model.condensed import Condensed
from orbimpc_ros.mpc.problem import Box, Problem, State

SIDES = np.array([[-1.0, 0.0], [0.0, -1.0], [1.0, 0.0], [0.0, 1.0]])


@dataclass(frozen=True)
class BigM:
    """Alternatives i of which at least one, by its binary b_ki, must hold at every step k.

    normals_i . (moved @ z)_k >= offsets_i - big (1 - b_ki)

    Attributes:
        normals: of the alternatives, shape (m, 2).
        moved: from z to what is kept in an alternative, shape (steps, N).
        big: leaves an alternative without its binary inert.
        offsets: of the alternatives, given a state, shape (m,).
    """

    normals: Array
    moved: Array
    big: float
    offsets: Callable[[State], Array]


def slope_of(problem: Problem) -> float:
    """Return the tangent t of the widest turn a < pi / 2: from x to y, |x cross y| <= t x . y.

    Raises:
        Declined: wider turns are no such pair of quadratic limits.
    """
    if problem.widest_turn >= 0.5 * np.pi:
        raise Declined('turns of a quarter and more are not stated')
    return float(np.tan(problem.widest_turn))


class CondensedPlanar:
    """Matrices of a planar problem of orders (1, 1).

    Args:
        problem: gives horizon, step, full speed and weights.

    Attributes:
        quadratic: Q, shape (N, N).
        squares: F with F^T F = Q, shape (rank of Q, N).
        reach: what z adds to s_1..s_N, shape (N, N).
        arrival: its last row, shape (N,).
        disjunctions: of a polygon floor and of each box.
        length: the weight l h z on each |z_k|, k = 1..N-1.
        linear: gives q, shape (N, 2), and c of a state and goals g_1..g_N, shape (N, 2).
    """

    def __init__(self, problem: Problem) -> None:
        condensed, self._advance = Condensed(problem), problem.step * problem.forward
        self.quadratic = 0.5 * condensed.hessian
        self.squares = _factor(self.quadratic)
        self.reach = problem.maps.reach[:, 1:]
        self.arrival = self.reach[-1]
        self.disjunctions = [self._beyond(box) for box in problem.boxes]
        if problem.floor.shape == 'polygon':
            self.disjunctions.insert(0, _beyond_floor(problem))
        self.length = problem.weights.length * self._advance
        self.linear = condensed.affine

    def to_go(self, state: State, goals: Array) -> Array:
        """Return what ``arrival @ z`` must be to arrive at g_N, shape (2,)."""
        return goals[-1] - self._first(state)

    def _beyond(self, box: Box) -> BigM:
        """Keep s_2..s_N beyond a side of a box; the state decides s_1.

        The big M is twice what the horizon can fly.
        """
        sides = np.concatenate([-box.minimum, box.maximum])
        big = 2.0 * len(self.reach) * self._advance
        return BigM(SIDES, self.reach[1:], big, lambda state: sides - SIDES @ self._first(state))

    def _first(self, state: State) -> Array:
        """Return s_1, shape (2,), which the state decides: s_k = s_1 + (reach @ z)_k."""
        return state.position + self._advance * state.rotation[:, 0]


def _beyond_floor(problem: Problem) -> BigM:
    low, steps = problem.floor.fraction, problem.horizon
    faces = normals(2, problem.floor.faces)
    offsets = np.full(len(faces), low)
    return BigM(faces, np.eye(steps), 1.0 + low, lambda _state: offsets)


def _factor(matrix: Array) -> Array:
    """Return F, as small as can be, with F^T F a positive semidefinite matrix."""
    values, vectors = np.linalg.eigh(matrix)
    kept = values > 1e-12 * max(values[-1], 1.0)
    return np.asarray(np.linalg.qr(np.sqrt(values[kept])[:, None] * vectors[:, kept].T, 'r'))
