"""The planar problem in z_k = R_k e1, k = 1..N, alone, derived apart from the package's own.

For n = 2 and orders (1, 1), with s_k = s_0 + h z sum_{j<k} R_j e1 and |u_k|_F^2 = 2 |dz_k|^2 / h^2,

    cost = sum_i z_i^T Q z_i + 2 b_i^T z_i + c + l h z sum_{k=1..N-1} |z_k|    (i: coordinates),

Q the same at every tick; state and goals only enter b, c and the arrival's right-hand side.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Box, Problem, State

SIDES = np.array([[-1.0, 0.0], [0.0, -1.0], [1.0, 0.0], [0.0, 1.0]])


class Condensed:
    """Matrices of a planar problem of orders (1, 1).

    Args:
        problem: gives horizon, step, full speed and weights.

    Attributes:
        quadratic: Q, shape (N, N).
        squares: F with F^T F = Q, shape (rank of Q, N).
        reach: what z adds to s_1..s_N, shape (N, N).
        arrival: its last row, shape (N,).
        map_size: twice what the horizon can fly, the big M of a box's sides [m].
        length: the weight l h z on each |z_k|, k = 1..N-1.
    """

    def __init__(self, problem: Problem) -> None:
        steps, w = problem.horizon, problem.weights
        self._advance = problem.step * problem.forward
        self.reach = self._advance * np.tril(np.ones((steps, steps)), -1)
        self._weight = np.full(steps, w.position)
        self._weight[-1] += w.terminal
        self._turning = 2.0 * w.input / problem.step**2
        differences = np.eye(steps) - np.eye(steps, k=-1)
        self.quadratic = self.reach.T @ (self._weight[:, None] * self.reach)
        self.quadratic += self._turning * differences.T @ differences
        self.squares = _factor(self.quadratic)
        self.arrival = self.reach[-1]
        self.map_size = 2.0 * steps * self._advance
        self.length = w.length * self._advance

    def linear(self, state: State, goals: Array) -> tuple[Array, float]:
        """Return 2 b, shape (N, 2), and c for a state and goals g_1..g_N, shape (N, 2)."""
        heading = state.rotation[:, 0]
        miss = self.first(state) - goals
        linear = 2.0 * self.reach.T @ (self._weight[:, None] * miss)
        linear[0] -= 2.0 * self._turning * heading
        constant = self._weight @ np.sum(miss**2, axis=1) + self._turning * heading @ heading
        return linear, float(constant + self.length * np.linalg.norm(heading))

    def to_go(self, state: State, goals: Array) -> Array:
        """Return what ``arrival @ z`` must be to arrive at g_N, shape (2,)."""
        return goals[-1] - self.first(state)

    def side_offsets(self, box: Box, state: State) -> Array:
        """Return c with the free side i of a box: SIDES[i] . (reach @ z)_k >= c_i, shape (4,)."""
        return np.concatenate([-box.minimum, box.maximum]) - SIDES @ self.first(state)

    def first(self, state: State) -> Array:
        """Return s_1, shape (2,), which the state decides: s_k = s_1 + (reach @ z)_k."""
        return state.position + self._advance * state.rotation[:, 0]


def _factor(matrix: Array) -> Array:
    """Return F, as small as can be, with F^T F a positive semidefinite matrix."""
    values, vectors = np.linalg.eigh(matrix)
    kept = values > 1e-12 * max(values[-1], 1.0)
    return np.asarray(np.linalg.qr(np.sqrt(values[kept])[:, None] * vectors[:, kept].T, 'r'))
