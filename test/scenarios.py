# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The scenarios of config/ without nodes: the vehicle's world, and the planner's problem."""

from __future__ import annotations

from functools import partial

from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.sim.vehicle import Model
from orbimpc_ros.sim.world import Scenario


def scenario(name: str) -> Scenario:
    """Return vehicle, start and goal of a parameter file."""
    from orbimpc_ros.sim.parameters import sim_settings
    from orbimpc_ros.tool import settings

    return sim_settings(settings.of_sim(settings.resolve(settings.config(name)))).scenario


def problem(name: str, floor: str = '') -> Problem:
    """Return the problem of a parameter file, with its own floor or another."""
    from orbimpc_ros.ros.parameters.planner import planner_settings
    from orbimpc_ros.tool import settings

    changes = [f'floor.shape={floor}'] if floor else []
    return planner_settings(settings.resolve(settings.config(name), changes)).problem


# The paper's retrieval, a rope swinging about (5, 0); the same in space; its Dubins car, from the
# origin along x to (5, 10) at t = 20 s; its spacecraft, from rest to (5, 10, 25), at rest at 20 s.
retrieval, retrieval3d, dubins, spacecraft = (
    partial(scenario, f'{name}.yaml')
    for name in ('retrieval', 'retrieval3d', 'dubins', 'spacecraft')
)
retrieval_problem, spacecraft_problem = (
    partial(problem, f'{name}.yaml') for name in ('retrieval', 'spacecraft')
)


def model_of(problem: Problem) -> Model:
    """Return the vehicle model of a planning problem."""
    return Model(
        problem.dimension,
        problem.rotation_order,
        problem.translation_order,
        problem.step,
        problem.forward,
        discretisation=problem.discretisation,
    )
