# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Initial states of plans: measurements in wind, delays, lags, and the estimated disturbance.

Also the detection of velocities given in the wrong frame.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from problems import ORDERS, rotation
from scenarios import spacecraft_problem
from stepping import Stepped, flown, launched, started

from orbimpc_ros.loop.capture import WINDOW, VelocityFrameCheck
from orbimpc_ros.loop.compensation import (
    DRIFT,
    DRIFT_PUSHED,
    GAP,
    LARGEST,
    CommandHistory,
    Compensator,
    Interval,
    Odometry,
    Response,
)
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.outcome import Cause, Reason
from orbimpc_ros.mpc.plan import Command
from orbimpc_ros.mpc.problem import Floor, Problem, State
from orbimpc_ros.sim.vehicle import Model, Plant, measured

LONG = 6.0  # [s] twenty time constants: lags have settled by then
LAGS = [(0.3, 0.3), (0.2, 0.3), (0.3, 0.1), (0.0, 0.2), (0.3, 0.0)]


def known(problem, wind=None, source='ground'):
    return Compensator(problem, given=wind, velocity_source=source)


def command(fraction, rate=(0.0,)):
    return Command(fraction, np.array(rate), np.eye(2 if len(rate) == 1 else 3))


# --- measurements in wind


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('source', ['ground', 'air'])
@pytest.mark.parametrize('seed', range(5))
def test_a_plan_starts_from_the_speed_through_the_air(n, source, seed):
    rng = np.random.default_rng([seed, n])
    model = Model(n, forward=2.0, disturbance=tuple(rng.normal(size=n)))
    place, attitude = rng.normal(size=n), rotation(rng, n)
    vehicle = launched(model, place, attitude, fraction=rng.uniform(0.2, 1.0))
    compensator = known(Problem(n, forward=2.0), model.blown, source)
    seen = measured(vehicle, source)
    state = State.at(**compensator.state(seen))
    np.testing.assert_allclose(state.rotation, vehicle.fraction * vehicle.attitude, atol=1e-12)
    np.testing.assert_allclose(state.disturbance, model.blown)
    assert compensator.odd_speed(seen) == ''


def test_an_odd_speed_is_one_through_the_air():
    seen = Odometry(0.0, np.zeros(2), np.eye(2), np.array([1.5, 0.0]), np.zeros(1))
    along = np.array([0.7, 0.0])
    assert 'measured a forward speed of 1.5 m/s' in known(Problem()).odd_speed(seen)
    assert known(Problem(), along).odd_speed(seen) == ''
    assert 'of 1.5 m/s' in known(Problem(), along, 'air').odd_speed(seen)


# --- delays


@pytest.mark.parametrize('source', ['ground', 'air'])
@pytest.mark.parametrize('orders', ORDERS)
def test_a_measurement_moves_on_as_the_vehicle_does(orders, source):
    """Before any command is known and with two of them, in wind or under gravity.

    Some rates are near zero, where closed forms switch to series. At rotation order 1 rates are
    obeyed at once; speeds, and rates at order 2, take effect with the next command.
    """
    rng, n, order = np.random.default_rng(1), orders['dimension'], orders['translation_order']
    problem = Problem(**orders, forward=2.0)
    for _ in range(20):
        plant = Plant(n, 1, order, forward=2.0, disturbance=tuple(rng.normal(size=n)))
        rates = 10.0 ** rng.uniform(-4, 0.5, (3, 1)) * rng.normal(size=(3, plant.rates))
        first, second = (command(rng.uniform(), rate) for rate in rates[1:])
        place, attitude, velocity = rng.normal(size=n), rotation(rng, n), rng.normal(size=n)
        start = launched(
            plant, place, attitude, fraction=rng.uniform(), velocity=velocity, body_rate=rates[0]
        )
        spans = 0.1, 0.3, 0.2
        known = (None, None), (first, None), (second, first)
        intervals = [Interval(span, *each) for span, each in zip(spans, known, strict=True)]
        loop = Compensator(problem, given=plant.blown, velocity_source=source)
        later = loop.advanced(measured(start, source), intervals)
        turns = rates if problem.rotation_order == 1 else rates[[0, 0, 1]]
        before, vehicle = start.fraction if order == 1 else 0.0, start
        shares = before, before, first.speed_fraction
        for span, rate, share in zip(spans, turns, shares, strict=True):
            vehicle = flown(plant, vehicle, share, rate, span)
        expected = measured(vehicle, source)
        assert later.time == pytest.approx(0.6)
        for name in ('position', 'attitude', 'body_velocity'):
            found = getattr(later, name)
            np.testing.assert_allclose(found, getattr(expected, name), atol=1e-6, err_msg=name)
        if problem.rotation_order == 2:
            np.testing.assert_array_equal(later.body_rate, first.body_rate)
        assert loop.advanced(later, []) is later


