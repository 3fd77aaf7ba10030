# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The convex program in the thrust axes alone, solved by a compiled active-set method.

In the plane R e1 determines R; in space it is all that the cost depends on if neither inputs nor
attitude have a weight. Then the relaxation is a quadratic program in z_1..z_N with balls and
half-spaces on *places*: linear functions of z_1..z_N, such as a thrust axis, a control point of
the motion within a step, or the difference of two thrust axes. A place's map A_p and the Hessian
are the same for every coordinate, so rows n . v_p >= b on places p have

    a_i . H^-1 a_j = (n_i . n_j) G[p_i, p_j],        G = A H^-1 A^T, A the maps of all places,

and a solve needs G only. Balls are represented by tangents, added where the iterate leaves a ball,
and the quadratic program is solved by the dual active-set method of Goldfarb and Idnani, whose
iterates minimise the Lagrangian for multipliers u >= 0. If a violated row depends linearly on
active rows and none of them can be dropped, the multipliers grow without limit along a direction
that proves infeasibility by Farkas' lemma over the balls |z_k| <= 1. This is a hundred times
faster than an interior-point solver set up anew for each set of rows.

Mathematics: docs/mathematics.md, 4.12.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.rotations import carried, coordinates
from orbimpc_ros.mpc.kernels import COMPILED, bare, compiled, entry_point
from orbimpc_ros.mpc.kernels.linear import copy_to, extend_factor, refutes, solve_factored
from orbimpc_ros.mpc.model.dynamics import Condensed, suits_dense_code
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.solve.relaxation import Multipliers, Relaxation, Row, stacked
from orbimpc_ros.mpc.solve.request import Request

SOLVED, STALLED, REFUTED, INTERRUPTED = range(4)  # status of a solve
ADDED, BLOCKED, BROKEN = range(3)  # status of adding a row
OUTSIDE = 1e-9  # violation below which a row or ball counts as satisfied
FLAT = 1e-12  # relative curvature that counts as zero
ITERATIONS = 600
SLICE = 1e6  # multiplications between two polls of the deadline: about a millisecond
WORST_CONDITION = 1e7  # above it, too many solves stall by rounding


class Places(NamedTuple):
    """Data common to all solves.

    Attributes:
        maps: A, coefficients of z_1..z_N in each place, shape (P, N); the first N are the identity.
        gram: G, shape (P, P).
        balls: places constrained to balls, shape (B,); the first N are the thrust axes.
    """

    maps: Array
    gram: Array
    balls: np.ndarray


class PlaceLimits(NamedTuple):
    """The constraints of one solve on places, and the minimiser without them.

    Attributes:
        free: places of the unconstrained minimiser, shape (P, n).
        centres: of the balls, shape (B, n).
        radii: of the balls, shape (B,).
        places: of the half-spaces, shape (M,).
        normals: unit vectors, shape (M, n).
        offsets: shape (M,).
    """

    free: Array
    centres: Array
    radii: Array
    places: np.ndarray
    normals: Array
    offsets: Array


class ActiveSet(NamedTuple):
    """The active rows and behind them a new one, with work arrays.

    Attributes:
        at: place of each row, shape (S,).
        rows: index of its half-space; -1 - b for a tangent to ball b, shape (S,).
        normals: shape (S, n).
        offsets: shape (S,).
        u: multipliers, >= 0, shape (S,).
        gram: lower triangle of a_i . H^-1 a_j, shape (S, S).
        factor: its Cholesky factor, shape (S, S).
        values: places of the minimiser of the Lagrangian, shape (P, n).
    """

    at: np.ndarray
    rows: np.ndarray
    normals: Array
    offsets: Array
    u: Array
    gram: Array
    factor: Array
    values: Array


def active_set(steps: int, places: int, dimension: int) -> ActiveSet:
    """Return an empty active set with capacity for all independent rows and two more."""
    n, size = dimension, steps * dimension + 2
    shapes = size, size, (size, n), size, size, (size, size), (size, size), (places, n)
    made, indices = ActiveSet._make(map(np.zeros, shapes)), np.zeros((2, size), np.int64)
    return made._replace(at=indices[0], rows=indices[1])


@compiled
def _set_values(gram, free, held, count):
    """Set the places of the minimiser of the Lagrangian."""
    values = held.values
    copy_to(values, free)
    for i in range(count):
        column = gram[held.at[i]]
        for c in range(values.shape[1]):
            weight = held.u[i] * held.normals[i, c]
            for p in range(len(values)):
                values[p, c] += weight * column[p]


