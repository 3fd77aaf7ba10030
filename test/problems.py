# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Families of random problems, random parts of problems, and the reference cases."""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orbimpc_ros.mpc.geometry.rotations import exp, turned_onto
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.model.dynamics import translation_rollout
from orbimpc_ros.mpc.problem import (
    Approach,
    Ball,
    Box,
    Floor,
    MovingObstacle,
    Problem,
    State,
    Weights,
)
from orbimpc_ros.mpc.problem.case import Case, case_of
from orbimpc_ros.mpc.problem.reach import beyond_reach

HELD_OUT = os.environ.get('ORBIMPC_SEEDS', '')  # first:end of the seeds that replace the usual ones
REFERENCE = Path(__file__).parent / 'reference'
CASES = json.loads((REFERENCE / 'cases.json').read_text())
ANSWERS = json.loads((REFERENCE / 'answers.json').read_text())
ORDERS = [
    {'dimension': n, 'rotation_order': r, 'translation_order': t}
    for n, r, t in itertools.product((2, 3), (1, 2), (1, 2))
]
needs_machine_code = pytest.mark.skipif(not COMPILED, reason='too slow without numba')

# Arguments of Problem; weights by name; max_rate and max_acceleration per step; and the numbers of
# boxes, balls and hazards between start and goal.
ARRIVES = {'terminal': 'constraint'}
SPACE = {'dimension': 3}
COASTS = {'rotation_order': 2, 'translation_order': 2}
ROUND = {'floor': Floor('circle', fraction=0.6)}
FAST = {'floor': Floor('circle', fraction=0.8)}
FACETS = {'floor': Floor('polygon', 6, 0.6)}
WING = {'floor': Floor('circle', fraction=0.7), 'max_rate': 0.5, 'max_acceleration': 0.03}
TILTED = {**SPACE, 'translation_order': 2, 'tilt': 0.3, 'glide_slope': 0.4}
TOWARDS = Approach(0.4, (1.0, 0.5))
FAMILIES: dict[str, dict[str, Any]] = {
    'hull': {},
    'hull, exact': {'discretisation': 'exact'},
    'hull, inertia': {'translation_order': 2},
    'hull, held': {'translation_order': 2, 'discretisation': 'held'},
    'hull, coasting': COASTS,
    'hull, decided': {'rotation_order': 2, 'decided': True},
    'hull, length': {'length': 0.3},
    'hull, attitude': {'attitude': 0.5},
    'hull, arrival': ARRIVES,
    'hull, inertia, arrival': {'translation_order': 2, **ARRIVES},
    'hull, inertia, soft arrival': {'translation_order': 2, 'arrival_weight': 5.0},
    'polygon': {'floor': Floor('polygon', 4, 0.5)},
    'polygon, length': {'floor': Floor('polygon', 5, 0.5), 'length': 0.3},
    'polygon, arrival': {'floor': Floor('polygon', 4, 0.5), **ARRIVES},
    'polygon, coasting': {'floor': Floor('polygon', 4, 0.5), **COASTS},
    'polygon, acceleration': {**FACETS, 'max_acceleration': 0.3},
    'circle': ROUND,
    'circle, coasting': {**ROUND, **COASTS},
    'circle, coasting, turn rate': {**ROUND, **COASTS, 'max_rate': 0.7},
    'circle, constant speed': {'floor': Floor('circle', fraction=1.0)},
    'circle, inertia': {**ROUND, 'translation_order': 2},
    'circle, exact': {**ROUND, 'discretisation': 'exact'},
    'circle, length': {**ROUND, 'length': 0.3},
    'circle, turn rate': {**ROUND, 'max_rate': 0.7},
    'circle, turn rate, arrival': {**ROUND, 'max_rate': 2.5, **ARRIVES},
    'circle, hazards': {**ROUND, 'max_rate': 0.9, 'hazards': 1},
    'shell': {**SPACE, **ROUND, 'input': 0.0},
    'solid': {**SPACE, 'floor': Floor('polygon', 6, 0.5), 'horizon': 3},
    'space': SPACE,
    'space, coasting': {**SPACE, **COASTS},
    'space, arrival': {**SPACE, **ARRIVES},
    'space, attitude': {**SPACE, 'attitude': 0.5},
    'boxes': {'boxes': 3},
    'boxes, shared faces': {'boxes': 3, 'no_corner_cutting': True},
    'boxes, inertia': {'boxes': 2, 'translation_order': 2},
    'boxes that move': {'hazards': 2},
    'discs': {'balls': 2},
    'discs that move': {'balls': 2, 'hazards': 1},
    'space, boxes': {**SPACE, 'boxes': 2},
    'axes, boxes': {**SPACE, 'boxes': 2, 'input': 0.0},
    'approach': {'approach': Approach(0.3, (1.0, 0.5))},
    'space, approach': {**SPACE, 'approach': Approach(0.2, (1.0, 0.5, 0.1))},
    'cones': {**TILTED, 'floor': Floor('circle', fraction=0.1), 'length': 0.05},
    'turn rate': {'max_rate': 0.5},
    'turn rate, inertia': {'translation_order': 2, 'max_rate': 0.5},
    'turn rate, exact': {'discretisation': 'exact', 'max_rate': 0.3},
    'turn rate, length': {'max_rate': 0.5, 'length': 0.3},
    'turn rate, arrival': {'max_rate': 1.2, **ARRIVES},
    'turn rate, boxes': {'max_rate': 1.0, 'boxes': 2},
    'space, turn rate': {**SPACE, 'max_rate': 0.5},
    'axes, turn rate': {**SPACE, 'max_rate': 0.5, 'input': 0.0},
    'space, turn rate, inertia': {**SPACE, 'translation_order': 2, 'max_rate': 0.5},
    'acceleration': {'max_acceleration': 0.2},
    'space, acceleration': {**SPACE, 'max_acceleration': 0.2},
}
# Not all of these are proved optimal; if one is, its certificate takes what the search has proved.
OPEN: dict[str, dict[str, Any]] = {
    'polygon, turn rate': {**FACETS, 'max_rate': 0.7},
    'polygon, turn rate, length': {**FACETS, 'max_rate': 0.7, 'length': 0.3},
    'space, wing': {**SPACE, **ROUND, 'max_rate': 0.5},
    'space, polygon, turn rate': {**SPACE, 'floor': Floor('polygon', 6, 0.5), 'max_rate': 0.5},
    'circle, arrival': {**ROUND, **ARRIVES},
    'circle, length, arrival': {**ROUND, 'length': 0.3, **ARRIVES},
    'circle, arrival, acceleration': {**ROUND, 'max_acceleration': 0.2, **ARRIVES},
    'shell, arrival': {**SPACE, **ROUND, 'input': 0.0, **ARRIVES},
    'shell, attitude': {**SPACE, **ROUND, 'attitude': 0.5},
    'shell, no turns': {**SPACE, **ROUND, 'max_rate': 1e-320},
    'space, coasting, length': {**SPACE, **COASTS, 'length': 0.3},
    'circle, acceleration': {**FAST, 'max_acceleration': 0.05, 'horizon': 4},
    'circle, turn rate, acceleration': {**WING, 'max_rate': 0.4},
    'acceleration, turn rate': {'max_acceleration': 0.2, 'max_rate': 1.0},
    'acceleration, boxes': {'max_acceleration': 0.2, 'boxes': 1, 'no_corner_cutting': True},
    'acceleration, discs': {'max_acceleration': 0.2, 'balls': 1, 'hazards': 1},
    'acceleration, length': {'max_acceleration': 0.2, 'length': 0.3, 'discretisation': 'exact'},
    'circle, turn rate, approach': {**ROUND, 'max_rate': 0.9, 'approach': TOWARDS},
    'polygon, turn rate, approach': {**FACETS, 'max_rate': 0.9, 'approach': TOWARDS},
    'long': {**FAST, 'max_rate': 0.5, 'horizon': 20},
    'wing': {**WING, 'approach': Approach(0.5, (1.0, 0.5))},
}


