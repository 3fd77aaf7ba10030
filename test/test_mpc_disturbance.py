# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The estimated disturbance: what it learns, what it does not, and that loops lose their offset."""

import math
from dataclasses import replace

import numpy as np
import pytest
from continuous import Craft, at_rest, flown
from stepping import measured

from orbimpc_ros.loop.compensation import (
    GAP,
    LARGEST,
    PATIENCE,
    PUSHED,
    CommandHistory,
    Estimator,
    NoiseModel,
)
from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.mpc.plan import Command
from orbimpc_ros.mpc.problem import Floor, Problem

STEP = 0.1  # [s]


class Watched:
    """A vehicle that flies random commands, and an estimator that watches it."""

    def __init__(self, plant, n, seed=0, given=None):
        self.rng, self.plant, self.time = np.random.default_rng(seed), plant, 0.0
        problem = Problem(
            dimension=n, translation_order=2 if plant.inertial else 1, forward=plant.forward
        )
        self.estimator = Estimator(problem, plant.speed_lag, given=given)
        self.history, self.motion = CommandHistory(), at_rest(n, 0.3, 0.0, plant)

    def watch(self, ticks, noise=0.0, moved=0.0):
        """Fly on; return the innovations. Measured positions are off by noise, and by so much."""
        innovations = []
        for _ in range(ticks):
            error = noise * self.rng.normal(size=len(self.motion.position)) + moved
            self.estimator.observe(measured(self.time, self.motion, error), self.history)
            innovations.append(self.estimator.innovation)
            rate = 0.4 * self.rng.normal(size=len(self.motion.rate))
            command = Command(self.rng.uniform(0.5, 1.0), rate, np.eye(len(self.motion.position)))
            self.history.add(command, self.time)
            self.motion = flown(self.plant, self.motion, command.speed_fraction, rate, STEP)
            self.time += STEP
        return np.array(innovations)

    @property
    def found(self):
        return self.estimator.disturbance


PLANTS = [
    (2, Craft(15.0, speed_lag=0.8, rate_lag=0.3, blown=np.array([3.0, -2.0]))),
    (3, Craft(2.0, speed_lag=0.3, blown=np.array([0.3, -0.2, 0.1]))),
    (2, Craft(5.0, inertial=True, speed_lag=0.2, blown=np.array([1.0, -0.5]))),
    (3, Craft(15.0, inertial=True, speed_lag=0.1, rate_lag=0.1, blown=np.array([1.0, 2.0, -9.0]))),
]


@pytest.mark.parametrize(('n', 'plant'), PLANTS)
def test_a_steady_disturbance_is_found_whatever_is_commanded(n, plant):
    watched = Watched(plant, n)
    watched.watch(300)
    np.testing.assert_allclose(watched.found, plant.blown, atol=0.01 * plant.forward)


def test_a_jump_of_the_clock_leaves_the_wind_known_and_a_reset_does_not():
    plant = PLANTS[0][1]
    watched = Watched(plant, 2)
    watched.watch(100)
    watched.estimator.start_afresh()
    np.testing.assert_allclose(watched.found, plant.blown, atol=0.01 * plant.forward)
    watched.estimator.reset()
    np.testing.assert_array_equal(watched.found, 0.0)


@pytest.mark.parametrize('velocity_source', ['air', 'ground'])
def test_who_is_met_in_flight_is_not_taken_for_one_at_rest_in_a_wind(velocity_source):
    """A lagging vehicle that flies before its first command covers what it could not from rest."""
    plant = PLANTS[0][1]
    problem = Problem(forward=plant.forward)
    estimator, history = Estimator(problem, plant.speed_lag, velocity_source), CommandHistory()
    motion, off = at_rest(2, 0.3, 0.8, plant), []
    for k in range(12):
        at = measured(0.5 * k, motion)
        if velocity_source == 'air':
            through = motion.attitude.T @ (motion.velocity - plant.blown)
            at = replace(at, body_velocity=through)
        estimator.observe(at, history)
        off.append(np.linalg.norm(estimator.disturbance - plant.blown))
        command = Command(0.9, np.array([0.3]), motion.attitude)
        history.add(command, 0.5 * k)
        motion = flown(plant, motion, 0.9, command.body_rate, 0.5)
    assert max(off) <= np.linalg.norm(plant.blown)  # from rest, it seems to be a wind of 10 m/s
    assert off[6] < {'air': 0.3, 'ground': 0.5}[velocity_source]


