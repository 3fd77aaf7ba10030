# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
r"""Trajectories of the discrete dynamics and their costs, term by term.

Rotations: R_{k+1} = R_k + h u_k, or W_{k+1} = W_k + h u_k and R_{k+1} = R_k + h W_k (explicit
Euler, old values on the right). Translations: see :mod:`orbimpc_ros.mpc.model.translation`. Costs:

.. math::
    q \sum_{k=1}^{N} \|s_k - g_k\|^2 + m \|s_N - g_N\|^2 + r \sum_{k=0}^{N-1} \|u_k\|_F^2
    + \ell \sum_{k=0}^{N} \lambda_k h z \|R_k e_1\| + w (\|s_N - g_N\|^2 + h^2 \|p_N\|^2)
    + a \|R_N - R_g\|_F^2

with the arrival weight w, and with lambda_k the share of a step for which R_k e_1 acts: 1, and 0
for k = N; if thrust moves on a chord, 1/2 for the first and the last. All but the length term is
quadratic; ``condensed`` has that part as a function of the thrust axes alone, ``solve.statement``
the whole as a cone program. The check evaluates the objective independently.

Mathematics: docs/mathematics.md, 1.1 and 1.2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.rotations import (
    coordinate_count,
    coordinates,
    frobenius_factor,
    matrix,
)
from orbimpc_ros.mpc.problem import Problem, State


def _inputs_of(problem: Problem, rotations: Array) -> Array:
    """Return the inputs u_0..u_{N-1} that produce rotations R_0..R_N, shape (N + 1, n, n).

    At rotation order 2 the last input changes only W_N, which no cost contains: it is zero.
    """
    rates = (rotations[1:] - rotations[:-1]) / problem.step
    if problem.rotation_order == 1:
        return rates
    inputs = np.zeros(rates.shape)
    inputs[:-1] = (rates[1:] - rates[:-1]) / problem.step
    return inputs


def translation_rollout(problem: Problem, state: State, headings: Array) -> tuple[Array, Array]:
    """Return s_0..s_N and the velocities p_0..p_N, each of shape (N + 1, n).

    Args:
        problem: gives the model, the step and the forward magnitude.
        state: gives s_0 and, for an inertial model, p_0.
        headings: R_k e1, k = 0..N, shape (N + 1, n).

    Without inertia the velocity is z R_k e1 + w, a function of the rotation alone.
    """
    maps, given = problem.maps, np.vstack([headings, state.velocity, state.disturbance])
    return maps.places @ given + state.position, maps.speeds @ given


def decided(problem: Problem, state: State) -> tuple[Array, Array]:
    """Return s_0..s_N and p_0..p_N for R_1 e1 = .. = R_N e1 = 0: what the state alone decides."""
    headings = np.zeros((problem.horizon + 1, problem.dimension))
    headings[0] = state.rotation[:, 0]
    return translation_rollout(problem, state, headings)


def adrift(problem: Problem, state: State) -> Array:
    """Return s_0 moved by the disturbance alone, at s_1..s_N, shape (N, n).

    They are the origins of displacements, whose dynamics contain no disturbance.
    """
    return state.position + np.outer(problem.maps.places[1:, -1], state.disturbance)


def input_map(problem: Problem) -> Array:
    """Return D with the inputs u_k = sum_j D[k, j] R_j, shape (N, N + 1), or (N - 1, N + 1).

    At rotation order 2 these are the second differences u_0..u_{N-2}.
    """
    n_steps, h = problem.horizon, problem.step
    first = np.diff(np.eye(n_steps + 1), axis=0) / h
    return first if problem.rotation_order == 1 else np.diff(first, axis=0) / h


KINK = 1e-5  # below it |R e1| counts as zero, where the length term has a kink


def position_weights(problem: Problem) -> Array:
    """Return the weight on |s_k - g_k|^2, k = 1..N, the terminal one included, shape (N,)."""
    weights = np.full(problem.horizon, float(problem.weights.position))
    weights[-1] += problem.weights.terminal + problem.arrival_weight
    return weights


def velocity_weight(problem: Problem) -> float:
    """Return the weight on |p_N|^2, part of the arrival weight of an inertial vehicle."""
    return problem.arrival_weight * problem.step**2 if problem.inertial else 0.0


def input_weight(problem: Problem) -> float:
    """Return the weight on the squared coordinates of an input."""
    return problem.weights.input * frobenius_factor(problem.dimension)


def attitude_weight(problem: Problem) -> float:
    """Return the weight on the squared coordinates of R_N - R_g."""
    return problem.weights.attitude * frobenius_factor(problem.dimension)


def wanted_coordinates(problem: Problem, state: State) -> Array:
    """Return the coordinates of R_g, shape (d,); zero if no rotation is desired."""
    if state.wanted is None:
        return np.zeros(coordinate_count(problem.dimension))
    return coordinates(state.wanted)


def length_weights(problem: Problem) -> Array:
    """Return the weights on |R_k e1|, k = 0..N, shape (N + 1,)."""
    return problem.weights.length * problem.step * problem.forward * problem.maps.lasting


def first_length(problem: Problem, state: State) -> float:
    """Return the length cost of R_0 e1, a constant given by the state."""
    heading = state.rotation[:, 0]
    return float(length_weights(problem)[0]) * math.sqrt(heading @ heading)


def gradients(problem: Problem, state: State, goals: Array, x: Array) -> list[Array]:
    """Return the gradient of each cost term in the coordinates x of R_1..R_N, shape (N, d) each."""
    maps, turn = problem.maps, input_map(problem)[:, 1:]
    flown = trajectory_of(problem, state, goals, x)
    missed = position_weights(problem)[:, None] * (flown.positions[1:] - goals)
    stopped = velocity_weight(problem) * np.outer(maps.arrival[-1, 1:], flown.velocities[-1])
    turned = coordinates(flown.inputs[: len(turn)])
    attitude = np.zeros_like(x)
    attitude[-1] = 2.0 * attitude_weight(problem) * (x[-1] - wanted_coordinates(problem, state))
    axes = flown.headings[1:]
    kinked = np.maximum(np.linalg.norm(axes, axis=1, keepdims=True), KINK)
    return [
        on_axes(2.0 * maps.reach[:, 1:].T @ missed),
        2.0 * input_weight(problem) * turn.T @ turned,
        on_axes(2.0 * stopped),
        on_axes(length_weights(problem)[1:, None] * axes / kinked),
        attitude,
    ]


def on_axes(gradient: Array) -> Array:
    """Return a gradient in thrust axes, shape (N, n), as one in rotations, shape (N, d)."""
    steps, n = gradient.shape
    full = np.zeros((steps, coordinate_count(n)))
    full[:, :n] = gradient
    return full


@dataclass(frozen=True)
class Trajectory:
    """States and inputs that obey the dynamics, with their cost.

    Attributes:
        positions: s_0..s_N, shape (N + 1, n) [m].
        velocities: p_0..p_N, shape (N + 1, n) [m/s].
        rotations: R_0..R_N, shape (N + 1, n, n).
        inputs: u_0..u_{N-1}, shape (N, n, n).
        cost: the objective.
    """

    positions: Array
    velocities: Array
    rotations: Array
    inputs: Array
    cost: float

    @property
    def headings(self) -> Array:
        """Return the thrust axes R_k e1, shape (N + 1, n)."""
        return self.rotations[:, :, 0]


def trajectory_of(problem: Problem, state: State, goals: Array, x: Array) -> Trajectory:
    """Return the trajectory with rotation coordinates x_1..x_N, shape (N, d), and its cost."""
    return flown(problem, state, goals, matrix(x))


def flown(problem: Problem, state: State, goals: Array, turned: Array) -> Trajectory:
    """Return the trajectory with rotations R_1..R_N, shape (N, n, n), and its cost."""
    rotations = np.concatenate([state.rotation[None], turned])
    axes = rotations[:, :, 0]
    positions, velocities = translation_rollout(problem, state, axes)
    inputs = _inputs_of(problem, rotations)
    w, missed, u = problem.weights, positions[1:] - goals, inputs.ravel()
    every, last = missed.ravel(), missed[-1]
    cost = w.position * (every @ every) + w.input * (u @ u)
    cost += (w.terminal + problem.arrival_weight) * (last @ last)
    if problem.arrival_weight > 0.0:
        cost += velocity_weight(problem) * (velocities[-1] @ velocities[-1])
    if w.length > 0.0:
        cost += length_weights(problem) @ np.sqrt(np.einsum('kc,kc->k', axes, axes))
    if w.attitude > 0.0:
        off = (rotations[-1] - state.wanted).ravel()
        cost += w.attitude * (off @ off)
    return Trajectory(positions, velocities, rotations, inputs, float(cost))
