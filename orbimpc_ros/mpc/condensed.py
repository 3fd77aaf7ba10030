"""The quadratic part of the objective as a function of the thrust axes R_1 e1..R_N e1 alone.

With positions eliminated by the dynamics, and for n = 2 (where R e1 is all of R),

    cost = 1/2 sum_jk H_jk z_j . z_k + sum_k q_k . z_k + c + (length term),   z_k = R_k e1.

H is the same for every coordinate, so one N x N matrix says it all.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc import dynamics
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.orbitopes import frobenius_factor
from orbimpc_ros.mpc.problem import Problem, State


def position_weights(problem: Problem) -> Array:
    """Return the weight on |s_k - g_k|^2, k = 1..N, the terminal weight included."""
    weights = np.full(problem.horizon, float(problem.weights.position))
    weights[-1] += problem.weights.terminal + problem.arrival_weight
    return weights


def input_weight(problem: Problem) -> float:
    """Return the weight on the squared coordinates of an input."""
    return problem.weights.input * frobenius_factor(problem.dimension)


def hessian(problem: Problem) -> Array:
    """Return H, shape (N, N), without the weight on the last velocity, which only adds to it."""
    reach = dynamics.position_map(problem)[:, 1:]
    differences = dynamics.input_map(problem)[:, 1:]
    quadratic = 2.0 * reach.T @ (position_weights(problem)[:, None] * reach)
    return quadratic + 2.0 * input_weight(problem) * differences.T @ differences


def affine(problem: Problem, state: State, goals: Array) -> tuple[Array, float]:
    """Return q, shape (N, n), and c for a state and goals g_1..g_N, shape (N, n).

    c includes the length of the first step, which no decision changes.
    """
    reach, differences = dynamics.position_map(problem), dynamics.input_map(problem)
    weights, turning = position_weights(problem), input_weight(problem)
    heading = state.rotation[:, 0]
    miss = dynamics.drift(problem, state) + np.outer(reach[:, 0], heading) - goals
    q = 2.0 * reach[:, 1:].T @ (weights[:, None] * miss)
    q += 2.0 * turning * np.outer(differences[:, 1:].T @ differences[:, 0], heading)
    c = weights @ np.sum(miss * miss, axis=1)
    c += turning * np.sum(differences[:, 0] ** 2) * (heading @ heading)
    return q, float(c + first_length(problem, state))


def first_length(problem: Problem, state: State) -> float:
    """Return the length cost of the first step, which the state alone decides."""
    spent = problem.weights.length * problem.step * problem.forward
    return float(spent * np.linalg.norm(state.rotation[:, 0]))
