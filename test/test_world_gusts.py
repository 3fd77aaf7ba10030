# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Laws of gusts: their statistics are those asked for, and a seed brings them again."""

import numpy as np
import pytest

from orbimpc_ros.sim.plant import Gusts

LONG = 10_000.0  # [s]


def series(gusts, every=0.5):
    return np.array([gusts.at(t, 2) for t in np.arange(0.0, LONG, every)])


@pytest.mark.parametrize('memory', [0.5, 3.0])
def test_gusts_have_the_deviation_and_the_memory_asked_for(memory):
    """Within four standard errors of estimates from as many independent gusts as there were."""
    blown = series(Gusts(1.5, memory, 7)) / 1.5
    error = 4.0 * np.sqrt(2.0 * memory / LONG)
    np.testing.assert_allclose(blown.mean(axis=0), 0.0, atol=error)
    np.testing.assert_allclose(blown.var(axis=0), 1.0, atol=error + 0.02 / memory)
    later = round(memory / 0.5)
    correlation = (blown[later:] * blown[:-later]).mean(axis=0)
    np.testing.assert_allclose(correlation, np.exp(-1.0), atol=error)
    assert abs((blown[:, 0] * blown[:, 1]).mean()) < error


def test_the_first_gust_is_as_strong_as_any():
    begun = np.array([Gusts(2.0, 5.0, seed).at(0.0, 3) for seed in range(400)])
    assert begun.std() == pytest.approx(2.0, rel=4.0 / np.sqrt(2 * begun.size))


def test_a_seed_brings_the_same_gusts_in_whatever_order_they_are_asked_for():
    times = np.random.default_rng(1).uniform(0.0, 100.0, size=200)
    gusts, again = Gusts(1.0, 3.0, 5), Gusts(1.0, 3.0, 5)
    first = {t: gusts.at(t, 2) for t in times}
    for t in sorted(times):
        np.testing.assert_array_equal(again.at(t, 2), first[t])
    assert not np.allclose(Gusts(1.0, 3.0, 6).at(1.0, 2), gusts.at(1.0, 2))


def test_gusts_never_jump():
    """Not between samples either, nor where one block of them ends: as rough as their law says."""
    gusts = Gusts(1.0, 3.0, 5)
    steps = np.diff([gusts.at(t, 2) for t in np.arange(0.0, 100.0, 0.01)], axis=0)
    assert np.abs(steps).max() < 5.0 * np.sqrt(2.0 * 0.02 / 3.0)
