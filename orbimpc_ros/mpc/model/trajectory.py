# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A trajectory of the discrete dynamics and what it costs.

Mathematics: docs/mathematics.md, 1.1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.orbitopes import matrix
from orbimpc_ros.mpc.model import dynamics
from orbimpc_ros.mpc.model.cost import value
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
    inputs = dynamics.inputs_of(problem, rotations)
    cost = value(problem, state, goals, rotations, inputs, (positions, velocities))
    return Trajectory(positions, velocities, rotations, inputs, cost)
