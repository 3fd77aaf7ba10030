# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The score of each controller: rates, times and costs over all runs of a study."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from orbimpc_ros.mpc.arrays import Array

BINS = 7  # of frequencies


@dataclass(frozen=True)
class Score:
    """One controller over all runs, in their order.

    Attributes:
        name: of the controller.
        caught: for each run whether, shape (runs,).
        ticks: for each run the ticks to the catch, inf without one, shape (runs,).
        flown: ticks of all runs together.
        closest: for each run the least distance [m], shape (runs,).
        turned: for each run the sum of angles turned [rad], shape (runs,).
        tick_ms: of every tick [ms].
        forecast_ms: of every tick [ms].
        certified: share of ticks that were proved optimal.
        fallbacks: ticks without a plan of their own.
        loss: largest projection loss of a step [m]; NaN without plans.
        compared: ticks that IPOPT solved as well.
        excess: largest relative cost above IPOPT's; NaN where nothing was compared.
        cheaper: ticks of these that IPOPT solved at a higher cost.
    """

    name: str
    caught: np.ndarray
    ticks: Array
    flown: int
    closest: Array
    turned: Array
    tick_ms: Array
    forecast_ms: Array
    certified: float
    fallbacks: int
    loss: float
    compared: int
    excess: float
    cheaper: int

    @property
    def rate(self) -> float:
        """Return the share of runs with a catch."""
        return float(self.caught.mean())

    def within(self, share: float) -> float:
        """Return the ticks within which a share of all runs was caught; inf if never."""
        return float(np.quantile(self.ticks, share, method='higher'))


def scores(rows: pa.Table, names: Sequence[str]) -> dict[str, Score]:
    """Return the scores by controller.

    Args:
        rows: of a complete study, run by run.
        names: of the controllers.
    """
    return {name: _score(name, rows.filter(pc.field('controller') == name)) for name in names}


def _score(name: str, rows: pa.Table) -> Score:
    caught, ticks = _numbers(rows, 'caught').astype(bool), _numbers(rows, 'ticks')
    flown = int(ticks.sum())
    return Score(
        name=name,
        caught=caught,
        ticks=np.where(caught, ticks, np.inf),
        flown=flown,
        closest=_numbers(rows, 'closest'),
        turned=_numbers(rows, 'turned'),
        tick_ms=_all(rows, 'tick_ms'),
        forecast_ms=_all(rows, 'forecast_ms'),
        certified=float(_numbers(rows, 'certified').sum() / flown),
        fallbacks=int(_numbers(rows, 'fallbacks').sum()),
        loss=_largest(rows, 'projection_loss'),
        compared=int(_numbers(rows, 'compared').sum()),
        excess=_largest(rows, 'excess'),
        cheaper=int(_numbers(rows, 'cheaper').sum()),
    )


def _numbers(rows: pa.Table, name: str) -> Array:
    return np.asarray(rows[name].to_numpy(), dtype=float)


def _all(rows: pa.Table, name: str) -> Array:
    return np.asarray(pc.list_flatten(rows[name]).to_numpy(), dtype=float)


def _largest(rows: pa.Table, name: str) -> float:
    found = pc.max(rows[name]).as_py()
    return float('nan') if found is None else found


def versus(ours: Score, theirs: Score) -> tuple[float, float, float]:
    """Return the shares of runs in which ours caught sooner, as soon, and later.

    A run that neither caught counts as alike.
    """
    sooner = float(np.mean(ours.ticks < theirs.ticks))
    later = float(np.mean(ours.ticks > theirs.ticks))
    return sooner, 1.0 - sooner - later, later


def frequencies(rows: pa.Table, name: str) -> Array:
    """Return the frequency that each run drew, shape (runs,) [Hz]."""
    return _numbers(rows.filter(pc.field('controller') == name), 'rope.frequency')


def rate_over(frequency: Array, caught: np.ndarray) -> tuple[Array, Array]:
    """Return bins of frequency that have runs: their middles [Hz] and their catch rates."""
    edges = np.linspace(frequency.min(), frequency.max(), BINS + 1)
    place = np.clip(np.searchsorted(edges, frequency, side='right') - 1, 0, BINS - 1)
    counts = np.bincount(place, minlength=BINS)
    full = counts > 0
    catches = np.bincount(place, caught.astype(float), minlength=BINS)
    return (0.5 * (edges[1:] + edges[:-1]))[full], catches[full] / counts[full]
