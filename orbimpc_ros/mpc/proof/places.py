# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Where headings lead the control points of steps, as the bodies beside them see it.

Mathematics: docs/mathematics.md, 3.7, and docs/proofs.md.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.separation import separation
from orbimpc_ros.mpc.proof.limits import ENDS, STEP
from orbimpc_ros.mpc.proof.stated import CONTROLS, Bodies, Motion
from orbimpc_ros.mpc.proof.tree import POINTS


def controls_of(motion: Motion, flown: Array) -> Array:
    """Return the control points of steps, shape (N, degree + 1, ...).

    Args:
        motion: how vehicles move.
        flown: positions and velocities at the ends of steps, shape (2, N + 1, ...).
    """
    s, p = flown
    ahead = s[:-1] + motion.lead * p[:-1], s[1:] - motion.lead * p[1:]
    within = s[:-1], *ahead, s[1:]
    return np.stack([within[i] for i in CONTROLS[motion.degree]], axis=1)


class Places:
    """The control points that plans have beside bodies.

    Args:
        bodies: J of them.
        free: control points without headings, less s_0, shape (N, m, n) [m].
        reach: what headings add to them, shape (N, m, N) [m].

    Attributes:
        rows: which of four rows each step and body have, shape (J, N, 4).
        points: which control points, of N m, they are of; where there are fewer, the first one
            again, as in what follows, shape (J, N, 4).
        free: where these are without headings, as bodies see them, shape (J, N, 4, n) [m].
        reach: what each heading adds, shape (J, N, 4, N) [m].
    """

    def __init__(self, bodies: Bodies, free: Array, reach: Array) -> None:
        (count, m, n), of = free.shape, bodies.of[:, None]
        at = np.full((len(bodies.of), count, POINTS), -1)
        at[:, :, 0] = np.where(of == STEP, 0, m - 1)
        for i in range(1, m):
            at[:, :, i] = np.where(of == STEP, i, -1)
        at[:, 1:, 0] = np.where(of == ENDS, 0, at[:, 1:, 0])
        at[:, 1:, 1] = np.where(of == ENDS, m - 1, at[:, 1:, 1])
        self.rows, steps = at >= 0, np.arange(count)[:, None]
        at = np.where(self.rows, at, at[:, :, :1])
        middles = np.where(self.rows[..., None], bodies.centres, bodies.centres[:, :, :1])
        self.points = m * steps + at
        self.free, self.reach = free[steps, at] - middles, reach[steps, at]
        self._bodies, self._radii = bodies, bodies.extents[:, 2 * n, None]

    def entered(self, x: Array) -> tuple[Array, Array]:
        """Return by how far headings lead into each body, and the directions out of it.

        Args:
            x: R_1 e1..R_N e1, shape (N, n).

        Returns:
            Lengths, shape (J, N) [m], and unit vectors, shape (J, N, n).
        """
        places, n = self.free + self.reach @ x, x.shape[1]
        around = self._radii[:, 0] > 0.0
        along = np.concatenate([-places, places], axis=-1)
        short = (self._bodies.extents[:, None, None, : 2 * n] - along).max(axis=2)
        face = short.argmin(axis=-1)
        into, ways = short.min(axis=-1), np.vstack([-np.eye(n), np.eye(n)])[face]
        if around.any():
            ways[around], away = separation(places[around])
            into[around] = self._radii[around] - away
        sizes = self._radii + self._bodies.margins[0]
        nothing = around[:, None] & (sizes <= 0.0)  # shrunk for who leaves it: passed anywhere
        return np.where(nothing, -np.inf, into + self._bodies.margins[0]), ways
