# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The method of multipliers: its progress, its line search, and how stiff its penalty becomes.

What both engines of augmented Lagrangians share: :mod:`orbimpc_ros.mpc.kernels.riccati` and
:mod:`orbimpc_ros.mpc.kernels.augmented_lagrangian`.

Mathematics: docs/mathematics.md, 4.2 and 4.7.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels import compiled

SETTLED, STALLED, PAUSED, PROVED = range(4)  # what a minimisation ends with; PROVED: a bound
SIGMA, BEST, PROMISED = range(3)  # in Iterate.numbers
STEPS, TAKEN = range(2)  # in Iterate.counts

ENOUGH = 1e-2  # a minimum is near enough at this share of what the multipliers gain by it
HALVINGS = 30
DESCENT = 1e-4  # share of a Newton step's promise that a step must keep
ROUNDING = 1e-13
GROWTH = 3.0
QUICK, SLOW, STUCK = 2, 6, 15  # Newton steps after which sigma grows fast, grows, stays, shrinks


class Iterate(NamedTuple):
    """A minimisation that can be interrupted.

    Attributes:
        x: the point it is at, shape (N, d).
        held: the multipliers held, or the force that they exert, shape (N, d).
        numbers: sigma, the penalty's parameter; the greatest lower bound; how far the last Newton
            step promised to bring the merit down, shape (3,).
        counts: steps and updates made; Newton steps since sigma last changed, shape (2,).
    """

    x: Array
    held: Array
    numbers: Array
    counts: np.ndarray


def begun(steps: int, width: int, sigma: float) -> Iterate:
    """Return the progress of a minimisation that has not begun.

    Args:
        steps: N.
        width: d, the coordinates of a step.
        sigma: the penalty's first parameter.
    """
    numbers = np.array([sigma, -np.inf, np.inf])
    x, held = np.zeros((steps, width)), np.zeros((steps, width))
    return Iterate(x, held, numbers, np.zeros(2, np.int64))


@compiled
def stiffen(progress, near, largest):
    """Set the next sigma, when its Newton steps came near a minimum or are given up.

    Args:
        progress: updated in place.
        near: whether they came near.
        largest: sigma may be.
    """
    sigma, taken = progress.numbers[SIGMA], progress.counts[TAKEN]
    if not near:
        sigma /= GROWTH * GROWTH
    elif taken <= QUICK:
        sigma = min(largest, sigma * GROWTH * GROWTH)
    elif taken <= SLOW:
        sigma = min(largest, sigma * GROWTH)
    progress.numbers[SIGMA] = sigma
    progress.numbers[PROMISED], progress.counts[TAKEN] = np.inf, 0


@compiled
def descends(reached, merit, share, decrease):
    """Return whether a share of a Newton step brings the merit down far enough (Armijo's rule).

    Args:
        reached: the merit there.
        merit: before the step.
        share: of the step, 0..1.
        decrease: that the whole step promises.
    """
    return reached <= merit - DESCENT * share * decrease + ROUNDING * (1.0 + abs(merit))
