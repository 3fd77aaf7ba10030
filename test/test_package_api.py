# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The declared interface of the library: complete, documented, and with value semantics."""

import dataclasses
import inspect
import pickle
import re
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import orbimpc_ros
from orbimpc_ros import Box, Floor, Odometry, Planner, Problem, Snapshot, Solver, State, Weights

PAGE = (Path(__file__).parents[1] / 'docs' / 'library.md').read_text()
CLASSES = [n for n in orbimpc_ros.__all__ if not n.startswith('_')]


@pytest.mark.parametrize('name', CLASSES)
def test_every_name_is_documented_where_it_stands_and_on_the_page(name):
    assert inspect.getdoc(getattr(orbimpc_ros, name))
    assert name in dir(orbimpc_ros)
    assert f'`{name}' in PAGE


@pytest.mark.parametrize('name', ['Solver', 'Planner', 'Snapshot'])
def test_signatures_are_those_of_the_page(name):
    """Names and defaults of arguments are public: changing them takes a deprecation."""
    signature = inspect.signature(getattr(orbimpc_ros, name))
    words = [
        p.name if p.default is p.empty else f'{p.name}={p.default!r}'
        for p in signature.parameters.values()
    ]
    (stated,) = re.findall(rf'^    {name}\((.*)\)$', PAGE, re.MULTILINE)
    stated = stated.replace('*, ', '').replace('1e-4', '0.0001')
    assert stated == ', '.join(words)


def measured():
    still = np.zeros(2)
    return Odometry(1.0, still.copy(), np.eye(2), np.array([1.0, 0.0]), np.zeros(1))


def values():
    problem = Problem(floor=Floor('circle', fraction=0.5), obstacles=(Box([3, 3], [4, 4]),))
    state = State.at([0.0, 0.0], np.eye(2))
    plan = Solver(Problem()).solve(state, np.ones((5, 2)))
    decision = Planner(Problem()).step(Snapshot(measured(), np.ones((5, 2))))
    decision = dataclasses.replace(decision, refutation={'goals': [[1.0]]})
    return [problem, Weights(), state, plan, plan.proof, measured(), decision, decision.command]


def test_values_compare_hash_and_pickle_by_content():
    for one, twin in zip(values(), values(), strict=True):
        assert one is not twin
        assert one == twin
        assert hash(one) == hash(twin)
        assert pickle.loads(pickle.dumps(one)) == one
        assert one != 'something else'
    one = pickle.dumps(orbimpc_ros.BadInput('goals', [1.0], '2 numbers'))
    assert 'goals is [1.0]' in str(pickle.loads(one))  # as from a process of a pool


def test_threads_may_share_a_solver():
    problem = Problem(horizon=8, obstacles=(Box([1, -1], [2, 1]), Box([3, 0], [4, 3])))
    solver, state = Solver(problem), State.at([0.0, 0.0], np.eye(2))
    goals = np.random.default_rng(5).normal(scale=4.0, size=(48, 1, 2)) + np.zeros((8, 2))
    with ThreadPoolExecutor(8) as pool:
        plans = list(pool.map(partial(solver.solve, state), goals))
    alone = [solver.solve(state, each).objective for each in goals]
    assert [plan.objective for plan in plans] == pytest.approx(alone)


def test_values_of_other_content_differ_and_cannot_be_changed():
    for one in values():
        field = dataclasses.fields(one)[0].name
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(one, field, None)
        for array in (v for v in vars(one).values() if isinstance(v, np.ndarray) and v.size):
            assert not array.flags.writeable
    moved = dataclasses.replace(measured(), position=np.array([1e-9, 0.0]))
    assert moved != measured()
    state, zero = State.at([0.0, 0.0], np.eye(2)), State.at([-0.0, 0.0], np.eye(2))
    assert {state: 1}[zero] == 1  # equal numbers, with different signs
    assert dataclasses.replace(state, coasted=np.eye(2)) != state
