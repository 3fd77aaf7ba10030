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

from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.model.dynamics import (
    attitude_weight,
    first_length,
    input_map,
    input_weight,
    position_weights,
    velocity_weight,
)
from orbimpc_ros.mpc.model.translation import STARTED
from orbimpc_ros.mpc.problem import Problem, State

LONGEST = 30  # horizon; beyond it sparse solves are faster than dense ones
WORST_CONDITION = 1e9
TURNED = [0, 3]  # rows of R_0 e1 and R_g e1 among the knowns
SLIGHT = 1e-10  # share of the diagonal added to a singular Hessian


class Quadratic(NamedTuple):
    """A sum of weighted squares, 1/2 x.Hx + (q y).x + y.cy, for coordinates x of R_1..R_N.

    Attributes:
        hessian: H, shape (N, N).
        pulled: q, map from m given quantities y, shape (N, m).
        squared: c, shape (m, m).
    """

    hessian: Array
    pulled: Array
    squared: Array

    @classmethod
    def of(cls, weights: Array, moved: Array, given: Array) -> Quadratic:
        """Return the sum of the weighted squares of moved x + given y, each of as many rows."""
        weighed = moved.T * weights
        return cls(2.0 * weighed @ moved, 2.0 * weighed @ given, given.T * weights @ given)


class Condensed:
    """The quadratic of one problem, in which the data of a tick enter linearly.

    These data are the *knowns*, rows of shape (n,): R_0 e1, p_0, the disturbance w, R_g e1 (zero if
    no rotation is desired), and g_1 - s_0..g_N - s_0.

    Attributes:
        axes: the quadratic of a coordinate of R e1, given the knowns.
        others: that of R e2 or R e3, given the same coordinates of R_0 and R_g.
        hessian: H of ``axes``, shape (N, N).
        arrival: a terminal constraint, s_N = g_N and with inertia p_N = 0: its rows over R_1 e1..
            R_N e1, shape (m, N), and the map from the knowns to their values, shape (m, N + 4).
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        maps, count = problem.maps, problem.horizon
        # Each row is an input, and then R_N - R_g.
        turned = np.vstack([input_map(problem), np.eye(count + 1)[-1:]])
        own = np.zeros((len(turned), 2))
        own[:, 0], own[-1, 1] = turned[:, 0], -1.0
        turning = np.full(len(turned), input_weight(problem))
        turning[-1] = attitude_weight(problem)
        self.others = Quadratic.of(turning, turned[:, 1:], own)
        # Each row is s_k - g_k, and then p_N.
        flown = np.vstack([maps.places[1:], maps.speeds[-1:]])
        known = np.hstack([flown[:, STARTED], np.zeros((count + 1, 1)), -np.eye(count + 1, count)])
        weights = np.append(position_weights(problem), velocity_weight(problem))
        moved = Quadratic.of(weights, flown[:, 1:-2], known)
        self.hessian: Array = moved.hessian + self.others.hessian
        moved.pulled[:, TURNED] += self.others.pulled
        moved.squared[np.ix_(TURNED, TURNED)] += self.others.squared
        self.axes = moved._replace(hessian=self.hessian)
        ends = slice(count - 1, count + problem.inertial)
        self.arrival = flown[ends, 1:-2], -known[ends]

    def affine(self, state: State, goals: Array) -> tuple[Array, float]:
        """Return q, shape (N, n), and c for a state and goals g_1..g_N, shape (N, n).

        c includes the constant length term of R_0 e1.
        """
        known = knowns(state, goals)
        c = float(np.vdot(known, self.axes.squared @ known))
        if self._problem.weights.length:
            c += first_length(self._problem, state)
        return self.axes.pulled @ known, c


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


class Unconstrained(NamedTuple):
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


def minimisers(problem: Problem, condensed: Condensed) -> tuple[Unconstrained, Unconstrained]:
    """Return the maps for coordinates of R e1, and for those of R e2 and R e3.

    Given are the knowns, or R_0 and R_g, and then R_1.
    """
    (rows, values), given = condensed.arrival, problem.rotation_order - 1
    met = len(rows) if problem.terminal == 'constraint' else 0
    thrust = _unbounded(given, condensed.axes, rows[:met], values[:met])
    return thrust, _unbounded(given, condensed.others, rows[:0], np.zeros((0, 2)))


def _unbounded(known: int, quadratic: Quadratic, rows: Array, values: Array) -> Unconstrained:
    """Return the maps for a cost by elimination.

    Args:
        known: number of the first rotations that are given: R_1 is at rotation order 2.
        quadratic: the cost, given m - 1 quantities.
        rows: of a terminal constraint over x_1..x_N.
        values: map from the given quantities except R_1 to their values.
    """
    hessian, c = quadratic.hessian, np.pad(quadratic.squared, (0, 1))
    q, values = (np.pad(each, ((0, 0), (0, 1))) for each in (quadratic.pulled, values))
    first = np.zeros((known, q.shape[1]))
    first[:, -1] = 1.0
    inverse = np.linalg.inv(hessian[known:, known:])
    raised = inverse @ rows[:, known:].T
    lift = raised @ np.linalg.inv(rows[:, known:] @ raised)
    inverse = inverse - lift @ raised.T
    decided = lift @ (values - rows[:, :known] @ first)
    decided -= inverse @ (q[known:] + hessian[known:, :known] @ first)
    minimiser = np.concatenate([first, decided])
    bent = hessian @ minimiser
    least = c + minimiser.T @ (0.5 * bent + q)
    return Unconstrained(inverse, minimiser, bent, 0.5 * (least + least.T), c)
