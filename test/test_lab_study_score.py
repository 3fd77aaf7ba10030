# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The scores of a study: rates, times and duels of runs that are known."""

import numpy as np
import pytest

pytest.importorskip('pyarrow', reason="no pyarrow: pip install 'orbimpc_ros[study]'")

import pyarrow as pa

from orbimpc_ros.lab.study.score import BINS, frequencies, rate_over, scores, versus

INF = np.inf


def rows(name, ticks, **changes):
    """Return one row for each run; 0 ticks stand for none caught within 60."""
    for run, each in enumerate(ticks):
        flown = each or 60
        yield {
            'run': run,
            'controller': name,
            'caught': bool(each),
            'ticks': flown,
            'rope.frequency': 0.1 * run,
            'closest': 0.1 if each else 2.5,
            'turned': 1.0,
            'tick_ms': [float(run)] * flown,
            'forecast_ms': [1.0] * flown,
            'certified': flown - 1,
            'fallbacks': 1,
            'projection_loss': None,
            'compared': flown,
            'excess': -0.1 * run,
            'cheaper': 1,
        } | changes


def scored(**flights):
    table = pa.Table.from_pylist([row for name, t in flights.items() for row in rows(name, t)])
    return scores(table, list(flights)), table


def test_a_score_counts_what_was_flown():
    found, table = scored(ours=[5, 7, 0, 9], theirs=[5, 8, 60, 4])
    ours = found['ours']
    assert ours.rate == 0.75
    assert ours.ticks.tolist() == [5, 7, INF, 9]
    assert ours.flown == 81
    assert ours.certified == pytest.approx(77 / 81)
    assert (ours.fallbacks, ours.compared, ours.cheaper) == (4, 81, 4)
    assert ours.excess == 0.0
    assert np.isnan(ours.loss)
    assert ours.closest.max() == 2.5
    assert len(ours.tick_ms) == 81
    assert frequencies(table, 'ours').tolist() == pytest.approx([0.0, 0.1, 0.2, 0.3])


def test_a_time_that_no_majority_reaches_is_never():
    found, _ = scored(ours=[5, 7, 0, 9], theirs=[0, 0, 0, 4])
    assert found['ours'].within(0.5) == 9
    assert found['ours'].within(0.9) == INF
    assert found['theirs'].within(0.5) == INF


def test_duels_are_counted_run_by_run():
    found, _ = scored(ours=[5, 7, 0, 9, 0], theirs=[5, 8, 60, 4, 0])
    assert versus(found['ours'], found['theirs']) == pytest.approx((0.2, 0.4, 0.4))
    assert versus(found['theirs'], found['ours']) == pytest.approx((0.4, 0.4, 0.2))


def test_rates_go_by_frequency():
    frequency = np.linspace(0.0, 0.7, 701)
    middles, rates = rate_over(frequency, frequency < 0.35)
    assert middles == pytest.approx(np.arange(0.05, 0.7, 0.1))
    assert rates == pytest.approx([1, 1, 1, 0.5, 0, 0, 0], abs=0.01)
    assert len(middles) == BINS


def test_one_frequency_is_one_bin():
    middles, rates = rate_over(np.full(4, 0.1), np.array([True, False, True, True]))
    assert middles == pytest.approx([0.1])
    assert rates == pytest.approx([0.75])
