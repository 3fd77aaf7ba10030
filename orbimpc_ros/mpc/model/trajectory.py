"""A trajectory of the discrete dynamics and what it costs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.orbitopes import matrix
from orbimpc_ros.mpc.model import dynamics
from orbimpc_ros.mpc.problem import Problem, State


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
    """Return the trajectory with rotation coordinates x_1..x_N, shape (N, d)."""
    rotations = np.concatenate([state.rotation[None], matrix(x)])
    positions, velocities = dynamics.translation_rollout(problem, state, rotations[:, :, 0])
    inputs = dynamics.inputs_of(problem, state, rotations)
    cost = objective(problem, goals, rotations, positions, inputs)
    cost += last_velocity_cost(problem, velocities)
    return Trajectory(positions, velocities, rotations, inputs, cost)


def last_velocity_cost(problem: Problem, velocities: Array) -> float:
    """Return what the arrival weight makes of p_N, given p_0..p_N, shape (N + 1, n)."""
    if problem.translation_order == 1:
        return 0.0
    last = problem.step * velocities[-1]
    return problem.arrival_weight * float(last @ last)


def objective(
    problem: Problem, goals: Array, rotations: Array, positions: Array, inputs: Array
) -> float:
    """Return the cost of a trajectory, term by term as the problem states it.

    Args:
        problem: gives the weights.
        goals: g_1..g_N, shape (N, n) [m].
        rotations: R_0..R_N, shape (N + 1, n, n).
        positions: s_0..s_N, shape (N + 1, n).
        inputs: u_0..u_{N-1}, shape (N, n, n).
    """
    w = problem.weights
    miss, u, headings = positions[1:] - goals, inputs.ravel(), rotations[:-1, :, 0]
    last = miss[-1] @ miss[-1]
    cost = w.position * (miss.ravel() @ miss.ravel()) + w.input * (u @ u)
    cost += (w.terminal + problem.arrival_weight) * last
    if w.length > 0.0:
        lengths = np.sqrt(np.einsum('kc,kc->k', headings, headings)).sum()
        cost += w.length * problem.step * problem.forward * lengths
    return float(cost)
