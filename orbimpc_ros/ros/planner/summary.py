"""The vehicle that the planner believes in, in one line, and what is doubtful about it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.ros.parameters.parameter import Row
from orbimpc_ros.ros.parameters.planner import PLANNER, Ageing, PlannerSettings

BRISK = 2.0 * math.pi  # [rad/s] a turn in a second: above it, numbers tend to be degrees
DEFAULTS: Mapping[str, Row] = {row.name: row for row in PLANNER}


def summary(settings: PlannerSettings, simulated: bool) -> str:
    """Return in one line what the planner takes the vehicle and its own task to be.

    Args:
        settings: of the planner.
        simulated: whether time comes from /clock.
    """
    problem = settings.problem
    return ', '.join(
        (
            *_vehicle(problem, settings.mass),
            f'{problem.step:g} s x {problem.horizon}',
            f'{problem.dimension}D',
            f'rotation order {problem.rotation_order}',
            f'translation order {problem.translation_order}',
            'planned at each odometry' if settings.on_odometry else 'planned every step',
            'time of /clock' if simulated else "the system's time",
            f'goals {_ageing(settings)}',
            f'safe command {_safe_command(settings)}',
        )
    )


def doubts(settings: PlannerSettings, given: Mapping[str, Any]) -> list[str]:
    """Return what is allowed, yet hardly meant, one line each.

    Args:
        settings: of the planner.
        given: values that were given at the start, by parameter.
    """
    rate, shape = settings.problem.max_rate, settings.problem.floor.shape
    found = []
    if rate > BRISK:
        asked = f'{math.radians(rate):.4g} rad/s if {rate:g} deg/s is meant'
        found.append(f'max_rate is {rate:g} rad/s, {math.degrees(rate):.4g} deg/s: {asked}')
    found += _short_sight(settings.problem)
    for name in ('floor.fraction', 'floor.faces'):
        unused = name.removeprefix('floor.') not in settings.problem.floor.parameters
        if unused and given.get(name, DEFAULTS[name].default) != DEFAULTS[name].default:
            found.append(f'{name} is {given[name]:g} and floor.shape {shape}: it has no effect')
    return found


def _short_sight(problem: Problem) -> list[str]:
    """Say that a vehicle which cannot stop never sees itself turned round at the horizon's end."""
    turned = problem.horizon * problem.step * problem.max_rate
    if not problem.turns_are_angles or turned >= math.pi:
        return []
    needed = math.ceil(math.pi / (problem.step * problem.max_rate))
    return [
        f'a horizon of {problem.horizon * problem.step:.4g} s turns by '
        f'{math.degrees(turned):.4g} deg at most: past a goal behind it the vehicle may not turn '
        f'round; half a turn takes a horizon of {needed}'
    ]


def _vehicle(problem: Problem, mass: float) -> list[str]:
    unit = 'm/s' if problem.translation_order == 1 else 'm/s^2'
    parts = [f'{problem.forward:g} {unit}']
    if problem.translation_order == 2:
        parts.append(f'{mass:g} kg')
    if problem.floor.exists:
        least = problem.floor.clearance(problem.dimension) * problem.forward
        parts.append(f'at least {least:.4g} {unit} ({problem.floor})')
    if problem.max_rate:
        parts.append(f'at most {math.degrees(problem.max_rate):.4g} deg/s')
    return parts


def _ageing(settings: PlannerSettings) -> str:
    if settings.goal_ageing is Ageing.NONE:
        return 'never stale'
    streamed = settings.goal_ageing is Ageing.STREAMED
    return f'stale after {settings.goal_timeout:g} s{" once they stream" if streamed else ""}'


def _safe_command(settings: PlannerSettings) -> str:
    floored = settings.problem.floor.exists
    below = floored and settings.safe_command == 'stop' and settings.problem.translation_order == 1
    return f'{settings.safe_command}{" although that is below the floor" if below else ""}'
