# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Forecasts of a swinging goal: how far off they are, and when."""

import numpy as np
import pytest

from orbimpc_ros.loop.goal.forecast import FORECASTS
from orbimpc_ros.loop.goal.motion import GoalObservation

AHEAD = np.arange(1.0, 6.0)


def swing(rng, n=2, frequency=None):
    frequency = rng.uniform(0.02, 0.3) if frequency is None else frequency
    centre, amplitude = rng.normal(size=n) * 5, rng.uniform(0.3, 0.7, size=n)
    phase = rng.uniform(0, 2 * np.pi, size=n)

    def at(t):
        return centre + amplitude * np.sin(2 * np.pi * frequency * np.asarray(t)[..., None] + phase)

    return at, frequency


def error_after(forecast, rope, rng, *, seconds, noise=0.0, lost=0.0, spacing=1.0, start=100.0):
    """Return the largest error [m] of the next five seconds' forecast after watching a while."""
    times = start + np.arange(0.0, seconds + spacing / 2, spacing)
    kept = rng.uniform(size=len(times)) >= lost
    kept[[0, -1]] = True
    for t in times[kept]:
        forecast.observe(GoalObservation(t, rope(t) + noise * rng.normal(size=2)))
    ahead = times[-1] + AHEAD
    return np.linalg.norm(forecast.at(ahead) - rope(ahead), axis=1).max()


@pytest.mark.parametrize('seed', range(20))
def test_harmonic_knows_a_swing_after_seeing_it_once(seed):
    rng = np.random.default_rng(seed)
    rope, frequency = swing(rng)
    seconds = max(1.0 / frequency, 6.0)
    assert error_after(FORECASTS['harmonic'](), rope, rng, seconds=seconds) < 0.01


@pytest.mark.parametrize('seed', range(20))
def test_harmonic_stands_noise_and_dropouts(seed):
    """2 cm of noise and a fifth of the sightings lost: within a capture radius of 0.15 m."""
    rng = np.random.default_rng(seed)
    rope, frequency = swing(rng)
    error = error_after(
        FORECASTS['harmonic'](),
        rope,
        rng,
        seconds=max(1.3 / frequency, 20),
        noise=0.02,
        lost=0.2,
    )
    assert error < 0.15


def test_harmonic_beats_the_others_over_many_swings():
    errors = {kind: [] for kind in FORECASTS}
    for seed in range(40):
        for kind, found in errors.items():
            rng = np.random.default_rng(seed)
            rope, _ = swing(rng)
            found.append(error_after(FORECASTS[kind](), rope, rng, seconds=12, noise=0.01))
    median = {kind: np.median(found) for kind, found in errors.items()}
    assert median['harmonic'] < 0.2 * min(median['hold'], median['velocity'])


@pytest.mark.parametrize('kind', FORECASTS)
def test_one_sighting_is_held(kind):
    forecast = FORECASTS[kind]()
    forecast.observe(GoalObservation(3.0, np.array([1.0, 2.0, 3.0])))
    assert np.allclose(forecast.at(3.0 + AHEAD), [1.0, 2.0, 3.0], atol=1e-6)


@pytest.mark.parametrize('kind', FORECASTS)
def test_a_goal_at_rest_is_forecast_at_rest(kind):
    forecast = FORECASTS[kind]()
    for t in range(10):
        forecast.observe(GoalObservation(float(t), np.array([4.0, -1.0])))
    assert np.allclose(forecast.at(9.0 + AHEAD), [4.0, -1.0], atol=1e-3)


@pytest.mark.parametrize('kind', FORECASTS)
def test_reset_forgets(kind):
    forecast = FORECASTS[kind]()
    for t in range(5):
        forecast.observe(GoalObservation(float(t), np.array([float(t), 0.0])))
    forecast.reset()
    forecast.observe(GoalObservation(0.0, np.array([7.0, 7.0])))
    assert np.allclose(forecast.at(AHEAD), [7.0, 7.0], atol=1e-6)


def test_velocity_goes_straight_on():
    forecast = FORECASTS['velocity']()
    for t in (0.0, 1.0, 2.0):
        forecast.observe(GoalObservation(t, np.array([1.0 + 0.5 * t, -t])))
    assert np.allclose(forecast.at(np.array([4.0])), [[3.0, -4.0]])


def test_fast_sightings_resolve_fast_swings():
    rng = np.random.default_rng(0)
    rope, _ = swing(rng, frequency=1.4)
    error = error_after(FORECASTS['harmonic'](), rope, rng, seconds=3.0, spacing=0.05)
    assert error < 0.05


def test_repeated_stamps_do_not_break_a_forecast():
    for kind in FORECASTS:
        forecast = FORECASTS[kind]()
        for _ in range(3):
            forecast.observe(GoalObservation(1.0, np.array([1.0, 1.0])))
        assert np.allclose(forecast.at(1.0 + AHEAD), 1.0, atol=1e-3)
