# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The discrete dynamics, as rollouts and as maps over the thrust axes R_0 e1..R_N e1.

Rotations: R_{k+1} = R_k + h u_k, or W_{k+1} = W_k + h u_k and R_{k+1} = R_k + h W_k (explicit
Euler, old values on the right). Translations: see :mod:`orbimpc_ros.mpc.model.translation`.

Mathematics: docs/mathematics.md, 1.1.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Problem, State


def inputs_of(problem: Problem, rotations: Array) -> Array:
    """Return the inputs u_0..u_{N-1}, shape (N, n, n), that produce rotations R_0..R_N.

    At rotation order 2 the last input moves only W_N, which nothing sees: it is zero.

    Args:
        problem: gives the order and the step.
        rotations: R_0..R_N, shape (N + 1, n, n).
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
        state: gives s_0 and, of an inertial model, p_0.
        headings: R_k e1, k = 0..N, shape (N + 1, n).

    Without inertia the velocity is z R_k e1 + w, a function of the rotation alone.
    """
    flown, positions = problem.maps, np.empty(headings.shape)
    positions[0] = state.position
    np.add(flown.reach @ headings, state.position, out=positions[1:])
    if state.disturbed:
        positions[1:] += flown.blown * state.disturbance
    if not problem.inertial:
        velocities = problem.forward * headings
        return positions, velocities + state.disturbance if state.disturbed else velocities
    positions[1:] += flown.drift * state.velocity
    velocities = np.empty(headings.shape)
    velocities[0] = state.velocity
    np.add(flown.pushed @ headings, flown.carried * state.velocity, out=velocities[1:])
    if state.disturbed:
        velocities[1:] += flown.hastened * state.disturbance
    return positions, velocities


def drift(problem: Problem, state: State) -> Array:
    """Return the positions s_1..s_N, shape (N, n), of a vehicle that coasts without thrust."""
    maps = problem.maps
    coasting = state.position + maps.drift * state.velocity
    return coasting + maps.blown * state.disturbance if state.disturbed else coasting


def adrift(problem: Problem, state: State) -> Array:
    """Return where what the state decides at once would have it at s_1..s_N, shape (N, n).

    That is s_0, moved by the disturbance alone: the origin of displacements, in which the dynamics
    know no disturbance. Without any it is s_0 all along, shape (1, n).
    """
    if not state.disturbed:
        return state.position[None]
    return state.position + problem.maps.blown * state.disturbance


def input_map(problem: Problem) -> Array:
    """Return D with the inputs u_k = sum_j D[k, j] R_j, shape (N, N + 1), or (N - 1, N + 1).

    At rotation order 2 these are the second differences u_0..u_{N-2}.
    """
    n_steps, h = problem.horizon, problem.step
    first = np.diff(np.eye(n_steps + 1), axis=0) / h
    return first if problem.rotation_order == 1 else np.diff(first, axis=0) / h
