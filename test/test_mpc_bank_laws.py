# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Laws of the bank of goal models: what it knows of each family, and how well it knows that."""

import numpy as np
import pytest
from bank_motions import AHEAD, FAMILIES, START, drawn, shown, sighted
from scipy.stats import chi2

from orbimpc_ros.loop.goal.bank import Bank
from orbimpc_ros.loop.goal.motion import GoalObservation
from orbimpc_ros.mpc.geometry.rotations import exp

SEEDS = range(10)


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('family', FAMILIES)
def test_every_family_is_recovered_exactly_without_noise(family, n):
    for seed in range(3):
        rng = np.random.default_rng([1, n, seed])
        motion = drawn(family, n, rng)
        times, seen = sighted(motion, rng)
        bank, ahead = shown(times, seen), times[-1] + np.arange(0.0, AHEAD + 0.1, 0.5)
        np.testing.assert_allclose(bank.at(ahead), motion(ahead), atol=1e-3)
        assert bank.model == family


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('family', FAMILIES)
def test_the_bank_is_as_good_as_the_family_that_fits(family, n):
    """At 5 cm of noise; the median over draws, 3 s ahead after 20 s of sightings."""
    errors = {'bank': [], 'oracle': []}
    for seed in SEEDS:
        rng = np.random.default_rng([2, n, seed])
        motion = drawn(family, n, rng)
        times, seen = sighted(motion, rng, noise=0.05)
        ahead = times[-1:] + AHEAD
        bank, oracle = shown(times, seen).at(ahead), motion.fitted(times, seen, ahead)
        errors['bank'].append(np.linalg.norm(bank - motion(ahead)))
        errors['oracle'].append(np.linalg.norm(oracle - motion(ahead)))
    assert np.median(errors['bank']) <= 1.3 * np.median(errors['oracle'])


@pytest.mark.parametrize('n', [2, 3])
def test_errors_are_as_large_as_the_covariance_says(n):
    """The squared error by the covariance is chi-squared, with n degrees of freedom a draw."""
    total, count = 0.0, 0
    for family in FAMILIES:
        for seed in SEEDS:
            rng = np.random.default_rng([3, n, seed])
            motion = drawn(family, n, rng)
            times, seen = sighted(motion, rng, noise=0.05)
            ahead = times[-1:] + AHEAD
            prediction = shown(times, seen).predicted(ahead)
            off = (prediction.positions - motion(ahead))[0]
            total += off @ np.linalg.solve(prediction.covariances[0], off)
            count += n
    assert chi2.ppf(1e-3, count) < total < chi2.ppf(1.0 - 1e-3, count)


def test_while_it_is_open_whether_a_goal_moves_the_covariance_covers_both():
    """After a second, of goals at rest and of slow ones: what the two differ by is part of it."""
    scaled = []
    for seed in range(100):
        rng = np.random.default_rng([12, seed])
        velocity, times = (seed % 2) * np.array([0.12, -0.05]), START + 0.1 * np.arange(10)
        seen = np.outer(times - START, velocity) + 0.05 * rng.normal(size=(10, 2))
        ahead = times[-1:] + AHEAD
        prediction = shown(times, seen).predicted(ahead)
        off = (prediction.positions - np.outer(ahead - START, velocity))[0]
        scaled.append(off @ np.linalg.solve(prediction.covariances[0], off) / len(off))
    assert np.median(scaled) < 1.3  # without what they differ by: 1.7


@pytest.mark.parametrize('n', [2, 3])
@pytest.mark.parametrize('family', FAMILIES)
def test_forecasts_move_turn_and_wait_with_the_goal(family, n):
    rng = np.random.default_rng([4, n])
    times, seen = sighted(drawn(family, n, rng), rng, seconds=8.0, noise=0.02)
    ahead = times[-1] + np.arange(1.0, 4.0)
    turn, offset = exp(rng.normal(size=n * (n - 1) // 2)), 100.0 * rng.normal(size=n)
    before, after = shown(times, seen), shown(times + 64.0, seen @ turn.T + offset)
    one, other = before.predicted(ahead), after.predicted(ahead + 64.0)
    assert one.model == other.model
    np.testing.assert_allclose(other.positions, one.positions @ turn.T + offset, atol=1e-4)
    np.testing.assert_allclose(
        other.covariances, turn @ one.covariances @ turn.T, rtol=1e-2, atol=1e-6
    )


@pytest.mark.parametrize('noise', [0.0, 0.05])
@pytest.mark.parametrize('n', [2, 3])
def test_covariances_are_covariances_and_grow(n, noise):
    rng = np.random.default_rng([5, n])
    times, seen = sighted(drawn('carrier', n, rng), rng, noise=noise)
    bank = Bank()
    for k in range(len(times)):
        shown(times[k : k + 1], seen[k : k + 1], bank)
        prediction = bank.predicted(times[k] + np.array([0.0, 1.0, 30.0]))
        spread = prediction.covariances
        np.testing.assert_allclose(spread, spread.swapaxes(1, 2), rtol=1e-6, atol=1e-12)
        assert (np.linalg.eigvalsh(spread) >= -1e-9).all()
        assert np.trace(spread[2]) >= np.trace(spread[0])
        np.testing.assert_array_equal(bank.at(np.array([START])), bank.at(np.array([START])))


def test_predictions_are_frozen():
    prediction = shown([START], np.zeros((1, 2))).predicted(START + np.arange(3.0))
    for array in (prediction.positions, prediction.covariances):
        with pytest.raises(ValueError, match='read-only'):
            array[0] = 1.0


def test_the_same_sightings_give_the_same_bits_whoever_asked_meanwhile():
    rng = np.random.default_rng(6)
    times, seen = sighted(drawn('swing', 3, rng), rng, noise=0.05)
    silent, asked, again = shown(times, seen), Bank(), Bank()
    for time, position in zip(times, seen, strict=True):
        asked.observe(GoalObservation(float(time), position.copy()))
        asked.at(time + np.arange(5.0))
    shown(times[:50], seen[:50] + 1.0, again).reset()
    shown(times, seen, again)
    ahead = times[-1] + np.arange(5.0)
    for other in (asked, again):
        np.testing.assert_array_equal(silent.at(ahead), other.at(ahead))
        np.testing.assert_array_equal(
            silent.predicted(ahead).covariances, other.predicted(ahead).covariances
        )
