# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Refusals and their words: the value, what is allowed, who is to blame."""

import numpy as np
import pytest

from orbimpc_ros.loop.goal.forecast import forecast_named
from orbimpc_ros.loop.goal.motion import GoalTrajectory
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.problem import (
    Box,
    Floor,
    Problem,
    State,
    Weights,
)
from orbimpc_ros.mpc.solve.solver import Solver


@pytest.mark.parametrize(
    ('make', 'culprit'),
    [
        (lambda: Problem(dimension=4), 'dimension'),
        (lambda: Problem(dimension=True), 'dimension'),
        (lambda: Problem(rotation_order=3), 'rotation_order'),
        (lambda: Problem(translation_order=0), 'translation_order'),
        (lambda: Problem(horizon=0), 'horizon'),
        (lambda: Problem(horizon=2.0), 'horizon'),
        (lambda: Problem(step=0.0), 'step'),
        (lambda: Problem(step=1e-300), 'step'),
        (lambda: Problem(forward=1e-300), 'forward'),
        (lambda: Problem(step=np.nan), 'step'),
        (lambda: Problem(forward=-1.0), 'forward'),
        (lambda: Problem(forward='fast'), 'forward'),
        (lambda: Problem(step=10**400), 'step'),
        (lambda: Box([0.0, 0.0], [1.0, 10**400]), 'obstacles.max'),
        (lambda: Problem(terminal='maybe'), 'terminal'),
        (lambda: Problem(weights={'position': 1.0}), 'weights'),
        (lambda: Problem(floor='circle'), 'floor'),
        (lambda: Problem(obstacles=[Box([0, 0], [1, 1])]), 'obstacles'),
        (lambda: Problem(obstacles=(([0, 0], [1, 1]),)), 'obstacles'),
        (lambda: Problem(max_rate=4.0), 'max_rate'),
        (lambda: Problem(max_rate=-0.1), 'max_rate'),
        (lambda: Problem(obstacles=(Box([0, 0, 0], [1, 1, 1]),)), 'obstacles.min'),
        (lambda: Problem(obstacles=(Box([0, 0], [1, 1]),) * 65), 'obstacles'),
        (lambda: Problem(floor=Floor('polygon', 4, 0.8)), 'floor.fraction'),
        (lambda: Problem(dimension=3, floor=Floor('polygon', 6, 0.6)), 'floor.fraction'),
        (lambda: Problem(dimension=3, floor=Floor('polygon', 4, 0.5)), 'floor.faces'),
        (lambda: Floor('square'), 'floor.shape'),
        (lambda: Floor('polygon', 2, 0.4), 'floor.faces'),
        (lambda: Floor('circle', 4, 1.1), 'floor.fraction'),
        (lambda: Floor('circle', 4, 0.0), 'floor.fraction'),
        (lambda: Weights(input=-1.0), 'weights.input'),
        (lambda: Weights(position=np.inf), 'weights.position'),
        (lambda: Box([0.0, 0.0], [1.0, 0.0]), 'obstacles.max'),
        (lambda: Box([0.0, np.nan], [1.0, 1.0]), 'obstacles.min'),
        (lambda: State.at([0.0], np.eye(2)), 'state.position'),
        (lambda: State.at([0.0, np.nan], np.eye(2)), 'state.position'),
        (lambda: State.at([0.0, 0.0], np.eye(3)), 'state.rotation'),
        (lambda: State.at([0.0, 0.0], 1.1 * np.eye(2)), 'state.rotation'),
        (lambda: State.at([0.0, 0.0], np.ones((2, 2))), 'state.rotation'),
        (lambda: State.at([0.0] * 3, np.diag([1.0, 1.0, -1.0])), 'state.rotation'),
        (lambda: State.at([0.0] * 2, np.eye(2), velocity=[1.0]), 'state.velocity'),
        (lambda: State.at([0.0] * 2, np.eye(2), attitude=2 * np.eye(2)), 'state.attitude'),
        (lambda: State.at([0.0] * 2, np.eye(2), coasted=np.zeros((2, 2))), 'state.coasted'),
        (lambda: forecast_named('guess'), 'goal_prediction'),
        (lambda: GoalTrajectory(np.array([1.0, 1.0]), np.zeros((2, 2))), 'goal_path stamps'),
        (lambda: Solver(Problem()).solve(STILL, np.zeros((4, 2))), 'goals'),
    ],
)
def test_refused_with_the_culprit_named_in_one_line(make, culprit):
    with pytest.raises(BadInput) as caught:
        make()
    assert caught.value.culprit == culprit
    assert 'allowed: ' in str(caught.value)
    assert '\n' not in str(caught.value)


STILL = State.at([0.0, 0.0], np.eye(2))


def test_a_huge_value_is_cut_short_in_the_message():
    with pytest.raises(BadInput) as caught:
        forecast_named('x' * 10_000)
    assert len(str(caught.value)) < 200


def test_states_start_at_rest_and_know_their_attitude():
    state = State.at([1.0, 2.0, 3.0], 0.5 * np.eye(3))
    assert state.dimension == 3
    assert np.all(state.velocity == 0.0)
    assert np.all(state.rotation_rate == 0.0)
    assert np.allclose(state.attitude, np.eye(3))
    with pytest.raises(ValueError, match='read-only'):
        state.position[0] = 0.0


def test_parts_of_another_type_are_named_with_the_type_that_is_wanted():
    with pytest.raises(BadInput, match=r'^weights is a dict; allowed: a Weights$'):
        Problem(weights={'position': 1.0})


def same(x=0.0):
    """Return a new state, box and problem; equal ones for equal numbers."""
    box = Box([x, 1.0], [2.0, 3.0])
    state = State.at([x, 1.0], np.eye(2), coasted=np.eye(2))
    return state, box, Problem(obstacles=(box,))


def test_values_are_equal_by_content_and_serve_as_keys():
    for value, twin, other in zip(same(), same(-0.0), same(0.5), strict=True):
        assert value == twin
        assert hash(value) == hash(twin)
        assert value != other
        assert value != 'value'
        assert {value: 1}[twin] == 1
    assert State.at([0.0, 1.0], np.eye(2)) != same()[0]  # without what it coasts to
