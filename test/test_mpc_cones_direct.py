# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The cone program in space made without CVXPY: the same as the one stated in CVXPY."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from problems import goals, state, weights

from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.geometry.orbitopes import margin, matrix
from orbimpc_ros.mpc.model.trajectory import trajectory_of
from orbimpc_ros.mpc.problem import Floor, Problem
from orbimpc_ros.mpc.solve.direct_statement import DirectStatement
from orbimpc_ros.mpc.solve.disjunction import Slot
from orbimpc_ros.mpc.solve.program import Program
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.statement import Statement

SLOTS = (Slot('heading', 2), Slot('position', 3), Slot('heading', 5))
AXIS = np.array([0.6, 0.0, 0.8])


def drawn(rng, translation_order, **more):
    changes = {
        'dimension': 3,
        'translation_order': translation_order,
        'horizon': 6,
        'weights': weights(rng),
        'discretisation': str(rng.choice(['euler', 'exact'])),
        'terminal': str(rng.choice(['penalty', 'constraint'])),
        'arrival_weight': float(rng.choice([0.0, 3.0])),
        'floor': Floor('circle', 4, 0.3) if rng.uniform() < 0.5 else Floor(),
        'glide_slope': 0.3 if rng.uniform() < 0.5 else 0.0,
        'tilt': 0.8 if translation_order == 2 and rng.uniform() < 0.5 else 0.0,
    }
    return Problem(**(changes | more))


def relaxed(program, request, halfspaces):
    try:
        return program.relax(request, halfspaces)
    except Infeasible:
        return None


@pytest.mark.parametrize('translation_order', [1, 2])
@pytest.mark.parametrize('weight', ['drawn', 0.0])
@pytest.mark.parametrize('seed', range(6))
def test_both_statements_are_of_the_same_program(monkeypatch, translation_order, weight, seed):
    rng = np.random.default_rng(seed)
    problem = drawn(rng, translation_order)
    if weight == 0.0:
        problem = replace(problem, weights=replace(problem.weights, input=0.0, terminal=1.0))
    direct = Program(problem, SLOTS)
    assert isinstance(direct._statement, DirectStatement)
    monkeypatch.setattr(DirectStatement, 'states', lambda *_: False)
    stated = Program(problem, SLOTS)
    assert isinstance(stated._statement, Statement)
    for halfspaces in ([], [(0, AXIS, 0.4), (1, AXIS, 0.1)]):
        start = state(rng, problem, full_speed=False)
        start = replace(start, disturbance=np.array([0.1, 0.0, -0.2]))
        request = Request(start, goals(rng, problem, distance=1.0))
        a, b = (relaxed(each, request, halfspaces) for each in (direct, stated))
        assert (a is None) == (b is None)
        if a is None:
            continue
        costs = [trajectory_of(problem, *request[:2], each.x).cost for each in (a, b)]
        assert a.bound == pytest.approx(b.bound, rel=1e-5, abs=1e-7)
        if (
            not problem.floor.exists
        ):  # which lengths are at least as large as: more than one optimum
            assert costs[0] == pytest.approx(costs[1], rel=1e-5, abs=1e-7)
            assert a.bound <= costs[0] * (1.0 + 1e-6) + 1e-9
        assert margin(matrix(a.x)).min() >= -1e-6  # as the check allows


def test_it_is_not_for_what_it_does_not_state():
    assert DirectStatement.states(Problem(dimension=3), False)
    for other in ({'dimension': 2}, {'rotation_order': 2}, {'max_rate': 0.1}):
        assert not DirectStatement.states(Problem(**({'dimension': 3} | other)), False)


def test_it_takes_no_cvxpy():
    code = (
        'import sys, numpy as np\n'
        'from orbimpc_ros.mpc.problem import Problem, State\n'
        'from orbimpc_ros.mpc.solve.solver import Solver\n'
        'p = Problem(dimension=3, translation_order=2, tilt=0.3, glide_slope=0.3)\n'
        's = State.at([1.0, 0.0, 5.0], np.diag([-1.0, -1.0, 1.0]))\n'
        "assert Solver(p).solve(s, np.zeros((5, 3))).status == 'optimal'\n"
        "assert 'cvxpy' not in sys.modules\n"
    )
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
