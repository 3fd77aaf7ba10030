# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Bench rows of real vehicles: met in flight, and the same problem for everybody."""

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.bench import contest as parts
from benchmarks.bench.contenders.contender import Declined, Solution
from benchmarks.bench.contenders.planar import slope_of
from benchmarks.bench.contest import CVXPY, GUROBI, IPOPT, SCIP
from benchmarks.bench.contests import CONTESTS
from benchmarks.bench.duel import OURS, Samples, duel
from benchmarks.bench.rows import of_duel
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.problem import Floor, Problem

PATIENCE = 600.0  # [s]: on a busy machine too
searched = pytest.mark.skipif(
    not COMPILED, reason='minutes, or without a proof, in plain Python: pip install numba'
)


def contest(key, horizon=None):
    """A contest, with fewer steps to plan than it has where others take minutes for all."""
    found = next(each for each in CONTESTS if each.key == key)
    return replace(found, problem=replace(found.problem, horizon=horizon)) if horizon else found


def solved(each, name, indices):
    """The answers of a contender to some instances; skips where it is not installed."""
    if name in parts.PACKAGES:
        pytest.importorskip(parts.PACKAGES[name])
    contender, answers = each.contender(name, PATIENCE), []
    instances = each.instances(each.problem, max(indices) + 1)
    for index in indices:
        contender.solve(*instances[index])
        answers.append(contender.solution())
    return answers


@searched
@pytest.mark.parametrize('name', [GUROBI, SCIP])
@pytest.mark.parametrize('key', ['wing', 'wing-octagon', 'wing-circle'])
def test_whoever_proves_something_of_a_wing_proves_it_of_the_same_problem(key, name):
    """In wind, at a turn that the attitude begins, above the floor: early and late in a flight."""
    each, indices = contest(key, 4), [0, 9, 19]
    pairs = zip(solved(each, name, indices), solved(each, OURS, indices), strict=True)
    for theirs, ours in pairs:
        assert theirs.objective == pytest.approx(ours.objective, rel=2 * each.gap)
        assert not theirs.gap > each.gap


@searched
@pytest.mark.parametrize('key', ['wing', 'wing-circle'])
def test_a_local_solver_finds_no_better_wing(key):
    each, indices = contest(key, 6), range(0, 20, 4)
    pairs = [
        (theirs.objective, ours.objective)
        for theirs, ours in zip(
            solved(each, IPOPT, indices), solved(each, OURS, indices), strict=True
        )
    ]
    assert all(theirs > ours * (1.0 - each.gap) for theirs, ours in pairs if not math.isnan(theirs))
    assert any(theirs == pytest.approx(ours, rel=each.gap) for theirs, ours in pairs)


@searched
@pytest.mark.parametrize(('key', 'horizon'), [('multirotor', 12), ('lander', 30)])
def test_the_relaxation_under_gravity_is_a_bound_that_some_plans_attain(key, horizon):
    each, indices = contest(key, horizon), [0, 3]
    pairs = list(zip(solved(each, CVXPY, indices), solved(each, OURS, indices), strict=True))
    assert all(theirs.relaxed for theirs, _ in pairs)
    assert all(theirs.objective < ours.objective * (1.0 + 1e-5) for theirs, ours in pairs)
    assert any(
        theirs.objective == pytest.approx(ours.objective, rel=1e-4) for theirs, ours in pairs
    )


def test_wings_meet_winds_and_goals_that_move():
    each = contest('wing', 4)
    instances = each.instances(each.problem, 80)
    assert len(instances) == 80
    winds = {tuple(state.disturbance) for state, _ in instances}
    assert len(winds) == 2  # of two flights
    assert all(np.linalg.norm(goals[-1] - goals[0]) > 0.0 for _, goals in instances)
    flown = np.diff([state.position for state, _ in instances[:40]], axis=0)
    over_ground = np.linalg.norm(flown, axis=1) / each.problem.step
    assert over_ground.max() < each.problem.forward + 5.0
    assert np.linalg.norm(instances[39].state.position - instances[39].goals[0]) < 40.0


def test_turns_of_a_quarter_and_more_are_declined():
    """Beyond them the two limits of a turn no longer say that it is so short."""
    floor = Floor('circle', fraction=0.5)
    assert slope_of(Problem(floor=floor, max_rate=1.0)) == pytest.approx(np.tan(1.0))
    with pytest.raises(Declined, match='a quarter'):
        slope_of(Problem(floor=floor, max_rate=1.6))


class Fake:
    """A contender that counts what it meets and finds what it is told to."""

    def __init__(self, objective, *, relaxed=False):
        self.met, self._solution = 0, Solution(objective, relaxed=relaxed)

    def solve(self, state, goals):
        self.met += 1

    def solution(self):
        return self._solution


def test_rivals_meet_some_instances_and_are_compared_on_those():
    sides = {OURS: Fake(1.0), 'rival': Fake(1.0)}
    samples = duel(
        sides, [(None, None)] * 7, warm_up=0, budget=60.0, show=lambda done: None, every=3
    )
    assert (sides[OURS].met, sides['rival'].met) == (7, 3)
    ours, theirs = of_duel('p', samples, {})
    assert (ours.n, theirs.n) == (7, 3)


def test_a_bound_below_our_plan_beats_nobody_and_a_gap_is_no_difference():
    def row(solution, gap):
        sides = {OURS: Solution(1.0), 'other': solution}
        samples = {name: Samples({0: 1.0}, {0: each}) for name, each in sides.items()}
        return of_duel('p', samples, {}, gap)[1]

    assert row(Solution(0.99), 1e-3).beaten
    assert not row(Solution(0.9995), 1e-3).beaten
    assert row(Solution(0.9995), 1e-4).beaten
    bound = row(Solution(0.5, relaxed=True), 1e-3)
    assert not bound.beaten
    assert bound.note == 'relaxed: a bound, lower on 1'
