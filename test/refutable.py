# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Random problems, most of which nothing satisfies, of every kind that refutations are of."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import problems

from orbimpc_ros.mpc.problem import Approach, Ball, Box, Floor, MovingObstacle, Problem, State
from orbimpc_ros.mpc.problem.case import Case

Draw = Callable[[np.random.Generator], Case]
WING: dict[str, Any] = {'floor': Floor('circle', fraction=0.7), 'max_rate': 0.5}


def _somewhere(rng: np.random.Generator, problem: Problem, away: float, **extra: Any) -> Case:
    """Return a problem with a goal so many reaches away, in any direction."""
    start = problems.state(rng, problem)
    way = rng.normal(size=problem.dimension)
    reach = np.abs(problem.maps.reach[-1]).sum()
    moved = problem.maps.drift[-1] * start.velocity if problem.inertial else 0.0
    goal = start.position + moved + away * reach * way / np.linalg.norm(way)
    return Case(problem, start, np.tile(goal, (problem.horizon, 1)))


def _arriving(rng: np.random.Generator, **given: Any) -> Problem:
    return Problem(horizon=int(rng.integers(3, 9)), terminal='constraint', **given)


def out_of_reach(rng: np.random.Generator) -> Case:
    orders = dict(problems.ORDERS[int(rng.integers(len(problems.ORDERS)))])
    return _somewhere(rng, _arriving(rng, **orders), rng.uniform(1.0, 1.6))


def out_of_reach_above_a_floor(rng: np.random.Generator) -> Case:
    shape = ('circle', 'polygon')[int(rng.integers(2))]
    floor = Floor(shape, 6, float(rng.uniform(0.3, 0.85)))
    return _somewhere(rng, _arriving(rng, floor=floor), rng.uniform(1.0, 1.4))


def too_fast_to_stop(rng: np.random.Generator) -> Case:
    n = int(rng.integers(2, 4))
    problem = _arriving(rng, dimension=n, translation_order=2)
    attitude = problems.rotation(rng, n)
    speed = rng.uniform(0.5, 1.3) * problem.horizon
    way = rng.normal(size=n)
    velocity = speed * way / np.linalg.norm(way)
    state = State.at(np.zeros(n), attitude, velocity=velocity)
    goal = 0.5 * problem.horizon * velocity
    return Case(problem, state, np.tile(goal, (problem.horizon, 1)))


def behind_a_wing(rng: np.random.Generator) -> Case:
    """To where only who could turn on the spot, or wait, arrives."""
    return _somewhere(rng, _arriving(rng, **WING), rng.uniform(0.1, 0.9))


def no_turn_meets_the_cone(rng: np.random.Generator) -> Case:
    angle = rng.uniform(-np.pi, np.pi)
    approach = Approach(float(rng.uniform(0.1, 0.6)), (float(np.cos(angle)), float(np.sin(angle))))
    horizon = int(rng.integers(2, 5))
    problem = Problem(horizon=horizon, approach=approach, **WING)
    start = State.at(np.zeros(2), problems.rotation(rng, 2, 0.3))
    return Case(problem, start, np.tile(rng.normal(size=2), (horizon, 1)))


def walled_in(rng: np.random.Generator) -> Case:
    """From inside of four walls to outside of them."""
    size, thick = rng.uniform(1.2, 2.0), rng.uniform(1.1, 1.6)
    outer = size + thick
    walls = tuple(
        Box(np.array(low), np.array(high))
        for low, high in (
            ((-outer, size), (outer, outer)),
            ((-outer, -outer), (outer, -size)),
            ((size, -outer), (outer, outer)),
            ((-outer, -outer), (-size, outer)),
        )
    )
    problem = Problem(
        horizon=int(rng.integers(4, 6)), terminal='constraint', obstacles=walls,
        no_corner_cutting=True,
    )  # fmt: skip
    angle = rng.uniform(0.0, 2.0 * np.pi)
    goal = (outer + 0.3) * np.sqrt(2.0) * np.array([np.cos(angle), np.sin(angle)])
    state = State.at(rng.uniform(-0.3, 0.3, 2), problems.rotation(rng, 2))
    return Case(problem, state, np.tile(goal, (problem.horizon, 1)))


def held_by_a_body(rng: np.random.Generator) -> Case:
    """Too deep inside of a body to leave it in a step."""
    n = int(rng.integers(2, 4))
    half = rng.uniform(0.9, 2.0, size=n)
    problem = Problem(n, horizon=int(rng.integers(2, 6)), obstacles=(Box(-half, half),))
    state = State.at(rng.uniform(-0.3, 0.3, n), problems.rotation(rng, n))
    return Case(problem, state, np.tile(rng.normal(size=n), (problem.horizon, 1)))


def run_over(rng: np.random.Generator) -> Case:
    """In the way of a body that is faster, and wide."""
    angle, size = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(2.5, 5.0)
    ahead = np.array([np.cos(angle), np.sin(angle)])
    body: Ball | Box = Ball(-ahead * (size + 1.5), float(size))
    if rng.random() < 0.5:
        body = Box(body.centre - size, body.centre + size)
    hazard = MovingObstacle.drifting(body, rng.uniform(1.5, 3.0) * ahead)
    problem = Problem(horizon=int(rng.integers(3, 6)))
    state = State.at(np.zeros(2), problems.rotation(rng, 2), hazards=(hazard,))
    return Case(problem, state, np.tile(rng.normal(size=2), (problem.horizon, 1)))


def too_slow_to_speed_up(rng: np.random.Generator) -> Case:
    pace = float(rng.uniform(0.05, 0.2))
    problem = _arriving(rng, max_acceleration=pace)
    way = problems.rotation(rng, 2)
    state = State.at(np.zeros(2), 0.2 * way, attitude=way)
    goal = rng.uniform(0.3, 0.8) * problem.horizon * way[:, 0]
    return Case(problem, state, np.tile(goal, (problem.horizon, 1)))


def too_steep_a_descent(rng: np.random.Generator) -> Case:
    problem = _arriving(
        rng, dimension=3, translation_order=2, tilt=float(rng.uniform(0.1, 0.5)),
        glide_slope=float(rng.uniform(0.2, 0.6)),
    )  # fmt: skip
    attitude = np.eye(3)[:, [2, 0, 1]]  # upright
    place = np.append(rng.uniform(-2.0, 2.0, 2), rng.uniform(1.0, 6.0)) * problem.horizon
    state = State.at(place, attitude, velocity=np.append(rng.normal(size=2), -1.0))
    return Case(problem, state, np.zeros((problem.horizon, 3)))


KINDS: dict[str, Draw] = {
    each.__name__.replace('_', ' '): each
    for each in (
        out_of_reach, out_of_reach_above_a_floor, too_fast_to_stop, behind_a_wing,
        no_turn_meets_the_cone, walled_in, held_by_a_body, run_over, too_slow_to_speed_up,
        too_steep_a_descent,
    )
}  # fmt: skip
