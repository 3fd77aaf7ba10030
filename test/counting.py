# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Problems with plans, what their methods say of bounds, and what is counted of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import certified
import numpy as np
import problems

from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import Approach, Box, Floor, Problem, State, Weights
from orbimpc_ros.mpc.problem.case import Case
from orbimpc_ros.mpc.problem.units import Units
from orbimpc_ros.mpc.proof.grounds import ChoiceGrounds
from orbimpc_ros.mpc.proof.recount import Recount
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.solver import Solver


def solved(kind: str, seed: int, **changes: Any) -> tuple[Case, Plan]:
    """Return the first of a seed's problems that has a plan, with it."""
    rng = np.random.default_rng([seed, *kind.encode()])
    while True:
        case = certified.case(kind, rng, longest=6)
        case = case._replace(problem=replace(case.problem, **changes))
        try:
            return case, Solver(case.problem).solve(case.state, case.goals)
        except Infeasible:  # a body where the state already leads
            continue


def said(case: Case) -> float:
    """Return the bound that the method gives of itself."""
    solver = Solver(case.problem)
    units, method = solver._units, solver._method_for(case.state)
    found = method.solve(Request(units.state(case.state), units.lengths(case.goals)))
    return units.cost * found.lower_bound


def told(problem: Problem, state: State, goals: np.ndarray) -> tuple[float, float, Any]:
    """Return a method's bound and cost, and what its bound rests on, as the problem was posed."""
    solver, units = Solver(problem), Units.of(problem)
    found = solver._method.solve(Request(units.state(state), units.lengths(goals)))
    grounds = solver._posed(found.grounds)
    return units.cost * found.lower_bound, units.cost * found.cost, (grounds, units.cost)


def counted(case: Case, plan: Plan, **changes: Any) -> float:
    """Return what the grounds of a plan's bound prove, with some of them changed."""
    grounds = plan.proof.grounds._replace(**changes)
    recount = Recount(case.problem)
    return recount.bound(case.state, case.goals, grounds, plan.proof.cost_unit)


def changed(array: np.ndarray, place: Any, value: Any) -> np.ndarray:
    """Return an array with one of its entries changed."""
    array = array.copy()
    array[place] = value
    return array


def mutants(grounds: ChoiceGrounds, rng: np.random.Generator, count: int) -> Iterator[dict]:
    """Yield so many random changes of one number of a tree each."""
    for _ in range(count):
        name = ChoiceGrounds._fields[rng.integers(len(ChoiceGrounds._fields))]
        array = getattr(grounds, name)
        if not array.size:
            continue
        place = tuple(rng.integers(size) for size in array.shape)
        old = array[place]
        value = not old if array.dtype == bool else old + rng.integers(-3, 4)
        if array.dtype.kind == 'f':
            value = old * rng.uniform(0.0, 3.0) + 0.1 * rng.normal()
        yield {name: changed(array, place, value)}


def a_change(seed: int) -> Case:
    """Return a problem with a floor whose speed changes slowly, a state, and goals."""
    rng = np.random.default_rng(seed)
    faces = int(rng.choice([0, 4, 6]))
    least = rng.uniform(0.3, 0.95 * np.cos(np.pi / faces) if faces else 0.8)
    step, forward = 10.0 ** rng.uniform(-1, 0), 10.0 ** rng.uniform(-0.5, 1)
    turn = float(rng.choice([0.3, 0.7, 1.5, 0.0]))
    problem = Problem(
        horizon=int(rng.integers(3, 6)),
        step=step,
        forward=forward,
        weights=Weights(1.0, 0.05, 0.0, 10.0),
        floor=Floor('polygon', faces, least) if faces else Floor('circle', fraction=least),
        max_rate=turn / step,
        max_acceleration=float(rng.choice([0.05, 0.1, 0.3])) * forward / step,
    )
    unit = problem.length_unit
    turned = rng.uniform(least, 1.0) * problems.rotation(rng, 2)
    start = State.at(10.0 * unit * rng.normal(size=2), turned)
    way = rng.normal(size=2)
    way *= rng.uniform(0.1, 0.9) * problem.horizon * unit / np.linalg.norm(way)
    return Case(problem, start, np.tile(start.position + way, (problem.horizon, 1)))


def an_approach(seed: int) -> Case:
    """Return a problem with a floor, a turn limit and a cone of approach, a state, and goals."""
    rng = np.random.default_rng(seed)
    step, forward = 10.0 ** rng.uniform(-1, 0), 10.0 ** rng.uniform(-0.5, 1)
    floors = (
        Floor('circle', fraction=float(rng.uniform(0.3, 1.0))),
        Floor('polygon', faces=6, fraction=float(rng.uniform(0.3, 0.8))),
    )
    problem = Problem(
        horizon=int(rng.integers(3, 14)),
        step=step,
        forward=forward,
        weights=Weights(float(rng.choice([0.0, 1.0])), 0.05, 0.0, 10.0),
        floor=floors[seed % 2],
        max_rate=float(rng.uniform(0.2, 1.3)) / step,
        max_acceleration=float(rng.choice([0.0, 0.2])) * forward / step,
        approach=Approach(float(rng.uniform(0.05, 1.0)), tuple(rng.normal(size=2))),
    )
    start = State.at(3.0 * rng.normal(size=2), problems.rotation(rng, 2))
    way = rng.normal(size=2)
    way *= rng.uniform(0.1, 0.8) * problem.horizon * problem.length_unit / np.linalg.norm(way)
    return Case(problem, start, np.tile(start.position + way, (problem.horizon, 1)))


@cache
def between_walls() -> tuple[Case, Plan]:
    """Return a problem in space whose tree has parts that are empty, and sides left out."""
    walls = tuple(
        Box((x, y - 1.5, -1.5), (x + 0.3, y + 1.5, 1.5)) for x, y in ((1.0, -0.4), (1.8, 0.9))
    )
    problem = Problem(
        dimension=3,
        horizon=8,
        step=0.3,
        translation_order=2,
        discretisation='exact',
        forward=3.0,
        weights=Weights(1.0, 0.05, 0.0, 10.0),
        obstacles=walls,
        no_corner_cutting=True,
    )
    state = State.at(np.zeros(3), np.eye(3), velocity=np.array([0.3, 0.0, 0.0]))
    case = Case(problem, state, np.tile([3.0, 0.3, 0.0], (8, 1)))
    return case, Solver(problem).solve(*case[1:])
