# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Trajectories of the discrete dynamics (1.1a) and their costs (1.2a): term by term, and condensed.

All but the length term is quadratic; ``solve.program`` states the whole as a cone program. The
check evaluates the objective independently.

With positions eliminated (1.3a), one N x N matrix H serves every coordinate of R e1, another one
the rest. Unless an orbitope is active, the minimiser of a coordinate of R_1..R_N is a linear map of
the same coordinate of the knowns; at rotation order 2 also of R_1.

Mathematics: docs/mathematics.md, 1.1 to 1.3 and 4.7.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.rotations import (
    coordinate_count,
    coordinates,
    frobenius_factor,
    matrix,
)
from orbimpc_ros.mpc.model.translation import STARTED
from orbimpc_ros.mpc.problem import Problem, State

KINK = 1e-5  # below it |R e1| counts as zero, where the length term has a kink
LONGEST = 30  # horizon; beyond it sparse solves are faster than dense ones
WORST_CONDITION = 1e9
SLIGHT = 1e-10  # share of the diagonal added to a singular Hessian


def translation_rollout(problem: Problem, state: State, headings: Array) -> tuple[Array, Array]:
    """Return s_0..s_N and p_0..p_N for headings R_0 e1..R_N e1, each of shape (N + 1, n).

    Without inertia the velocity is z R_k e1 + w, a function of the rotation alone.
    """
    maps = problem.maps
    driving = np.concatenate([headings, state.velocity[None], state.disturbance[None]])
    return maps.places @ driving + state.position, maps.speeds @ driving


def adrift(problem: Problem, state: State) -> Array:
    """Return s_N if there were a disturbance only, no velocity and no thrust, shape (n,) [m]."""
    return state.position + problem.maps.places[-1, -1] * state.disturbance


def input_map(problem: Problem) -> Array:
    """Return D with the inputs u_k = sum_j D[k, j] R_j, shape (N, N + 1), or (N - 1, N + 1).

    At rotation order 2 these are the second differences u_0..u_{N-2}: u_{N-1} changes only W_N,
    which no cost contains.
    """
    order = problem.rotation_order
    return np.diff(np.eye(problem.horizon + 1), order, axis=0) / problem.step**order


def motion_weights(problem: Problem) -> Array:
    """Return the weights on |s_1 - g_1|^2..|s_N - g_N|^2 and on |p_N|^2, shape (N + 1,).

    Those at the end include the arrival weight, for p_N if the vehicle is inertial.
    """
    weights = np.full(problem.horizon + 1, float(problem.weights.position))
    weights[-2] += problem.weights.terminal + problem.arrival_weight
    weights[-1] = problem.arrival_weight * problem.step**2 * problem.inertial
    return weights


def turning_weights(problem: Problem) -> Array:
    """Return the weights on squared coordinates of each input and of R_N - R_g, shape (2,)."""
    w = problem.weights
    return frobenius_factor(problem.dimension) * np.array([w.input, w.attitude])


def length_weights(problem: Problem) -> Array:
    """Return the weights on |R_k e1|, k = 0..N, shape (N + 1,)."""
    return problem.weights.length * problem.step * problem.forward * problem.maps.lasting


def first_length(problem: Problem, state: State) -> float:
    """Return the length cost of R_0 e1, a constant given by the state."""
    heading = state.rotation[:, 0]
    return float(length_weights(problem)[0]) * math.sqrt(heading @ heading)


def gradients(problem: Problem, state: State, goals: Array, x: Array) -> list[Array]:
    """Return the gradient of each cost term in the coordinates x of R_1..R_N, shape (N, d) each.

    The terms are the quadratic one in x, the linear one, and that of lengths.
    """
    condensed, data = Condensed(problem), knowns(state, goals)
    axes = x[:, : problem.dimension]
    kinked = np.maximum(np.linalg.norm(axes, axis=1, keepdims=True), KINK)
    both = condensed.axes, condensed.others
    return [
        beside(x, *(each.hessian for each in both)),
        beside(data, *(each.pulled for each in both)),
        on_axes(length_weights(problem)[1:, None] * axes / kinked),
    ]


