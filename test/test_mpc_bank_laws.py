# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Laws of the bank of goal models."""

import numpy as np
import pytest
from bank_motions import AHEAD, FAMILIES, drawn, shown, sighted

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
        assert bank.motion.model == family


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
@pytest.mark.parametrize('family', FAMILIES)
def test_forecasts_move_turn_and_wait_with_the_goal(family, n):
    rng = np.random.default_rng([4, n])
    times, seen = sighted(drawn(family, n, rng), rng, seconds=8.0, noise=0.02)
    ahead = times[-1] + np.arange(1.0, 4.0)
    turn, offset = exp(rng.normal(size=n * (n - 1) // 2)), 100.0 * rng.normal(size=n)
    before, after = shown(times, seen), shown(times + 64.0, seen @ turn.T + offset)
    assert before.motion.model == after.motion.model
    moved = before.at(ahead) @ turn.T + offset
    np.testing.assert_allclose(after.at(ahead + 64.0), moved, atol=1e-4)


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
