# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Lags: where they leave a vehicle, what it is sent, and how well it arrives in spite of them."""

from dataclasses import replace

import numpy as np
import pytest
from continuous import Craft, Motion, at_rest, flown
from scenarios import spacecraft_problem
from stepping import Stepped, measured

from orbimpc_ros.loop.compensation import CommandHistory, Compensator, Response
from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.plan import Command
from orbimpc_ros.mpc.problem import Floor, Problem

LONG = 6.0  # [s] twenty time constants: by then lags are over
LAGS = [(0.3, 0.3), (0.2, 0.3), (0.3, 0.1), (0.0, 0.2), (0.3, 0.0)]


@pytest.mark.parametrize('dimension', [2, 3])
def test_in_the_end_a_lagging_vehicle_is_where_a_settled_one_went_a_lag_later(dimension):
    """About one axis, and at a steady rate, exactly: attitude and position."""
    rng = np.random.default_rng(1)
    lag, rates = 0.3, 1 if dimension == 2 else 3
    plant = Craft(2.0, speed_lag=lag, rate_lag=lag)
    rate = rng.normal(size=rates)
    start = at_rest(dimension, 0.4, 0.7, plant)
    start = replace(start, rate=0.5 * rate)
    problem = Problem(dimension, forward=2.0, discretisation='exact')
    settled = Compensator(problem, Response(lag, lag)).start(measured(0.0, start)).odometry
    assert settled.time == lag
    end = flown(plant, start, 0.7, rate, LONG)
    ideal = replace(start, position=settled.position, attitude=settled.attitude)
    there = flown(Craft(2.0), ideal, 0.7, rate, LONG - lag)
    np.testing.assert_allclose(end.attitude, there.attitude, atol=1e-4)
    steady = flown(plant, replace(start, rate=rate), 0.7, rate, lag)
    seen = measured(0.0, replace(start, rate=rate))
    settled = Compensator(problem, Response(lag, lag)).start(seen).odometry
    np.testing.assert_allclose(settled.position, steady.position, atol=1e-4)


@pytest.mark.parametrize('lags', LAGS)
def test_in_the_end_a_lagging_thrust_has_done_what_a_settled_one_does(lags):
    """Position and velocity, whatever the thrust was before; gravity acts all the while."""
    plant = Craft(3.0, True, *lags, blown=np.array([0.2, -0.4]))
    start = Motion(np.array([1.0, 2.0]), np.array([0.5, -0.3]), np.eye(2), np.zeros(1), 0.9)
    problem = Problem(translation_order=2, forward=3.0, discretisation='exact')
    compensator = Compensator(problem, Response(*lags), plant.blown)
    for share, at in ((0.9, -LONG), (0.3, 0.0)):
        compensator.history.add(Command(share, np.zeros(1), np.eye(2)), at)
    settled = compensator.start(measured(0.0, start)).odometry
    end = flown(plant, start, 0.3, np.zeros(1), LONG)
    ideal = Motion(
        settled.position, settled.attitude @ settled.body_velocity, np.eye(2), np.zeros(1), 0.3
    )
    there = flown(Craft(3.0, True, blown=plant.blown), ideal, 0.3, np.zeros(1), LONG - lags[1])
    np.testing.assert_allclose(end.velocity, there.velocity, atol=5e-3)
    np.testing.assert_allclose(end.position, there.position, atol=2e-2)


def test_half_a_step_of_a_lag_is_in_the_euler_model():
    step = 0.4
    for lag, exact, euler in ((0.1, 0.1, 0.0), (0.3, 0.3, 0.1)):
        response = Response(0.0, lag)
        assert response.lead(Problem(step=step, discretisation='exact')) == exact
        assert response.lead(Problem(step=step)) == pytest.approx(euler)


def test_no_lag_changes_nothing():
    odometry = measured(1.0, at_rest(2))
    assert Compensator(Problem()).start(odometry).odometry is odometry


@pytest.mark.parametrize('name', ['speed', 'rate'])
@pytest.mark.parametrize('value', [-0.1, np.inf, np.nan])
def test_a_lag_that_cannot_be_is_refused(name, value):
    with pytest.raises(BadInput, match=f'response.{name}'):
        Response(**{name: value})


