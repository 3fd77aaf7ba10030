# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The general convex program, with R_k in conv SO(n), solved by Clarabel for states and goals.

Rows are A x + s = b with s in a cone. The variables are the rotation coordinates x_0..x_N; the
displacements v_k = s_k - s_0, with for an inertial vehicle the velocities p_k; and, if lengths,
tilt or ``max_acceleration`` need them, t_1..t_N with t_k >= |R_k e1|. The state then enters only b,
except for a coasted rotation and the axes of cones, whose rows come last; the goals enter the
linear cost: q_k |s_k - g_k|^2 = q_k |v_k|^2 + pull_k . v_k + const, pull_k = -2 q_k (g_k - s_0).

In space, without weights on inputs and attitude, cost and constraints depend on the thrust axes
only: these replace the rotations, and balls replace the orbitopes.

Mathematics: docs/mathematics.md, 4.8.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib import import_module
from itertools import chain
from typing import Any

import numpy as np
from scipy import sparse

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.rotations import carried, coordinate_count, coordinates, lmi_parts
from orbimpc_ros.mpc.model.dynamics import (
    first_length,
    input_map,
    knowns,
    length_weights,
    motion_weights,
    turning_weights,
)
from orbimpc_ros.mpc.model.translation import step_of
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.cones import relief, slope_sides
from orbimpc_ros.mpc.solve.conic import (
    SOLVED,
    ConeProgram,
    Part,
    Positive,
    Round,
    Semidefinite,
    Zero,
    run,
)
from orbimpc_ros.mpc.solve.relaxation import Multipliers, Relaxation, Row
from orbimpc_ros.mpc.solve.request import Request

NONE = np.zeros(0, int)
ORDER = 4  # of the matrices S(R)
REFUTED = ('PrimalInfeasible', 'AlmostPrimalInfeasible')
SMALL = 1e-2  # below this cost the program is solved again, with the cost scaled up
TINY = 1e-11  # well below 1e-9, the smallest denominator of a relative gap
STUCK = ('NumericalError', 'InsufficientProgress')
NEAR = 1e-9  # primal residual of a stalled solve that still counts as accurate
ROUGH = 1e-4  # primal residual of a stalled solve that is good enough for branching
FAR = 1.0  # in lengths of the horizon at full speed: the cost is scaled down for goals beyond it
OUTWARD = 1.0 + 1e-12  # margin that keeps multipliers inside their cone in spite of rounding


