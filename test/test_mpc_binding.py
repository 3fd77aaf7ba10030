# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Active constraints of an optimum and their prices, against optima of the relaxed problem."""

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from problems import ORDERS, floor, goals, state, weights

from orbimpc_ros.mpc.geometry.orbitopes import lmi
from orbimpc_ros.mpc.problem import Box, Problem, State, Weights
from orbimpc_ros.mpc.sensitivity.constraints import explained
from orbimpc_ros.mpc.solve.disjunction import disjunctions_of, shortfall
from orbimpc_ros.mpc.solve.solver import Solver

EPS = 3e-4
# Clarabel's own doubts are far below what is asked of it here.
pytestmark = pytest.mark.filterwarnings('ignore:Solution may be inaccurate')


class Eased:
    """A problem as the paper writes it, in the branch that a plan chose, each constraint eased.

    Stated anew, step by step, to have nothing in common with what it is an oracle for.
    """

    def __init__(self, problem: Problem, start: State, targets, plan) -> None:
        n, last = problem.dimension, problem.horizon
        self.ease: dict = {}
        self._problem, self._rows = problem, []
        self._chords = cp.Parameter(last)
        r = [cp.Variable((n, n)) for _ in range(last + 1)]
        s = [start.position]
        p = [start.velocity]
        for k in range(last):
            pushed = problem.forward * r[k][:, 0]
            s.append(s[k] + problem.step * (pushed if problem.translation_order == 1 else p[k]))
            p.append(p[k] + problem.step * pushed)
        rates = [(r[k + 1] - r[k]) / problem.step for k in range(last)]
        inputs = rates
        if problem.rotation_order == 2:
            inputs = [(rates[k + 1] - rates[k]) / problem.step for k in range(last - 1)]
        w = problem.weights
        cost = sum(w.position * cp.sum_squares(s[k] - targets[k - 1]) for k in range(1, last + 1))
        cost += w.input * sum(cp.sum_squares(u) for u in inputs) if inputs else 0.0
        cost += w.terminal * cp.sum_squares(s[last] - targets[-1])
        if w.length:
            flown = problem.step * problem.forward
            cost += w.length * flown * sum(cp.norm(r[k][:, 0]) for k in range(last))
        self._rows += [r[0] == start.rotation]
        self._first(start, r[1])
        for k in range(1, last + 1):
            self._hull(k, r[k])
        if problem.max_rate:
            for k in range(1, last + 1):
                turned = (r[k] - r[k - 1])[:, 0]
                self._rows.append(cp.norm(turned) <= self._chord(k))
        if problem.terminal == 'constraint':
            for i, axis in enumerate('xyz'[:n]):
                self._rows.append(s[last][i] == targets[-1][i] + self._by(f'terminal {axis}', last))
                if problem.translation_order == 2:
                    self._rows.append(p[last][i] == self._by(f'terminal velocity {axis}', last))
        self._choices(plan, [x[:, 0] for x in r], s)
        self._program = cp.Problem(cp.Minimize(cost), self._rows)

    def _by(self, name, step):
        return self.ease.setdefault((name, step), cp.Parameter(value=0.0))

    def _chord(self, k):
        self._by('max_rate', k)
        return self._chords[k - 1]

    def _first(self, start, first):
        if self._problem.rotation_order == 2:
            fraction = cp.Variable()
            self._rows += [first == fraction * start.coasted]
            self._rows += [fraction >= -self._by('thrust', 1)]

    def _hull(self, k, r):
        by = self._by('hull', k)
        if self._problem.dimension == 2:
            self._rows += [r[0, 0] == r[1, 1], r[0, 1] == -r[1, 0], cp.norm(r[:, 0]) <= 1 + by]
        else:
            rows = [[*row] for row in lmi([r[i, j] for j in range(3) for i in range(3)])]
            self._rows.append(cp.bmat(rows) + by * np.eye(4) >> 0)

    def _choices(self, plan, headings, positions):
        problem = self._problem
        per_box = max(1, problem.horizon - int(problem.no_corner_cutting))
        for i, choice in enumerate(disjunctions_of(problem)):
            values = choice.values(plan.rotations[:, :, 0], plan.positions)
            cell = choice.cells[int(shortfall(choice.cells, values).max(axis=1).argmin())]
            i -= problem.horizon * (problem.floor.shape != 'none')
            name = 'floor' if choice.on == 'heading' else f'obstacle {i // per_box}'
            for k in choice.steps:
                value = (headings if choice.on == 'heading' else positions)[k]
                self._rows.append(cell.normal @ value >= cell.offset - self._by(name, k))

    def optimum(self, name='', step=0, by=0.0) -> float:
        for parameter in self.ease.values():
            parameter.value = 0.0
        omega = np.full(self._problem.horizon, self._problem.max_rate)
        if name == 'max_rate':
            omega[step - 1] += by
        elif name:
            self.ease[name, step].value = by
        self._chords.value = 2.0 * np.sin(0.5 * self._problem.step * omega)
        return self._program.solve(solver=cp.CLARABEL)

    def price(self, name, step) -> float:
        """Return by how much the optimum falls per unit, from both sides."""
        tighter, easier = (self.optimum(name, step, by) for by in (-EPS, EPS))
        return (tighter - easier) / (2.0 * EPS)