@pytest.mark.parametrize('share', [0.7, 0.85, 1.0])
@pytest.mark.parametrize('along', [-4.0, 4.0])
def test_a_wind_along_the_way_is_not_taken_for_airspeed(along, share):
    """At constant airspeed nothing but the floor and full speed tell them apart, at first."""
    axis = at_rest(2, 0.3).attitude[:, 0]
    plant = Craft(15.0, speed_lag=0.8, blown=along * axis)
    problem = Problem(forward=15.0, floor=Floor('circle', fraction=2.0 / 3.0))
    estimator, history = Estimator(problem, plant.speed_lag), CommandHistory()
    motion = at_rest(2, 0.3, share, plant)
    for k in range(20):
        estimator.observe(measured(STEP * k, motion), history)
        history.add(Command(share, np.zeros(1), motion.attitude), STEP * k)
        motion = flown(plant, motion, share, np.zeros(1), STEP)
    np.testing.assert_allclose(estimator.disturbance, plant.blown, atol=0.6)


@pytest.mark.parametrize('step', [0.02, 0.1, 0.5])
def test_a_wind_that_turns_about_is_followed_within_two_seconds(step):
    plant, history = PLANTS[0][1], CommandHistory()
    estimator = Estimator(Problem(forward=plant.forward), plant.speed_lag)
    motion, rng = at_rest(2, 0.3, 0.9, plant), np.random.default_rng(2)
    for k in range(round(8.0 / step) + 1):
        blown = plant.blown if step * k < 6.0 else -plant.blown
        noise = 0.1 * rng.normal(size=2)
        estimator.observe(measured(step * k, motion, noise), history)
        rate = np.array([0.4 * math.sin(step * k)])
        history.add(Command(0.9, rate, motion.attitude), step * k)
        motion = flown(replace(plant, blown=blown), motion, 0.9, rate, step)
    assert np.linalg.norm(estimator.disturbance + plant.blown) < 0.1 * np.linalg.norm(
        2 * plant.blown
    )


@pytest.mark.parametrize('believed', [True, False])
def test_speed_that_is_not_as_commanded_is_no_wind_where_what_is_measured_is_believed(believed):
    """A wing that is told 15 m/s flies 12, and is blown along by a wind besides."""
    wind, velocity = np.array([3.0, -2.0]), np.array([12.0, 0.0])
    estimator = Estimator(Problem(forward=15.0), 0.0, 'air', measured=believed)
    history = CommandHistory()
    for k in range(30):
        place = 0.5 * k * (velocity + wind)
        at = Odometry(0.5 * k, place, np.eye(2), velocity, np.zeros(1))
        estimator.observe(at, history)
        history.add(Command(1.0, np.zeros(1), np.eye(2)), 0.5 * k)
    slower = np.zeros(2) if believed else np.array([-3.0, 0.0])
    np.testing.assert_allclose(estimator.disturbance, wind + slower, atol=0.1)


def test_what_is_known_is_not_estimated_again():
    plant = PLANTS[3][1]
    watched = Watched(plant, 3, given=np.array([0.0, 0.0, -9.0]))
    watched.watch(300)
    np.testing.assert_allclose(watched.found, [1.0, 2.0, -9.0], atol=0.15)


