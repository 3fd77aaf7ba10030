# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Goals: forecasts of all motion families, changes of course, outliers, and paths to follow.

The oracle is the goal's own family, fitted by nonlinear least squares to the same sightings and
started from the truth: the best forecast that can be expected from them. Path tests cover the speed
along a path in wind, and paths that the wind makes impossible.
"""

import math
from typing import NamedTuple

import numpy as np
import pytest
from scipy.optimize import least_squares

from orbimpc_ros.loop.compensation import Odometry, WindReport
from orbimpc_ros.loop.goal.forecast import BELIEVED, FORECASTS, MEMORY, Bank
from orbimpc_ros.loop.goal.motion import GoalObservation, Route
from orbimpc_ros.loop.planner import Planner, Snapshot
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.problem import Floor, Problem

FAMILIES = ('still', 'velocity', 'swing', 'carrier', 'turn', 'damped')
START = 1000.0  # [s] time of the first sighting
AHEAD = 3.0  # [s] of forecasts beyond the last sighting
CHANGED = START + 12.0  # [s] time of a change of course
SOON = 2.0  # [s] within which a change of course must be recognised


class Motion(NamedTuple):
    """A goal's motion in n dimensions, with its parameters."""

    family: str
    n: int
    parameters: np.ndarray

    def __call__(self, times):
        """Return c + v t + a cos wt + b sin wt, possibly damped, or a circle; shape (M, n)."""
        t, n, p = np.asarray(times) - START, self.n, self.parameters
        found, p = np.tile(p[:n], (len(t), 1)), p[n:]
        if self.family in ('velocity', 'carrier'):
            found, p = found + np.outer(t, p[:n]), p[n:]
        if self.family == 'damped':
            return found + np.exp(-p[-1] * t)[:, None] * swung(p[:n], p[n:-2], p[-2] * t)
        if self.family in ('swing', 'carrier'):
            return found + swung(p[:n], p[n:-1], p[-1] * t)
        if self.family == 'turn':
            return found + p[-2] * swung(*exp(p[:-2]).T[:2], p[-1] * t)
        return found

    def fitted(self, times, seen, ahead):
        """Return the oracle's forecast at ``ahead``."""

        def residuals(parameters):
            return (self._replace(parameters=parameters)(times) - seen).ravel()

        found = least_squares(residuals, self.parameters, x_scale='jac', method='lm')
        return self._replace(parameters=found.x)(ahead)


def swung(a, b, angles):
    return np.outer(np.cos(angles), a) + np.outer(np.sin(angles), b)


