# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Seeded random problems, and the reference cases with their optimal values."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np

from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.problem import Box, Floor, Problem, State, Weights
from orbimpc_ros.mpc.problem.case import Case, case_of

REFERENCE = Path(__file__).parent / 'reference'
CASES = json.loads((REFERENCE / 'cases.json').read_text())
ANSWERS = json.loads((REFERENCE / 'answers.json').read_text())
ORDERS = [
    {'dimension': n, 'rotation_order': r, 'translation_order': t}
    for n, r, t in itertools.product((2, 3), (1, 2), (1, 2))
]


def reference(name: str) -> Case:
    return case_of(CASES[name])


def rotation(rng: np.random.Generator, n: int, largest: float = np.pi) -> np.ndarray:
    """A rotation by a random angle, often tiny or almost the largest, about a random axis."""
    axis = rng.normal(size=1 if n == 2 else 3)
    axis /= np.linalg.norm(axis)
    near = 10.0 ** rng.uniform(-12, 0)
    angle = rng.choice([rng.uniform(0, largest), near * largest, (1 - near) * largest])
    return exp(angle * axis)


def state(rng: np.random.Generator, problem: Problem, *, full_speed: bool = True) -> State:
    n = problem.dimension
    attitude = rotation(rng, n)
    fraction = 1.0 if full_speed else rng.uniform(0.3, 1.0)
    second = problem.translation_order == 2
    turning = 0.3 * rng.normal(size=1 if n == 2 else 3)
    return State.at(
        rng.normal(size=n),
        fraction * attitude,
        velocity=0.3 * rng.normal(size=n) if second else None,
        attitude=attitude,
        coasted=attitude @ exp(problem.step * turning) if problem.rotation_order == 2 else None,
    )


def goals(rng: np.random.Generator, problem: Problem, distance: float = 4.0) -> np.ndarray:
    """Goals that drift: a different one for every step."""
    first = distance * rng.normal(size=problem.dimension)
    drift = 0.2 * rng.normal(size=(problem.horizon, problem.dimension))
    return first + np.cumsum(drift, axis=0)


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
