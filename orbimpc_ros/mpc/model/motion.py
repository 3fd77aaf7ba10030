# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The motion within steps: polynomials, by the control points that they stay in the hull of.

A step of explicit Euler moves along a straight line, one integrated exactly along a curve of degree
2 or 3, which positions and velocities at its ends determine (Bernstein, Bezier).

Mathematics: docs/mathematics.md, 3.7.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.model.translation import Translation, maps_of
from orbimpc_ros.mpc.problem import Problem, State


def controls(degree: int, step: float, positions: Array, velocities: Array) -> Array:
    """Return the control points of each step, shape (N, degree + 1, ...).

    Args:
        degree: of the motion within a step, 1 to 3.
        step: h [s].
        positions: s_0..s_N, shape (N + 1, ...).
        velocities: p_0..p_N, shape (N + 1, ...).
    """
    begin, end = positions[:-1], positions[1:]
    leave, arrive = step / degree * velocities[:-1], step / degree * velocities[1:]
    between = [[], [begin + leave], [begin + leave, end - arrive]][degree - 1]
    return np.stack([begin, *between, end], axis=1)


def control_maps(problem: Problem) -> Array:
    """Return what R_0 e1..R_N e1 add to each control point, shape (N, degree + 1, N + 1)."""
    return _control_maps(problem.translation, problem.horizon, problem.step, problem.forward)


@lru_cache(maxsize=64)
def _control_maps(model: Translation, horizon: int, step: float, forward: float) -> Array:
    maps = maps_of(model, horizon, step, forward)
    still = np.zeros((1, horizon + 1))
    velocities = forward * np.eye(horizon + 1)
    if model.inertial:
        velocities = np.vstack([still, maps.pushed])
    return sealed(controls(model.degree, step, np.vstack([still, maps.reach]), velocities))


def coasting_controls(problem: Problem, state: State) -> Array:
    """Return the control points without any thrust, less s_0, shape (N, degree + 1, n)."""
    maps, coasted = problem.maps, np.zeros((2, problem.horizon + 1, problem.dimension))
    coasted[0, 1:] = maps.drift * state.velocity + maps.blown * state.disturbance
    if problem.inertial:
        coasted[1, 0] = state.velocity
        coasted[1, 1:] = maps.carried * state.velocity + maps.hastened * state.disturbance
    else:
        coasted[1] = state.disturbance
    return controls(problem.translation.degree, problem.step, *coasted)
