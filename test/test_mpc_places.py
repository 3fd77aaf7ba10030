# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The quadratic over thrust axes, its rows on places: against the general program."""

import numpy as np
import pytest
from problems import rotation

from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.model.motion import coasting_controls, control_maps
from orbimpc_ros.mpc.model.trajectory import trajectory_of
from orbimpc_ros.mpc.problem import Floor, Problem, State, Weights
from orbimpc_ros.mpc.solve.disjunction import Slot
from orbimpc_ros.mpc.solve.place_program import PlaceProgram
from orbimpc_ros.mpc.solve.program import Program
from orbimpc_ros.mpc.solve.relaxation import Point
from orbimpc_ros.mpc.solve.request import Request

pytestmark = pytest.mark.skipif(not COMPILED, reason='too slow to be used without numba')

STEPS = 6
SPACE = {'dimension': 3, 'weights': Weights(input=0.0), 'discretisation': 'exact'}
MODELS = [
    {},
    {'discretisation': 'exact'},
    {'translation_order': 2},
    {'translation_order': 2, 'discretisation': 'held', 'arrival_weight': 5.0},
    {'max_rate': 1.2, 'floor': Floor('circle')},
    {'max_rate': 2.5, 'floor': Floor('circle')},
    {'max_rate': 0.8},
    SPACE,
]


def asked(rng, problem):
    """A request, and half-spaces for it on headings, positions and control points."""
    n = problem.dimension
    attitude = rotation(rng, n)
    start = State.at(
        rng.normal(size=n),
        rng.uniform(0.1, 1.0) * attitude,
        attitude=attitude,
        velocity=rng.normal(size=n) * problem.inertial,
        disturbance=0.2 * rng.normal(size=n),
    )
    goals = np.tile(start.position + rng.uniform(0.5, 5.0) * rng.normal(size=n), (STEPS, 1))
    maps = control_maps(problem)
    free = coasting_controls(problem, start) + maps[:, :, :1] * start.rotation[:, 0]
    rows = []
    for slot in rng.choice(2 * STEPS, rng.integers(0, 6), replace=False):
        normal = rng.normal(size=n)
        normal /= np.linalg.norm(normal)
        least = rng.uniform(-0.5, 0.6)
        rows.append((int(slot), normal, least + (slot >= STEPS) * (normal @ start.position - 1.0)))
    for _ in range(rng.integers(0, 9)):
        k, i = rng.integers(STEPS), rng.integers(maps.shape[1])
        normal = rng.normal(size=n)
        normal /= np.linalg.norm(normal)
        if maps[k, i, 1:].any():
            point = Point(int(k * maps.shape[1] + i), maps[k, i, 1:])
            least = 0.4 * rng.normal() - 0.4 + normal @ (start.position - free[k, i])
            rows.append((point, normal, float(least)))
    return Request(start, goals), rows


def programs(model):
    problem = Problem(horizon=STEPS, step=0.7, forward=1.3, **model)
    slots = [Slot(on, k) for on in ('heading', 'position') for k in range(1, STEPS + 1)]
    assert PlaceProgram.solves(problem)
    return problem, PlaceProgram(problem, slots), Program(problem, slots)


@pytest.mark.parametrize('model', MODELS)
def test_it_finds_what_the_general_program_finds(model):
    problem, program, general = programs(model)
    rng, refuted, solved = np.random.default_rng(31), 0, 0
    for _ in range(20):
        request, rows = asked(rng, problem)
        try:
            expected = general.relax(request, rows)
        except Infeasible:
            refuted += 1
            with pytest.raises(Infeasible):
                program.relax(request, rows)
            continue
        solved += 1
        found = program.relax(request, rows)
        cost = trajectory_of(problem, request.state, request.goals, found.x).cost
        assert found.bound <= cost + 1e-9 * cost
        assert found.bound == pytest.approx(cost, rel=1e-7, abs=1e-7)
        assert found.bound == pytest.approx(expected.bound, rel=1e-6, abs=1e-6)
    assert solved >= 8
    assert refuted or not problem.inertial


def test_closer_chords_bound_turns_more():
    problem, program, general = programs({'max_rate': 1.2, 'floor': Floor('circle')})
    request, _ = asked(np.random.default_rng(3), problem)
    chords = np.full(STEPS - 1, 0.1)
    held = program.relax(request, [], chords)
    assert np.linalg.norm(np.diff(held.x, axis=0), axis=1).max() <= 0.1 + 1e-8
    assert held.bound == pytest.approx(general.relax(request, [], chords).bound, rel=1e-6)
    assert held.bound > program.relax(request).bound * (1.0 + 1e-3)


def test_a_deadline_leaves_a_bound_that_holds():
    problem, program, _ = programs({})
    rng = np.random.default_rng(8)
    for _ in range(10):
        request, rows = asked(rng, problem)
        late = request._replace(out_of_time=lambda: True)
        try:
            done = program.relax(request, rows)
            assert program.relax(late, rows).bound <= done.bound + 1e-9 * abs(done.bound)
        except Infeasible:
            continue
