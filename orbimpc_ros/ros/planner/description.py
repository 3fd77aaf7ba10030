# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The vehicle that the planner believes in, in one line, and what is doubtful about it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

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
    problem, response = settings.problem, settings.response
    every = 'step' if settings.period == problem.step else f'{settings.period:g} s'
    at_odometry = settings.trigger == 'odom'
    parts = [
        *_vehicle(settings),
        *_surroundings(settings),
        f'{problem.step:g} s x {problem.horizon}',
        problem.discretisation == 'exact' and 'integrated exactly',
        f'{problem.dimension}D',
        f'rotation order {problem.rotation_order}',
        f'translation order {problem.translation_order}',
        'planned at each odometry' if at_odometry else f'planned every {every}',
        response.lags and f'lags {response.speed:g} s (speed), {response.rate:g} s (rate)',
        settings.estimated and 'disturbance estimated',
        'time of /clock' if simulated else "the system's time",
        f'goals {_ageing(settings)}',
        f'safe command {_safe_command(settings)}',
        settings.dry_run and 'commands nothing: a dry run',
        settings.gated and 'commands nothing until it is engaged',
    ]
    return ', '.join(part for part in parts if isinstance(part, str) and part)


def doubts(settings: PlannerSettings, given: Mapping[str, Any]) -> list[str]:
    """Return what is allowed, yet hardly meant, one line each.

    Args:
        settings: of the planner.
        given: values that were given at the start, by parameter.
    """
    problem, found = settings.problem, []
    rate, floor = problem.max_rate, problem.floor
    if rate > BRISK:
        asked = f'{math.radians(rate):.4g} rad/s if {rate:g} deg/s is meant'
        found.append(f'max_rate is {rate:g} rad/s, {math.degrees(rate):.4g} deg/s: {asked}')
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
    turned = problem.horizon * problem.step * rate  # whoever intercepts looks beyond the horizon
    if not settings.capture_radius and problem.turns_are_angles and turned < math.pi:
        needed = math.ceil(math.pi / (problem.step * rate))
        found.append(
            f'a horizon of {problem.horizon * problem.step:.4g} s turns by '
            f'{math.degrees(turned):.4g} deg at most: past a goal behind it the vehicle may not '
            f'turn round; half a turn takes a horizon of {needed}'
        )
    if given.get('approach.cone', 0.0) and not settings.approach.exists:
        asked = f'approach.cone is {given["approach.cone"]:g} and objective track'
        found.append(f'{asked}: it has no effect')
    for name in ('floor.fraction', 'floor.faces'):
        unused = name.removeprefix('floor.') not in floor.parameters
        if unused and given.get(name, DEFAULTS[name]) != DEFAULTS[name]:
            asked = f'{name} is {given[name]:g} and floor.shape {floor.shape}'
            found.append(f'{asked}: it has no effect')
    return found


def _vehicle(settings: PlannerSettings) -> list[object]:
    """Return full speed or thrust, and the limits of the vehicle."""
    problem, unit = settings.problem, _unit(settings.problem)
    least = problem.floor.clearance(problem.dimension) * problem.forward
    degrees, slope = math.degrees(problem.max_rate), math.degrees(problem.glide_slope)
    return [
        f'{problem.forward:g} {unit}',
        problem.translation_order == 2 and f'{settings.mass:g} kg',
        problem.floor.exists and f'at least {least:.4g} {unit} ({problem.floor})',
        problem.max_rate and f'at most {degrees:.4g} deg/s',
        problem.max_acceleration and f'at most {problem.max_acceleration:.4g} m/s^2',
        problem.tilt and f'tilted by at most {math.degrees(problem.tilt):.4g} deg',
        problem.glide_slope and f'above a glide slope of {slope:.4g} deg',
    ]


def _surroundings(settings: PlannerSettings) -> list[object]:
    """Return what moves the vehicle beside its thrust, and what it cannot do against that."""
    problem, gravity, unit = settings.problem, settings.gravity, _unit(settings.problem)
    least = problem.floor.clearance(problem.dimension) * problem.forward
    hover = f'hovers at {gravity / problem.forward:.3g} of its thrust'
    if least > gravity:
        hover = f'cannot hover, for its least thrust is {least:.4g}'
    wind = settings.disturbance.copy()
    wind[-1] += gravity
    speed, blown = float(np.linalg.norm(wind)), ''
    if speed:
        blown = f'wind ({", ".join(f"{each:.4g}" for each in wind)}) {unit}'
    if speed >= problem.forward:
        blown += f', {speed:.4g} {unit} in all: too much to hold a goal'
    if speed and problem.tilt:
        known = settings.disturbance
        needed = math.atan2(math.hypot(*known[:2]), -known[2])
        if needed > problem.tilt:
            degrees = f'{math.degrees(needed):.4g} deg'
            blown += f', to hold a goal takes a tilt of {degrees}: more than is allowed'
    slip = ', with its slip' if settings.sideslip else ''
    return [
        gravity and f'gravity {gravity:g} {unit}: {hover}',
        settings.hover_thrust and f'told as {settings.hover_thrust:g} on thrust',
        blown,
        settings.frames.velocity == 'world' and 'velocities of the world frame',
        settings.velocity_source == 'air' and f'odometry through the air{slip}',
    ]


def _unit(problem: Problem) -> str:
    return 'm/s' if problem.translation_order == 1 else 'm/s^2'


def _ageing(settings: PlannerSettings) -> str:
    if settings.goal_ageing is Ageing.NONE:
        return 'never stale'
    streamed = settings.goal_ageing is Ageing.STREAMED
    return f'stale after {settings.goal_timeout:g} s{" once they stream" if streamed else ""}'


def _safe_command(settings: PlannerSettings) -> str:
    kind, problem = settings.safe_command, settings.problem
    if settings.gravity and kind in ('stop', 'hold_rate_zero'):
        return f'{kind} although that is to fall'
    if problem.floor.exists and kind == 'stop' and problem.translation_order == 1:
        return f'{kind} although that is below the floor'
    return kind
