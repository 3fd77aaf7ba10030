# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Before which time nothing catches: by closed forms, step by step, and what was counted again.

The chases and their earliest ends are those of others (reference/interception.json): a Dubins
vehicle of constant airspeed, with a tightest turn, in a wind; a goal that moves straight on.
"""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from problems import ORDERS, REFERENCE, floor, needs_machine_code, rotation
from problems import state as state_of
from stepping import Stepped, odometry

from orbimpc_ros.loop.intercept import EFFORT, steps_before
from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.model.dynamics import trajectory_of
from orbimpc_ros.mpc.problem import Approach, Floor, Problem
from orbimpc_ros.mpc.problem.reach import missed
from orbimpc_ros.mpc.proof.document import verified
from orbimpc_ros.mpc.proof.reading import parsed
from orbimpc_ros.mpc.proof.refute import catches_refuted

CHASES = json.loads((REFERENCE / 'interception.json').read_text())['cases']
HEADED = [known for known in CHASES if known['prescribed']['time'] < 15.0]
NEAR = 0.1  # radius of a catch, a share of what is flown in a step
RADIUS = 0.4
FREE = Problem(horizon=6)
WING = Problem(horizon=6, max_rate=0.6, floor=Floor('circle', fraction=1.0))


def jumping(rng):
    """Return goals that are now near, now far, shape (6, 2): early ones are not the harder ones."""
    far = rng.uniform(0.0, 1.6, 6) * np.arange(1, 7)
    angles = rng.uniform(-1.5, 1.5, 6)
    return far[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])


def hunted(problem, goals, **given):
    """Return the catch of a first tick from the origin along x at full speed, and its state."""
    tick = Stepped(problem, capture_radius=RADIUS, **given).tick(odometry(), goals)
    return tick.catch, tick.state


def excluded(catch):
    return steps_before(catch.bound, catch.sought.problem.step)


# --- closed forms


def catch(chase, step, horizon, approach=None, *, between=False):
    """The catch of a controller's first tick, at ends of steps or ``between`` them."""
    speed, start = chase['airspeed'], chase['start']
    problem = Problem(
        horizon=horizon, step=step, forward=speed, floor=floor('circle', 1.0),
        max_rate=speed / chase['turn_radius'], discretisation='exact',
    )  # fmt: skip
    known = {'disturbance': np.array(chase['wind']), 'velocity_source': 'air'}
    controller = Stepped(problem, capture_radius=NEAR * step * speed, approach=approach, **known)
    attitude, along = exp(np.array([start['heading']])), np.array([speed, 0.0])
    odometry = Odometry(0.0, np.array(start['position']), attitude, along, np.zeros(1))

    def ahead(times):
        moved = np.outer(times, chase['target']['velocity'])
        return np.array(chase['target']['position']) + moved

    goals = ahead(step * np.arange(1, horizon + 1))
    return controller.tick(odometry, goals, None, ahead if between else None).catch


@needs_machine_code
@pytest.mark.parametrize('chase', CHASES, ids=lambda chase: chase['free']['word'])
def test_the_earliest_catch_is_at_the_first_step_that_ends_after_the_closed_form(chase):
    time = chase['free']['time']
    step = next(step for step in (0.2, 0.4, 0.8) if time < 29.0 * step)
    found = catch(chase, step, 30)
    sooner = 2.0 * NEAR * step  # what a radius may save, should the goal go along
    assert time - sooner <= found.time <= time + 1.5 * step
    assert time - step <= found.bound <= found.time


@needs_machine_code
@pytest.mark.parametrize('chase', HEADED, ids=lambda chase: chase['prescribed']['word'])
def test_a_catch_in_a_cone_is_no_later_than_the_closed_form_of_its_axis(chase):
    step, given = 0.8, chase['prescribed']
    axis = (math.cos(given['heading']), math.sin(given['heading']))
    found = catch(chase, step, 20, Approach(0.2, axis))
    assert chase['free']['time'] - step <= found.bound <= found.time
    assert found.time <= given['time'] + 1.5 * step


@needs_machine_code
@pytest.mark.parametrize('number', range(3))
def test_a_catch_between_ends_of_steps_is_at_the_time_of_the_closed_form(number):
    """Within 2 %, where it is known where the goal is between the ends of steps."""
    short = [chase for chase in CHASES if chase['free']['time'] < 5.5]
    chase = short[number % len(short)]
    time, found = chase['free']['time'], catch(chase, 0.2, 30, between=True)
    assert time - 0.2 <= found.bound <= found.time
    assert found.time == pytest.approx(time, rel=0.02)