A, B, C = command(0.1), command(0.2), command(0.3)


def told(begin, end, sent=((1.0, A), (2.0, B), (3.0, C))):
    kept = CommandHistory()
    for at, given in sent:
        kept.add(given, at)
    return [(pytest.approx(time), *given) for time, *given in kept.intervals(begin, end)]


def test_intervals_are_what_was_in_force():
    assert told(1.5, 1.7) == [(0.2, A, None)]
    assert told(1.5, 2.5) == [(0.5, A, None), (0.5, B, A)]
    assert told(2.0, 3.5) == [(1.0, B, A), (0.5, C, B)]
    assert told(4.0, 4.25) == [(0.25, C, B)]
    assert told(0.5, 1.25) == [(0.5, None, None), (0.25, A, None)]
    assert told(0.0, 0.5) == [(0.5, None, None)]
    assert told(2.5, 2.5) == told(2.5, 2.0) == []


# --- lags


def settled(compensator, vehicle):
    """Return the vehicle without lags that the compensator plans for in place of a lagging one."""
    seen = compensator.start(measured(vehicle)).odometry
    velocity = seen.attitude @ seen.body_velocity
    return replace(
        vehicle, time=seen.time, position=seen.position, attitude=seen.attitude, velocity=velocity
    )


@pytest.mark.parametrize('dimension', [2, 3])
def test_in_the_end_a_lagging_vehicle_is_where_a_settled_one_went_a_lag_later(dimension):
    """Exact for turns about one axis: the attitude always, the position at a steady rate."""
    lag, ideal = 0.3, Plant(dimension, forward=2.0)
    plant = replace(ideal, speed_lag=lag, rate_lag=lag)
    rate = np.random.default_rng(1).normal(size=plant.rates)
    start = replace(started(plant, 0.4, 0.7), body_rate=0.5 * rate)
    problem = Problem(dimension, forward=2.0, discretisation='exact')
    compensator = Compensator(problem, Response(lag, lag))
    begun = settled(compensator, start)
    assert begun.time == lag
    end = flown(plant, start, 0.7, rate, LONG)
    there = flown(ideal, begun, 0.7, rate, LONG - lag)
    np.testing.assert_allclose(end.attitude, there.attitude, atol=1e-4)
    turning = replace(start, body_rate=rate)
    steady = flown(plant, turning, 0.7, rate, lag)
    np.testing.assert_allclose(settled(compensator, turning).position, steady.position, atol=1e-4)


@pytest.mark.parametrize(('speed', 'rate'), LAGS)
@pytest.mark.parametrize('orders', ORDERS)
def test_a_late_measurement_of_a_lagging_vehicle_counts_as_a_prompt_one(orders, speed, rate):
    """It lags behind a command in force before, and behind another one sent in the meantime."""
    rng, n, order = np.random.default_rng(1), orders['dimension'], orders['translation_order']
    for _ in range(5):
        wind = tuple(rng.normal(size=n))
        plant = Plant(n, 1, order, speed_lag=speed, rate_lag=rate, forward=2.0, disturbance=wind)
        problem = Problem(**orders, forward=2.0, discretisation='exact')
        compensator = Compensator(problem, Response(speed, rate), plant.blown)
        vehicle, found = started(plant, 0.0, 0.0), []
        if order == 1:
            compensator.history.add(command(0.0, np.zeros(plant.rates)), -LONG)
        for k, span in enumerate((0.4, 0.2, 0.1)):
            if k != 1:
                told = command(rng.uniform(), 0.5 * rng.normal(size=plant.rates))
                compensator.history.add(told, vehicle.time)
            vehicle = flown(plant, vehicle, told.speed_fraction, told.body_rate, span)
            found.append((measured(vehicle), vehicle.time))
        now = vehicle.time
        prompt, late = (compensator.start(seen, now - at, now).odometry for seen, at in found[-2:])
        assert late.time == pytest.approx(prompt.time)
        for name in ('position', 'attitude', 'body_velocity', 'body_rate'):
            np.testing.assert_allclose(getattr(late, name), getattr(prompt, name), atol=1e-2)


