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
@pytest.mark.parametrize(
    ('noise', 'lost', 'swings', 'least', 'within'),
    [(0.0, 0.0, 1.0, 6.0, 0.01), (0.02, 0.2, 1.3, 20.0, 0.15)],
    ids=['exact', 'noise and dropouts'],
)
def test_harmonic_knows_a_swing_after_seeing_it_once(seed, noise, lost, swings, least, within):
    """With 2 cm of noise and a fifth of the sightings lost within a capture radius of 0.15 m."""
    rng = np.random.default_rng(seed)
    rope, frequency = swing(rng)
    known = {'seconds': max(swings / frequency, least), 'noise': noise, 'lost': lost}
    assert error_after(FORECASTS['harmonic'](), rope, rng, **known) < within


STILL = {
    'one sighting': ([3.0], [1.0, 2.0, 3.0]),
    'at rest': ([*range(10)], [4.0, -1.0]),
    'the same stamp again': ([1.0, 1.0, 1.0], [1.0, 1.0]),
}


@pytest.mark.parametrize('kind', FORECASTS)
@pytest.mark.parametrize(('times', 'place'), STILL.values(), ids=STILL)
def test_what_shows_no_motion_is_forecast_where_it_is(kind, times, place):
    """Also if it moved before a reset."""
    forecast = FORECASTS[kind]()
    for t in range(5):
        forecast.observe(GoalObservation(float(t), np.array([float(t), 0.0])))
    forecast.reset()
    for t in times:
        forecast.observe(GoalObservation(float(t), np.array(place)))
    assert np.allclose(forecast.at(times[-1] + AHEAD), place, atol=1e-3)


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