# --- each step by itself


@pytest.mark.parametrize('seed', range(15))
def test_without_limits_what_is_excluded_is_what_is_out_of_reach(seed):
    """R_0 decides the first step, and each heading after it moves a vehicle by a step."""
    goals = jumping(np.random.default_rng([seed, 77]))
    catch, _ = hunted(FREE, goals)
    miss = np.linalg.norm(goals - [1.0, 0.0], axis=1) - np.arange(6)
    count = excluded(catch)
    assert np.all(miss[:count] > RADIUS)
    if count < 6:  # the next is not surely out of reach
        assert miss[count] <= np.sqrt(1.0 + EFFORT) * RADIUS + 1e-3


@needs_machine_code
@pytest.mark.parametrize(
    'problem', [FREE, WING, replace(WING, floor=Floor('circle', fraction=0.5))]
)
@pytest.mark.parametrize('seed', range(3))
def test_each_step_that_is_excluded_is_refuted_exactly(problem, seed):
    catch, _ = hunted(problem, jumping(np.random.default_rng([seed, 79])))
    count = excluded(catch)
    if count:
        made = catches_refuted(catch.sought, count)
        verdict = verified(parsed(made.text().encode()))
        assert verdict.holds
        assert verdict.proved == (count + 1) * problem.step


# --- what of it was counted again


@needs_machine_code
@pytest.mark.parametrize('problem', [FREE, WING])
def test_bounds_that_plans_and_distances_prove_are_counted_again(problem):
    catches = [hunted(problem, jumping(np.random.default_rng([s, 80])))[0] for s in range(10)]
    assert all(catch.checked for catch in catches)
    assert sum(map(excluded, catches)) > 5


@needs_machine_code
def test_a_bound_that_rests_on_a_step_that_is_the_methods_word_is_its_word(monkeypatch):
    goals = np.tile([3.9, 0.0], (6, 1))
    behind = np.vstack([goals[:2], [[0.0, 1.0]], goals[3:]])  # where a wing does not turn to
    assert [hunted(FREE, goals)[0].checked, hunted(WING, behind)[0].checked] == [True, True]
    unproved = lambda *_, **__: -np.inf  # noqa: E731
    monkeypatch.setattr('orbimpc_ros.mpc.solve.solver.Verifier.bound', unproved)
    assert hunted(FREE, goals)[0].checked  # by distances alone
    word, _ = hunted(WING, behind)
    assert excluded(word) == 3
    assert not word.checked


@needs_machine_code
def test_what_no_turn_leads_to_is_the_methods_word():
    coned = Approach(0.2, (-1.0, 0.0))
    catch, _ = hunted(WING, np.tile([1.0, 0.0], (6, 1)), approach=coned)
    assert excluded(catch) > 1
    assert not catch.checked


# --- what headings do not lead to


MOTIONS = [{**orders, 'discretisation': how} for orders in ORDERS for how in ('euler', 'exact')]


@pytest.mark.parametrize('given', MOTIONS)
def test_straight_flights_end_at_the_rim_of_what_headings_lead_to(given):
    rng = np.random.default_rng([*map(ord, str(given))])
    problem = Problem(horizon=5, step=0.6, forward=1.7, **given)
    n, radius = problem.dimension, 0.3
    start = replace(state_of(rng, problem), disturbance=0.2 * rng.normal(size=n))
    way = rotation(rng, n)
    ahead = trajectory_of(problem, start, np.zeros((5, n)), coordinates(np.tile(way, (5, 1, 1))))
    back = trajectory_of(problem, start, np.zeros((5, n)), coordinates(np.tile(-way, (5, 1, 1))))
    middle = 0.5 * (ahead.positions + back.positions)[1:]
    rim = ahead.positions[1:] - middle
    away = np.linalg.norm(rim, axis=1, keepdims=True)
    outward = np.divide(rim, away, out=np.tile(way[:, 0], (5, 1)), where=away > 0.0)
    for beyond, outside in ((-1e-9, False), (1e-9, True)):
        goals = middle + (away + radius + beyond) * outward
        assert missed(problem, start, goals, radius).tolist() == 5 * [outside]