@pytest.mark.parametrize(('speed', 'rate'), LAGS)
def test_in_the_end_a_lagging_thrust_has_done_what_a_settled_one_does(speed, rate):
    """Position and velocity agree in the end for any earlier thrust, under constant gravity."""
    ideal = Plant(2, 1, 2, forward=3.0, disturbance=(0.2, -0.4))
    plant, still = replace(ideal, speed_lag=speed, rate_lag=rate), np.zeros(1)
    start = replace(started(plant, 0.0, 0.9), velocity=np.array([0.5, -0.3]))
    problem = Problem(translation_order=2, forward=3.0, discretisation='exact')
    compensator = Compensator(problem, Response(speed, rate), plant.blown)
    for share, at in ((0.9, -LONG), (0.3, 0.0)):
        compensator.history.add(Command(share, still, np.eye(2)), at)
    end = flown(plant, start, 0.3, still, LONG)
    there = flown(
        ideal, replace(settled(compensator, start), fraction=0.3), 0.3, still, LONG - rate
    )
    np.testing.assert_allclose(end.velocity, there.velocity, atol=5e-3)
    np.testing.assert_allclose(end.position, there.position, atol=2e-2)


def test_half_a_step_of_a_lag_is_in_the_euler_model():
    step = 0.4
    for lag, exact, euler in ((0.1, 0.1, 0.0), (0.3, 0.3, 0.1)):
        response = Response(0.0, lag)
        assert response.lead(Problem(step=step, discretisation='exact')) == exact
        assert response.lead(Problem(step=step)) == pytest.approx(euler)


@pytest.mark.parametrize('name', ['speed', 'rate'])
@pytest.mark.parametrize('value', [-0.1, np.inf, np.nan])
def test_a_lag_that_cannot_be_is_refused(name, value):
    with pytest.raises(BadInput, match=f'response.{name}'):
        Response(**{name: value})


def test_a_lagging_wing_met_in_flight_is_planned_for_at_its_speed():
    plant = Plant(forward=15.0, speed_lag=0.8)
    floored = Problem(forward=15.0, max_rate=0.4, floor=Floor('circle', fraction=2.0 / 3.0))
    loop, wing = Compensator(floored, Response(0.8)), started(plant, 0.0, 0.9)
    for told in (0.9, 0.7):
        share = np.linalg.norm(loop.start(measured(wing)).state['rotation'][:, 0])
        assert share == pytest.approx(wing.fraction, abs=1e-9)
        loop.history.add(command(told), wing.time)
        wing = flown(plant, wing, told, np.zeros(1), 0.5)


def test_the_applied_thrust_follows_what_was_commanded():
    """Also commands that are forgotten by now: there are many within a lag."""
    lag = 0.3
    history = CommandHistory(lag)
    sent = [(0.0, 0.2), (0.5, 1.0), (0.9, 0.4)]
    for at, fraction in sent:
        history.add(Command(fraction, np.zeros(1), np.eye(2)), at)
    plant, shares = Plant(2, 1, 2, speed_lag=lag), []
    vehicle = started(plant)
    for (_, fraction), time in zip(sent, (0.5, 0.4, 0.3), strict=True):
        before = vehicle.velocity[0]
        vehicle = flown(plant, vehicle, fraction, np.zeros(1), time)
        shares.append((vehicle.velocity[0] - before) / time)
    assert history.applied(1.2) == pytest.approx(vehicle.fraction, abs=1e-9)
    assert history.means(0.5, 0.9)[0] == pytest.approx(shares[1], abs=1e-6)
    both = vehicle.velocity[0] / 1.2, vehicle.position[0] / (0.5 * 1.2**2)
    assert history.means(0.0, 1.2) == pytest.approx(both, abs=1e-3)
    assert history.means(-0.5, 1.2) is None
    for k, fraction in enumerate(np.linspace(0.4, 1.0, 200)):
        history.add(Command(fraction, np.zeros(1), np.eye(2)), 1.2 + 0.005 * k)
        vehicle = flown(plant, vehicle, fraction, np.zeros(1), 0.005)
    assert history.applied(1.2 + 0.005 * 200) == pytest.approx(vehicle.fraction, abs=1e-3)
    history.forget()
    assert history.intervals(1.5, 2.0) == [Interval(0.5, None, None)]