def polled(limit: int) -> Callable[[], bool]:
    """Return a deadline check that returns True from call ``limit`` + 1 on."""
    left = iter(range(limit))
    return lambda: next(left, None) is None


def seeds(*usual: int) -> list[int]:
    """Return a test's seeds: the usual ones, or the held-out ones of ``ORBIMPC_SEEDS``."""
    return [*range(*map(int, HELD_OUT.split(':')))] if HELD_OUT else [*usual]


def case(family: str, seed: int = 0, longest: int = 7) -> Case:
    """Return a problem of a family with a state, and with goals within reach."""
    rng = np.random.default_rng([seed, *family.encode()])
    while True:
        found = _drawn(family, rng, longest)
        ahead = np.tile(found.state.rotation[:, 0], (found.problem.horizon + 1, 1))
        first = translation_rollout(found.problem, found.state, ahead)[0][:2]
        clear = all(body.depth(first).max() < 0.0 for body in found.problem.obstacles)
        if clear and beyond_reach(*found.parts) <= 0.0:
            return found


def _drawn(family: str, rng: np.random.Generator, longest: int) -> Case:
    given = dict((FAMILIES | OPEN)[family])
    boxes, balls, hazards = (given.pop(name, 0) for name in ('boxes', 'balls', 'hazards'))
    wanting, decided = given.pop('attitude', 0.0), given.pop('decided', False)
    weights = Weights(1.0, given.pop('input', 0.05), given.pop('length', 0.0), 10.0, wanting)
    horizon = int(rng.integers(4, longest + 1))
    horizon = given.pop('horizon', horizon)
    step, forward = 10.0 ** rng.uniform(-1, 0), 10.0 ** rng.uniform(-0.5, 1)
    if 'max_rate' in given:
        given['max_rate'] = given['max_rate'] / step
    if 'max_acceleration' in given:
        given['max_acceleration'] = given['max_acceleration'] * forward / step
    problem = Problem(horizon=horizon, step=step, forward=forward, weights=weights, **given)
    n, unit = problem.dimension, problem.maps.unit
    attitude = rotation(rng, n)
    extra: dict[str, Any] = {'velocity': 0.1 * rng.normal(size=n) * unit / step}
    coasts = problem.rotation_order == 2 and not decided
    coasted = attitude @ rotation(rng, n, 0.2) if coasts else None
    # Here plans limit the acceleration: other families start at full speed.
    paced = family in OPEN and problem.max_acceleration and problem.terminal != 'constraint'
    speed = rng.uniform(problem.floor.fraction, 1.0) if paced else 1.0
    state = State.at(
        rng.normal(size=n) * unit,
        speed * attitude,
        coasted=coasted,
        disturbance=0.05 * rng.normal(size=n) * unit / step ** (2 if problem.inertial else 1),
        wanted=rotation(np.random.default_rng(horizon), n),
        **(extra if problem.inertial else {}),
    )
    way = rng.normal(size=n)
    reach = horizon * unit * (0.25 * horizon if problem.inertial else 1.0)
    near = 0.2 if problem.inertial else 0.5
    target = state.position + rng.uniform(0.1, near) * reach * way / np.linalg.norm(way)
    bodies = [_on_the_way(rng, state.position, target) for _ in range(boxes + balls + hazards)]
    every = [*map(_within, bodies[:balls]), *bodies[balls:]]
    problem = replace(problem, obstacles=tuple(every[hazards:]))
    drift = 0.1 * unit / step * rng.normal(size=(hazards, n))
    moving = itertools.starmap(MovingObstacle.drifting, zip(every, drift, strict=False))
    return Case(problem, replace(state, hazards=tuple(moving)), np.tile(target, (horizon, 1)))


