# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The estimated disturbance, and velocities in the wrong frame: what is learnt and what is not."""

import math
from dataclasses import replace

import numpy as np
import pytest
from stepping import flown, started

from orbimpc_ros.loop.compensation import (
    GAP,
    LARGEST,
    PATIENCE,
    PUSHED,
    CommandHistory,
    Estimator,
    NoiseModel,
)
from orbimpc_ros.loop.state import WINDOW, Odometry, VelocityFrameCheck
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.plan import Command
from orbimpc_ros.mpc.problem import Floor, Problem
from orbimpc_ros.sim.plant import Plant
from orbimpc_ros.sim.vehicle import measured

STEP = 0.1  # [s]


class Watched:
    """A vehicle that flies commands, and an estimator that watches it."""

    def __init__(self, plant, fraction=0.0, step=STEP, floor=Floor(), **known):  # noqa: B008
        self.plant, self.step, self.rng = plant, step, np.random.default_rng(0)
        orders = {'translation_order': plant.translation_order, 'floor': floor}
        problem = Problem(plant.dimension, forward=plant.forward, **orders)
        self.estimator = Estimator(problem, plant.speed_lag, plant.velocity_source, **known)
        self.history, self.vehicle = CommandHistory(), started(plant, 0.3, fraction)

    def watch(self, ticks, command=None, noise=0.0, moved=0.0):
        """Fly on, as commanded or at random; return the innovations.

        Measured positions are off by noise, and by so much.
        """
        innovations = []
        for _ in range(ticks):
            seen = measured(self.vehicle, self.plant.velocity_source)
            error = noise * self.rng.normal(size=len(seen.position)) + moved
            self.observe(replace(seen, position=seen.position + error))
            innovations.append(self.estimator.innovation)
            fraction, rate = command or (
                self.rng.uniform(0.5, 1.0), 0.4 * self.rng.normal(size=self.plant.rates),
            )  # fmt: skip
            given = Command(fraction, np.atleast_1d(rate), self.vehicle.attitude)
            self.history.add(given, self.vehicle.time)
            self.vehicle = flown(self.plant, self.vehicle, fraction, given.body_rate, self.step)
        return np.array(innovations)

    def observe(self, odometry):
        self.estimator.observe(odometry, self.history)

    @property
    def found(self):
        return self.estimator.disturbance


WING = Plant(forward=15.0, speed_lag=0.8, rate_lag=0.3, disturbance=(3.0, -2.0))
FALLING = Plant(3, 1, 2, forward=15.0, speed_lag=0.1, rate_lag=0.1, disturbance=(1.0, 2.0, -9.0))
PLANTS = [
    WING,
    Plant(3, forward=2.0, speed_lag=0.3, disturbance=(0.3, -0.2, 0.1)),
    Plant(2, 1, 2, forward=5.0, speed_lag=0.2, disturbance=(1.0, -0.5)),
    FALLING,
]


@pytest.fixture
def watched():
    """A wing that is known for long."""
    found = Watched(WING)
    found.watch(200)
    return found


@pytest.mark.parametrize('plant', PLANTS)
def test_a_steady_disturbance_is_found_whatever_is_commanded(plant):
    watched = Watched(plant)
    watched.watch(300)
    np.testing.assert_allclose(watched.found, plant.blown, atol=0.01 * plant.forward)


def test_a_jump_of_the_clock_leaves_the_wind_known_and_a_reset_does_not(watched):
    watched.estimator.start_afresh()
    np.testing.assert_allclose(watched.found, WING.blown, atol=0.01 * WING.forward)
    watched.estimator.reset()
    np.testing.assert_array_equal(watched.found, 0.0)


@pytest.mark.parametrize(('source', 'soon'), [('air', 0.3), ('ground', 0.5)])
def test_who_is_met_in_flight_is_not_taken_for_one_at_rest_in_a_wind(source, soon):
    """A lagging vehicle that flies before its first command covers what it could not from rest."""
    watched, off = Watched(replace(WING, velocity_source=source), 0.8, 0.5), []
    for _ in range(12):
        watched.watch(1, (0.9, 0.3))
        off.append(np.linalg.norm(watched.found - WING.blown))
    assert max(off) <= np.linalg.norm(WING.blown)  # from rest, it seems to be a wind of 10 m/s
    assert off[6] < soon


@pytest.mark.parametrize('share', [0.7, 0.85, 1.0])
@pytest.mark.parametrize('along', [-4.0, 4.0])
def test_a_wind_along_the_way_is_not_taken_for_airspeed(along, share):
    """At constant airspeed nothing but the floor and full speed tell them apart, at first."""
    blown = along * exp(np.array([0.3]))[:, 0]
    plant = Plant(forward=15.0, speed_lag=0.8, disturbance=tuple(blown))
    watched = Watched(plant, share, floor=Floor('circle', fraction=2.0 / 3.0))
    watched.watch(20, (share, 0.0))
    np.testing.assert_allclose(watched.found, blown, atol=0.6)


@pytest.mark.parametrize('step', [0.02, 0.1, 0.5])
def test_a_wind_that_turns_about_is_followed_within_two_seconds(step):
    watched = Watched(WING, 0.9, step)
    for time in step * np.arange(round(8.0 / step) + 1):
        if time >= 6.0:
            watched.plant = replace(WING, disturbance=tuple(-WING.blown))
        watched.watch(1, (0.9, 0.4 * math.sin(time)), noise=0.1)
    assert np.linalg.norm(watched.found + WING.blown) < 0.1 * np.linalg.norm(2 * WING.blown)


