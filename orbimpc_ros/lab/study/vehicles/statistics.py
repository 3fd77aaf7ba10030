# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Intervals and paired tests: Wilson for shares, bootstrap for times, the sign test for pairs."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy import stats

from orbimpc_ros.mpc.arrays import Array

CONFIDENCE = 0.95
DRAWS, SEED = 2000, 0
Interval = tuple[float, float]


def wilson(successes: int, count: int) -> Interval:
    """Return the interval of a share by Wilson's score."""
    z = float(stats.norm.ppf(0.5 + 0.5 * CONFIDENCE))
    share, weight = successes / count, z * z / count
    middle = (share + 0.5 * weight) / (1.0 + weight)
    half = z * math.sqrt(share * (1.0 - share) / count + 0.25 * weight / count) / (1.0 + weight)
    return max(0.0, middle - half), min(1.0, middle + half)


def of_mean(values: Array) -> Interval:
    """Return the interval of a mean, such as that of paired differences, by bootstrap."""
    rng = np.random.default_rng(SEED)
    means = rng.choice(values, (DRAWS, len(values))).mean(axis=1)
    low, high = np.quantile(means, [0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE])
    return float(low), float(high)


def of_ratio(statistic: Callable[..., Array], ours: Array, theirs: Array) -> Interval:
    """Return the interval of the ratio of a statistic of paired values, by bootstrap of the pairs.

    Args:
        statistic: such as ``np.median``, of the last axis.
        ours: shape (M,).
        theirs: shape (M,), above 0.
    """
    drawn = np.random.default_rng(SEED).integers(len(ours), size=(DRAWS, len(ours)))
    ratios = statistic(ours[drawn], axis=1) / statistic(theirs[drawn], axis=1)
    low, high = np.quantile(ratios, [0.5 - 0.5 * CONFIDENCE, 0.5 + 0.5 * CONFIDENCE])
    return float(low), float(high)


def sign_test(differences: Array) -> float:
    """Return how probable so one-sided a set of paired differences is, were both alike."""
    less, more = int((differences < 0.0).sum()), int((differences > 0.0).sum())
    if less + more == 0:
        return 1.0
    return float(stats.binomtest(less, less + more).pvalue)
