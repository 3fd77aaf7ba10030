# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The scenarios of config/ without nodes: the vehicle's world, and the planner's problem."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

from orbimpc_ros.loop.planner import Decision, Planner
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.sim.vehicle import Model

if TYPE_CHECKING:  # needs ROS
    from orbimpc_ros.ros.parameters.planner import PlannerSettings
    from orbimpc_ros.sim.parameters import SimSettings
    from orbimpc_ros.sim.world import Flight


def scenario(name: str) -> SimSettings:
    """Return vehicle, start and goal of a parameter file."""
    from orbimpc_ros.sim.parameters import sim_settings
    from orbimpc_ros.tool import settings

    return sim_settings(settings.of_sim(settings.resolve(settings.config(name))))


def planned(name: str, floor: str = '') -> PlannerSettings:
    """Return the planner's settings of a parameter file, with its own floor or another."""
    from orbimpc_ros.ros.parameters.planner import planner_settings
    from orbimpc_ros.tool import settings

    changes = [f'floor.shape={floor}'] if floor else []
    return planner_settings(settings.resolve(settings.config(name), changes))


def problem(name: str, floor: str = '') -> Problem:
    """Return the problem of a parameter file, with its own floor or another."""
    return planned(name, floor).problem


# The paper's retrieval, a rope swinging about (5, 0); the same in space; its Dubins car, from the
# origin along x to (5, 10) at t = 20 s.
retrieval, retrieval3d, dubins = (
    partial(scenario, f'{name}.yaml') for name in ('retrieval', 'retrieval3d', 'dubins')
)
retrieval_problem, spacecraft_problem = (
    partial(problem, f'{name}.yaml') for name in ('retrieval', 'spacecraft')
)


def retrieved(
    problem: Problem, world: SimSettings | None = None
) -> Iterator[tuple[Flight, Decision | None]]:
    """Fly the paper's retrieval, or to another goal, with a planner for a problem."""
    from orbimpc_ros.tool.offline import OfflinePlanner, closed_loop

    planner = OfflinePlanner(planned('retrieval.yaml'), planner=Planner(problem))
    return closed_loop(planner, world or retrieval())


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