def beside(rows: Array, thrust: Array, others: Array) -> Array:
    """Return ``thrust`` applied to coordinates of R e1 in rows, ``others`` to the rest, (m, d)."""
    n = min(rows.shape[1], 3)
    return np.hstack([thrust @ rows[:, :n], others @ rows[:, n:]])


def on_axes(gradient: Array) -> Array:
    """Return a gradient in thrust axes, shape (N, n), as one in rotations, shape (N, d)."""
    steps, n = gradient.shape
    return np.hstack([gradient, np.zeros((steps, coordinate_count(n) - n))])


@dataclass(frozen=True, eq=False)
class Trajectory:
    """States that obey the dynamics, with their cost.

    Attributes:
        objective: the cost, evaluated from these numbers.
        positions: s_0..s_N, shape (N + 1, n) [m].
        velocities: p_0..p_N, shape (N + 1, n) [m/s].
        rotations: R_0..R_N in conv SO(n), shape (N + 1, n, n).
    """

    objective: float
    positions: Array
    velocities: Array
    rotations: Array


def trajectory_of(problem: Problem, state: State, goals: Array, x: Array) -> Trajectory:
    """Return the trajectory with rotation coordinates x_1..x_N, shape (N, d), and its cost."""
    return flown(problem, state, goals, matrix(x))


def flown(problem: Problem, state: State, goals: Array, turned: Array) -> Trajectory:
    """Return the trajectory with rotations R_1..R_N, shape (N, n, n), and its cost."""
    rotations = np.concatenate([state.rotation[None], turned])
    axes = rotations[:, :, 0]
    positions, velocities = translation_rollout(problem, state, axes)
    order = problem.rotation_order
    u = np.diff(rotations, order, axis=0).ravel() / problem.step**order
    w, missed = problem.weights, positions[1:] - goals
    every, last = missed.ravel(), missed[-1]
    cost = w.position * (every @ every) + w.input * (u @ u)
    cost += (w.terminal + problem.arrival_weight) * (last @ last)
    if problem.inertial:
        cost += problem.arrival_weight * problem.step**2 * (velocities[-1] @ velocities[-1])
    if w.length > 0.0:
        cost += length_weights(problem) @ np.sqrt(np.einsum('kc,kc->k', axes, axes))
    if w.attitude > 0.0:
        off = (rotations[-1] - state.wanted).ravel()
        cost += w.attitude * (off @ off)
    return Trajectory(float(cost), positions, velocities, rotations)


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
    def of(cls, weights: Array, moved: Array, shift: Array) -> Quadratic:
        """Return the sum of the weighted squares of the rows of moved x + shift y."""
        weighed = moved.T * weights
        return cls(2.0 * weighed @ moved, 2.0 * weighed @ shift, shift.T * weights @ shift)


