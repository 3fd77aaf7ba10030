# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Rollouts of headings, step by step, and the slopes that forces on them add.

In either arithmetic.

Mathematics: docs/mathematics.md, 1.1, and docs/proofs.md.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from orbimpc_ros.mpc.proof.arithmetic import Number, generic

# Rows of a start, with the d coordinates that are in the cost, shape (6, d).
VELOCITY, WIND, FIRST, WANTED, DECIDED, TIED = range(6)


class StepMap(NamedTuple):
    """A step: s + drift p + push z + follow z' + blow w, keep p + add z + after z' + gust w.

    Attributes:
        lead: offset of a control point next to an end of a step, per velocity there [s].
        degree: of the motion within a step.
    """

    drift: Number
    keep: Number
    push: Number
    follow: Number
    blow: Number
    add: Number
    after: Number
    gust: Number
    lead: Number
    degree: int


@generic
def rolled(motion, start, point, flown):
    """Set positions relative to s_0, velocities, and no forces on them, shape (4, N + 1, n)."""
    flown[2:] = 0 * motion.drift
    for c in range(flown.shape[2]):
        before, fast, wind = start[FIRST, c], start[VELOCITY, c], start[WIND, c]
        flown[0, 0, c], flown[1, 0, c] = 0 * fast, fast
        for k in range(len(point)):
            z, push = point[k, c], motion.push * before + motion.blow * wind
            flown[0, k + 1, c] = flown[0, k, c] + motion.drift * fast + push + motion.follow * z
            push = motion.add * before + motion.gust * wind
            fast = motion.keep * fast + push + motion.after * z
            flown[1, k + 1, c], before = fast, z


@generic
def pulled_back(motion, flown, slopes):
    """Add the forces on positions and velocities to slopes, shape (N, d), by the adjoint."""
    for c in range(flown.shape[2]):
        on_s, on_p, earlier = 0 * flown[2, 0, c], 0 * flown[2, 0, c], 0 * flown[2, 0, c]
        for k in range(len(slopes), 0, -1):
            on_s, on_p = on_s + flown[2, k, c], on_p + flown[3, k, c]
            before = slopes[k - 1, c] + earlier
            slopes[k - 1, c] = before + motion.follow * on_s + motion.after * on_p
            earlier = motion.push * on_s + motion.add * on_p
            on_p = motion.keep * on_p + motion.drift * on_s


def flown_by(motion: StepMap, start: Any, point: Any) -> Any:
    """Return positions relative to s_0 and velocities at the ends of steps, shape (2, N + 1, n).

    Args:
        motion: of a step.
        start: shape (6, n).
        point: headings R_1 e1..R_N e1, shape (N, n).
    """
    flown = np.zeros((4, len(point) + 1, point.shape[1]), point.dtype)
    rolled(motion, start, point, flown)
    return flown[:2]