@pytest.mark.parametrize(('seed', 'gain'), [(0, 0.97), (1, 1.03)])
def test_a_lagging_spacecraft_arrives_at_rest(seed, gain):
    """The paper's spacecraft in continuous time: lags of 0.2 s and 0.3 s, thrust 3 % off."""
    rng = np.random.default_rng(seed)
    problem = replace(spacecraft_problem(), rotation_order=1, discretisation='exact')
    plant = Plant(3, 1, 2, speed_lag=0.2, rate_lag=0.3, gain=gain)
    goal = np.array([5.0, 10.0, 25.0]) + rng.uniform(-2.0, 2.0, 3)
    controller = Stepped(problem, shrinking=True, response=Response(0.2, 0.3))
    vehicle, fallbacks = started(plant, np.pi), set()
    for _ in range(problem.horizon):
        ends = controller.ends(vehicle.time + controller.lead)
        tick = controller.tick(measured(vehicle), np.tile(goal, (len(ends), 1)))
        fallbacks.add(tick.fallback)
        controller.sent(tick.command, vehicle.time)
        command = tick.command.speed_fraction, tick.command.body_rate
        vehicle = flown(plant, vehicle, *command, problem.step)
    assert np.linalg.norm(vehicle.position - goal) < 0.05
    assert np.linalg.norm(vehicle.velocity) < 0.05
    assert 'safe command' not in fallbacks


@pytest.mark.parametrize('rotation_order', [1, 2])
def test_a_vehicle_that_obeys_at_once_is_sent_what_is_due_now(rotation_order):
    """At translation order 2 a plan's command is for the next step: it is sent when that begins."""
    problem = Problem(2, rotation_order, 2, horizon=8, floor=Floor('circle', 4, 0.3))
    prompt, plain = (Stepped(problem, response=Response(lag, lag)) for lag in (1e-9, 0.0))
    position, sent, planned = np.zeros(2), [], []
    for k in range(4):
        odometry = Odometry(float(k), position, np.eye(2), np.array([0.3 * k, 0.0]), np.zeros(1))
        goals = np.tile([6.0, 1.0], (8, 1))
        sent.append(prompt.tick(odometry, goals).command)
        planned.append(prompt._compensator.history.due)
        plain.tick(odometry, goals)
    for now, before in zip(sent[1:], planned[:-1], strict=True):
        assert now.speed_fraction == before.speed_fraction
        if rotation_order == 2:
            np.testing.assert_array_equal(now.body_rate, before.body_rate)
    assert sent[0].speed_fraction == pytest.approx(0.3)
    prompt.safe(np.eye(2), Reason(Cause.DISABLED, 'a stop'))  # is below the floor, and is over
    assert prompt.tick(odometry, goals).plan is not None


# --- the estimated disturbance

STEP = 0.1  # [s]


class Watched:
    """A vehicle that flies commands, and an estimator that observes it."""

    def __init__(self, plant, fraction=0.0, step=STEP, source='ground', **known):
        self.plant, self.step, self.source = plant, step, source
        self.rng = np.random.default_rng(0)
        floor = known.pop('floor', Floor())
        orders = {'translation_order': plant.translation_order, 'floor': floor}
        problem = Problem(plant.dimension, forward=plant.forward, **orders)
        known |= {'estimated': True, 'velocity_source': source}
        self.estimator = Compensator(problem, Response(plant.speed_lag, plant.rate_lag), **known)
        self.history, self.vehicle = self.estimator.history, started(plant, 0.3, fraction)

    def watch(self, ticks, command=None, noise=0.0, moved=0.0):
        """Fly ``ticks`` steps with a command, or random ones; return the innovations.

        Measured positions have this noise and this offset ``moved`` [m].
        """
        innovations = []
        for _ in range(ticks):
            seen = measured(self.vehicle, self.source)
            error = noise * self.rng.normal(size=len(seen.position)) + moved
            self.estimator.start(replace(seen, position=seen.position + error))
            innovations.append(self.estimator.innovation)
            fraction, rate = command or (
                self.rng.uniform(0.5, 1.0), 0.4 * self.rng.normal(size=self.plant.rates),
            )  # fmt: skip
            given = Command(fraction, np.atleast_1d(rate), self.vehicle.attitude)
            self.history.add(given, self.vehicle.time)
            self.vehicle = flown(self.plant, self.vehicle, fraction, given.body_rate, self.step)
        return np.array(innovations)

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
    """A wing whose wind has been estimated for 20 s."""
    found = Watched(WING)
    found.watch(200)
    return found