@pytest.mark.parametrize('believed', [True, False])
def test_speed_that_is_not_as_commanded_is_no_wind_where_what_is_measured_is_believed(believed):
    """A wing that is told 15 m/s flies 12, and is blown along by a wind besides."""
    slow = replace(WING, speed_lag=0.0, gain=0.8, velocity_source='air')
    watched = Watched(slow, 1.0, 0.5, measured=believed)
    watched.watch(30, (1.0, 0.0))
    slower = 0.0 if believed else -3.0 * watched.vehicle.attitude[:, 0]
    np.testing.assert_allclose(watched.found, WING.blown + slower, atol=0.1)


def test_what_is_known_is_not_estimated_again():
    watched = Watched(FALLING, given=np.array([0.0, 0.0, -9.0]))
    watched.watch(300)
    np.testing.assert_allclose(watched.found, FALLING.blown, atol=0.15)


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


def test_a_bad_fix_is_not_taken_for_wind(watched):
    before = watched.found
    bad = watched.watch(1, moved=20.0)
    assert bad[0] > 5.0
    np.testing.assert_allclose(watched.found, before, atol=1e-12)
    watched.watch(5)
    np.testing.assert_allclose(watched.found, before, atol=0.05)


def test_a_position_that_has_jumped_for_good_is_believed_and_is_no_wind(watched):
    before = watched.found
    innovations = watched.watch(PATIENCE + 50, moved=20.0)
    assert (innovations[: PATIENCE - 1] > 5.0).all()
    assert (innovations[PATIENCE:] < 1.0).all()
    np.testing.assert_allclose(watched.found, before, atol=0.05)


@pytest.mark.parametrize(('later', 'off'), [(-STEP, 0.02), (GAP, 2.0)])
def test_nothing_is_learnt_over_a_gap_or_from_a_stamp_that_does_not_increase(watched, later, off):
    before, given, vehicle = watched.found, watched.history.last, watched.vehicle
    if later > 0.0:
        vehicle = flown(WING, vehicle, given.speed_fraction, given.body_rate, later)
    seen = measured(vehicle)
    place = seen.position + min(0.0, later) * vehicle.velocity + off
    watched.observe(replace(seen, time=watched.vehicle.time + later, position=place))
    np.testing.assert_array_equal(watched.found, before)


def test_nothing_is_learnt_before_a_command_is_known():
    watched = Watched(WING)
    for k in range(5):
        seen = measured(watched.vehicle)
        watched.observe(replace(seen, time=0.1 * k, position=np.array([3.0 * k, 0.0])))
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


# --- velocities in the wrong frame


def flight(rng, dimension, count=60, noise=0.0, wind=0.0, speed=2.0):
    """Yield times, positions, attitudes and velocities in the world of a turning vehicle."""
    rates = 1 if dimension == 2 else 3
    attitude = exp(rng.normal(size=rates))
    position, rate = rng.normal(size=dimension), 0.5 * rng.normal(size=rates)
    for k in range(count):
        velocity = speed * attitude[:, 0]
        yield 0.1 * k, position + noise * rng.normal(size=dimension), attitude, velocity
        attitude = attitude @ exp(0.1 * rate)
        position = position + 0.1 * speed * attitude[:, 0] + 0.1 * wind * np.eye(dimension)[0]


def doubt(given, truly, states):
    """Return what a witness says of velocities given in a frame that may not be theirs."""
    witness = VelocityFrameCheck(given)
    for time, position, attitude, velocity in states:
        sent = velocity if truly == 'world' else attitude.T @ velocity
        read = attitude.T @ sent if given == 'world' else sent
        rate = np.zeros(1 if len(position) == 2 else 3)
        witness.note(Odometry(time, position.copy(), attitude.copy(), read, rate))
    return witness.doubt


@pytest.mark.parametrize('dimension', [2, 3])
@pytest.mark.parametrize('truly', ['body', 'world'])
@pytest.mark.parametrize('given', ['body', 'world'])
def test_a_wrong_frame_is_told_and_the_right_one_is_not(given, truly, dimension):
    rng = np.random.default_rng([dimension, given == 'body', truly == 'body'])
    doubts = [doubt(given, truly, flight(rng, dimension, noise=0.005)) for _ in range(20)]
    if given == truly:
        assert not any(doubts)
    else:  # who looks along x all the time gives nothing away
        assert sum(f'those of the {truly} frame' in each for each in doubts) >= 15


@pytest.mark.parametrize('given', ['body', 'world'])
@pytest.mark.parametrize(
    ('wind', 'noise', 'speed'),
    [(0.0, 0.2, 2.0), (1.5, 0.0, 2.0), (1.5, 0.05, 2.0), (0.0, 0.0, 0.0)],
)
def test_noise_wind_and_rest_are_no_wrong_frame(given, wind, noise, speed):
    rng = np.random.default_rng(8)
    for _ in range(20):
        assert not doubt(given, given, flight(rng, 2, noise=noise, wind=wind, speed=speed))


def test_a_few_measurements_are_no_evidence():
    rng = np.random.default_rng(9)
    assert not doubt('body', 'world', flight(rng, 2, count=WINDOW))