def check(problem, start, targets):
    """Every constraint of a problem costs what relaxing it gains, none at all if not reported."""
    plan = Solver(problem, coasting=start.coasted is not None).solve(start, targets)
    told = explained(problem, start, targets, plan)
    relaxed = Eased(problem, start, targets, plan)
    assert relaxed.optimum() == pytest.approx(plan.objective, rel=1e-5, abs=1e-6)
    assert told.unexplained < 1e-3
    prices = {(each.name, each.step): each.price for each in told.binding}
    assert prices.keys() <= relaxed.ease.keys()
    dearest = max([1.0, *prices.values()])
    for name, step in relaxed.ease:
        if name == 'thrust' and problem.weights.length:
            continue  # the length term's kink is in the way
        expected = relaxed.price(name, step)
        if name.startswith('terminal'):
            expected = abs(expected)
        assert prices.get((name, step), 0.0) == pytest.approx(expected, abs=2e-3 * dearest)
    return told


BOX = Box(np.array([1.2, -0.6]), np.array([2.13, 0.5]))
PROBLEMS = {
    'floor': {'floor': floor('polygon')},
    'hexagon': {'floor': floor('polygon', 0.8, 6)},
    'rate': {'max_rate': 0.4},
    'box': {'obstacles': (BOX,)},
    'corners': {
        'obstacles': (BOX,),
        'no_corner_cutting': True,
    },
    'all': {
        'floor': floor('polygon', 0.4),
        'max_rate': 0.9,
        'obstacles': (BOX,),
    },
    'cube': {'dimension': 3, 'floor': floor('polygon', 0.5, 6)},
}


@pytest.mark.parametrize('name', PROBLEMS)
@pytest.mark.parametrize('seed', range(2))
def test_prices_of_limits_are_what_relaxing_them_gains(name, seed):
    rng = np.random.default_rng(seed)
    problem = Problem(horizon=4, weights=Weights(length=0.1 * seed), **PROBLEMS[name])
    start = State.at(np.zeros(problem.dimension), np.eye(problem.dimension))
    target = np.array([3.0, 0.3, 0.4])[: problem.dimension] + 0.3 * rng.normal(
        size=problem.dimension
    )
    check(problem, start, np.tile(target, (4, 1)))


@pytest.mark.parametrize('orders', ORDERS, ids=lambda o: '-'.join(map(str, o.values())))
@pytest.mark.parametrize('terminal', ['penalty', 'constraint'])
def test_prices_of_hull_and_arrival_are_what_relaxing_them_gains(orders, terminal):
    rng = np.random.default_rng(1)
    problem = Problem(horizon=8, terminal=terminal, weights=weights(rng), **orders)
    start = state(rng, problem)
    if terminal == 'constraint':
        start = replace(start, velocity=np.zeros(problem.dimension))
        targets = start.position + 0.5 * np.ones((8, problem.dimension))
    else:
        targets = goals(rng, problem)
    check(problem, start, targets)


def gains(problem, start, targets, name, eps=1e-5):
    """Return the sum of a constraint's prices, and what easing it at all steps at once gains."""
    solve = Solver(problem, gap_tolerance=1e-9).solve
    told = explained(problem, start, targets, solve(start, targets))
    eased = {
        'floor': {'floor': replace(problem.floor, fraction=problem.floor.fraction - eps)},
        'max_rate': {'max_rate': problem.max_rate + eps},
    }[name]
    better = Solver(replace(problem, **eased), gap_tolerance=1e-9).solve(start, targets)
    price = sum(each.price for each in told.binding if each.name == name)
    return price, (solve(start, targets).objective - better.objective) / eps


@pytest.mark.parametrize(
    ('name', 'limits'),
    [
        ('floor', {'floor': floor('circle')}),
        ('floor', {'floor': floor('circle', 1.0)}),  # the hull binds as well, from the other side
        ('floor', {'floor': floor('polygon', 0.8, 6)}),
        ('max_rate', {'max_rate': 0.5}),
    ],
)
def test_prices_of_limits_add_up_over_the_steps(name, limits):
    problem = Problem(horizon=5, **limits)
    start = State.at([0.0, 0.0], np.eye(2))
    price, gained = gains(problem, start, np.tile([-0.2, 0.3], (5, 1)), name)
    assert price > 1.0
    assert price == pytest.approx(gained, rel=1e-2)


@pytest.mark.parametrize('off', [0.0, 1e-12])
def test_nothing_binds_at_rest_on_the_goal(off):
    problem, start = Problem(), State.at([0.0, 0.0], np.zeros((2, 2)))
    targets = np.full((5, 2), off)
    told = explained(problem, start, targets, Solver(problem).solve(start, targets))
    assert told.binding == ()
    assert told.unexplained < 1e-3


def test_a_plan_that_could_be_better_is_not_explained():
    problem, start = Problem(), State.at([0.0, 0.0], np.eye(2))
    near, far = np.tile([0.5, 0.5], (5, 1)), np.tile([-3.0, 1.0], (5, 1))
    plan = Solver(problem).solve(start, near)
    assert explained(problem, start, near, plan).unexplained < 1e-3
    assert explained(problem, start, far, plan).unexplained > 0.1


def test_the_dearest_constraint_comes_first():
    problem, start = Problem(), State.at([0.0, 0.0], np.eye(2))
    targets = np.tile([9.0, 0.0], (5, 1))
    told = explained(problem, start, targets, Solver(problem).solve(start, targets))
    assert [str(each) for each in told.binding] == ['hull@1', 'hull@2', 'hull@3', 'hull@4']
    assert sorted(told.binding, key=lambda each: -each.price) == list(told.binding)