def _on_the_way(rng: np.random.Generator, begin: np.ndarray, end: np.ndarray) -> Box:
    """Return a box between two points that contains neither."""
    apart = np.linalg.norm(end - begin)
    middle = begin + rng.uniform(0.4, 0.7) * (end - begin)
    size = rng.uniform(0.15, 0.25, len(begin)) * apart
    middle = middle + 0.05 * apart * rng.normal(size=len(begin)) / np.sqrt(len(begin))
    return Box(middle - size, middle + size)


def _within(box: Box) -> Ball:
    """Return the largest ball inside a box, at its centre."""
    size = box.maximum - box.minimum
    return Ball(box.minimum + 0.5 * size, 0.5 * float(size.min()))


def reference(name: str) -> Case:
    return case_of(CASES[name])


# --- parts


def rotation(rng: np.random.Generator, n: int, largest: float = np.pi) -> np.ndarray:
    """Return a rotation about a random axis; the angle is often tiny or nearly the largest."""
    axis = rng.normal(size=1 if n == 2 else 3)
    axis /= np.linalg.norm(axis)
    near = 10.0 ** rng.uniform(-12, 0)
    angle = rng.choice([rng.uniform(0, largest), near * largest, (1 - near) * largest])
    return exp(angle * axis)


def state(rng: np.random.Generator, problem: Problem, *, full_speed: bool = True) -> State:
    n = problem.dimension
    attitude = rotation(rng, n)
    fraction = 1.0 if full_speed else rng.uniform(0.3, 1.0)
    turning = 0.3 * rng.normal(size=1 if n == 2 else 3)
    return State.at(
        rng.normal(size=n),
        fraction * attitude,
        velocity=0.3 * rng.normal(size=n) if problem.translation_order == 2 else None,
        attitude=attitude,
        coasted=attitude @ exp(problem.step * turning) if problem.rotation_order == 2 else None,
    )