class Condensed:
    """The quadratic of one problem, in which the data of a tick enter linearly.

    These data are the *knowns*, rows of shape (d,): R_0, p_0, the disturbance w, R_g (zero if no
    rotation is desired), and g_1 - s_0..g_N - s_0; vectors are as if they were thrust axes.

    Attributes:
        axes: the quadratic of a coordinate of R e1, given the same coordinate of the knowns.
        others: that of a coordinate of R e2 or R e3.
        hessian: H of ``axes``, shape (N, N).
        arrival: a terminal constraint, s_N = g_N and with inertia p_N = 0: its rows over R_1 e1..
            R_N e1, shape (m, N), and the map from the knowns to their values, shape (m, N + 4).
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        maps, count = problem.maps, problem.horizon
        # Each row is an input, and then R_N - R_g.
        turned = np.vstack([input_map(problem), np.eye(count + 1)[-1:]])
        own = np.zeros((len(turned), count + 4))
        own[:, 0], own[-1, 3] = turned[:, 0], -1.0
        turning = turning_weights(problem).repeat([len(turned) - 1, 1])
        self.others = Quadratic.of(turning, turned[:, 1:], own)
        # Each row is s_k - g_k, and then p_N.
        flown = np.vstack([maps.places[1:], maps.speeds[-1:]])
        shift = np.hstack([flown[:, STARTED], np.zeros((count + 1, 1)), -np.eye(count + 1, count)])
        moved = Quadratic.of(motion_weights(problem), flown[:, 1:-2], shift)
        self.axes = Quadratic(*map(np.add, moved, self.others))
        self.hessian = self.axes.hessian
        ends = slice(count - 1, count + problem.inertial)
        self.arrival = flown[ends, 1:-2], -shift[ends]

    def affine(self, state: State, goals: Array) -> tuple[Array, float]:
        """Return q, shape (N, n), and c for a state and goals g_1..g_N, shape (N, n).

        c includes the constant length term of R_0 e1.
        """
        data = knowns(state, goals, axes=True)
        c = float(np.vdot(data, self.axes.squared @ data))
        return self.axes.pulled @ data, c + first_length(self._problem, state)


def knowns(state: State, goals: Array, *, axes: bool = False) -> Array:
    """Return the knowns, shape (N + 4, d), see :class:`Condensed`; of ``axes`` alone (N + 4, n)."""
    n, start = len(state.position), state.rotation[:, 0] if axes else coordinates(state.rotation)
    rows = np.zeros((len(goals) + 4, len(start)))
    rows[0], rows[1, :n] = start, state.velocity
    rows[2, :n] = state.disturbance
    if state.wanted is not None:
        rows[3] = state.wanted[:, 0] if axes else coordinates(state.wanted)
    rows[4:, :n] = goals - state.position
    return rows


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
    """Maps from the knowns and R_1, m = N + 5 rows, to the minimiser of the quadratic alone.

    Attributes:
        inverse: of the Hessian over the free steps, projected to the directions that a terminal
            constraint leaves free; zero for a given R_1, shape (N, N).
        minimiser: x_1..x_N, shape (N, m).
        least: the cost, as a quadratic form, shape (m, m).
        lift: least moves of x by which the rows of a terminal constraint change by one, (N, rows).
    """

    inverse: Array
    minimiser: Array
    least: Array
    lift: Array


def minimisers(problem: Problem, condensed: Condensed) -> tuple[Unconstrained, Unconstrained]:
    """Return the maps for coordinates of R e1, and for those of R e2 and R e3.

    Their arguments are the knowns, and then R_1.
    """
    (rows, values), decided = condensed.arrival, problem.rotation_order - 1
    met = len(rows) if problem.terminal == 'constraint' else 0
    thrust = unbounded(decided, condensed.axes, rows[:met], values[:met])
    return thrust, unbounded(decided, condensed.others, rows[:0], values[:0])


def unbounded(decided: int, quadratic: Quadratic, rows: Array, values: Array) -> Unconstrained:
    """Return the maps for a cost by elimination.

    Args:
        decided: number of the first rotations that are given: R_1 is at rotation order 2.
        quadratic: the cost, given the knowns.
        rows: of a terminal constraint over x_1..x_N.
        values: map from the knowns to their values.
    """
    hessian, c = quadratic.hessian, np.pad(quadratic.squared, (0, 1))
    q, values = (np.pad(each, ((0, 0), (0, 1))) for each in (quadratic.pulled, values))
    first = np.zeros_like(q)
    first[:decided, -1] = 1.0
    free = hessian[decided:, decided:]
    invert = np.linalg.inv if np.linalg.cond(free) < WORST_CONDITION else np.linalg.pinv
    inverse = np.pad(invert(free), (decided, 0))
    raised = inverse @ rows.T
    lift = raised @ np.linalg.inv(rows @ raised)
    inverse = inverse - lift @ raised.T
    minimiser = first + lift @ (values - rows @ first) - inverse @ (q + hessian @ first)
    least = c + minimiser.T @ (0.5 * hessian @ minimiser + q)
    return Unconstrained(inverse, minimiser, 0.5 * (least + least.T), lift)
