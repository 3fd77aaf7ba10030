# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The quadratic part of the objective as a function of the thrust axes R_1 e1..R_N e1 alone.

With positions eliminated by the dynamics, and for n = 2 (R e1 then determines R),

    cost = 1/2 sum_jk H_jk z_j . z_k + sum_k q_k . z_k + c + (length term),   z_k = R_k e1.

H is the same for every coordinate, so one N x N matrix suffices.

Unless an orbitope is active, the minimiser of a coordinate of R_1..R_N is a linear map of the same
coordinate of given quantities: for R e1 of the knowns, for the other columns of R_0 and R_g; at
rotation order 2 also of R_1.

Mathematics: docs/mathematics.md, 1.3 and 4.7.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.model import dynamics
from orbimpc_ros.mpc.model.dynamics import (
    attitude_weight,
    first_length,
    input_weight,
    position_weights,
    velocity_weight,
)
from orbimpc_ros.mpc.problem import Problem, State

LONGEST = 30  # horizon; beyond it sparse solves are faster than dense ones
WORST_CONDITION = 1e9
TURNED = [0, 3]  # rows of R_0 e1 and R_g e1 among the knowns
SLIGHT = 1e-10  # share of the diagonal added to a singular Hessian


class Condensed:
    """The quadratic of one problem, in which the data of a tick enter linearly.

    These data are the *knowns*, rows of shape (n,): R_0 e1, p_0, the disturbance w, R_g e1 (zero if
    no rotation is desired), and g_1 - s_0..g_N - s_0.

    Attributes:
        hessian: H, shape (N, N).
        turning: its part from the weights on inputs and attitude, shape (N, N), which is the whole
            Hessian for the other columns of R_k.
        pulled: map from the knowns to q, shape (N, N + 4).
        squared: quadratic form of the knowns that is c, shape (N + 4, N + 4).
        turned: map from the other columns of R_0 and R_g to their q, shape (N, 2).
        turned_squared: quadratic form of those that is their c, shape (2, 2).
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        maps, turn = problem.maps, dynamics.input_map(problem)
        reach = maps.reach
        weights, turning = position_weights(problem), input_weight(problem)
        unseen, goals = np.zeros((problem.horizon, 1)), -np.eye(problem.horizon)
        miss = np.hstack([reach[:, :1], maps.drift, maps.blown, unseen, goals])
        pull = 2.0 * reach[:, 1:].T * weights
        self.turning: Array = 2.0 * turning * turn[:, 1:].T @ turn[:, 1:]
        self.turned: Array = np.hstack([2.0 * turning * turn[:, 1:].T @ turn[:, :1], unseen])
        self.turned_squared: Array = np.zeros((2, 2))
        self.turned_squared[:1, :1] = turning * turn[:, :1].T @ turn[:, :1]
        self._want(attitude_weight(problem))
        self.hessian: Array = pull @ reach[:, 1:] + self.turning
        self.pulled: Array = pull @ miss
        self.pulled[:, TURNED] += self.turned
        self.squared: Array = miss.T * weights @ miss
        self.squared[np.ix_(TURNED, TURNED)] += self.turned_squared
        self._stop(velocity_weight(problem))

    def _want(self, weight: float) -> None:
        """Add a weight on the squared coordinates of R_N - R_g."""
        self.turning[-1, -1] += 2.0 * weight
        self.turned[-1, 1] -= 2.0 * weight
        self.turned_squared[1, 1] += weight

    def _stop(self, weight: float) -> None:
        """Add a weight on the squared last velocity of an inertial vehicle."""
        maps, known = self._problem.maps, len(self.squared) - 3
        pushed, rest = maps.pushed[-1, 1:], np.zeros(known)
        left = np.concatenate([maps.pushed[-1, :1], maps.carried[-1], maps.hastened[-1], rest])
        self.hessian += 2.0 * weight * np.outer(pushed, pushed)
        self.pulled += 2.0 * weight * np.outer(pushed, left)
        self.squared += weight * np.outer(left, left)

    def affine(self, state: State, goals: Array) -> tuple[Array, float]:
        """Return q, shape (N, n), and c for a state and goals g_1..g_N, shape (N, n).

        c includes the constant length term of R_0 e1.
        """
        known = knowns(state, goals)
        c = float(np.vdot(known, self.squared @ known))
        if self._problem.weights.length:
            c += first_length(self._problem, state)
        return self.pulled @ known, c


def knowns(state: State, goals: Array) -> Array:
    """Return the knowns of the quadratic, shape (N + 4, n): see :class:`Condensed`."""
    known = np.empty((len(goals) + 4, goals.shape[1]))
    known[0], known[1], known[2] = state.rotation[:, 0], state.velocity, state.disturbance
    known[3] = 0.0 if state.wanted is None else state.wanted[:, 0]
    np.subtract(goals, state.position, out=known[4:])
    return known


def suits_dense_code(problem: Problem) -> bool:
    """Return True if a problem is short and well enough conditioned for dense machine code."""
    if problem.horizon > LONGEST:
        return False
    decided = slice(problem.rotation_order - 1, None)  # at order 2, R_1 is not free
    hessian = Condensed(problem).hessian[decided, decided]
    return bool(np.linalg.cond(hessian) < WORST_CONDITION)


def regular(hessian: Array) -> tuple[Array, Array, float]:
    """Return H + delta, its inverse, both of shape (N, N), and delta N / 2.

    delta is zero unless H is too close to singular to be inverted, as without a weight on the last
    heading. Within the disks |z_k| <= 1 the larger matrix costs at most delta N / 2 more.
    """
    delta, eye = 0.0, np.eye(len(hessian))
    if not np.linalg.cond(hessian) < WORST_CONDITION:
        delta = SLIGHT * (float(np.diag(hessian).max()) or 1.0)
    inverse = np.linalg.inv(hessian + delta * eye)
    return hessian + delta * eye, 0.5 * (inverse + inverse.T), 0.5 * delta * len(hessian)


@dataclass(frozen=True)
class Unconstrained:
    """Maps from given quantities, m rows with R_1 last, to the minimiser of the quadratic alone.

    Attributes:
        inverse: of the Hessian over the free steps, projected to the directions that a terminal
            constraint leaves free, shape (free steps, free steps).
        minimiser: x_1..x_N, shape (N, m).
        bent: H x, shape (N, m).
        least: the cost, as a quadratic form, shape (m, m).
        constant: the cost of x = 0, as a quadratic form, shape (m, m).
    """

    inverse: Array
    minimiser: Array
    bent: Array
    least: Array
    constant: Array


def thrust_axis(problem: Problem, condensed: Condensed) -> Unconstrained:
    """Return the maps for coordinates of R e1; given :func:`knowns`, then R_1 e1."""
    return _unbounded(
        problem, condensed.hessian, condensed.pulled, condensed.squared, _arrival(problem)
    )


def other_axes(problem: Problem, condensed: Condensed) -> Unconstrained:
    """Return the maps for coordinates of R e2 and R e3; given those of R_0, R_g and R_1."""
    reached = np.zeros((0, problem.horizon)), np.zeros((0, 3))
    return _unbounded(
        problem, condensed.turning, condensed.turned, condensed.turned_squared, reached
    )


def _arrival(problem: Problem) -> tuple[Array, Array]:
    """Return a terminal constraint as rows over z_1..z_N, and the map from knowns to their values.

    It is s_N = g_N and, at translation order 2, p_N = 0.
    """
    maps = problem.maps
    rows = maps.arrival
    if problem.terminal != 'constraint':
        rows = rows[:0]
    wanted = np.zeros((len(rows), problem.horizon + 5))
    wanted[:, 0] = -rows[:, 0]
    if len(rows):
        wanted[0, 1:3] = -maps.drift[-1, 0], -maps.blown[-1, 0]
        wanted[0, -2] = 1.0
        wanted[1:, 1:3] = -maps.carried[-1, 0], -maps.hastened[-1, 0]
    return rows[:, 1:], wanted


def _unbounded(
    problem: Problem, hessian: Array, q: Array, c: Array, arrival: tuple[Array, Array]
) -> Unconstrained:
    """Return the maps for a cost 1/2 x.Hx + (q known).x + known.c known, by elimination.

    Args:
        problem: gives the rotation order, at 2 of which R_1 is given.
        hessian: H, shape (N, N).
        q: map from the given quantities except R_1 to linear terms, shape (N, m - 1).
        c: quadratic form of the same for the constant, shape (m - 1, m - 1).
        arrival: rows over x_1..x_N, and the map from the given quantities to their values.
    """
    known = problem.rotation_order - 1  # R_1 is known at order 2
    q, c = np.pad(q, ((0, 0), (0, 1))), np.pad(c, (0, 1))
    first = np.zeros((known, q.shape[1]))
    first[:, -1] = 1.0
    rows, wanted = arrival
    inverse = np.linalg.inv(hessian[known:, known:])
    raised = inverse @ rows[:, known:].T
    lift = raised @ np.linalg.inv(rows[:, known:] @ raised)
    inverse = inverse - lift @ raised.T
    decided = lift @ (wanted - rows[:, :known] @ first)
    decided -= inverse @ (q[known:] + hessian[known:, :known] @ first)
    minimiser = np.concatenate([first, decided])
    bent = hessian @ minimiser
    least = c + minimiser.T @ (0.5 * bent + q)
    return Unconstrained(inverse, minimiser, bent, 0.5 * (least + least.T), c)
