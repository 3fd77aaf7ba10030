# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The relaxed problem, with R_k in conv SO(n), as data of a cone program.

Rows are A x + s = b with s in a cone: first the zero cone, then the non-negative, second-order and
semidefinite ones. The variables are the rotation coordinates x_0..x_N; the displacements
v_k = s_k - d_k, where d_k is s_0 moved by the disturbance alone; for an inertial vehicle the
velocities p_0..p_N without the effect of the disturbance; and, if lengths, tilt or
``max_acceleration`` need them, t_1..t_N with t_k >= |R_k e1|. The state then enters only b, except
for the axes of cones and a coasted rotation, and the goals enter the linear cost:
q_k |s_k - g_k|^2 = q_k |v_k|^2 + pull_k . v_k + const, pull_k = -2 q_k (g_k - d_k).

In space, without weights on inputs and attitude, cost and constraints depend on the thrust axes
only: these replace the rotations, and balls replace the orbitopes.

Mathematics: docs/mathematics.md, 4.8.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy import sparse

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.rotations import carried, coordinate_count, coordinates, lmi_parts
from orbimpc_ros.mpc.model.dynamics import (
    adrift,
    attitude_weight,
    input_map,
    input_weight,
    length_weights,
    position_weights,
    velocity_weight,
)
from orbimpc_ros.mpc.model.translation import step_of
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.cones import relief, slope_sides
from orbimpc_ros.mpc.solve.conic import cones_of
from orbimpc_ros.mpc.solve.relaxation import Multipliers

ORDER = 4  # of the matrices S(R)
TINY = 1e-300
OUTWARD = 1.0 + 1e-12  # margin that keeps multipliers inside their cone in spite of rounding

Part = tuple[np.ndarray, np.ndarray, Any]  # rows counted from 0, columns, values or one for all


class _Rows:
    """A builder of the sparse matrix A and of b."""

    def __init__(self) -> None:
        self._entries: list[tuple[np.ndarray, np.ndarray, Array]] = []
        self._b: list[Array] = []
        self.count = 0

    def add(self, offsets: Array, *parts: Part) -> np.ndarray:
        """Add rows with right-hand sides of shape (K,), and return their indices."""
        numbers = self.count + np.arange(len(offsets))
        for rows, columns, values in parts:
            spread = np.broadcast_to(np.asarray(values, dtype=float), np.shape(columns)).ravel()
            kept = spread != 0.0
            rows = np.broadcast_to(rows, np.shape(columns)).ravel()
            self._entries.append((numbers[rows][kept], np.ravel(columns)[kept], spread[kept]))
        self._b.append(np.asarray(offsets, dtype=float))
        self.count += len(offsets)
        return numbers

    def matrix(self, columns: int) -> tuple[sparse.csc_matrix, Array]:
        """Return A and b."""
        rows, places, values = (np.concatenate(each) for each in zip(*self._entries, strict=True))
        shape = (self.count, columns)
        return sparse.csc_matrix((values, (rows, places)), shape=shape), np.concatenate(self._b)