class Program:
    """The convex program of a problem for repeated solves.

    Args:
        problem: what to solve.
        coasting: whether R_1 is rho times the ``coasted`` rotation, with rho in [0, 1] free (for
            rotation order 2).
        tolerance: Clarabel's, on feasibility and on the gap.

    Attributes:
        count: number of columns.
        x: columns of x_1..x_N, shape (N, width).
        t: columns of t_1..t_N, shape (N,) or (0,).
    """

    def __init__(
        self, problem: Problem, *, coasting: bool = False, tolerance: float = 1e-9
    ) -> None:
        self.problem, self._tolerance = problem, tolerance
        n, steps = problem.dimension, problem.horizon
        self._decided = problem.rotation_order - 1
        self._coasting = coasting and bool(self._decided)
        axial = not (problem.weighs_rotations or self._decided)
        self._width = n if axial else coordinate_count(n)
        self._lengths = length_weights(problem)[1:]
        sized = bool(self._lengths.any() or problem.tilt or problem.max_acceleration)
        self.count = 0
        self._x = self._columns(steps + 1, self._width)
        self._y = self._columns(steps, 1 + problem.inertial, n)  # v_k and p_k
        self.x, self.t = self._x[1:], self._columns(steps * sized)
        self._rho = self._columns(int(self._coasting))
        self._along = self._columns(
            int(problem.first_turn_is_a_cone) + int(problem.approach.exists)
        )
        self._parts = list[Part]()
        self._rows = {'chords': slice(0, 0)}
        self._state_moves()
        self._state_limits()
        rows, offsets, cones = zip(*self._parts, strict=True)
        stacked = sparse.vstack(rows, format='csc'), np.concatenate(offsets)
        self._stated = ConeProgram(*self._cost(), *stacked, list(chain.from_iterable(cones)))
        self._request: Request | None = None

    # --- what does not depend on the state

    def _columns(self, *shape: int) -> np.ndarray:
        """Return the indices of new columns."""
        first, self.count = self.count, self.count + math.prod(shape)
        return first + np.arange(math.prod(shape)).reshape(shape)

    def _over(self, columns: np.ndarray, part: Any) -> sparse.csr_matrix:
        """Return rows over some columns as rows over all of them."""
        part = sparse.coo_matrix(part)
        places = part.row, columns.ravel()[part.col]
        return sparse.csr_matrix((part.data, places), shape=(part.shape[0], self.count))

    def _add(self, name: str, rows: sparse.csr_matrix, offsets: Any, cones: list[Any]) -> None:
        """Add rows with offsets for each, or one for all."""
        begun, count = sum(len(b) for _, b, _ in self._parts), rows.shape[0]
        self._rows[name] = slice(begun, begun + count)
        self._parts.append((rows, np.broadcast_to(np.asarray(offsets, float), count), cones))

    def _state_moves(self) -> None:
        """State x_0, the dynamics and an arrival."""
        problem, n, steps = self.problem, self.problem.dimension, self.problem.horizon
        start, last = self._x[0], self._y[-1]
        self._add('start', self._over(start, np.eye(len(start))), 0.0, [Zero(len(start))])
        once = step_of(problem.translation, problem.step, problem.forward)
        kept = sparse.eye(steps * len(last)) - sparse.kron(np.eye(steps, k=-1), once.transition)
        pushed = sparse.kron(np.eye(steps, steps + 1), once.push[:, None])
        pushed += sparse.kron(np.eye(steps, steps + 1, 1), once.follow[:, None])
        moved = self._over(self._y, sparse.kron(kept, np.eye(n)))
        moved -= self._over(self._x, sparse.kron(pushed, np.eye(n, self._width)))
        self._add('moved', moved, 0.0, [Zero(self._y.size)])
        if problem.terminal == 'constraint':
            self._add('arrival', self._over(last, np.eye(last.size)), 0.0, [Zero(last.size)])

    def _state_limits(self) -> None:
        """State the limits of each R_k, of its speed and tilt, of the slope, and of chords."""
        problem, n, steps = self.problem, self.problem.dimension, self.problem.horizon
        free, every = self.x[self._decided :], np.eye(steps)
        if len(self.t):
            self._below('speed', self._over(self.t, every[self._decided :]), 1.0)
            if problem.least_speed > 0.0:
                self._below('floor', self._over(self.t, -every), -problem.least_speed)
            self._within('disks', self.x, every, 0.0, self.t)
        elif self._width == n:
            self._within('balls', free, np.eye(len(free)), 1.0)
        if problem.tilt:
            lean = self._over(self.t, math.cos(problem.tilt) * every)
            self._below('tilt', lean - self._over(self.x[:, 2], every), 0.0)
        if self._coasting:
            self._below('fraction', self._over(self._rho, [[-1.0], [1.0]]), [0.0, 1.0])
        if problem.glide_slope:
            x, y, z = slope_sides(problem)
            sides = -np.array([[0.0, 0.0, z], [x, 0.0, 0.0], [0.0, y, 0.0]])
            beside = self._over(self._y[:, 0], sparse.kron(every, sides))
            self._add('slope', beside, 0.0, [Round(3)] * steps)
        # With angles, the first turn is from Q_0 e1: no chord of R_0 e1.
        turned = np.diff(np.eye(steps + 1), axis=0)[int(problem.turns_are_angles) :]
        if problem.max_rate and len(turned):
            self._within('chords', self._x, turned, problem.chord)
        if self._width == 9:
            import_module('scipy.linalg')  # Clarabel would, at the first solve: 60 ms, in a tick
            constant, linear = lmi_parts()
            low, high = np.tril_indices(ORDER)  # of the transpose, hence column by column
            scale, picked = np.where(low == high, 1.0, math.sqrt(2.0)), ORDER * high + low
            parts = sparse.kron(np.eye(len(free)), -scale[:, None] * linear[picked])
            offsets = np.tile(scale * constant[picked], len(free))
            self._add(
                'orbitopes', self._over(free, parts), offsets, [Semidefinite(ORDER)] * len(free)
            )

    def _below(self, name: str, rows: sparse.csr_matrix, offsets: Any) -> None:
        self._add(name, rows, offsets, [Positive(rows.shape[0])])

    def _within(
        self, name: str, x: np.ndarray, shares: Array, size: float, sizes: np.ndarray = NONE
    ) -> None:
        """Add cones |sum_k shares_k z_k| <= size; the first row of each is that of the size.

        Args:
            name: of the rows.
            x: columns of rotations or axes whose thrust axes are z_1..z_M, shape (M, width).
            shares: shape (K, M).
            size: of all; 0 with ``sizes``.
            sizes: columns of each size, shape (K,), or (0,).
        """
        n, count = self.problem.dimension, len(shares)
        sides, heads = np.eye(1 + n, self._width, -1), np.eye(1 + n, 1)
        rows = self._over(x, sparse.kron(-shares, sides))
        if len(sizes):
            rows -= self._over(sizes, sparse.kron(np.eye(count), heads))
        self._add(name, rows, np.tile(size * heads[:, 0], count), [Round(1 + n)] * count)

    def _cost(self) -> tuple[sparse.csc_matrix, Array]:
        """Return the upper half of P (distances, inputs, the last rotation), and q (lengths)."""
        problem = self.problem
        diagonal, linear = np.zeros(self.count), np.zeros(self.count)
        weights = 2.0 * motion_weights(problem)
        diagonal[self._y[:, 0]], diagonal[self._y[-1, 1:]] = weights[:-1, None], weights[-1]
        bent, steadying = 2.0 * turning_weights(problem)
        diagonal[self._x[-1]] = steadying
        if len(self.t):
            linear[self.t] = self._lengths
        differences = sparse.csc_matrix(input_map(problem))
        turning = bent * (differences.T @ differences)
        rest = sparse.csc_matrix((self.count - self._x.size,) * 2)
        inputs = sparse.block_diag([sparse.kron(turning, sparse.eye(self._width)), rest])
        return sparse.csc_matrix(sparse.triu(inputs + sparse.diags(diagonal))), linear

    # --- what depends on it

    def stated(self, request: Request) -> ConeProgram:
        """Return the program of a request."""
        if request is not self._request:
            self._bind(request)
        return self._program

    def _bind(self, request: Request) -> None:
        """Set the data of the next solves from state and goals."""
        problem, state, goals = self.problem, request.state, request.goals
        weights, seen = motion_weights(problem)[:-1], goals - state.position
        steadying, wanted = turning_weights(problem)[1], knowns(state, goals)[3]
        constant = float(np.sum(weights[:, None] * seen * seen)) + first_length(problem, state)
        constant += steadying * float(wanted @ wanted)
        pull, q = -2.0 * weights[:, None] * seen, self._stated.linear.copy()
        q[self._y[:, 0]] += pull
        if steadying > 0.0:  # otherwise the columns may be those of thrust axes only
            q[self._x[-1]] -= 2.0 * steadying * wanted
        moved = self._stated._replace(linear=q, offsets=self._offsets(request, seen))
        self._program = moved.extended(*self._aimed(state))
        self._request, self._constant = request, constant
        # The whole cost is scaled down for distant goals: otherwise a goal 1e4 horizons away makes
        # an interior-point method report a feasible problem as infeasible.
        reach = problem.horizon * problem.step * problem.forward
        usual = FAR * (1.0 + 2.0 * float(weights.max()) * reach)
        self._scale = max(1.0, float(np.abs(pull).max()) / usual)

    def _offsets(self, request: Request, seen: Array) -> Array:
        """Return b for state and goals; ``seen`` are g_1 - s_0..g_N - s_0, shape (N, n)."""
        problem, state, rows = self.problem, request.state, self._rows
        b, moved = self._stated.offsets.copy(), np.empty(self._y.shape)
        b[rows['start']] = coordinates(state.rotation)[: self._width]
        once = step_of(problem.translation, problem.step, problem.forward)
        moved[:] = np.outer(once.blow, state.disturbance)
        if problem.inertial:
            moved[0] += np.outer(once.transition[:, 1], state.velocity)
        b[rows['moved']] = moved.ravel()
        if problem.terminal == 'constraint':
            b[rows['arrival']][: problem.dimension] = seen[-1]
        if problem.has_cones:
            eased = relief(problem, state, request.goals)
            if problem.tilt:
                b[rows['tilt']] = eased.tilt
            if problem.glide_slope:
                above = np.outer(eased.slope, [0.0, 0.0, 1.0]) - slope_sides(problem) * seen
                b[rows['slope']] = above[:, [2, 0, 1]].ravel()
        return b

    def _aimed(self, state: State) -> list[Part]:
        """Return rows whose entries depend on the state: R_1 if it decides that, and cones."""
        problem, n = self.problem, self.problem.dimension
        parts, aims = list[Part](), []
        if self._decided:
            values = coordinates(state.rotation + problem.step * state.rotation_rate)
            fixed = np.eye(self._width, self.count, self.x[0, 0])
            if self._coasting:
                assert state.coasted is not None
                fixed[:, self._rho[0]], values = -coordinates(state.coasted), 0.0 * values
            parts.append((fixed, values, [Zero(self._width)]))
        if problem.first_turn_is_a_cone:
            aims.append((self.x[0, :n], state.attitude[:, 0], problem.widest_turn))
        if problem.approach.exists:
            last, axis = self.x[-1, :n], problem.approach.axis(state)
            aims.append((last, axis, problem.approach.cone))
            ahead = np.zeros((1, self.count))
            ahead[0, last] = -axis
            least = math.cos(problem.approach.cone) * problem.least_heading
            parts.append((ahead, np.array([-least]), [Positive(1)]))
        for along, (z, axis, angle) in zip(self._along, aims, strict=True):
            cone = np.zeros((1 + n, self.count))
            cone[1:, z] = -np.eye(n)
            cone[:, along] = [-math.sin(angle), *axis]
            parts.append((cone, np.zeros(1 + n), [Round(1 + n)]))
        return parts

    # --- solves

    def relax(
        self, request: Request, rows: Sequence[Row] = (), chords: Array | None = None
    ) -> Relaxation:
        """See :meth:`orbimpc_ros.mpc.solve.relaxation.Relaxed.relax`."""
        program = self.stated(request)
        if chords is not None:
            b = program.offsets.copy()
            b[self._rows['chords']][:: 1 + self.problem.dimension] = chords
            program = program._replace(offsets=b)
        return self.solved(request, self.cut(program, rows))

    def cut(self, program: ConeProgram, rows: Sequence[Row], *, equal: bool = False) -> ConeProgram:
        """Return a program with half-spaces added, or their boundary planes if ``equal``."""
        if not rows:
            return program
        shares, normals = (np.array([row[i] for row in rows]) for i in (1, 2))
        entries = np.zeros((len(rows), self.count))
        axes = self.x[:, : self.problem.dimension]
        entries[:, axes] = -shares[:, :, None] * normals[:, None]
        offsets, cone = -np.array([row.offset for row in rows]), Zero if equal else Positive
        return program.extended((entries, offsets, [cone(len(rows))]))

    def solved(self, request: Request, program: ConeProgram) -> Relaxation:
        """Return the solution of the program of the last request with rows added, and its bound."""
        relaxed = self._solved(request, program, self._scale)
        if request.late or not relaxed.is_accurate or relaxed.bound >= SMALL * self._scale:
            return relaxed
        # Near the goal the cost almost vanishes: a gap that is small compared to 1 is not small
        # compared to the cost unless the cost is scaled up.
        anew = self._solved(request, program, max(relaxed.bound, TINY))
        return anew if anew.is_accurate else relaxed

    def _solved(self, request: Request, program: ConeProgram, scale: float) -> Relaxation:
        """Solve with the cost divided by ``scale``.

        If Clarabel reports infeasibility, its multipliers are taken as a Farkas certificate.
        """
        answer = run(program, self._tolerance, scale, request.out_of_time)
        if answer is None:
            return Relaxation(None, -np.inf)
        x = np.asarray(answer.x)
        multipliers = self._multipliers(x, scale * np.asarray(answer.z))
        if str(answer.status) in REFUTED:
            return Relaxation(None, np.inf, multipliers, empty=True)
        accurate = str(answer.status) in SOLVED or _is_within(answer, NEAR)
        if not (accurate or _is_within(answer, ROUGH)):
            return Relaxation(None, -np.inf, multipliers)
        rotations = x[self.x]
        if self._width < coordinate_count(self.problem.dimension):
            rotations = coordinates(carried(request.state.attitude, rotations))
        bound = scale * answer.obj_val_dual + self._constant if accurate else -np.inf
        return Relaxation(rotations, bound, multipliers)

    # --- multipliers

    def _multipliers(self, x: Array, z: Array) -> Multipliers:
        """Return the multipliers of a solution in the form of proofs.

        Args:
            x: the solution, all columns.
            z: multipliers of all rows.
        """
        problem, n, steps = self.problem, self.problem.dimension, self.problem.horizon
        own, rows = self._program, self._rows
        count = len(own.offsets)
        none: Array = np.zeros((steps, n))
        pull, slide, tether, share = none[:0], none[:0, :0], none.copy(), none
        if problem.terminal == 'constraint':
            pull = z[rows['arrival']].reshape(-1, n)
        if problem.glide_slope:
            slide = self._sliding(z[rows['slope']].reshape(-1, 3))
        tied = z[rows['chords']].reshape(-1, 1 + n)[:, 1:]
        tether[steps - len(tied) :] = -tied
        # All other constraints on a single R_k e1 but its ball, or orbitope.
        held, fixed = np.zeros(count), len(self._stated.offsets)
        if n == 3:
            held[fixed:] = z[fixed:count]
        if problem.tilt:
            held[rows['tilt']] = z[rows['tilt']]
        if len(self.t):
            held[rows['disks']] = self._leaning(z)
        if held.any():
            share = -(own.rows.T @ held)[self.x[:, :n]]
        return Multipliers(x[self.x], np.maximum(z[count:], 0.0), pull, slide, tether, share)

    def _leaning(self, z: Array) -> Array:
        """Return the share of the tilt, and with d = 9 of lengths, in the multipliers of disks.

        Those of t >= |z| balance those of lengths and of z_3 >= cos(tilt) t; at t = floor only part
        of them. They are shared between both in proportion; the rest of the tilt's is a multiplier
        of z_3 >= cos(tilt) floor.
        """
        disks, leaning = z[self._rows['disks']].reshape(len(self.t), -1), 0.0 * self._lengths
        if self.problem.tilt:
            leaning = math.cos(self.problem.tilt) * np.maximum(z[self._rows['tilt']], 0.0)
        held = leaning + self._lengths * (self._width == 9)
        sizes = np.linalg.norm(disks[:, 1:], axis=1)
        most = np.maximum(np.maximum(self._lengths + leaning, sizes), TINY)
        return (disks * (held / most)[:, None]).ravel()

    def _sliding(self, z: Array) -> Array:
        """Return multipliers of the glide slope, moved into the polar cone, shape (N, 3)."""
        x, y, height = slope_sides(self.problem)
        slide = -np.array([x, y, height]) * z[:, [1, 2, 0]]
        rim = OUTWARD * height / x * np.hypot(slide[:, 0], slide[:, 1])
        slide[:, 2] = np.minimum(slide[:, 2], -rim)
        return slide


def _is_within(answer: Any, tolerance: float) -> bool:
    """Return True if a solve that stalled nevertheless satisfies the constraints."""
    near = answer.r_prim <= tolerance and np.isfinite(answer.x).all()
    return bool(near and str(answer.status) in STUCK)