@pytest.mark.parametrize(('noise', 'within'), [(0.0, 0.0004), (0.1, 0.12), (0.3, 0.15)])
@pytest.mark.parametrize('plant', PLANTS)
def test_a_steady_disturbance_is_found_whatever_is_commanded(plant, noise, within):
    watched = Watched(plant)
    watched.watch(300, noise=noise * plant.forward)
    np.testing.assert_allclose(watched.found, plant.blown, atol=within * plant.forward)


def test_a_vehicle_is_taken_to_carry_its_weight_before_its_first_command():
    """Otherwise the lag of a thrust that was there already would be taken for a lift."""
    weight = -9.0 * exp(np.array([0.3]))[:, 0]
    plant = Plant(2, 1, 2, forward=18.0, speed_lag=0.15, disturbance=tuple(weight))
    watched = Watched(plant, 0.5, 0.15, given=weight)
    for thrust in (0.4, 1.0, 0.7):  # such changes move a vehicle less than their means would
        watched.watch(2, (thrust, 0.0))
        np.testing.assert_allclose(watched.found, weight, atol=0.02)


def test_a_jump_of_the_clock_leaves_the_wind_known_and_a_reset_does_not(watched):
    watched.estimator.start_afresh()
    np.testing.assert_allclose(watched.found, WING.blown, atol=0.01 * WING.forward)
    watched.estimator.start_afresh(wind=True)
    np.testing.assert_array_equal(watched.found, 0.0)


@pytest.mark.parametrize(('source', 'soon'), [('air', 0.3), ('ground', 0.5)])
def test_who_is_met_in_flight_is_not_taken_for_one_at_rest_in_a_wind(source, soon):
    """Before its first command, a vehicle in flight covers more than it could from rest."""
    watched, off = Watched(WING, 0.8, 0.5, source=source), []
    for _ in range(12):
        watched.watch(1, (0.9, 0.3))
        off.append(np.linalg.norm(watched.found - WING.blown))
    assert max(off) <= np.linalg.norm(WING.blown)  # from rest: a wind of 10 m/s
    assert off[6] < soon


@pytest.mark.parametrize('share', [0.7, 0.85, 1.0])
@pytest.mark.parametrize('along', [-4.0, 4.0])
def test_a_wind_along_the_way_is_not_taken_for_airspeed(along, share):
    """At constant airspeed only the limits of speed, floor and full, tell them apart at first."""
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
    """With measured airspeed trusted, flying at 12 of 15 m/s commanded adds nothing to the wind."""
    slow = replace(WING, speed_lag=0.0, gain=0.8)
    watched = Watched(slow, 1.0, 0.5, source='air', sideslip=believed)
    watched.watch(30, (1.0, 0.0))
    slower = 0.0 if believed else -3.0 * watched.vehicle.attitude[:, 0]
    np.testing.assert_allclose(watched.found, WING.blown + slower, atol=0.1)


def test_what_is_known_is_not_estimated_again():
    watched = Watched(FALLING, given=np.array([0.0, 0.0, -9.0]))
    watched.watch(300)
    np.testing.assert_allclose(watched.found, FALLING.blown, atol=0.15)
    other = Watched(FALLING, given=np.array([0.0, 0.0, -8.0])).estimator
    other.continue_from(watched.estimator)
    np.testing.assert_allclose(other.disturbance, watched.found + np.array([0.0, 0.0, 1.0]))