def test_the_applied_thrust_follows_what_was_commanded():
    history, lag = CommandHistory(), 0.3
    sent = [(0.0, 0.2), (0.5, 1.0), (0.9, 0.4)]
    for at, fraction in sent:
        history.add(Command(fraction, np.zeros(1), np.eye(2)), at)
    plant, motion = Craft(1.0, True, speed_lag=lag), at_rest(2)
    shares = []
    for (_, fraction), time in zip(sent, (0.5, 0.4, 0.3), strict=True):
        before = motion.velocity[0]
        motion = flown(plant, motion, fraction, np.zeros(1), time)
        shares.append((motion.velocity[0] - before) / time)
    assert history.applied(1.2, lag) == pytest.approx(motion.fraction, abs=1e-9)
    assert history.mean(0.5, 0.9, lag) == pytest.approx(shares[1], abs=1e-6)
    assert history.mean(0.0, 1.2, lag) == pytest.approx(motion.velocity[0] / 1.2, abs=1e-6)
    assert history.mean(-0.5, 1.2, lag) is None


def arrived(problem, plant, motion, goal, response):
    """Fly to an arrival; return the miss [m], the speed left [m/s] and the ticks."""
    controller = Stepped(problem, shrinking=True, response=response)
    ticks, time = [], 0.0
    for _ in range(problem.horizon):
        odometry = measured(time, motion)
        ends = controller.ends(odometry.time + controller.lead)
        ticks.append(controller.tick(odometry, np.tile(goal, (len(ends), 1))))
        command = ticks[-1].command
        controller.sent(command, time)
        motion = flown(plant, motion, command.speed_fraction, command.body_rate, problem.step)
        time += problem.step
    return np.linalg.norm(motion.position - goal), np.linalg.norm(motion.velocity), ticks


@pytest.mark.parametrize(('seed', 'gain'), [(0, 0.97), (1, 1.03)])
def test_a_lagging_spacecraft_arrives_at_rest(seed, gain):
    """The paper's spacecraft in continuous time: thrust lag 0.2 s, rate lag 0.3 s, thrust off."""
    rng = np.random.default_rng(seed)
    problem = replace(spacecraft_problem(), rotation_order=1, discretisation='exact')
    plant = Craft(1.0, True, 0.2, 0.3, gain)
    motion = replace(at_rest(3), attitude=exp(np.array([0.0, 0.0, np.pi])))
    goal = np.array([5.0, 10.0, 25.0]) + rng.uniform(-2.0, 2.0, 3)
    miss, speed, ticks = arrived(problem, plant, motion, goal, Response(0.2, 0.3))
    assert miss < 0.05
    assert speed < 0.05
    assert 'safe command' not in {tick.fallback for tick in ticks}


@pytest.mark.parametrize('rotation_order', [1, 2])
def test_a_vehicle_that_obeys_at_once_is_sent_what_is_due_now(rotation_order):
    """At second order a plan's command is for the next step: it goes out when that begins."""
    problem = Problem(
        rotation_order=rotation_order, translation_order=2, horizon=8, floor=Floor('circle', 4, 0.3)
    )
    prompt, plain = (Stepped(problem, response=Response(lag, lag)) for lag in (1e-9, 0.0))
    position, sent, planned = np.zeros(2), [], []
    for k in range(4):
        odometry = Odometry(float(k), position, np.eye(2), np.array([0.3 * k, 0.0]), np.zeros(1))
        goals = np.tile([6.0, 1.0], (8, 1))
        sent.append(prompt.tick(odometry, goals).command)
        planned.append(prompt._compensator.due)
        plain.tick(odometry, goals)
    for now, before in zip(sent[1:], planned[:-1], strict=True):
        assert now.speed_fraction == before.speed_fraction
        if rotation_order == 2:
            np.testing.assert_array_equal(now.body_rate, before.body_rate)
    assert sent[0].speed_fraction == pytest.approx(0.3)
