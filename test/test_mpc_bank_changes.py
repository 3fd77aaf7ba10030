# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Goals that change their course, and sightings that are wrong: what the bank makes of them."""

import numpy as np
import pytest
from bank_motions import AHEAD, START, drawn, shown, sighted

from orbimpc_ros.loop.goal.bank import BELIEVED, MEMORY, Bank
from orbimpc_ros.loop.goal.motion import GoalObservation

CHANGED = START + 12.0  # [s]
SOON = 2.0  # [s] within which a change of course is to be known


@pytest.mark.parametrize(('rate', 'noise'), [(2.0, 0.02), (5.0, 0.05), (10.0, 0.05)])
@pytest.mark.parametrize('turned', [0.0, 0.5, 1.0], ids=['stops', 'turns', 'reverses'])
def test_a_second_after_a_change_of_course_the_new_one_is_known(turned, rate, noise):
    """However seldom the goal is seen: up to 3 m/s, three seconds ahead."""
    missed = []
    for seed in range(20):
        rng = np.random.default_rng([15, seed])
        speed, angle = rng.uniform(0.3, 3.0), rng.uniform(-np.pi, np.pi)
        old = speed * np.array([np.cos(angle), np.sin(angle)])
        new = speed * np.array([np.cos(angle + np.pi * turned), np.sin(angle + np.pi * turned)])
        new = new if turned else np.zeros(2)
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
    """What there is of it in a second is neither still nor straight, but bent."""
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
    assert np.median(errors) < 0.15  # of swings of some metres


def test_an_outlier_is_no_velocity():
    rng = np.random.default_rng(8)
    times, seen = sighted(drawn('carrier', 2, rng), rng, noise=0.02)
    ahead = times[-1] + np.arange(0.0, 4.0)
    without = shown(np.delete(times, 100), np.delete(seen, 100, axis=0)).at(ahead)
    seen[100] += [100.0, -50.0]
    np.testing.assert_allclose(shown(times, seen).at(ahead), without, atol=0.02)
    last = np.vstack([seen, seen[-1] + 100.0])
    np.testing.assert_allclose(
        shown(np.r_[times, times[-1] + 0.1], last).at(ahead), without, atol=1e-9
    )


def test_a_goal_that_stays_elsewhere_is_believed_to_be_there():
    times = START + 0.1 * np.arange(50)
    bank, there = shown(times, np.zeros((50, 3))), np.full((BELIEVED, 3), 40.0)
    later = times[-1] + 0.1 * np.arange(1, BELIEVED + 1)
    shown(later[:-1], there[:-1], bank)
    np.testing.assert_allclose(bank.at(later), 0.0, atol=1e-6)
    shown(later[-1:], there[-1:], bank)
    np.testing.assert_allclose(bank.at(later + AHEAD), 40.0, atol=1e-3)


def test_what_noise_sightings_have_is_not_forgotten_with_the_motion():
    """Three sightings that agree by chance are not exact, for the hundred before were not."""
    rng = np.random.default_rng(13)
    times, seen = START + 0.1 * np.arange(100), 0.2 * rng.normal(size=(100, 2))
    seen[-BELIEVED:] = 40.0
    bank, fresh = shown(times, seen), shown(times[-BELIEVED:], seen[-BELIEVED:])
    np.testing.assert_allclose([bank.at(times[-1:]), fresh.at(times[-1:])], 40.0, atol=1e-6)
    for each in (bank, fresh):  # a deviation and a half aside
        shown(times[-1:] + 0.1, seen[-1:] + 0.3, each)
    assert bank.at(times[-1:] + 0.1)[0, 0] > 40.01
    np.testing.assert_allclose(fresh.at(times[-1:] + 0.1), 40.0, atol=1e-6)


def test_two_sightings_at_once_are_no_velocity():
    """A nanosecond apart, a centimetre is no 10,000 km/s."""
    times = START + np.array([0.0, 1e-6, 0.1, 0.100001])
    seen = np.array([[0.0, 0.0], [0.01, 0.0], [0.0, 0.01], [0.01, 0.01]])
    assert np.abs(shown(times, seen).at(START + np.arange(4.0))).max() < 1.0


@pytest.mark.parametrize(
    'sighting',
    [
        GoalObservation(START + 1.0, np.array([np.nan, 0.0])),
        GoalObservation(START + 9.0, np.array([np.inf, 0.0])),
        GoalObservation(np.nan, np.zeros(2)),
        GoalObservation(np.inf, np.zeros(2)),
        GoalObservation(START, np.full(2, 9.0)),
        GoalObservation(START - 5.0, np.full(2, 9.0)),
        GoalObservation(START + 4.9, np.full(2, 9.0)),
    ],
    ids=['NaN', 'infinite', 'never', 'for ever', 'first again', 'before', 'last again'],
)
def test_what_is_no_news_says_nothing(sighting):
    rng = np.random.default_rng(9)
    times, seen = START + 0.1 * np.arange(50), 0.02 * rng.normal(size=(50, 2))
    bank, ahead = shown(times, seen), START + np.arange(5.0, 9.0)
    before = bank.at(ahead)
    bank.observe(sighting)
    np.testing.assert_array_equal(bank.at(ahead), before)


def test_a_goal_lost_for_long_is_held_where_it_is_seen_again():
    times = START + 0.1 * np.arange(50)
    bank = shown(times, np.outer(times - START, [1.0, 0.0]))
    shown([START + 1e6], np.array([[7.0, 7.0]]), bank)
    np.testing.assert_allclose(bank.at(START + 1e6 + np.arange(3.0)), 7.0, atol=1e-9)


@pytest.mark.parametrize('family', ['still', 'carrier', 'turn'])
def test_a_long_watch_loses_nothing(family):
    """Four times as many sightings as are kept: the forecast stays exact."""
    motion = drawn(family, 2, np.random.default_rng(10))
    times = START + 0.5 * np.arange(4 * MEMORY)
    bank, ahead = shown(times, motion(times)), times[-1] + np.arange(0.0, 4.0)
    np.testing.assert_allclose(bank.at(ahead), motion(ahead), atol=1e-3)
    assert bank.motion.model == family


@pytest.mark.parametrize('seed', range(8))
def test_whatever_is_seen_forecasts_are_finite(seed):
    """Jumps, gaps, bursts, equal and backward stamps, huge and NaN positions, in any order."""
    rng = np.random.default_rng([11, seed])
    n, bank = 2 + seed % 2, Bank()
    time, place = START, np.zeros(n)
    bank.observe(GoalObservation(time, place.copy()))
    for _ in range(400):
        time += rng.choice(
            [0.0, -1.0, 1e-9, 0.05, 0.1, 1.0, 30.0, 1e7], p=[*[0.05] * 3, 0.3, 0.4, *[0.05] * 3]
        )
        place = place + rng.choice([0.0, 0.1, 30.0, 1e9], p=[0.5, 0.4, 0.08, 0.02]) * rng.normal(
            size=n
        )
        wrong = rng.choice([0.0, np.nan, np.inf, 1e300], p=[0.91, 0.03, 0.03, 0.03])
        bank.observe(GoalObservation(time, place + wrong))
        ahead = bank.at(max(time, START) + np.array([0.0, 3.0]))
        assert np.isfinite(ahead).all()