@pytest.mark.parametrize('order', [1, 2])
def test_innovations_are_as_large_as_the_model_says(order):
    """For motion drawn from the model itself, their standard deviation is one."""
    rng, unit, drift = np.random.default_rng(4), 3.0, {1: DRIFT, 2: DRIFT_PUSHED}[order]
    problem = Problem(translation_order=order, forward=unit)
    estimator = Compensator(problem, Response(0.5), estimated=True)
    estimator.history.add(Command(0.0, np.zeros(1), np.eye(2)), -1.0)
    (s, p, w), found = np.zeros((3, 2)), []
    for k in range(3000):
        for _ in range(10):
            gust = 0.05 * unit * np.sqrt(0.01) * rng.normal(size=2)
            w = np.clip(w + drift * unit * np.sqrt(0.01) * rng.normal(size=2), -2.0, 2.0)
            if order == 1:
                s = s + 0.01 * w + gust
            else:
                s, p = s + 0.01 * p, p + 0.01 * w + gust
        seen, speed = (v + 0.01 * unit * rng.normal(size=2) for v in (s, p))
        estimator.observe(Odometry(0.1 * (k + 1), seen, np.eye(2), speed, np.zeros(1)))
        found.append(estimator.innovation)
    typical = float(np.sqrt(np.mean(np.square(found[50:]))))
    # The larger of two axes counts: the mean of the larger of two chi-squares, over their mean.
    assert typical == pytest.approx(math.sqrt(1.64 if order == 1 else 1.5), rel=0.1)


def test_a_bad_fix_is_not_taken_for_wind(watched):
    before = watched.found
    assert watched.watch(1, moved=2000.0)[0] > 5.0
    np.testing.assert_allclose(watched.found, before, atol=1e-12)
    watched.plant = replace(WING, disturbance=tuple(-WING.blown))
    watched.watch(20)  # nor for noise, which would hide another wind
    np.testing.assert_allclose(watched.found, -before, atol=0.5)


def test_a_position_that_has_jumped_for_good_is_believed_and_is_no_wind(watched):
    before = watched.found
    innovations = watched.watch(52, moved=20.0)
    assert innovations[0] > 5.0 > 5.0 * innovations[2:].max()
    np.testing.assert_allclose(watched.found, before, atol=0.05)


@pytest.mark.parametrize(('later', 'off'), [(-STEP, 0.02), (GAP, 2.0)])
def test_nothing_is_learnt_over_a_gap_or_from_a_stamp_that_does_not_increase(watched, later, off):
    before, given, vehicle = watched.found, watched.history.last, watched.vehicle
    if later > 0.0:
        vehicle = flown(WING, vehicle, given.speed_fraction, given.body_rate, later)
    seen = measured(vehicle)
    place = seen.position + min(0.0, later) * vehicle.velocity + off
    watched.estimator.start(replace(seen, time=watched.vehicle.time + later, position=place))
    np.testing.assert_array_equal(watched.found, before)


def test_nothing_is_learnt_before_a_command_is_known():
    watched = Watched(WING)
    for k in range(5):
        seen = measured(watched.vehicle)
        watched.estimator.start(replace(seen, time=0.1 * k, position=np.array([3.0 * k, 0.0])))
    np.testing.assert_array_equal(watched.found, [0.0, 0.0])


def test_an_estimate_that_runs_away_is_limited_and_told():
    """A stuck vehicle commanded at full speed looks like one in a wind of that speed."""
    estimator = Compensator(Problem(forward=10.0), Response(0.2), estimated=True)
    told = []
    for k in range(100):
        estimator.history.add(Command(1.0, np.zeros(1), np.eye(2)), 0.1 * k)
        still = Odometry(0.1 * k + 0.05, np.zeros(2), np.eye(2), np.zeros(2), np.zeros(1))
        told.append(estimator.observe(still))
        assert np.linalg.norm(estimator.disturbance) <= LARGEST * 10.0 + 1e-9
    assert told[0] == ''
    assert told[-1].startswith('the disturbance is estimated to be 8.')
    assert told[-1].endswith('m/s, taken as 8 m/s')


# --- velocities in the wrong frame


def flight(rng, dimension, count=60, noise=0.0, wind=0.0, speed=2.0):
    """Yield times, positions, attitudes and world-frame velocities of a turning vehicle."""
    rates = 1 if dimension == 2 else 3
    attitude = exp(rng.normal(size=rates))
    position, rate = rng.normal(size=dimension), 0.5 * rng.normal(size=rates)
    for k in range(count):
        velocity = speed * attitude[:, 0]
        yield 0.1 * k, position + noise * rng.normal(size=dimension), attitude, velocity
        attitude = attitude @ exp(0.1 * rate)
        position = position + 0.1 * speed * attitude[:, 0] + 0.1 * wind * np.eye(dimension)[0]


def doubt(given, truly, states):
    """Return the frame check's warning for velocities of frame ``truly`` read as of ``given``."""
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
    else:  # a vehicle that always heads along x reveals nothing
        assert sum(f'in the {truly} frame' in each for each in doubts) >= 15


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