def disturbed(rng: np.random.Generator, problem: Problem, *, full_speed: bool = False) -> State:
    """Return a random state with a disturbance of up to 0.6 ``forward`` and a wanted attitude."""
    start = state(rng, problem, full_speed=full_speed)
    w = rng.normal(size=problem.dimension)
    w *= 0.6 * problem.forward * rng.random() / np.linalg.norm(w)
    return replace(start, disturbance=w, wanted=rotation(rng, problem.dimension))


def goals(rng: np.random.Generator, problem: Problem, distance: float = 4.0) -> np.ndarray:
    """Return drifting goals, a different one for every step."""
    shape = problem.horizon, problem.dimension
    return distance * rng.normal(size=shape[1]) + np.cumsum(0.2 * rng.normal(size=shape), axis=0)


def weights(rng: np.random.Generator) -> Weights:
    return Weights(
        position=rng.uniform(0.1, 2.0),
        input=10.0 ** rng.uniform(-2, 0),
        length=rng.choice([0.0, rng.uniform(0.0, 2.0)]),
        terminal=rng.uniform(0.0, 10.0),
    )


def box(rng: np.random.Generator, n: int, centre: np.ndarray) -> Box:
    half = rng.uniform(0.2, 0.8, size=n)
    return Box(centre - half, centre + half)


def floor(shape: str, fraction: float = np.sqrt(0.3), faces: int = 4) -> Floor:
    return Floor(shape, faces, float(fraction))


UPRIGHT = turned_onto(np.eye(3), np.array([0.0, 0.0, 1.0]))
FALLING = np.array([0.0, 0.0, -1.62])  # [m/s^2]


def lander(**others: Any) -> Problem:
    """Return the problem of a lander in lunar gravity: eight steps of one second."""
    usual: dict[str, Any] = {
        **TILTED,
        'horizon': 8,
        'forward': 3.6,
        'weights': Weights(position=0.3, input=0.05, length=0.3, terminal=1.0),
        'discretisation': 'exact',
        'tilt': 0.2,
        'glide_slope': 0.6,
    }
    return Problem(**(usual | others))


def falling(position: Any, velocity: Any = (0.0, 0.0, 0.0), **more: Any) -> State:
    """Return the state of a lander, upright by default."""
    known = {'velocity': velocity, 'attitude': UPRIGHT, 'disturbance': FALLING, **more}
    return State.at(position, 0.45 * known['attitude'], **known)