def drawn(family, n, rng):
    """Return random motion: 0.05 to 0.4 Hz, 0.3 to 1.5 m, 0.3 to 3 m/s, turns 0.1 to 0.6 rad/s."""
    centre, velocity = 5.0 * rng.normal(size=n), rng.uniform(0.3, 2.5) * direction(rng, n)
    rate = 2.0 * np.pi * np.exp(rng.uniform(np.log(0.05), np.log(0.4)))
    size, phase = rng.uniform(0.3, 1.5, size=n), rng.uniform(0.0, 2.0 * np.pi, size=n)
    a, b = size * np.cos(phase), size * np.sin(phase)
    rest = {'velocity': [velocity], 'swing': [a, b, rate], 'carrier': [velocity, a, b, rate]}
    if family == 'damped':
        damping = 1.0 / np.exp(rng.uniform(np.log(5.0), np.log(20.0)))
        rest['damped'] = [2.0 * a, 2.0 * b, rate, damping]
    if family == 'turn':
        rate, speed = rng.uniform(0.1, 0.6) * rng.choice([-1.0, 1.0]), rng.uniform(0.5, 3.0)
        attitude = rng.uniform(-np.pi, np.pi, size=n * (n - 1) // 2)
        rest['turn'] = [attitude, speed / abs(rate), rate]
    return Motion(family, n, np.hstack([centre, *rest.get(family, [])]))


def direction(rng, n):
    along = rng.normal(size=n)
    return along / np.linalg.norm(along)


def sighted(motion, rng, *, seconds=20.0, noise=0.0, spacing=0.0):
    """Return times and positions of sightings at 5 to 20 Hz with jitter; a seventh are lost."""
    spacing = spacing or 1.0 / rng.uniform(5.0, 20.0)
    times = START + np.arange(0.0, seconds, spacing)
    times = times + 0.2 * spacing * rng.uniform(-1.0, 1.0, size=len(times))
    times = times[rng.uniform(size=len(times)) > 0.15]
    seen = motion(times)
    return times, seen + noise * rng.normal(size=seen.shape)


def shown(times, seen, bank=None):
    """Return a bank, or another forecast, after it has observed sightings."""
    bank = bank or Bank()
    for time, position in zip(times, seen, strict=True):
        bank.observe(GoalObservation(float(time), position.copy()))
    return bank


# --- laws


@pytest.mark.parametrize(  # the last are of more sightings than the bank keeps
    ('family', 'n', 'seconds'),
    [*((f, n, 20.0) for f in FAMILIES for n in (2, 3)), ('carrier', 2, 300.0), ('turn', 2, 300.0)],
)
def test_every_family_is_recovered_exactly_without_noise(family, n, seconds):
    for seed in range(2):
        rng = np.random.default_rng([1, n, seed])
        motion = drawn(family, n, rng)
        times, seen = sighted(motion, rng, seconds=seconds, spacing=0.2)
        bank, ahead = shown(times, seen), times[-1] + np.arange(0.0, AHEAD + 0.1, 0.5)
        np.testing.assert_allclose(bank.at(ahead), motion(ahead), atol=1e-3)
        assert bank.model == family


@pytest.mark.parametrize('family', FAMILIES)
def test_the_bank_is_as_good_as_the_family_that_fits(family):
    """Median errors 3 s ahead, at 5 Hz and 5 cm of noise, are within 30 % of the oracle's."""
    errors = {'bank': [], 'oracle': []}
    for seed in range(10):
        n, rng = 2 + seed % 2, np.random.default_rng([2, seed])
        motion = drawn(family, n, rng)
        times, seen = sighted(motion, rng, noise=0.05, spacing=0.2)
        ahead = times[-1:] + AHEAD
        bank, oracle = shown(times, seen).at(ahead), motion.fitted(times, seen, ahead)
        errors['bank'].append(np.linalg.norm(bank - motion(ahead)))
        errors['oracle'].append(np.linalg.norm(oracle - motion(ahead)))
    assert np.median(errors['bank']) <= 1.3 * np.median(errors['oracle'])


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('family', FAMILIES)
def test_forecasts_move_turn_and_wait_with_the_goal(family, n):
    rng = np.random.default_rng([4, n])
    times, seen = sighted(drawn(family, n, rng), rng, seconds=8.0, noise=0.02)
    ahead = times[-1] + np.arange(1.0, 4.0)
    turn, offset = exp(rng.normal(size=n * (n - 1) // 2)), 100.0 * rng.normal(size=n)
    before, after = shown(times, seen), shown(times + 64.0, seen @ turn.T + offset)
    assert before.model == after.model
    moved = before.at(ahead) @ turn.T + offset
    np.testing.assert_allclose(after.at(ahead + 64.0), moved, atol=1e-4)


def test_the_same_sightings_give_the_same_bits_whoever_asked_meanwhile():
    rng = np.random.default_rng(6)
    times, seen = sighted(drawn('swing', 3, rng), rng, noise=0.05)
    silent, again, asked = shown(times, seen), shown(times, seen), Bank()
    for time, position in zip(times, seen, strict=True):
        asked.observe(GoalObservation(float(time), position.copy()))
        asked.at(time + np.arange(5.0))
    ahead = times[-1] + np.arange(5.0)
    for other in (asked, again):
        np.testing.assert_array_equal(silent.at(ahead), other.at(ahead))


# --- other forecasts


@pytest.mark.parametrize(
    ('pace', 'spacing', 'noise', 'swings', 'least', 'within'),
    [
        (1.0, 1.0, 0.0, 1.0, 6.0, 0.01),
        (1.0, 1.0, 0.02, 1.3, 20.0, 0.15),
        (4.0, 0.05, 0.0, 3.0, 0.0, 0.05),
    ],
    ids=['exact', 'noise', 'fast'],
)
def test_harmonic_knows_a_swing_after_seeing_it_once(pace, spacing, noise, swings, least, within):
    """For five seconds ahead; with 2 cm of noise, to within a capture radius of 0.15 m."""
    for seed in range(20):
        rng = np.random.default_rng([17, seed])
        motion = drawn('swing', 2, rng)
        rate = pace * motion.parameters[-1]
        motion = motion._replace(parameters=np.r_[motion.parameters[:-1], rate])
        seconds = max(swings * 2.0 * np.pi / rate, least)
        times, seen = sighted(motion, rng, seconds=seconds, noise=noise, spacing=spacing)
        forecast = shown(times, seen, FORECASTS['harmonic']())
        ahead = times[-1] + np.arange(1.0, 6.0)
        error = np.linalg.norm(forecast.at(ahead) - motion(ahead), axis=1).max()
        assert error < within


@pytest.mark.parametrize('kind', FORECASTS)
@pytest.mark.parametrize(
    ('times', 'place'),
    [([3.0], [1.0, 2.0, 3.0]), (range(10), [4.0, -1.0]), ([1.0] * 3, [1.0, 1.0])],
)
def test_what_shows_no_motion_is_forecast_where_it_is(kind, times, place):
    """A goal seen once, at rest, or only at one stamp is held there."""
    forecast = shown(times, np.tile(place, (len(times), 1)), FORECASTS[kind]())
    assert np.allclose(forecast.at(times[-1] + np.arange(1.0, 6.0)), place, atol=1e-3)


# --- changes of course, and wrong sightings


@pytest.mark.parametrize(('rate', 'noise'), [(2.0, 0.02), (5.0, 0.05), (10.0, 0.05)])
@pytest.mark.parametrize('turned', [0.0, 0.5, 1.0], ids=['stops', 'turns', 'reverses'])
def test_a_second_after_a_change_of_course_the_new_one_is_known(turned, rate, noise):
    """For all sighting rates: the forecast is for three seconds ahead, at speeds of up to 3 m/s."""
    missed = []
    for seed in range(10):
        rng = np.random.default_rng([15, seed])
        speed, angle = rng.uniform(0.3, 3.0), rng.uniform(-np.pi, np.pi)
        old = speed * np.array([np.cos(angle), np.sin(angle)])
        new = bool(turned) * exp(np.array([np.pi * turned])) @ old
        since = np.arange(-rng.uniform(4.0, 10.0), 1.0, 1.0 / rate)[:, None]
        seen = np.where(since < 0.0, since * old, since * new)
        seen = seen + noise * rng.normal(size=seen.shape)
        bank = shown(CHANGED + since[:, 0], seen)
        missed.append(np.linalg.norm(bank.at(np.array([CHANGED + 4.0]))[0] - 4.0 * new))
    assert np.quantile(missed, 0.9) < 3.5


def test_no_forecast_is_faster_than_what_was_seen():
    rng = np.random.default_rng(16)
    for n, rate in ((2, 2.0), (3, 10.0)):
        bank, place, velocity, fastest = Bank(), np.zeros(n), np.zeros(n), 0.0
        for k in range(200):
            if rng.uniform() < 0.1:
                velocity = rng.uniform(0.0, 3.0) * rng.normal(size=n)
            fastest = max(fastest, float(np.linalg.norm(velocity)))
            place = place + velocity / rate
            time = START + k / rate
            bank.observe(GoalObservation(time, place.copy()))
            ahead = bank.at(time + np.array([0.0, 1.0, 4.0]))
            moved = np.linalg.norm(ahead - ahead[0], axis=1)
            assert (moved <= fastest * np.array([0.0, 1.0, 4.0]) + 1e-6).all()


def test_a_swing_that_becomes_another_is_known_soon():
    """The arc since the change is bent: neither rest nor a straight line explains it."""
    errors = []
    for seed in range(16):
        rng = np.random.default_rng([14, seed])
        before, other = drawn('swing', 2, rng), drawn('swing', 2, rng)
        offset = before([CHANGED]) - other([CHANGED])
        times, seen = sighted(before, rng, seconds=12.0 + SOON)
        new = times >= CHANGED
        seen[new] = other(times[new]) + offset
        ahead = times[-1:] + AHEAD
        errors.append(np.linalg.norm(shown(times, seen).at(ahead) - other(ahead) - offset))
    assert np.median(errors) < 0.15  # [m], of swings of several metres


@pytest.mark.parametrize('pace', [(1.0, 0.1, 3.0), (1.0, 0.4, 0.5), (0.2, 1.0, 1.0)])
def test_a_swing_seen_seldom_is_no_series_of_changes(pace):
    spacing, frequency, size = pace
    times, noise = START + spacing * np.arange(35.0), np.random.default_rng(21).normal(size=(30, 2))
    swing = size * np.sin(2.0 * np.pi * frequency * times[:, None] + [0.4, 2.0])
    forecast = shown(times[:30], swing[:30] + 0.02 * noise).at(times[30:])
    np.testing.assert_allclose(forecast, swing[30:], atol=0.1)


def test_an_outlier_is_no_velocity():
    rng = np.random.default_rng(8)
    times, seen = sighted(drawn('carrier', 2, rng), rng, noise=0.02)
    ahead = times[-1] + np.arange(0.0, 4.0)
    without = shown(np.delete(times, 100), np.delete(seen, 100, axis=0)).at(ahead)
    seen[100] += [100.0, -50.0]
    np.testing.assert_allclose(shown(times, seen).at(ahead), without, atol=0.02)
    another = np.r_[times, times[-1] + 0.1], np.vstack([seen, seen[-1] + 100.0])
    np.testing.assert_allclose(shown(*another).at(ahead), without, atol=1e-9)


def test_a_goal_that_stays_elsewhere_is_believed_to_be_there():
    times = START + 0.1 * np.arange(50)
    bank, there = shown(times, np.zeros((50, 3))), np.full((BELIEVED, 3), 40.0)
    later = times[-1] + 0.1 * np.arange(1, BELIEVED + 1)
    shown(later[:-1], there[:-1], bank)
    np.testing.assert_allclose(bank.at(later), 0.0, atol=1e-6)
    shown(later[-1:], there[-1:], bank)
    np.testing.assert_allclose(bank.at(later + AHEAD), 40.0, atol=1e-3)


def test_what_noise_sightings_have_is_not_forgotten_with_the_motion():
    """Three sightings that agree by chance are not taken for exact after a hundred noisy ones."""
    rng = np.random.default_rng(13)
    times, seen = START + 0.1 * np.arange(100), 0.2 * rng.normal(size=(100, 2))
    seen[-BELIEVED:] = 40.0
    bank, fresh = shown(times, seen), shown(times[-BELIEVED:], seen[-BELIEVED:])
    np.testing.assert_allclose([bank.at(times[-1:]), fresh.at(times[-1:])], 40.0, atol=1e-6)
    for each in (bank, fresh):  # off by 1.5 standard deviations
        shown(times[-1:] + 0.1, seen[-1:] + 0.3, each)
    assert bank.at(times[-1:] + 0.1)[0, 0] > 40.01
    np.testing.assert_allclose(fresh.at(times[-1:] + 0.1), 40.0, atol=1e-6)


def test_two_sightings_at_once_are_no_velocity():
    """A centimetre within a microsecond must not become a velocity of 10 km/s."""
    times = START + np.array([0.0, 1e-6, 0.1, 0.100001])
    seen = np.array([[0.0, 0.0], [0.01, 0.0], [0.0, 0.01], [0.01, 0.01]])
    assert np.abs(shown(times, seen).at(START + np.arange(4.0))).max() < 1.0


@pytest.mark.parametrize('later', [0.0, -5.0, 4.9], ids=['first again', 'before', 'last again'])
def test_what_is_no_news_says_nothing(later):
    rng = np.random.default_rng(9)
    times, seen = START + 0.1 * np.arange(50), 0.02 * rng.normal(size=(50, 2))
    bank, ahead = shown(times, seen), START + np.arange(5.0, 9.0)
    before = bank.at(ahead)
    bank.observe(GoalObservation(START + later, np.full(2, 9.0)))
    np.testing.assert_array_equal(bank.at(ahead), before)


def test_a_goal_lost_for_long_is_held_where_it_is_seen_again():
    times = START + 0.1 * np.arange(50)
    bank = shown(times, np.outer(times - START, [1.0, 0.0]))
    shown([START + 1e6], np.array([[7.0, 7.0]]), bank)
    np.testing.assert_allclose(bank.at(START + 1e6 + np.arange(3.0)), 7.0, atol=1e-9)


@pytest.mark.parametrize('seed', range(2))
def test_who_is_watched_for_long_is_as_well_known_when_the_oldest_sightings_are_dropped(seed):
    """With noise, the fit is still being refined when the oldest sightings are dropped."""
    rng = np.random.default_rng([18, seed])
    motion, times = drawn('turn', 2, rng), START + 0.05 * np.arange(MEMORY + 10)
    seen = motion(times) + 0.05 * rng.normal(size=(len(times), 2))
    bank = shown(times[: MEMORY - 1], seen[: MEMORY - 1])
    for time, place in zip(times[MEMORY - 1 :], seen[MEMORY - 1 :], strict=True):
        shown([time], [place], bank)
        ahead = np.array([time + AHEAD])
        assert np.linalg.norm(bank.at(ahead) - motion(ahead)) < 0.05


@pytest.mark.parametrize('seed', range(8))
def test_whatever_is_seen_forecasts_are_finite(seed):
    """After jumps, gaps, bursts, equal and backward stamps, and positions as far as messages go."""
    rng = np.random.default_rng([11, seed])
    n, bank = 2 + seed % 2, Bank()
    time, place = START, np.zeros(n)
    bank.observe(GoalObservation(time, place.copy()))
    for _ in range(400):
        time += rng.choice(
            [0.0, -1.0, 1e-9, 0.05, 0.1, 1.0, 30.0, 1e7], p=[*[0.05] * 3, 0.3, 0.4, *[0.05] * 3]
        )
        far = rng.choice([0.0, 0.1, 30.0, 1e7], p=[0.5, 0.4, 0.08, 0.02])
        place = np.clip(place + far * rng.normal(size=n), -1e7, 1e7)
        wrong = rng.choice([0.0, -1e7, 1e7], p=[0.91, 0.045, 0.045])
        bank.observe(GoalObservation(time, np.clip(place + wrong, -1e7, 1e7)))
        ahead = bank.at(max(time, START) + np.array([0.0, 3.0]))
        assert np.isfinite(ahead).all()


# --- paths

EAST, NORTH = np.eye(2)
SPEED = 20.0
LINE = Route(np.array([[-1e4, 0.0], [1e4, 0.0]]))
TIMES = np.arange(1.0, 9.0)


def circle(radius=200.0, count=361):
    angles = np.linspace(0.0, 2.0 * math.pi, count)
    points = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    points[-1] = points[0]
    return Route(points)


def pursued(route, begin=0.0, wind=(0.0, 0.0), times=TIMES, max_rate=0.3):
    """Return the goal's positions along a path at times, from 0 on, and the trouble reported."""
    pace = np.append(0.0, times), SPEED, np.array(wind)
    along = route.paced(begin, *pace)
    return route.place(along[1:]), route.trouble(along, *pace, max_rate)


@pytest.mark.parametrize('wind', [(0.0, 0.0), (5.0, 0.0), (-12.0, 9.0), (0.0, 19.0), (-19.0, 2.0)])
def test_the_goal_moves_at_the_airspeed_in_the_wind(wind):
    times = np.linspace(0.01, 60.0, 6000)
    for route, begin, near in ((LINE, 1e4, 1e-9), (circle(), 0.0, 0.02)):
        places, _ = pursued(route, begin, wind, times)
        through_air = np.diff(places, axis=0) / 0.01 - wind
        np.testing.assert_allclose(np.linalg.norm(through_air, axis=1), SPEED, rtol=near)
    assert pursued(LINE, 1e4, wind)[1] == ''


@pytest.mark.parametrize('wind', [(-24.0, 0.0), (0.0, 24.0), (-20.0, -1.0)])
def test_what_the_wind_does_not_allow_is_said_and_waits(wind):
    places, trouble = pursued(LINE, 1e4, wind)
    np.testing.assert_allclose(places, np.zeros((8, 2)), atol=1e-6)
    assert trouble.startswith('the path cannot be followed in a wind of 2')


def test_a_corner_that_is_too_sharp_is_said():
    corner = Route(np.array([[0.0, 0.0], [100.0, 0.0], [100.0, 500.0]]))
    assert 'rounded off' in pursued(corner, 20.0)[1]
    assert pursued(corner, 20.0, times=TIMES[:2])[1] == ''  # the corner is later
    assert pursued(circle(), max_rate=0.12)[1] == ''


def test_the_nearest_point_is_looked_for_along_the_way():
    eight = Route(np.array([[0.0, -50.0], [0.0, 50.0], [80.0, 50.0], [80.0, 0.0], [-80.0, 0.0]]))
    crossing = np.array([1.0, 0.5])  # nearest to the later of two crossing segments
    assert eight.nearest(crossing) == pytest.approx(50.0 + 50.0 + 80.0 + 50.0 + 79.0)
    assert eight.nearest(crossing, near=40.0, within=60.0) == pytest.approx(50.5)
    around = circle()
    assert around.nearest(np.array([200.0, -1.0]), near=1.0, within=50.0) > 1200.0


def test_an_open_path_ends_and_a_closed_one_goes_on():
    short = Route(np.array([[0.0, 0.0], [30.0, 0.0]]))
    np.testing.assert_allclose(pursued(short, times=np.array([5.0]))[0], [[30.0, 0.0]])
    around, _ = pursued(circle(), times=np.array([20.0 * math.pi]))
    np.testing.assert_allclose(around[0], circle().positions[0], atol=0.5)


def flown(route, wind, seconds, place=(0.0, 60.0), heading=0.0):
    """Return positions and final axis of a wing without lags on a route, and the last decision."""
    limits = {'forward': SPEED, 'floor': Floor('circle', fraction=0.8), 'max_rate': 0.4}
    problem = Problem(horizon=10, step=0.5, discretisation='exact', **limits)
    planner = Planner(problem, estimated=True, velocity_source='air')
    place, turned, places = np.array(place), exp(np.array([heading])), []
    for time in np.arange(0.0, seconds, 0.5):
        measured = Odometry(time, place, turned, np.array([SPEED, 0.0]), np.zeros(1))
        snapshot = Snapshot(measured, route, wind=WindReport(time, wind, 0.01))
        decision = planner.step(snapshot, time)
        planner.sent(decision.command, time)
        for _ in range(10):
            turned = turned @ exp(0.05 * decision.command.body_rate)
            place = place + 0.05 * (SPEED * turned[:, 0] + wind)
            places.append(place)
    return np.array(places), turned[:, 0], decision


@pytest.mark.parametrize('share', [0.0, 0.6, 0.9])
def test_a_line_is_followed_in_wind(share):
    places, _, decision = flown(LINE, share * SPEED * np.array([-0.6, 0.8]), 60.0)
    assert np.abs(places[-200:, 1]).max() < 1.0
    assert places[-1, 0] > places[-200, 0] + 10.0  # and moves along it
    assert 'cannot be followed' not in decision.reason


def test_a_wind_beyond_the_airspeed_is_said_and_flown_into():
    places, axis, decision = flown(LINE, 1.2 * SPEED * -EAST, 60.0)
    assert 'the path cannot be followed in a wind of 24 m/s' in decision.reason
    assert axis @ EAST > 0.95
    drift = (places[-1] - places[-200]) / 10.0
    assert np.linalg.norm(drift) < 0.2 * SPEED + 0.5  # the least possible: wind minus airspeed
