"""Laws of the wind: its statistics are those asked for, and a seed brings it again."""

import numpy as np
import pytest

from orbimpc_ros.world.air import Air

LONG = 40_000.0  # [s]


def series(air, every=0.5):
    return np.array([air.at(t) for t in np.arange(0.0, LONG, every)])


@pytest.mark.parametrize('memory', [0.5, 3.0])
def test_gusts_have_the_deviation_and_the_memory_asked_for(memory):
    """Within four standard errors of estimates from as many independent gusts as there were."""
    gusts = series(Air(np.array([3.0, -1.0]), 1.5, memory, 7))
    error = 4.0 * np.sqrt(2.0 * memory / LONG)
    np.testing.assert_allclose(gusts.mean(axis=0), [3.0, -1.0], atol=1.5 * error)
    blown = (gusts - gusts.mean(axis=0)) / 1.5
    np.testing.assert_allclose(blown.var(axis=0), 1.0, atol=error + 0.02 / memory)
    later = round(memory / 0.5)
    correlation = (blown[later:] * blown[:-later]).mean(axis=0)
    np.testing.assert_allclose(correlation, np.exp(-1.0), atol=error)
    assert abs((blown[:, 0] * blown[:, 1]).mean()) < error


def test_the_first_gust_is_as_strong_as_any():
    begun = np.array([Air(np.zeros(3), 2.0, 5.0, seed).at(0.0) for seed in range(400)])
    assert begun.std() == pytest.approx(2.0, rel=4.0 / np.sqrt(2 * begun.size))


def test_a_seed_brings_the_same_gusts_in_whatever_order_they_are_asked_for():
    times = np.random.default_rng(1).uniform(0.0, 100.0, size=200)
    air, again = Air(np.zeros(2), 1.0, 3.0, 5), Air(np.zeros(2), 1.0, 3.0, 5)
    first = {t: air.at(t) for t in times}
    for t in sorted(times):
        np.testing.assert_array_equal(again.at(t), first[t])
    assert not np.allclose(Air(np.zeros(2), 1.0, 3.0, 6).at(1.0), air.at(1.0))


def test_gusts_never_jump():
    """Not between samples either, nor where one block of them ends: as rough as their law says."""
    air = Air(np.zeros(2), 1.0, 3.0, 5)
    steps = np.diff([air.at(t) for t in np.arange(0.0, 100.0, 0.01)], axis=0)
    assert np.abs(steps).max() < 5.0 * np.sqrt(2.0 * 0.02 / 3.0)


def test_without_gusts_the_wind_is_steady():
    np.testing.assert_array_equal(Air(np.array([1.0, 2.0])).at(17.3), [1.0, 2.0])
