# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""An infeasible problem names the constraint that makes it so."""

from dataclasses import replace

import numpy as np
import pytest
from problems import floor, reference

from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.problem import Box, MovingObstacle, Problem, State
from orbimpc_ros.mpc.solve.solver import Solver

START = State.at([0.0, 0.0], np.eye(2))


def blamed(problem, start, goals):
    with pytest.raises(Infeasible) as caught:
        Solver(problem).solve(start, goals)
    return str(caught.value)


@pytest.mark.parametrize('name', ['dubins_hull', 'dubins_circle', 'spacecraft_fuel0.0'])
def test_a_goal_beyond_reach(name):
    problem, start, goals = reference(name)
    assert 'beyond what 20 steps can reach' in blamed(problem, start, 20.0 * goals)


@pytest.mark.parametrize('order', [1, 2])
def test_a_box_that_the_state_already_leads_into(order):
    ahead = Box([0.5, -1.0], [4.0, 1.0])
    problem = Problem(translation_order=order, obstacles=(Box([9.0, 9.0], [10.0, 10.0]), ahead))
    start = State.at([0.0, 0.0], np.eye(2), velocity=[1.0, 0.0])
    message = blamed(problem, start, np.zeros((5, 2)))
    assert 'obstacle 1 holds s_1' in message


@pytest.mark.parametrize('order', [1, 2])
def test_a_box_around_the_vehicle_is_left_only_where_it_is_a_hazard(order):
    around = Box([-0.7, -9.0], [9.0, 9.0])
    free = Problem(translation_order=order, horizon=8)
    walled = replace(free, obstacles=(around,))
    start, goals = State.at([0.9, 0.0], np.eye(2)), np.zeros((8, 2))
    message = blamed(walled, start, goals)
    assert message.startswith('obstacle 0 holds s_1, ')
    assert message.endswith('; a box has no way out for who begins inside, unless it is a hazard')
    hazard = MovingObstacle.drifting(around, np.zeros(2))
    plan = Solver(free).solve(replace(start, hazards=(hazard,)), goals)
    assert plan.positions[-1, 0] <= -0.7 + 1e-6


def test_constraints_that_only_together_leave_no_way():
    """Constant speed for five steps cannot end where it starts when it may hardly turn."""
    problem = Problem(terminal='constraint', floor=floor('circle', 0.95), max_rate=0.1, horizon=5)
    message = blamed(problem, START, np.tile([2.0, 0.0], (5, 1)))
    assert 'terminal: constraint' in message
    assert 'circle floor of 0.95' in message
    assert 'max_rate 0.1' in message