@compiled
def _find(places, limits, held, count):
    """Make the violated row that raises the dual value most the new one; return if there is any."""
    worst, values, row, violated = 0.0, held.values, held.normals[count], False
    n = values.shape[1]
    for m in range(len(limits.places)):
        p, short = limits.places[m], limits.offsets[m]
        for c in range(n):
            short -= limits.normals[m, c] * values[p, c]
        if short > OUTSIDE and short * short > worst * places.gram[p, p]:
            worst, violated = short * short / max(places.gram[p, p], 1e-300), True
            held.at[count], held.rows[count], held.offsets[count] = p, m, limits.offsets[m]
            copy_to(row, limits.normals[m])
    for b in range(len(places.balls)):
        p, square = places.balls[b], 0.0
        for c in range(n):
            square += (values[p, c] - limits.centres[b, c]) ** 2
        short = np.sqrt(square) - limits.radii[b]
        if short > OUTSIDE and short * short > worst * places.gram[p, p]:
            worst, violated = short * short / max(places.gram[p, p], 1e-300), True
            held.at[count], held.rows[count], held.offsets[count] = p, -1 - b, -limits.radii[b]
            for c in range(n):
                row[c] = (limits.centres[b, c] - values[p, c]) / np.sqrt(square)
                held.offsets[count] += row[c] * limits.centres[b, c]
    return violated


@compiled
def _drop(held, i, count):
    """Drop a row from the active set; return True if the remaining rows are independent."""
    for j in range(i, count):
        held.at[j], held.rows[j] = held.at[j + 1], held.rows[j + 1]
        held.offsets[j], held.u[j] = held.offsets[j + 1], held.u[j + 1]
        copy_to(held.normals[j], held.normals[j + 1])
        for k in range(i):
            held.gram[j, k] = held.gram[j + 1, k]
        for k in range(i, j + 1):
            held.gram[j, k] = held.gram[j + 1, k + 1]
    return extend_factor(held.gram, held.factor, i, count - 1)


@compiled
def _blocking(held, count, r):
    """Return the active row whose multiplier vanishes first, -1 if none does, and at what step."""
    blocking, limit = -1, np.inf
    for i in range(count):
        if r[i] > FLAT and held.u[i] < limit * r[i]:
            blocking, limit = i, held.u[i] / r[i]
    return blocking, limit


@compiled
def _add(places, held, count, r):
    """Add the new row to the active set, dropping rows that block it.

    Args:
        places: data common to all solves.
        held: the active set.
        count: number of its rows.
        r: set to the decrease of the other multipliers per unit of the new one, shape (S,).

    Returns:
        ``ADDED``, ``BLOCKED`` if no row can be dropped for it, or ``BROKEN`` by rounding; the new
        number of rows; and by how much the dual value rises.
    """
    place, row, size = held.at[count], held.normals[count], len(held.u)
    gap, own, held.u[count] = held.offsets[count], places.gram[place, place], 0.0
    risen = 0.0
    for c in range(len(row)):
        gap -= row[c] * held.values[place, c]
    for i in range(count + 1):
        along = 0.0
        for c in range(len(row)):
            along += row[c] * held.normals[i, c]
        held.gram[count, i] = along * places.gram[held.at[i], place]
    for _ in range(4 * size):
        copy_to(r[:count], held.gram[count, :count])
        curvature = own - solve_factored(held.factor, r, count)
        blocking, limit = _blocking(held, count, r)
        full = gap / curvature if curvature > FLAT * own else np.inf
        move = min(limit, full)
        if move == np.inf:
            return BLOCKED, count + 1, risen
        held.u[count] += move
        risen += move * (gap - 0.5 * move * max(0.0, curvature))
        for i in range(count):
            held.u[i] = max(0.0, held.u[i] - move * r[i])
        gap -= move * max(0.0, curvature)
        if full <= limit:
            count += 1
            if count < size and extend_factor(held.gram, held.factor, count - 1, count):
                return ADDED, count, risen
            return BROKEN, 0, 0.0
        if not _drop(held, blocking, count):
            return BROKEN, 0, 0.0
        count -= 1
    return BROKEN, 0, 0.0


@entry_point
def minimise(places, limits, held, count, value, work):
    """Solve from an active set that is optimal for its rows: an empty or an interrupted one.

    Args:
        places: data common to all solves.
        limits: the constraints of this solve.
        held: the active set, updated in place; ``values`` are the places of the solution.
        count: number of its rows.
        value: the dual value.
        work: budget of multiplications, exceeded by at most one row.

    Returns:
        The status, the dual value, and the number of active rows. Their multipliers belong to the
        solution, or if ``REFUTED`` prove infeasibility.
    """
    r, n = np.empty(len(held.u)), limits.free.shape[1]
    each = float((len(limits.places) + len(places.balls) + count * len(limits.free)) * n)
    _set_values(places.gram, limits.free, held, count)
    for _ in range(ITERATIONS):
        if not _find(places, limits, held, count):
            return SOLVED, value, count
        if work <= 0.0:
            return INTERRUPTED, value, count
        became, count, risen = _add(places, held, count, r)
        value += risen
        if became == BROKEN:
            return STALLED, -np.inf, 0
        work -= each + count * (2.0 * count + len(limits.free) * n)
        _set_values(places.gram, limits.free, held, count)
        if became == BLOCKED:
            y = np.maximum(0.0, -r[:count])
            y[-1] = 1.0
            if refutes(places.maps, (held.at, held.normals, held.offsets), y):
                copy_to(held.u, y)
                return REFUTED, value, count
            return STALLED, value, count
    return STALLED, value, count


