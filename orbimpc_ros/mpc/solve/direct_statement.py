# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The relaxed problem in space as the data of its cone program, made without CVXPY.

The same program as :class:`orbimpc_ros.mpc.solve.statement.Statement` states, for the problems of
descents and hovering: rotation order 1, no limit of the turn rate. It is ready in milliseconds,
which counts where the horizon shrinks and every tick has a program of its own. Where neither input
nor attitude has a weight, the cost sees the thrust axes alone: they take the place of the
rotations, and balls that of the orbitopes.

Rows read A x + s = b with s in a cone: zeros first, then what is not negative, second-order cones,
and semidefinite ones.

Mathematics: docs/mathematics.md, 4.8.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.orbitopes import coordinates, lmi_parts
from orbimpc_ros.mpc.geometry.rotations import carried
from orbimpc_ros.mpc.model.cost import (
    attitude_weight,
    input_weight,
    length_weights,
    position_weights,
    velocity_weight,
)
from orbimpc_ros.mpc.model.dynamics import adrift, input_map
from orbimpc_ros.mpc.model.translation import step_of
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.cones import relief, slope_sides
from orbimpc_ros.mpc.solve.disjunction import Slot

ORDER = 4  # of the matrices S(R)
TINY = 1e-300


class Block(NamedTuple):
    """A variable: entries that follow each other."""

    id: str
    size: int


class _Rows:
    """The rows of a matrix, kind by kind, as they are written down."""

    def __init__(self) -> None:
        self._entries: list[tuple[np.ndarray, np.ndarray, Array]] = []
        self._b: list[Array] = []
        self.count = 0

    def add(self, offsets: Array, *parts: tuple[np.ndarray, np.ndarray, Any]) -> np.ndarray:
        """Add rows with their right-hand sides, and return their numbers.

        Args:
            offsets: right-hand sides, shape (K,).
            parts: rows counted from 0, columns and values of entries, shape (J,) each or a number.
        """
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


