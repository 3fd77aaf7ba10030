"""The discrete dynamics (explicit Euler, old values on the right), as rollouts and as maps.

R_{k+1} = R_k + h u_k, or W_{k+1} = W_k + h u_k and R_{k+1} = R_k + h W_k;
s_{k+1} = s_k + h z R_k e1, or p_{k+1} = p_k + h z R_k e1 and s_{k+1} = s_k + h p_k.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Problem, State


def inputs_of(problem: Problem, state: State, rotations: Array) -> Array:
    """Return the inputs u_0..u_{N-1}, shape (N, n, n), that produce rotations R_0..R_N.

    At rotation order 2 the last input moves only W_N, which nothing sees: it is zero.

    Args:
        problem: gives the order and the step.
        state: gives the initial rotation and its rate.
        rotations: R_0..R_N, shape (N + 1, n, n).
    """
    rates = (rotations[1:] - rotations[:-1]) / problem.step
    if problem.rotation_order == 1:
        return rates
    inputs = np.zeros(rates.shape)
    inputs[:-1] = (rates[1:] - rates[:-1]) / problem.step
    return inputs


def rotation_rollout(problem: Problem, state: State, first_rate: Array, inputs: Array) -> Array:
    """Return R_0..R_N, shape (N + 1, n, n), that the inputs produce.

    Args:
        problem: gives the order and the step.
        state: gives R_0.
        first_rate: W_0, shape (n, n); used at rotation order 2 only.
        inputs: u_0..u_{N-1}, shape (N, n, n).
    """
    changes = problem.step * inputs
    if problem.rotation_order == 2:
        changes = problem.step * _accumulated(first_rate, changes[:-1])
    return _accumulated(state.rotation, changes)


def translation_rollout(problem: Problem, state: State, headings: Array) -> tuple[Array, Array]:
    """Return s_0..s_N and the velocities p_0..p_N, each of shape (N + 1, n).

    Args:
        problem: gives the order, the step and the forward magnitude.
        state: gives s_0 and, at translation order 2, p_0.
        headings: R_k e1, k = 0..N, shape (N + 1, n).

    At translation order 1 the velocity is z R_k e1, a function of the rotation alone.
    """
    pushed = problem.forward * headings
    if problem.translation_order == 1:
        return _accumulated(state.position, problem.step * pushed[:-1]), pushed
    velocities = _accumulated(state.velocity, problem.step * pushed[:-1])
    return _accumulated(state.position, problem.step * velocities[:-1]), velocities


def _accumulated(first: Array, changes: Array) -> Array:
    """Return where each change leads from ``first``, which comes first; one entry more."""
    return np.add.accumulate(np.concatenate([first[None], changes]))


def position_map(problem: Problem) -> Array:
    """Return T, shape (N, N + 1), with s_k = (drift of s_0, p_0) + sum_j T[k-1, j] R_j e1."""
    n_steps, h = problem.horizon, problem.step
    lag = np.arange(1, n_steps + 1)[:, None] - np.arange(n_steps + 1)[None, :]
    if problem.translation_order == 1:
        return h * problem.forward * (lag >= 1)
    return np.asarray(h * h * problem.forward * np.maximum(lag - 1, 0), dtype=float)


def arrival_map(problem: Problem) -> Array:
    """Return the rows over R_0 e1..R_N e1 that say what they add to s_N and, at order 2, to p_N."""
    place = position_map(problem)[-1:]
    if problem.translation_order == 1:
        return place
    pushed = np.full((1, problem.horizon + 1), problem.step * problem.forward)
    pushed[0, -1] = 0.0  # R_N pushes nothing any more
    return np.concatenate([place, pushed])


def drift(problem: Problem, state: State) -> Array:
    """Return the positions s_1..s_N, shape (N, n), of a vehicle that coasts without thrust."""
    return state.position + drift_map(problem) * state.velocity


def drift_map(problem: Problem) -> Array:
    """Return what p_0 adds to s_1..s_N, shape (N, 1)."""
    if problem.translation_order == 1:
        return np.zeros((problem.horizon, 1))
    return problem.step * np.arange(1.0, problem.horizon + 1.0)[:, None]


def input_map(problem: Problem) -> Array:
    """Return D with the inputs u_k = sum_j D[k, j] R_j, shape (N, N + 1), or (N - 1, N + 1).

    At rotation order 2 these are the second differences u_0..u_{N-2}.
    """
    n_steps, h = problem.horizon, problem.step
    first = np.diff(np.eye(n_steps + 1), axis=0) / h
    return first if problem.rotation_order == 1 else np.diff(first, axis=0) / h