class PlaceProgram:
    """The convex program of a problem for repeated solves with different rows on places.

    Args:
        problem: what to solve.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        steps, n = problem.horizon, problem.dimension
        self._condensed = Condensed(problem)
        self._inverse = np.linalg.inv(self._condensed.hessian)
        self._inverse = 0.5 * (self._inverse + self._inverse.T)
        turned = np.diff(np.eye(steps + 1), axis=0)[int(problem.turns_are_angles) :, 1:]
        turned = turned if problem.max_rate else turned[:0]
        maps = np.concatenate([np.eye(steps), problem.maps.controls.reshape(-1, steps), turned])
        last = len(maps) - len(turned)
        balls = np.concatenate([np.arange(steps), last + np.arange(len(turned))])
        gram = maps @ self._inverse @ maps.T
        self._places = Places(maps, 0.5 * (gram + gram.T), balls)
        self._held = active_set(steps, len(maps), n)
        self._request: Request | None = None
        self._minimise = bare(minimise)
        if self._minimise is minimise:
            # The first call compiles or loads machine code: at start-up rather than in a tick.
            start = State.at(np.zeros(n), np.eye(n), wanted=np.eye(n))
            self.relax(Request(start, np.zeros((steps, n))))
            self._minimise = bare(minimise)

    @staticmethod
    def solves(problem: Problem) -> bool:
        """Return True if this program applies to a problem and is fast on this machine."""
        plane = problem.dimension == 2
        return (
            COMPILED
            and problem.rotation_order == 1
            and (plane or not problem.weighs_rotations)
            and (plane or not problem.turns_are_angles)
            and problem.terminal == 'penalty'
            and problem.weights.length == 0.0
            and not problem.has_cones
            and not problem.approach.exists
            and suits_dense_code(problem)
            and bool(np.linalg.cond(Condensed(problem).hessian) < WORST_CONDITION)
        )

    def _bind(self, request: Request) -> None:
        """Compute the data that depend only on state and goals."""
        problem, self._request, state = self.problem, request, request.state
        q, constant = self._condensed.affine(state, request.goals)
        free = -self._inverse @ q
        self._free, self._least = self._places.maps @ free, constant + 0.5 * float(np.vdot(q, free))
        self._centres = np.zeros((len(self._places.balls), problem.dimension))
        self._radii = np.ones(len(self._centres))
        self._radii[problem.horizon :] = problem.chord
        if problem.max_rate and not problem.turns_are_angles:
            self._centres[problem.horizon] = state.rotation[:, 0]
        self._edges = _edges(problem, state) if problem.first_turn_is_a_cone else []

    def relax(
        self, request: Request, rows: Sequence[Row] = (), chords: Array | None = None
    ) -> Relaxation:
        """See :meth:`orbimpc_ros.mpc.solve.relaxation.Relaxed.relax`."""
        if request is not self._request:
            self._bind(request)
        limits, count, bound = self._limits(rows, chords), 0, self._least
        while True:
            data = self._places, limits, self._held, count, bound, SLICE
            status, bound, count = self._minimise(*data)
            if status != INTERRUPTED or request.late:
                break
        x = self._coordinates(request.state) if status == SOLVED else None
        multipliers = self._multipliers(count, len(rows))
        return Relaxation(x, bound, multipliers, empty=status == REFUTED)

    def _multipliers(self, count: int, passed: int) -> Multipliers:
        held, (steps, n) = self._held, (self.problem.horizon, self.problem.dimension)
        sizes, tether = np.zeros(passed), np.zeros((steps, n))
        for i, row in enumerate(held.rows[:count].tolist()):
            if 0 <= row < passed:  # later rows are the edges of the cone of the first turn
                sizes[row] += held.u[i]
            elif row < -steps:  # tangent to the ball of a chord; the last ball is of the last step
                tether[-1 - row - len(self._places.balls)] -= held.u[i] * held.normals[i]
        nothing = np.zeros((0, n)), np.zeros((0, 0))
        return Multipliers(held.values[:steps].copy(), sizes, *nothing, tether, 0.0 * tether)

    def _coordinates(self, state: State) -> Array:
        """Return the rotation coordinates of the last solution, shape (N, d)."""
        axes = self._held.values[: self.problem.horizon].copy()
        return axes if self.problem.dimension == 2 else coordinates(carried(state.attitude, axes))

    def _limits(self, rows: Sequence[Row], chords: Array | None) -> PlaceLimits:
        steps, radii = self.problem.horizon, self._radii
        if chords is not None:
            radii = radii.copy()
            radii[steps:] = np.minimum(radii[steps:], chords)
        half_spaces = stacked([*rows, *self._edges], self.problem.dimension)
        return PlaceLimits(self._free, self._centres, radii, *half_spaces)


def _edges(problem: Problem, state: State) -> list[Row]:
    """Return the edges of the first turn's cone in the plane."""
    x, y = state.attitude[:, 0]
    s, c = math.sin(problem.widest_turn), math.cos(problem.widest_turn)
    edges = np.array([[s * x - c * y, s * y + c * x], [s * x + c * y, s * y - c * x]])
    return [Row(0, np.eye(problem.horizon)[0], edge, 0.0) for edge in edges]
