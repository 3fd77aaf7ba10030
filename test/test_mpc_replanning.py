# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Planning more often than every step: what is left of a plan, of a horizon, and of a job."""

import numpy as np
import pytest
from continuous import Craft, at_rest, flown
from problems import floor
from stepping import Stepped, measured

from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.errors import SolverFailure
from orbimpc_ros.mpc.plan import shifted
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.solve.solver import Solver


def test_a_plan_shifted_by_a_share_of_a_step_keeps_the_floor_and_where_it_leads():
    """Between two headings at the floor a chord would lead below it."""
    problem = Problem(horizon=6, step=0.5, floor=floor('circle', 0.9), discretisation='exact')
    state, goals = State.at([0.0, 0.0], np.eye(2)), np.tile([-1.5, 0.5], (6, 1))
    plan = Solver(problem).solve(state, goals)
    for share in (0.25, 0.5, 0.9):
        moved = shifted(
            problem, state, goals, plan, share + np.arange(1.0, 7.0), projection='nearest'
        )
        assert violations(problem, state, goals, moved) == []
        assert moved.speed_fraction[1:].min() >= 0.9 - 1e-9
    kept = shifted(problem, state, goals, plan, np.arange(1.0, 7.0), projection='nearest')
    np.testing.assert_allclose(kept.positions, plan.positions, atol=1e-9)


@pytest.mark.parametrize('period', [0.1, 0.25, 0.3, 1.0])
def test_a_shrinking_horizon_ends_when_it_ended_before(period):
    """Its steps are never longer than a step, and become fewer."""
    controller = Stepped(Problem(horizon=4, step=1.0), shrinking=True)
    motion, time, counts = at_rest(2), 7.0, []
    while time < 10.95:
        ends = controller.ends(time)
        assert ends[-1] == pytest.approx(11.0)
        assert np.diff([time, *ends]).max() <= 1.0 + 1e-9
        counts.append(len(ends))
        controller.tick(measured(time, motion), np.tile([3.0, 1.0], (len(ends), 1)))
        time += period
    assert counts[0] == 4
    assert counts[-1] == 1
    assert sorted(counts, reverse=True) == counts


def test_a_plan_of_long_steps_stands_in_for_two_ticks_however_short_they_are(monkeypatch):
    controller, plant = Stepped(Problem(horizon=5)), Craft()
    motion, goals = at_rest(2, 0.0, 1.0, plant), np.tile([4.0, 1.0], (5, 1))
    first = controller.tick(measured(0.0, motion), goals)
    assert first.fallback == ''

    def fails(*_):
        raise SolverFailure('a test wants it')

    monkeypatch.setattr(Solver, 'solve', fails)
    fallbacks, last = [], first.command
    for k in (1, 2, 3):
        motion = flown(plant, motion, last.speed_fraction, last.body_rate, 0.1)
        tick = controller.tick(measured(0.1 * k, motion), goals)
        fallbacks.append(tick.fallback)
        last = tick.command
        if k < 3:  # a tenth of a step later the plan still says nearly the same
            np.testing.assert_allclose(tick.plan.rotations[-1], first.plan.rotations[-1])
            assert tick.command.speed_fraction == pytest.approx(1.0, abs=0.02)
    assert fallbacks == ['shifted plan', 'shifted plan', 'safe command']
