# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The paper's scenarios and their problems without ROS; config/ has files of the same names."""

from __future__ import annotations

import math

import numpy as np

from orbimpc_ros.mpc.problem import Floor, Problem, Weights
from orbimpc_ros.sim.vehicle import Model, launched
from orbimpc_ros.sim.world import Rope, Scenario, fixed


def model_of(problem: Problem, mass: float = 1.0) -> Model:
    """Return the vehicle that a planning problem believes in."""
    return Model(
        problem.dimension,
        problem.rotation_order,
        problem.translation_order,
        problem.step,
        problem.forward,
        mass,
        discretisation=problem.discretisation,
    )


def retrieval_problem() -> Problem:
    """Return the paper's UAV problem: five steps ahead, det R > 0.3 by a square."""
    return Problem(floor=Floor('polygon', 4, math.sqrt(0.3)))


def retrieval() -> Scenario:
    """Return the paper's UAV retrieval: a rope swinging about (5, 0), caught in flight."""
    model = model_of(retrieval_problem())
    return Scenario(
        model=model,
        start=launched(model, np.zeros(2), np.eye(2)),
        rope=Rope(
            np.array([5.0, 0.0]), np.array([0.5, 0.5]), 0.1, np.array([5.0, 3.5]) * np.pi / 3.0
        ),
        capture_radius=0.2,
        max_ticks=60,
    )


def retrieval3d_problem() -> Problem:
    """Return the UAV's problem in space: as in the plane, |R e1| > sqrt(0.3) by a cube."""
    return Problem(dimension=3, floor=Floor('polygon', 6, math.sqrt(0.3)))


def retrieval3d() -> Scenario:
    """Return the retrieval in space: a rope swinging about (6, 3, 4), forecast and caught."""
    model = model_of(retrieval3d_problem())
    return Scenario(
        model=model,
        start=launched(model, np.zeros(3), np.eye(3)),
        rope=Rope(
            np.array([6.0, 3.0, 4.0]),
            np.array([0.5, 0.5, 0.25]),
            0.18,
            np.array([2.0, 9.0, 4.0]) * np.pi / 6.0,
        ),
        capture_radius=0.15,
        max_ticks=60,
    )


def dubins_problem(floor: str = 'polygon') -> Problem:
    """Return the paper's Dubins car: the shortest way in 20 steps; a floor of det R = 1/2."""
    return Problem(
        horizon=20,
        weights=Weights(position=0.0, input=0.05, length=1.0, terminal=0.0),
        terminal='constraint',
        floor=Floor(floor, 4, math.sqrt(0.5)),
    )


def dubins() -> Scenario:
    """Return the paper's Dubins car: from the origin along x to (5, 10) at t = 20 s."""
    model = model_of(dubins_problem())
    start = launched(model, np.zeros(2), np.eye(2))
    return Scenario(
        model=model,
        start=start,
        rope=fixed(np.array([5.0, 10.0])),
        capture_radius=0.2,
        max_ticks=20,
        finish='arrival',
        arrival_radius=1e-3,
    )


def spacecraft_problem() -> Problem:
    """Return the paper's spacecraft: second order in space, at the goal and at rest at t = 20 s."""
    return Problem(
        dimension=3,
        rotation_order=2,
        translation_order=2,
        horizon=20,
        weights=Weights(position=0.0, input=1.0, length=0.1, terminal=0.0),
        terminal='constraint',
    )


def spacecraft() -> Scenario:
    """Return the paper's spacecraft: from rest, its thrust along -x, to (5, 10, 25), at rest."""
    model = model_of(spacecraft_problem())
    away = np.diag([-1.0, -1.0, 1.0])
    return Scenario(
        model=model,
        start=launched(model, np.zeros(3), away, fraction=0.0),
        rope=fixed(np.array([5.0, 10.0, 25.0])),
        capture_radius=0.2,
        max_ticks=20,
        finish='arrival',
        arrival_radius=0.05,
        arrival_speed=0.05,
    )
