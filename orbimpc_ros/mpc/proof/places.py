# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Where headings lead the control points of steps, as the bodies beside them see it.

Mathematics: docs/mathematics.md, 3.7, and docs/proofs.md.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.separation import separation
from orbimpc_ros.mpc.proof.flight import control_points
from orbimpc_ros.mpc.proof.stated import Bodies


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
        count, m, n = free.shape
        at = control_points(tuple(bodies.of.tolist()), count, m - 1)
        self.rows, steps = at >= 0, np.arange(count)[:, None]
        self.points = m * steps + np.where(self.rows, at, at[:, :, :1])
        middles = np.where(self.rows[..., None], bodies.centres, bodies.centres[:, :, :1])
        self.free = free.reshape(-1, n)[self.points] - middles
        self.reach = reach.reshape(-1, count)[self.points]
        self._bodies, self._radii = bodies, bodies.extents[:, 2 * n, None]

    def entered(self, x: Array) -> tuple[Array, Array]:
        """Return by how far headings lead into each body, and the directions out of it.

        Args:
            x: R_1 e1..R_N e1, shape (N, n).

        Returns:
            Lengths, shape (J, N) [m], and unit vectors, shape (J, N, n).
        """
        count, n = x.shape
        places = self.free + (self.reach.reshape(-1, count) @ x).reshape(self.free.shape)
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