class ConicStatement:
    """The cone program of a problem, parametrised by state and goals.

    Args:
        problem: what to solve.
        coasting: whether R_1 is rho times the coasted rotation, with rho in [0, 1] free.

    Attributes:
        data: of the program before a state is set, for :func:`~.conic.run`.
        x: columns of x_1..x_N, shape (N, width).
        moved: columns of v_1..v_N, shape (N, n).
        last: columns of p_N, shape (n,) or (0,).
        t: columns of t_1..t_N, shape (N,) or (0,).
    """

    def __init__(self, problem: Problem, *, coasting: bool = False) -> None:
        self.problem, self._coasting = problem, coasting and problem.rotation_order == 2
        n, steps = problem.dimension, problem.horizon
        self._decided = problem.rotation_order - 1
        axial = problem.weights.input == problem.weights.attitude == 0.0 and not self._decided
        self.width = n if axial else coordinate_count(n)
        self._lengths = length_weights(problem)[1:]
        sized = bool(self._lengths.any() or problem.tilt or problem.max_acceleration)
        self.columns = 0
        self._x = self._block(steps + 1, self.width)
        self._z, self.x = self._x[:, :n], self._x[1:]
        self.moved = self._block(steps, n)
        self._p = self._block((steps + 1) * problem.inertial, n)
        self.t = self._block(steps * sized, 1)[:, 0]
        self._rho = self._block(int(self._coasting), 1)[:, 0]
        self._along = self._block(int(problem.first_turn_is_a_cone), 1)[:, 0]
        self._towards = self._block(int(problem.approach.exists), 1)[:, 0]
        self.last = self._p[-1] if problem.inertial else np.zeros(0, int)
        begin = int(problem.turns_are_angles)  # the first turn is from Q_0 e1: no chord of R_0 e1
        self._chords = max(0, steps - begin) if problem.max_rate else 0
        self.data = self._stated()

    def _block(self, count: int, size: int) -> np.ndarray:
        """Return the indices of new columns, shape (count, size)."""
        first, self.columns = self.columns, self.columns + count * size
        return first + np.arange(count * size).reshape(count, size)

    # --- state and goals

    def put(self, state: State, goals: Array) -> dict[str, Any]:
        """Return the data, with A and b for a state and goals g_1..g_N, shape (N, n)."""
        problem, made = self.problem, {name: self.data[name].copy() for name in ('A', 'b', 'q')}
        a, b = made['A'].data, made['b']
        origins = adrift(problem, state)
        b[self._first] = coordinates(state.rotation)[: self.width]
        if self._coasting:
            assert state.coasted is not None
            a[self._coasted] = -coordinates(state.coasted)
        elif self._decided:
            b[self._second] = coordinates(state.rotation + problem.step * state.rotation_rate)
        if problem.inertial:
            b[self._velocity] = state.velocity
        if problem.terminal == 'constraint':
            stopped = -problem.maps.speeds[-1, -1] * state.disturbance
            b[self._arrival] = [*(goals[-1] - origins[-1]), *stopped][: len(self._arrival)]
        b[self._tied] = problem.chord
        if problem.has_cones:
            self._put_cones(b, state, goals, origins)
        if problem.first_turn_is_a_cone:
            a[self._turned] = state.attitude[:, 0]
        if problem.approach.exists:
            axis = problem.approach.axis(state)
            a[self._approached], a[self._ahead] = axis, -axis
        return self.data | made

    def _put_cones(self, b: Array, state: State, goals: Array, origins: Array) -> None:
        """Set the relief of tilt and glide slope, and the apex of the latter, in b."""
        eased = relief(self.problem, state, goals)
        if self.problem.tilt:
            b[self._tilted] = eased.tilt
        if self.problem.glide_slope:
            sides = slope_sides(self.problem) * (origins - goals)
            b[self._sloped], b[self._sloped + 1] = sides[:, 2] + eased.slope, sides[:, 0]
            b[self._sloped + 2] = sides[:, 1]

    def narrowed(self, data: dict[str, Any], chords: Array) -> dict[str, Any]:
        """Return data with limits of the K bounded chords, shape (K,)."""
        b = data['b'].copy()
        b[self._tied] = chords
        return data | {'b': b}

    def coordinates(self, x: Array, state: State) -> Array:
        """Return rotation coordinates, shape (N, d), of x_1..x_N, shape (N, width)."""
        rotations = self.width == coordinate_count(self.problem.dimension)
        return x if rotations else coordinates(carried(state.attitude, x))

    # --- multipliers

    def multipliers(self, x: Array, z: Array, sizes: Array, state: State) -> Multipliers:
        """Return the multipliers of a solution in the form of proofs.

        Args:
            x: the solution, all columns.
            z: multipliers of all rows of the program.
            sizes: multipliers of the added half-spaces, shape (M,).
            state: initial state of plans.
        """
        problem, n, steps = self.problem, self.problem.dimension, self.problem.horizon
        pull: Array = np.zeros((0, n))
        slide: Array = np.zeros((0, 0))
        share: Array = np.zeros((steps, n))
        if problem.terminal == 'constraint':
            pull = z[self._arrival].reshape(-1, n)
        if problem.first_turn_is_a_cone and n == 3:
            share[0] += z[self._cones[0]]
        if len(self.t):
            share += self._leaning(z)
        if problem.glide_slope:
            slide = self._sliding(z)
        if problem.approach.exists and n == 3:
            share[-1] += z[self._cones[-1]]
            share[-1] += max(0.0, z[self._least]) * problem.approach.axis(state)
        tether = np.zeros((steps, n))
        tether[steps - self._chords :] = -z[self._tied[:, None] + np.arange(1, 1 + n)]
        return Multipliers(x[self.x], sizes, pull, slide, tether, share)

    def _leaning(self, z: Array) -> Array:
        """Return the multipliers of the tilt, and with d = 9 of lengths, on R_k e1, shape (N, n).

        The multiplier of t >= |z| balances those of lengths and of z_3 >= cos(tilt) t; at t = floor
        only part of them. It is shared between both in proportion; the rest of the tilt's is a
        multiplier of z_3 >= cos(tilt) floor.
        """
        problem, n = self.problem, self.problem.dimension
        lean = math.cos(problem.tilt)
        up = np.maximum(z[self._tilted], 0.0) if problem.tilt else np.zeros(problem.horizon)
        sides = z[self._disks[:, None] + np.arange(1, 1 + n)]
        sizes = np.sqrt(np.einsum('kc,kc->k', sides, sides))
        most = np.maximum(np.maximum(self._lengths + lean * up, sizes), TINY)
        ways = -sides / most[:, None]
        held = -self._lengths[:, None] * ways if self.width == 9 else np.zeros(ways.shape)
        if problem.tilt:
            held -= lean * up[:, None] * ways
            held[:, 2] += up
        return held

    def _sliding(self, z: Array) -> Array:
        """Return multipliers of the glide slope, moved into the polar cone, shape (N, 3)."""
        x, y, height = slope_sides(self.problem)
        above = np.column_stack([z[self._sloped + 1], z[self._sloped + 2], z[self._sloped]])
        slide = -np.array([x, y, height]) * above
        rim = OUTWARD * height / x * np.hypot(slide[:, 0], slide[:, 1])
        slide[:, 2] = np.minimum(slide[:, 2], -rim)
        return slide

    # --- data

    def _stated(self) -> dict[str, Any]:
        rows, counts = _Rows(), []
        self._round: list[int] = []
        for kind in (self._equalities, self._inequalities, self._balls, self._semidefinite):
            before = rows.count
            kind(rows)
            counts.append(rows.count - before)
        a, b = rows.matrix(self.columns)
        psd = [ORDER] * (counts[3] // (ORDER * (ORDER + 1) // 2))
        self._locate(a)
        quadratic, linear = self._cost()
        cones = cones_of(counts[0], counts[1], self._round, psd)
        return {'P': quadratic, 'q': linear, 'A': a, 'b': b, 'cones': cones}

    def _locate(self, a: sparse.csc_matrix) -> None:
        """Locate the entries of A that depend on the state."""
        self._coasted = _entries(a, self._second, self._rho)
        self._turned = _entries(a, self._cones[:1].ravel(), self._along)
        self._approached = _entries(a, self._cones[-1:].ravel(), self._towards)
        if self.problem.approach.exists:
            self._ahead = _entries(a, np.array([self._least]), self._z[-1])

    def _equalities(self, rows: _Rows) -> None:
        """Add x_0, the R_1 that the body rate determines, the dynamics, and an arrival."""
        problem, steps, n = self.problem, self.problem.horizon, self.problem.dimension
        each, known = np.arange(self.width), np.zeros(self.width)
        self._first = rows.add(known, (each, self._x[0], 1.0))
        self._second = np.zeros(0, int)
        if self._decided:
            shares = (each, np.repeat(self._rho, self.width * self._coasting), -1.0)
            parts = [shares] if self._coasting else []
            self._second = rows.add(known, (each, self._x[1], 1.0), *parts)
        once = step_of(problem.translation, problem.step, problem.forward)
        lines, axes = np.arange(n * steps).reshape(steps, n), np.arange(n)
        flown = [(lines, self._z[:-1], -once.push[0]), (lines, self._z[1:], -once.follow[0])]
        moved = [(lines, self.moved, 1.0), (lines[1:], self.moved[:-1], -1.0)]
        if problem.inertial:
            a = once.transition
            self._velocity = rows.add(np.zeros(n), (axes, self._p[0], 1.0))
            gained = [(lines, self._z[:-1], -once.push[1]), (lines, self._z[1:], -once.follow[1])]
            kept = [(lines, self._p[1:], 1.0), (lines, self._p[:-1], -a[1, 1])]
            rows.add(np.zeros(n * steps), *kept, *gained)
            flown.append((lines, self._p[:-1], -a[0, 1]))
        rows.add(np.zeros(n * steps), *moved, *flown)
        if problem.terminal == 'constraint':
            ends = np.concatenate([self.moved[-1], self.last])
            self._arrival = rows.add(np.zeros(len(ends)), (np.arange(len(ends)), ends, 1.0))

    def _inequalities(self, rows: _Rows) -> None:
        """Add floor <= t <= 1, z_3 >= cos(tilt) t, 0 <= rho <= 1, and the approach's half-space."""
        problem, n = self.problem, self.problem.dimension
        every = np.arange(len(self.t))
        if len(every):
            free = every[: len(every) - self._decided]
            rows.add(np.ones(len(free)), (free, self.t[self._decided :], 1.0))
            least = problem.least_speed
            if least > 0.0:
                rows.add(np.full(len(every), -least), (every, self.t, -1.0))
        if problem.tilt:
            lean, up = math.cos(problem.tilt), self._z[1:, 2]
            self._tilted = rows.add(np.zeros(len(every)), (every, up, -1.0), (every, self.t, lean))
        if self._coasting:
            rows.add(np.array([0.0, 1.0]), (np.arange(2), self._rho[[0, 0]], np.array([-1.0, 1.0])))
        if problem.approach.exists:
            least = math.cos(problem.approach.cone) * problem.least_heading
            row = rows.add(np.array([-least]), (np.zeros(n, int), self._z[-1], -1.0))
            self._least = int(row[0])

    def _balls(self, rows: _Rows) -> None:
        """Add |z_k| <= t_k or 1, the glide slope, the cones of turn and approach, and chords."""
        problem, steps, n = self.problem, self.problem.horizon, self.problem.dimension
        self._disks = np.zeros(0, int)
        if len(self.t):
            self._disks = self._heads(rows, self._z[1:], (np.arange(steps), self.t, -1.0))
        elif self.width == n:
            self._heads(rows, self._z[1 + self._decided :])
        if problem.glide_slope:
            heads, (x, y, z) = 3 * np.arange(steps), -slope_sides(problem)
            moved = self.moved.T
            parts = [(heads, moved[2], z), (heads + 1, moved[0], x), (heads + 2, moved[1], y)]
            self._sloped = rows.add(np.zeros(3 * steps), *parts)[0::3]
            self._round += [3] * steps
        cones = []
        for along, z, angle in (
            (self._along, self._z[1:2], problem.widest_turn),
            (self._towards, self._z[-1:], problem.approach.cone),
        ):
            if len(along):
                widest = (np.zeros(1, int), along, -math.sin(angle))
                head = self._heads(rows, z, widest, axis=along)
                cones.append(head[0] + np.arange(1, 1 + n))
        self._cones = np.array(cones, int).reshape(-1, n)
        turned = self._z[-self._chords - 1 :] if self._chords else self._z[:0]
        self._tied = self._heads(rows, turned[1:], before=turned[:-1])

    def _heads(
        self,
        rows: _Rows,
        z: np.ndarray,
        size: Part | None = None,
        *,
        axis: np.ndarray | None = None,
        before: np.ndarray | None = None,
    ) -> np.ndarray:
        """Add cones |z_k - w_k| <= size and return their first rows, shape (K,).

        Args:
            rows: where to add them.
            z: columns of z_k, shape (K, n).
            size: the size of each cone; 1 by default.
            axis: the column of a scalar: w_k is this scalar times an axis set by the state.
            before: columns of w_k, shape (K, n).
        """
        count, n = z.shape
        heads = (1 + n) * np.arange(count)
        sides = heads[:, None] + np.arange(1, 1 + n)
        parts = [(sides, z, -1.0)]
        if size is not None:
            parts.append((heads[size[0]], *size[1:]))
        if axis is not None:
            parts.append((sides, np.broadcast_to(axis[:, None], sides.shape), 1.0))
        if before is not None:
            parts.append((sides, before, 1.0))
        offsets = np.zeros((count, 1 + n))
        offsets[:, 0] = float(size is None)
        self._round += [1 + n] * count
        return rows.add(offsets.ravel(), *parts)[heads]

    def _semidefinite(self, rows: _Rows) -> None:
        """Add S(R_k) >= 0: upper triangles column by column, off-diagonals times sqrt(2)."""
        if self.width < 9:
            return
        constant, linear = lmi_parts()
        low, high = np.tril_indices(ORDER)  # of the transpose, hence column by column
        scale = np.where(low == high, 1.0, math.sqrt(2.0))
        picked = ORDER * high + low
        parts = -scale[:, None] * linear.reshape(ORDER * ORDER, 9)[picked]
        free = self.x[self._decided :]
        each = sparse.kron(sparse.eye(len(free)), parts).tocoo()
        offsets = np.tile(scale * constant[picked], len(free))
        rows.add(offsets, (each.row, free.ravel()[each.col], each.data))

    def _cost(self) -> tuple[sparse.csc_matrix, Array]:
        """Return half of P (of distances, inputs and the last rotation), and q (of lengths)."""
        problem = self.problem
        diagonal, linear = np.zeros(self.columns), np.zeros(self.columns)
        diagonal[self.moved] = 2.0 * position_weights(problem)[:, None]
        diagonal[self._x[-1]] = 2.0 * attitude_weight(problem)
        diagonal[self.last] = 2.0 * velocity_weight(problem)
        if len(self.t):
            linear[self.t] = self._lengths
        differences = sparse.csc_matrix(input_map(problem))
        turning = 2.0 * input_weight(problem) * (differences.T @ differences)
        rest = sparse.csc_matrix((self.columns - self._x.size,) * 2)
        inputs = sparse.block_diag([sparse.kron(turning, sparse.eye(self.width)), rest])
        return sparse.csc_matrix(sparse.triu(inputs + sparse.diags(diagonal))), linear


def _entries(a: sparse.csc_matrix, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return the storage indices of entries by rows and columns, which are broadcast."""
    rows, columns = np.broadcast_arrays(rows, columns) if columns.size else (columns, columns)
    found = [
        a.indptr[c] + np.flatnonzero(a.indices[a.indptr[c] : a.indptr[c + 1]] == r)[0]
        for r, c in zip(rows.tolist(), columns.tolist(), strict=True)
    ]
    return np.array(found, int)
