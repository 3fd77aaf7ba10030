# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Bounds of problems with turn limits that a cone program solves, counted again."""

from dataclasses import replace
from functools import cache

import certified
import numpy as np
import pytest
from counting import counted, said

from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.problem import Approach, Floor, Problem, State, Weights
from orbimpc_ros.mpc.proof.grounds import NO_LEANS, ChoiceGrounds
from orbimpc_ros.mpc.proof.recount import Recount
from orbimpc_ros.mpc.solve.choice_nodes import ChoiceNodes, TreeLeaf
from orbimpc_ros.mpc.solve.place_program import PlaceProgram
from orbimpc_ros.mpc.solve.program import Program
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.solver import Solver

pytestmark = pytest.mark.skipif(not COMPILED, reason='too slow a search without numba')
ROUND, SHORT = Floor('circle', fraction=0.6), {'horizon': 2}
ARRIVES = {'terminal': 'constraint'}
TOWARDS = {'approach': Approach(0.4, (1.0, 0.5))}
KINDS = {
    'space': ('shell', SHORT | {'max_rate': 0.7}),
    'space, wide': ('shell', SHORT | {'max_rate': 2.5}),
    'space, inertia': ('shell', SHORT | {'max_rate': 0.7, 'translation_order': 2}),
    'space, rotations': ('space', SHORT | {'max_rate': 0.7, 'floor': ROUND}),
    'space, faces': ('space', {'max_rate': 0.2, 'floor': Floor('polygon', 6, 0.4)}),
    'space, boxes': ('axes, boxes', SHORT | {'max_rate': 0.9, 'floor': ROUND}),
    'space, lengths': ('shell', SHORT | {'max_rate': 0.7, 'weights': Weights(1, 0, 0.3, 10)}),
    'space, cone': (
        'shell',
        SHORT | {'max_rate': 0.9, 'approach': Approach(0.4, (1.0, 0.5, 0.1))},
    ),
    'space, no floor, cone': ('space, approach', {'max_rate': 0.9}),
    'space, no floor, arrival': ('space, turn rate', ARRIVES),
    'plane, boxes, cone': ('boxes', SHORT | TOWARDS | {'max_rate': 0.9, 'floor': ROUND}),
    'plane, boxes, no floor, cone': ('boxes', TOWARDS | {'max_rate': 0.9}),
}


@cache
def posed(kind):
    """Return a case of a kind that has a plan of no more than half a thousand nodes, with it."""
    base, changes = KINDS[kind]
    rng = np.random.default_rng([*kind.encode()])
    while True:
        case = certified.case(base, rng, longest=4)
        problem = replace(case.problem, **changes)
        case = case._replace(problem=problem, goals=case.goals[: problem.horizon])
        left = iter(range(1, 500))
        try:
            plan = Solver(problem).solve(*case[1:], None, lambda left=left: not next(left, 0))
        except OrbimpcError:
            continue
        if plan.is_closed:
            return case, plan


@pytest.mark.parametrize('kind', KINDS)
def test_what_a_search_proves_of_turns_is_proved_by_its_tree(kind):
    case, plan = posed(kind)
    assert isinstance(plan.proof.grounds, ChoiceGrounds)
    assert plan.proof.checked
    assert (1.0 - 1e-9) * said(case) <= counted(case, plan) <= plan.objective * (1.0 + 1e-7)


@pytest.mark.parametrize('kind', ['space', 'space, cone', 'plane, boxes, cone'])
def test_no_multipliers_of_turns_prove_more_than_a_trajectory_costs(kind):
    case, plan = posed(kind)
    grounds, rng = plan.proof.grounds, np.random.default_rng(3)
    most, changed = plan.objective * (1.0 + 1e-7), ('tethers', 'leans', 'presses')
    for _ in range(150):
        known = {name: getattr(grounds, name) for name in changed}
        other = {name: x * rng.uniform(0.0, 2.0, x.shape) for name, x in known.items()}
        for name in changed[:2]:
            added = rng.choice([0.0, 0.1, 1.0]) * rng.normal(size=known[name].shape)
            other[name] = other[name] + added
        assert counted(case, plan, **other) <= most


@pytest.mark.parametrize(
    ('of', 'kind'),
    [
        ('tethers', 'space, no floor, arrival'),
        ('tethers', 'plane, boxes, no floor, cone'),
        ('leans', 'space'),
        ('leans', 'space, faces'),
        ('leans', 'space, boxes'),
    ],
)
def test_a_bound_rests_on_how_far_the_vehicle_can_turn(of, kind):
    case, plan = posed(kind)
    known, before = getattr(plan.proof.grounds, of), counted(case, plan)
    most = (1.0 - 1e-6) * before
    assert counted(case, plan, **{of: 0.0 * known}) < most
    wider = replace(case.problem, max_rate=1.2 * case.problem.max_rate)
    assert counted(case._replace(problem=wider), plan) < most


@pytest.mark.parametrize('floor', [Floor(), Floor('circle', fraction=0.9)])
def test_programs_tell_the_same_of_chords(floor):
    problem = Problem(horizon=5, max_rate=0.3, floor=floor)
    state = State.at(np.zeros(2), np.eye(2))
    request = Request(state, np.tile([-3.0, 1.0], (5, 1)))
    told = []
    for program in (PlaceProgram(problem), Program(problem)):
        program.relax(request)
        found, tied = program.multipliers, np.zeros((program.chords, 2))
        for row, normal, size in zip(found.rows, found.normals, found.sizes, strict=True):
            if row < -5:
                tied[-6 - row] += size * normal
        told.append(tied)
    assert np.linalg.norm(told[0], axis=1).max() > 1.0
    assert told[1] == pytest.approx(told[0], abs=0.01)


def test_turns_at_rotation_order_2_are_not_counted():
    case, plan = posed('space')
    other = Recount(replace(case.problem, rotation_order=2))
    grounds, unit = plan.proof.grounds, plan.proof.cost_unit
    assert other.bound(case.state, case.goals, grounds, unit) == -np.inf


def test_leaves_of_which_only_some_have_cones_have_none_there():
    nodes, point, none = ChoiceNodes(), np.ones((2, 3)), np.zeros((0, 3))
    assert list(nodes.part(0, 0, 2)) == [1, 2]
    free, held = TreeLeaf(point, (), none), TreeLeaf(point, (), none, leans=np.ones((1, 3)))
    sides = np.zeros((2, 3), np.int64)
    assert nodes.grounds(sides, [free, held]).leans.tolist() == [[[0] * 3], [[1] * 3]]
    assert nodes.grounds(sides, [free, free]).leans is NO_LEANS
