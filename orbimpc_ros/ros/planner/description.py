# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The vehicle that the planner believes in, in one line, and what is doubtful about it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.ros.parameters.planner import PLANNER, Ageing, PlannerSettings

BRISK = 2.0 * math.pi  # [rad/s] a turn in a second: above it, numbers tend to be degrees
DEFAULTS = {spec.name: spec.default for spec in PLANNER}


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
            *_surroundings(settings),
            f'{problem.step:g} s x {problem.horizon}',
            *([] if problem.discretisation == 'euler' else ['integrated exactly']),
            f'{problem.dimension}D',
            f'rotation order {problem.rotation_order}',
            f'translation order {problem.translation_order}',
            _pace(settings),
            *_loop(settings),
            'time of /clock' if simulated else "the system's time",
            f'goals {_ageing(settings)}',
            f'safe command {_safe_command(settings)}',
            *(['commands nothing: a dry run'] if settings.dry_run else []),
            *(['commands nothing until it is engaged'] if settings.gated else []),
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
    found += _untold(settings, given)
    if not settings.capture_radius:  # whoever intercepts looks beyond the horizon
        found += _short_sight(settings.problem)
    if given.get('approach.cone', 0.0) and not settings.approach.exists:
        asked = f'approach.cone is {given["approach.cone"]:g} and objective track'
        found.append(f'{asked}: it has no effect')
    for name in ('floor.fraction', 'floor.faces'):
        unused = name.removeprefix('floor.') not in settings.problem.floor.parameters
        if unused and given.get(name, DEFAULTS[name]) != DEFAULTS[name]:
            found.append(f'{name} is {given[name]:g} and floor.shape {shape}: it has no effect')
    return found


def _untold(settings: PlannerSettings, given: Mapping[str, Any]) -> list[str]:
    """Say what vehicles that are turned by thrust or torque need, where nobody has stated it."""
    found, problem = [], settings.problem
    if settings.frames.thrust_axis == 'z' and problem.inertial and 'max_rate' not in given:
        found.append(
            'max_rate is not given: commands may turn by half a turn in a step; give the largest '
            'body rate that the autopilot allows [rad/s], or 0.0 for none'
        )
    if problem.rotation_order == 2 and not {'response.speed', 'response.rate'} & given.keys():
        found.append(
            'response.speed and response.rate are not given: the vehicle is taken to obey a step '
            'late; one that obeys at once misses its goal by far: give it lags, such as 0.001 [s], '
            'and discretisation exact'
        )
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
    unit = _unit(problem)
    parts = [f'{problem.forward:g} {unit}']
    if problem.translation_order == 2:
        parts.append(f'{mass:g} kg')
    if problem.floor.exists:
        least = problem.least_speed * problem.forward
        parts.append(f'at least {least:.4g} {unit} ({problem.floor})')
    if problem.max_rate:
        parts.append(f'at most {math.degrees(problem.max_rate):.4g} deg/s')
    if problem.max_acceleration:
        parts.append(f'at most {problem.max_acceleration:.4g} m/s^2')
    if problem.tilt:
        parts.append(f'tilted by at most {math.degrees(problem.tilt):.4g} deg')
    if problem.glide_slope:
        parts.append(f'above a glide slope of {math.degrees(problem.glide_slope):.4g} deg')
    return parts


def _surroundings(settings: PlannerSettings) -> list[str]:
    """Return what moves the vehicle beside its thrust, and what it cannot do against that."""
    problem, gravity, unit = settings.problem, settings.gravity, _unit(settings.problem)
    parts = [f'gravity {gravity:g} {unit}: {_hovering(problem, gravity)}'] if gravity else []
    wind = settings.disturbance.copy()
    wind[-1] += gravity
    if settings.hover_thrust:
        parts.append(f'told as {settings.hover_thrust:g} on thrust')
    speed = float(np.linalg.norm(wind))
    if speed:
        shown = ', '.join(f'{each:.4g}' for each in wind)
        beyond = f', {speed:.4g} {unit} in all: too much to hold a goal'
        parts.append(f'wind ({shown}) {unit}{beyond if speed >= problem.forward else ""}')
        parts += _leaning(problem, settings.disturbance)
    if settings.frames.velocity == 'world':
        parts.append('velocities of the world frame')
    if settings.velocity_source == 'air':
        parts.append(f'odometry through the air{", with its slip" if settings.sideslip else ""}')
    return parts


def _leaning(problem: Problem, disturbance: Array) -> list[str]:
    """Return that a goal cannot be held because it takes more tilt than is allowed, if it does."""
    if not problem.tilt:
        return []
    needed = math.atan2(math.hypot(*disturbance[:2]), -disturbance[2])
    if needed <= problem.tilt:
        return []
    return [f'to hold a goal takes a tilt of {math.degrees(needed):.4g} deg: more than is allowed']


def _hovering(problem: Problem, gravity: float) -> str:
    least = problem.least_speed * problem.forward
    if least > gravity:
        return f'cannot hover, for its least thrust is {least:.4g}'
    return f'hovers at {gravity / problem.forward:.3g} of its thrust'


def _unit(problem: Problem) -> str:
    return 'm/s' if problem.translation_order == 1 else 'm/s^2'


def _pace(settings: PlannerSettings) -> str:
    if settings.on_odometry:
        return 'planned at each odometry'
    every = 'step' if settings.period == settings.problem.step else f'{settings.period:g} s'
    return f'planned every {every}'


def _loop(settings: PlannerSettings) -> list[str]:
    """Return what is known of the vehicle's response, and of what disturbs it, if anything."""
    response, parts = settings.response, []
    if response.lags:
        parts.append(f'lags {response.speed:g} s (speed), {response.rate:g} s (rate)')
    if settings.estimated:
        parts.append('disturbance estimated')
    return parts


def _ageing(settings: PlannerSettings) -> str:
    if settings.goal_ageing is Ageing.NONE:
        return 'never stale'
    streamed = settings.goal_ageing is Ageing.STREAMED
    return f'stale after {settings.goal_timeout:g} s{" once they stream" if streamed else ""}'


def _safe_command(settings: PlannerSettings) -> str:
    floored = settings.problem.floor.exists
    below = floored and settings.safe_command == 'stop' and settings.problem.translation_order == 1
    if settings.gravity and settings.safe_command in ('stop', 'hold_rate_zero'):
        return f'{settings.safe_command} although that is to fall'
    return f'{settings.safe_command}{" although that is below the floor" if below else ""}'