class DirectStatement:
    """The convex program of a problem in space, parametrised by state and goals.

    Variables are x_0..x_N, rotation coordinates or thrust axes; the displacements v_1..v_N; the
    velocities p_0..p_N of an inertial vehicle; and t_1..t_N with t_k >= |R_k e1|, and of at least
    the floor's least, which length and tilt are about.

    Args:
        problem: one that :meth:`states` holds for.
        slots: what half-spaces will be put on.
    """

    coasting, chords, lengths = False, 0, None

    def __init__(self, problem: Problem, slots: Sequence[Slot] = ()) -> None:
        self.problem, self.slots, steps = problem, tuple(slots), problem.horizon
        self.width = 9 if max(problem.weights.input, problem.weights.attitude) > 0.0 else 3
        self.x = Block('R', (steps + 1) * self.width)
        self.moved = Block('s - s_0', 3 * steps)
        self._velocities = Block('p', 3 * (steps + 1) * problem.inertial)
        self._sizes = Block('|R e1|', steps)
        self._begin, self._columns = {}, 0
        for block in (self.x, self.moved, self._velocities, self._sizes):
            self._begin[block.id] = self._columns
            self._columns += block.size
        self._z = np.arange(steps + 1)[:, None] * self.width + np.arange(3)
        self._v = self._begin[self.moved.id] + np.arange(3 * steps).reshape(steps, 3)
        self._p = self._begin[self._velocities.id] + np.arange(3 * steps + 3).reshape(-1, 3)
        self._t = self._begin[self._sizes.id] + np.arange(steps)
        self._known: list[np.ndarray] = []  # the rows of each of the values
        self._data = self._compiled()

    @staticmethod
    def states(problem: Problem, coasting: bool) -> bool:
        """Return whether this states a problem."""
        return (
            problem.dimension == 3
            and problem.rotation_order == 1
            and problem.max_rate == 0.0
            and not problem.approach.exists
            and not coasting
        )

    @property
    def size(self) -> int:
        """Return the length of :meth:`values`."""
        return sum(map(len, self._known))

    @property
    def arrival(self) -> slice:
        """Return which of :meth:`values` say where s_N has to be, and then p_N."""
        kinds = 1 + self.problem.inertial
        first = self.width + 3 * (kinds - 1)
        return slice(first, first + 3 * kinds * (self.problem.terminal == 'constraint'))

    def leaning(self, z: Array) -> tuple[Array, Array, Array]:
        """Return the multipliers of cones, shape (C, 3), and of least headings within a tilt.

        And the ways along which lengths are, shape (N, 3). What t >= |z| holds, lengths and
        z_3 >= cos(tilt) t push; where t is the floor's, by more than that. Of either the same share
        is taken for |z|. What is left of a tilt's is one of z_3 >= cos(tilt) times the floor.

        Args:
            z: multipliers of all rows.
        """
        problem, leans, props = self.problem, [np.zeros((0, 3))], np.zeros(0)
        pushed, lean = length_weights(problem)[1:], math.cos(problem.tilt)
        up = np.maximum(z[self._tilted], 0.0) if problem.tilt else np.zeros(problem.horizon)
        sides = z[self._heads[:, None] + np.arange(1, 4)]
        sizes = np.sqrt(np.einsum('kc,kc->k', sides, sides))
        most = np.maximum(np.maximum(pushed + lean * up, sizes), TINY)
        ways = -sides / most[:, None]
        if problem.tilt:
            taken = -lean * up[:, None] * ways
            if problem.floor.clearance(3) > 0.0:
                used = up * (sizes / most)
                up, props = used, up - used
            taken[:, 2] += up
            leans.append(taken)
        if problem.glide_slope:
            x, y, height = slope_sides(problem)
            leans.append(
                np.column_stack(
                    [x * z[self._sloped + 1], y * z[self._sloped + 2], height * z[self._sloped]]
                )
            )
        return np.concatenate(leans), props, ways

    def values(self, state: State, goals: Array) -> Array:
        """Return what a state and goals g_1..g_N, shape (N, 3), put on right-hand sides."""
        problem, origins = self.problem, adrift(self.problem, state)
        known = [coordinates(state.rotation)[: self.width]]
        if problem.inertial:
            known.append(state.velocity)
        if problem.terminal == 'constraint':
            known.append(goals[-1] - origins[-1])
            if problem.inertial:
                known.append(-problem.maps.hastened[-1, 0] * state.disturbance)
        if problem.has_cones:
            eased = relief(problem, state, goals)
            known += [eased.tilt] if problem.tilt else []
            if problem.glide_slope:
                sides = slope_sides(problem) * (origins - goals)
                sides[:, 2] += eased.slope
                known += list(sides.T)
        return np.concatenate(known)

    def compiled(self, values: Array | None = None, offsets: Array | None = None) -> dict[str, Any]:
        """Return Clarabel's data for :meth:`values` and offsets of slots; both zero by default."""
        b = self._data['b'].copy()
        if values is not None:
            b[np.concatenate(self._known)] += values
        if offsets is not None and self.slots:
            b[self._slot_rows] -= offsets
        return {**self._data, 'b': b}

    def slot_variables(self, slot: int) -> tuple[Block, range]:
        """Return the variable that a slot is a row over, and which of its entries."""
        wanted = self.slots[slot]
        if wanted.on == 'heading':
            return self.x, range(wanted.step * self.width, wanted.step * self.width + 3)
        return self.moved, range(3 * wanted.step - 3, 3 * wanted.step)

    def last_velocity(self, column_of: Mapping[str, int]) -> np.ndarray:
        """Return the columns of p_N; none without inertia."""
        return self._p[-1] if self.problem.inertial else np.zeros(0, int)

    def largest(self, speed: float, spin: float) -> dict[Block, Array]:
        """Return the most that each entry of each variable can be in a plan from a state.

        Args:
            speed: |p_0| at translation order 2 [m/s].
            spin: not at rotation order 1.
        """
        flown = self.problem.maps
        moved = flown.drift[:, 0] * speed + flown.reach.sum(axis=1)
        each = {
            self.x: np.ones(self.x.size),
            self.moved: np.repeat(moved, 3),
            self._sizes: np.ones(self._sizes.size),
        }
        if self.problem.inertial:
            pushed = flown.carried[:, 0] * speed + flown.pushed.sum(axis=1)
            each[self._velocities] = np.repeat(np.append(speed, pushed), 3)
        return each

    def coordinates(self, x: Array, state: State) -> Array:
        """Return rotation coordinates, shape (N, 9), of x_1..x_N, shape (N, width)."""
        return x if self.width == 9 else coordinates(carried(state.attitude, x))

    # --- data

    def _compiled(self) -> dict[str, Any]:
        rows, counts = _Rows(), []
        for kind in (self._equalities, self._inequalities, self._round, self._semidefinite):
            before = rows.count
            kind(rows)
            counts.append(rows.count - before)
        a, b = rows.matrix(self._columns)
        steps = self.problem.horizon
        dims = SimpleNamespace(
            zero=counts[0],
            nonneg=counts[1],
            soc=[4] * steps + [3] * steps * bool(self.problem.glide_slope),
            psd=[ORDER] * steps if self.width == 9 else [],
        )
        quadratic, linear = self._cost()
        columns = SimpleNamespace(var_id_to_col=self._begin)
        return {'P': quadratic, 'c': linear, 'A': a, 'b': b, 'dims': dims, 'param_prob': columns}

    def _equalities(self, rows: _Rows) -> None:
        """Write down x_0, the model's steps, and an arrival."""
        problem, steps = self.problem, self.problem.horizon
        first = np.arange(self.width)
        self._known.append(rows.add(np.zeros(self.width), (first, first, 1.0)))
        once = step_of(problem.translation, problem.step, problem.forward)
        lines, three = np.arange(3 * steps).reshape(steps, 3), np.arange(3)
        flown = [(lines, self._z[:-1], -once.push[0]), (lines, self._z[1:], -once.follow[0])]
        moved = [(lines, self._v, 1.0), (lines[1:], self._v[:-1], -1.0)]
        if problem.inertial:
            a = once.transition
            self._known.append(rows.add(np.zeros(3), (three, self._p[0], 1.0)))
            gained = [(lines, self._z[:-1], -once.push[1]), (lines, self._z[1:], -once.follow[1])]
            kept = [(lines, self._p[1:], 1.0), (lines, self._p[:-1], -a[1, 1])]
            rows.add(np.zeros(3 * steps), *kept, *gained)
            flown.append((lines, self._p[:-1], -a[0, 1]))
        rows.add(np.zeros(3 * steps), *moved, *flown)
        if problem.terminal == 'constraint':
            self._known.append(rows.add(np.zeros(3), (three, self._v[-1], 1.0)))
            if problem.inertial:
                self._known.append(rows.add(np.zeros(3), (three, self._p[-1], 1.0)))

    def _inequalities(self, rows: _Rows) -> None:
        """Write down floor <= t <= 1, z_3 >= cos(tilt) t, and the slots."""
        problem, every = self.problem, np.arange(self.problem.horizon)
        rows.add(np.ones(len(every)), (every, self._t, 1.0))
        least = problem.floor.clearance(problem.dimension)
        if least > 0.0:
            rows.add(np.full(len(every), -least), (every, self._t, -1.0))
        if problem.tilt:
            lean = math.cos(problem.tilt)
            up = self._z[1:, 2]
            self._tilted = rows.add(np.zeros(len(every)), (every, up, -1.0), (every, self._t, lean))
            self._known.append(self._tilted)
        places = [self._slot_columns(slot) for slot in range(len(self.slots))]
        count = np.arange(len(places))[:, None]
        if places:
            self._slot_rows = rows.add(np.zeros(len(places)), (count, np.array(places), -1.0))

    def _slot_columns(self, slot: int) -> np.ndarray:
        block, entries = self.slot_variables(slot)
        return self._begin[block.id] + np.array(entries)

    def _round(self, rows: _Rows) -> None:
        """Write down |z_k| <= t_k, and the cones of the glide slope."""
        steps = self.problem.horizon
        four = 4 * np.arange(steps)
        axes = four[:, None] + np.arange(1, 4)
        self._heads = rows.count + four
        rows.add(np.zeros(4 * steps), (four, self._t, -1.0), (axes, self._z[1:], -1.0))
        if not self.problem.glide_slope:
            return
        heads = 3 * np.arange(steps)
        x, y, z = -slope_sides(self.problem)
        places = [(heads + 1, self._v[:, 0], x), (heads + 2, self._v[:, 1], y)]
        numbers = rows.add(np.zeros(3 * steps), (heads, self._v[:, 2], z), *places)
        self._sloped = numbers[0::3]
        for place in (1, 2, 0):
            self._known.append(numbers[place::3])

    def _semidefinite(self, rows: _Rows) -> None:
        """Write down S(R_k) >= 0: upper triangles by columns, off the diagonal times sqrt(2)."""
        if self.width == 3:
            return
        constant, linear = lmi_parts()
        low, high = np.tril_indices(ORDER)  # of the transposes: column by column
        scale = np.where(low == high, 1.0, math.sqrt(2.0))
        picked = ORDER * high + low
        parts = -scale[:, None] * linear.reshape(ORDER * ORDER, 9)[picked]
        steps = self.problem.horizon
        each = sparse.kron(sparse.eye(steps), parts).tocoo()
        offsets = np.tile(scale * constant[picked], steps)
        rows.add(offsets, (each.row, self.width + each.col, each.data))

    def _cost(self) -> tuple[sparse.csc_matrix, Array]:
        """Return P and c: distances, inputs and the last rotation squared; lengths."""
        problem, d = self.problem, self.width
        diagonal, linear = np.zeros(self._columns), np.zeros(self._columns)
        diagonal[self._v] = 2.0 * position_weights(problem)[:, None]
        diagonal[self.x.size - d : self.x.size] = 2.0 * attitude_weight(problem)
        if problem.inertial:
            diagonal[self._p[-1]] = 2.0 * velocity_weight(problem)
        linear[self._t] = length_weights(problem)[1:]
        differences = sparse.csc_matrix(input_map(problem))
        turning = 2.0 * input_weight(problem) * (differences.T @ differences)
        rest = sparse.csc_matrix((self._columns - self.x.size,) * 2)
        inputs = sparse.block_diag([sparse.kron(turning, sparse.eye(d)), rest])
        return sparse.csc_matrix(inputs + sparse.diags(diagonal)), linear