@pytest.mark.parametrize('order', [1, 2])
def test_innovations_are_as_large_as_the_model_says(order):
    """Of a motion drawn from the very model, they are of one standard deviation."""
    rng, unit, noise = np.random.default_rng(4), 3.0, {1: NoiseModel(), 2: PUSHED}[order]
    problem = Problem(translation_order=order, forward=unit)
    estimator, history = Estimator(problem, 0.5), CommandHistory()
    history.add(Command(0.0, np.zeros(1), np.eye(2)), -1.0)
    s, p, w = np.zeros(2), np.zeros(2), np.zeros(2)
    found = []
    for k in range(3000):
        for _ in range(10):
            gust = 0.05 * unit * np.sqrt(0.01) * rng.normal(size=2)
            w = w + noise.drift * unit * np.sqrt(0.01) * rng.normal(size=2)
            w = np.clip(w, -2.0, 2.0)
            if order == 1:
                s = s + 0.01 * w + gust
            else:
                s, p = s + 0.01 * p, p + 0.01 * w + gust
        seen, speed = (v + 0.01 * unit * rng.normal(size=2) for v in (s, p))
        at = Odometry(0.1 * (k + 1), seen, np.eye(2), speed, np.zeros(1))
        estimator.observe(at, history)
        found.append(estimator.innovation)
    typical = float(np.sqrt(np.mean(np.square(found[50:]))))
    # The larger of two axes: the mean of the larger of two chi-squares, over their mean.
    assert typical == pytest.approx(math.sqrt(1.64 if order == 1 else 1.5), rel=0.1)


def test_a_bad_fix_is_not_taken_for_wind():
    watched = Watched(PLANTS[0][1], 2)
    watched.watch(200)
    before = watched.found
    bad = watched.watch(1, moved=20.0)
    assert bad[0] > 5.0
    np.testing.assert_allclose(watched.found, before, atol=1e-12)
    watched.watch(5)
    np.testing.assert_allclose(watched.found, before, atol=0.05)


def test_a_position_that_has_jumped_for_good_is_believed_and_is_no_wind():
    watched = Watched(PLANTS[0][1], 2)
    watched.watch(200)
    before = watched.found
    innovations = watched.watch(PATIENCE + 50, moved=20.0)
    assert (innovations[: PATIENCE - 1] > 5.0).all()
    assert (innovations[PATIENCE:] < 1.0).all()
    np.testing.assert_allclose(watched.found, before, atol=0.05)


def test_nothing_is_learnt_over_a_gap_or_from_a_stamp_that_does_not_increase():
    watched = Watched(PLANTS[0][1], 2)
    watched.watch(200)
    before, last = watched.found, watched.time - STEP
    astray = replace(watched.motion, position=watched.motion.position + 3.0)
    watched.estimator.observe(measured(last, astray), watched.history)
    np.testing.assert_array_equal(watched.found, before)
    given = watched.history.last
    later = flown(watched.plant, watched.motion, given.speed_fraction, given.body_rate, GAP)
    drifted = measured(watched.time + GAP, later, np.array([2.0, 0.0]))
    watched.estimator.observe(drifted, watched.history)
    np.testing.assert_array_equal(watched.found, before)


def test_nothing_is_learnt_before_a_command_is_known():
    watched = Watched(PLANTS[0][1], 2)
    for k in range(5):
        drifting = replace(watched.motion, position=np.array([3.0 * k, 0.0]))
        watched.estimator.observe(measured(0.1 * k, drifting), watched.history)
    np.testing.assert_array_equal(watched.found, [0.0, 0.0])


def test_an_estimate_that_runs_away_is_limited_and_told():
    """Stuck, a vehicle that is commanded full speed seems to meet a wind of that speed."""
    estimator, history = Estimator(Problem(forward=10.0), 0.2), CommandHistory()
    told = []
    for k in range(100):
        history.add(Command(1.0, np.zeros(1), np.eye(2)), 0.1 * k)
        still = Odometry(0.1 * k + 0.05, np.zeros(2), np.eye(2), np.zeros(2), np.zeros(1))
        estimator.observe(still, history)
        told.append(estimator.limit())
        assert np.linalg.norm(estimator.disturbance) <= LARGEST * 10.0 + 1e-9
    assert told[0] == ''
    assert told[-1].startswith('the disturbance is estimated to be 8.')
    assert told[-1].endswith('m/s, taken as 8 m/s')
