# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Proofs by Clarabel's answers, judged by points that are feasible, whatever the solver says."""

from types import SimpleNamespace

import numpy as np
import pytest
from problems import ORDERS, floor, goals, rotation, state, weights

from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.model.trajectory import trajectory_of
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.solve import program as programs
from orbimpc_ros.mpc.solve.conic import SOLVED, run
from orbimpc_ros.mpc.solve.disjunction import Slot
from orbimpc_ros.mpc.solve.program import Program
from orbimpc_ros.mpc.solve.request import Request

PANIC = type('PanicException', (BaseException,), {})


def bound(problem, rng):
    """A program with a request at random, bound to it."""
    program = Program(problem, coasting=True)
    at = Request(state(rng, problem), goals(rng, problem))
    program._bind(at)
    return program, at


def answer(program):
    """What Clarabel says of a bound program, and the numbers that it says it of."""
    a, b = program._a, program._b
    program._solver.update(q=program._q, A=a, b=b)
    return run(program._solver, None), a, b


def feasible(rng, problem, start):
    """A random trajectory of rotations: of the hull, and of the coasting body's first step."""
    turns = [0.9 * rotation(rng, problem.dimension) for _ in range(problem.horizon)]
    if problem.rotation_order == 2:
        turns[0] = rng.uniform() * start.coasted
    return coordinates(np.array(turns))


@pytest.mark.parametrize('orders', ORDERS)
def test_any_multipliers_prove_a_bound_that_holds(orders):
    rng = np.random.default_rng(2)
    problem = Problem(**orders, horizon=6, weights=weights(rng))
    program, at = bound(problem, rng)
    start, targets = at.state, at.goals
    told, a, b = answer(program)
    costs = [
        trajectory_of(problem, start, targets, feasible(rng, problem, start)).cost
        for _ in range(20)
    ]
    best = program.relax(at)
    assert best.bound <= min(costs)
    z, x = np.asarray(told.z), np.asarray(told.x)
    for noise in (0.0, 1e-6, 1e-2, 1.0, 100.0):
        said = SimpleNamespace(
            x=x + noise * rng.normal(size=x.shape), z=z + noise * rng.normal(size=z.shape)
        )
        proved = program._certifier.lower_bound(
            said, a, b, program._q, program._scale, program._largest
        )
        lower = program._scale * proved + program._constant
        assert lower <= best.bound + 1e-6 * (1.0 + abs(best.bound))
        assert lower <= min(costs)
    assert lower < best.bound  # of noise alone next to nothing follows


def test_multipliers_that_are_no_numbers_prove_nothing():
    program, _ = bound(Problem(), np.random.default_rng(3))
    told, a, b = answer(program)
    for name in 'xz':
        broken = SimpleNamespace(x=np.asarray(told.x), z=np.asarray(told.z))
        setattr(broken, name, np.full_like(getattr(broken, name), np.nan))
        proved = program._certifier.lower_bound(broken, a, b, program._q, 1.0, program._largest)
        assert proved == -np.inf
    assert not program._certifier.refutes(broken, a, b, program._largest)


def test_infeasible_is_what_multipliers_prove_so():
    """An arrival out of reach is refuted; the same words about a problem with plans are not."""
    rng = np.random.default_rng(4)
    problem = Problem(terminal='constraint', horizon=4)
    program, at = bound(problem, rng)
    start = at.state
    far = np.tile(start.position + np.array([9.0, 0.0]), (4, 1))
    at = Request(start, far)
    with pytest.raises(Infeasible):
        program.relax(at)
    near = np.tile(start.position + start.rotation[:, 0] * 3.0, (4, 1))
    program._bind(Request(start, near))
    told, a, b = answer(program)
    assert str(told.status) in SOLVED
    lie = SimpleNamespace(status='PrimalInfeasible', x=told.x, z=told.z)
    assert program._relaxation(lie, a, b, program._q, 1.0).x is None


def test_a_solver_that_panics_has_failed_and_is_made_anew(monkeypatch):
    program, at = bound(Problem(), np.random.default_rng(5))
    expected = program.relax(at)

    def panic(*_):
        raise PANIC('Eigval error')

    broken = SimpleNamespace(
        **{name: lambda *_, **__: None for name in ('update', 'unset_termination_callback')},
        solve=panic,
    )
    program._solver = broken
    assert program.relax(at).bound == pytest.approx(expected.bound)  # solved anew at once
    assert program._solver is not broken
    monkeypatch.setattr(programs, 'run', lambda *_: None)
    assert program.relax(at).x is None


def test_what_is_no_panic_is_not_caught():
    def interrupted():
        raise KeyboardInterrupt

    solver = SimpleNamespace(unset_termination_callback=lambda: None, solve=interrupted)
    with pytest.raises(KeyboardInterrupt):
        run(solver, None)


def test_a_program_out_of_time_has_no_trajectory_but_a_bound_that_holds():
    rng = np.random.default_rng(6)
    problem = Problem(3, horizon=12, floor=floor('polygon', 0.5, 6))
    program = Program(problem, [Slot('heading', k) for k in range(1, 13)])
    start, targets = state(rng, problem), goals(rng, problem)
    at = Request(start, targets)
    whole = program.relax(at)
    bounds = []
    for most in (0, 3, 6):
        asked = iter(range(most))
        stopped = program.relax(
            at._replace(out_of_time=lambda asked=asked: next(asked, None) is None)
        )
        assert stopped.x is None
        assert stopped.bound <= whole.bound + 1e-6
        bounds.append(stopped.bound)
    assert bounds == sorted(bounds)
    assert program.relax(at._replace(out_of_time=lambda: False)).bound == pytest.approx(whole.bound)
