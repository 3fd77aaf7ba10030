# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The relaxed problem in CVXPY, term by term as the paper has it, R_k in conv SO(n).

Mathematics: docs/mathematics.md, 4.8.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import sparse

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.orbitopes import constraints, coordinate_count, coordinates
from orbimpc_ros.mpc.model.cost import (
    attitude_weight,
    input_weight,
    length_weights,
    position_weights,
    velocity_weight,
)
from orbimpc_ros.mpc.model.dynamics import adrift, input_map
from orbimpc_ros.mpc.model.translation import Step, step_of
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.cones import relief, slope_sides
from orbimpc_ros.mpc.solve.disjunction import Slot

try:
    import cvxpy as cp
except ModuleNotFoundError:
    raise BadInput.without('cvxpy') from None


class Statement:
    """The convex program of a problem in CVXPY, parametrised by state and goals.

    Variables are the rotation coordinates x_k of R_k and the displacements v_k = s_k - d_k from
    d_k, where the disturbance alone takes s_0; velocities, too, are without what it adds to them.
    With those, the state stands on right-hand sides only, and the goals in linear terms of the
    cost: q_k |s_k - g_k|^2 = q_k |v_k|^2 + pull_k . v_k + a constant, pull_k = -2 q_k (g_k - d_k).

    Each slot is one linear row over R_k e1 or v_k that a search may fill with a half-space; here
    its coefficients are placeholders that keep a place in the compiled matrix.

    Args:
        problem: what to solve.
        slots: what half-spaces will be put on.
        coasting: whether R_1 = rho * (the coasted rotation) with rho in [0, 1] free.
    """

    def __init__(self, problem: Problem, slots: Sequence[Slot], coasting: bool) -> None:
        n, steps, d = problem.dimension, problem.horizon, coordinate_count(problem.dimension)
        self.problem, self.coasting = problem, coasting
        self.x = cp.Variable((steps + 1) * d, name='R')
        self.moved = cp.Variable(steps * n, name='s - s_0')
        self.pull = cp.Parameter(steps * n)
        self.fraction = cp.Variable(name='thrust fraction')
        self.along, self.across = cp.Variable(name='along Q_0 e1'), cp.Variable(n)
        self._rotations = cp.reshape(self.x, (steps + 1, d), order='C')
        self._displacements = cp.reshape(self.moved, (steps, n), order='C')
        self._headings = self._rotations[:, :n]
        self._first = cp.Parameter(d)
        self._second = cp.Parameter(d)
        self._velocity = cp.Parameter(n)
        self._arrival, self._stopped = cp.Parameter(n), cp.Parameter(n)
        self._chords = self._chord_parameter()
        self._eased = cp.Parameter(steps) if problem.tilt else None
        self._sloped = [cp.Parameter(steps) for _ in range(n)] if problem.glide_slope else []
        self.towards, self.aside = cp.Variable(name='along the approach'), cp.Variable(n)
        self._steep = cp.Variable(steps, name='|R e1| or the floor')
        self._velocities: cp.Variable | None = None
        self.lengths: cp.Variable | None = None
        self.slots = tuple(slots)
        self._offsets = cp.Parameter(len(slots)) if slots else None
        flown = [*self._rotation_constraints(), *self._translation_constraints()]
        cost, epigraph = self._cost()
        self.program = cp.Problem(
            cp.Minimize(cost), [*flown, *self._limits(), *epigraph, *self._slot_rows()]
        )

    def values(self, state: State, goals: Array) -> Array:
        """Return what a state and goals g_1..g_N, shape (N, n), put on right-hand sides."""
        known = {
            self._first: coordinates(state.rotation),
            self._second: coordinates(state.rotation + self.problem.step * state.rotation_rate),
            self._velocity: state.velocity,
            self._arrival: goals[-1] - adrift(self.problem, state)[-1],
            self._stopped: -self.problem.maps.hastened[-1, 0] * state.disturbance,
        }
        if self.problem.has_cones:
            known |= self._cone_values(state, goals)
        if self._chords is not None:
            known[self._chords] = np.full(self._chords.size, self.problem.chord)
        return np.concatenate([known[parameter] for parameter in self._parameters()])

    def _cone_values(self, state: State, goals: Array) -> dict[cp.Parameter, Array]:
        """Return what is demanded of a state, and where the cone's tip is in displacements."""
        eased = relief(self.problem, state, goals)
        known = {} if self._eased is None else {self._eased: eased.tilt}
        if self._sloped:
            sides = slope_sides(self.problem) * (adrift(self.problem, state) - goals)
            sides[:, -1] += eased.slope
            known |= dict(zip(self._sloped, sides.T, strict=True))
        return known

    def compiled(self, values: Array | None = None, offsets: Array | None = None) -> dict[str, Any]:
        """Return Clarabel's data for :meth:`values` and offsets of slots; both zero by default."""
        ends = np.cumsum([parameter.size for parameter in self._parameters()])
        values = np.zeros(ends[-1]) if values is None else values
        for parameter, value in zip(self._parameters(), np.split(values, ends), strict=False):
            parameter.value = value
        self.pull.value = np.zeros(self.pull.size)
        if self._offsets is not None:
            self._offsets.value = np.zeros(len(self.slots)) if offsets is None else offsets
        return self.program.get_problem_data(cp.CLARABEL, enforce_dpp=True)[0]

    @property
    def width(self) -> int:
        """Return the coordinates of a rotation."""
        return coordinate_count(self.problem.dimension)

    def coordinates(self, x: Array, state: State) -> Array:
        """Return rotation coordinates, shape (N, d), of x_1..x_N: these are."""
        return x

    @property
    def size(self) -> int:
        """Return the length of :meth:`values`."""
        return sum(parameter.size for parameter in self._parameters())

    def _parameters(self) -> list[cp.Parameter]:
        known = {p.id for p in self.program.parameters()}
        candidates = [self._first, self._second, self._velocity, self._arrival, self._stopped]
        candidates += [*([] if self._eased is None else [self._eased]), *self._sloped]
        if self._chords is not None:
            candidates.append(self._chords)
        return [p for p in candidates if p.id in known]

    @property
    def arrival(self) -> slice:
        """Return which of :meth:`values` say where s_N has to be, and then p_N."""
        known = self._parameters()
        first = next((i for i, p in enumerate(known) if p is self._arrival), len(known))
        ends = np.cumsum([0, *(p.size for p in known)])
        count = self.problem.dimension * (1 + self.problem.inertial)
        return slice(int(ends[first]), int(ends[first]) + count * (first < len(known)))

    @property
    def chords(self) -> int:
        """Return how many turns a chord bounds: the last of :meth:`values`."""
        return 0 if self._chords is None else self._chords.size

    def _chord_parameter(self) -> cp.Parameter | None:
        """With a floor the first turn is measured from an attitude, not from R_0 e1."""
        count = self.problem.horizon - int(self.problem.turns_are_angles)
        return cp.Parameter(count) if self.problem.max_rate > 0.0 and count > 0 else None

    def _rotation_constraints(self) -> list[cp.Constraint]:
        problem, x = self.problem, self._rotations
        given: list[cp.Constraint] = [x[0] == self._first]
        if problem.rotation_order == 1:
            return given + constraints(x[1:], problem.dimension)
        if self.coasting:
            placeholder = np.ones(coordinate_count(problem.dimension))
            given += [x[1] == self.fraction * placeholder, self.fraction >= 0, self.fraction <= 1]
        else:
            given.append(x[1] == self._second)
        free = constraints(x[2:], problem.dimension) if problem.horizon > 1 else []
        return given + free

    def _translation_constraints(self) -> list[cp.Constraint]:
        """The model's steps y_{k+1} = A y_k + b R_k e1 + c R_{k+1} e1, with v for positions."""
        problem = self.problem
        once = step_of(problem.translation, problem.step, problem.forward)
        a, (flown, pushed), rows = once.transition, self._pushes(once), []
        if problem.inertial:
            velocity = cp.Variable((problem.horizon + 1, problem.dimension), name='p')
            self._velocities = velocity
            rows = [
                velocity[0] == self._velocity,
                velocity[1:] == a[1, 1] * velocity[:-1] + pushed,
            ]
            flown = a[0, 1] * velocity[:-1] + flown
        moved = self._displacements
        rows.append(moved[0] == flown[0])
        if problem.horizon > 1:
            rows.append(moved[1:] == moved[:-1] + flown[1:])
        if problem.terminal == 'constraint':
            rows.append(moved[-1] == self._arrival)
            if self._velocities is not None:
                rows.append(self._velocities[-1] == self._stopped)
        return rows

    def _pushes(self, once: Step) -> list[Any]:
        """Return what thrust adds to the first and to the last part of y in each step."""
        before, after = self._headings[:-1], self._headings[1:]
        terms = [
            [
                each * axes
                for each, axes in ((once.push[i], before), (once.follow[i], after))
                if each
            ]
            for i in (0, -1)
        ]
        return [sum(some) if some else 0.0 for some in terms]

    def _limits(self) -> list[cp.Constraint]:
        """|(R_{k+1} - R_k) e1| <= the chords, the cone of a first turn by an angle, and others."""
        limits = self._first_turn() if self.problem.first_turn_is_a_cone else []
        limits += self._approached() if self.problem.approach.exists else []
        limits += [] if self._eased is None else self._tilted(self._eased)
        if self._sloped:
            x, y, z = slope_sides(self.problem)
            moved = self._displacements
            aside = [x * moved[:, 0] + self._sloped[0], y * moved[:, 1] + self._sloped[1]]
            limits.append(cp.SOC(z * moved[:, 2] + self._sloped[2], cp.vstack(aside)))
        if self._chords is not None:
            begin = int(self.problem.turns_are_angles)
            turned = self._headings[begin + 1 :] - self._headings[begin:-1]
            limits.append(cp.SOC(self._chords, turned.T))
        return limits

    def _first_turn(self) -> list[cp.Constraint]:
        """|R_1 e1 - rho Q_0 e1| <= rho sin(h omega) for some rho >= 0: the cone around Q_0 e1."""
        problem = self.problem
        placeholder = np.ones(problem.dimension)
        widest = math.sin(problem.step * problem.max_rate)
        return [
            self.across == self._headings[1] - self.along * placeholder,
            cp.SOC(widest * self.along, self.across),
        ]

    def _approached(self) -> list[cp.Constraint]:
        """|R_N e1 - rho d| <= rho sin(cone) for some rho >= 0: the cone around d."""
        placeholder = np.ones(self.problem.dimension)
        return [
            self.aside == self._headings[-1] - self.towards * placeholder,
            cp.SOC(math.sin(self.problem.approach.cone) * self.towards, self.aside),
        ]

    def _tilted(self, eased: cp.Parameter) -> list[cp.Constraint]:
        """z_3 >= cos(tilt) t for some t >= |z|, and of at least the floor: |z| itself, if need be.

        Where a floor is in force, that is the hull of the headings allowed.
        """
        up, least = self._headings[1:, -1], self.problem.floor.clearance(self.problem.dimension)
        rows: list[cp.Constraint] = [
            cp.SOC(self._steep, self._headings[1:].T),
            up - math.cos(self.problem.tilt) * self._steep >= -eased,
        ]
        return rows if least == 0.0 else [*rows, self._steep >= least]

    def _slot_rows(self) -> list[cp.Constraint]:
        if self._offsets is None:
            return []
        seen = {'heading': self._headings, 'position': self._displacements}
        ones = np.ones(self.problem.dimension)
        picked = [seen[s.on][s.step - (s.on == 'position')] @ ones for s in self.slots]
        return [cp.hstack(picked) >= self._offsets]

    def slot_variables(self, slot: int) -> tuple[cp.Variable, range]:
        """Return the variable that a slot is a row over, and which of its entries."""
        n, wanted = self.problem.dimension, self.slots[slot]
        if wanted.on == 'heading':
            start = wanted.step * coordinate_count(n)
            return self.x, range(start, start + n)
        return self.moved, range((wanted.step - 1) * n, wanted.step * n)

    def last_velocity(self, column_of: Mapping[int, int]) -> np.ndarray:
        """Return the columns of p_N, given where each variable begins; none without inertia."""
        if self._velocities is None:
            return np.zeros(0, int)
        count, n = self._velocities.shape  # column by column, as CVXPY has all matrices
        return column_of[self._velocities.id] + count * np.arange(1, n + 1) - 1

    def largest(self, speed: float, spin: float) -> dict[cp.Variable, Array]:
        """Return the most that each entry of each variable can be in a plan from a state.

        Entries of matrices in conv SO(n) are at most 1; what moves adds that up.

        Args:
            speed: |p_0| at translation order 2 [m/s].
            spin: the largest entry of W_0 at rotation order 2 [1/s].
        """
        problem, n, flown = self.problem, self.problem.dimension, self.problem.maps
        moved = flown.drift[:, 0] * speed + flown.reach.sum(axis=1)
        pushed = flown.carried[:, 0] * speed + flown.pushed.sum(axis=1)
        angle = problem.step * problem.max_rate if problem.first_turn_is_a_cone else 0.0
        rho, farthest = 1.0 / math.cos(angle), 1.0 / math.cos(problem.approach.cone)
        each = {
            self.x: np.full(self.x.size, 1.0 + problem.step * spin),
            self.moved: np.repeat(moved, n),
            self.fraction: np.ones(1),
            self._steep: np.ones(self._steep.size),
            self.along: np.array([rho]),
            self.across: np.full(n, 1.0 + rho),
            self.towards: np.array([farthest]),
            self.aside: np.full(n, 1.0 + farthest),
        }
        if self._velocities is not None:
            each[self._velocities] = np.tile(np.append(speed, pushed), n)  # column by column
        if self.lengths is not None:
            each[self.lengths] = np.ones(self.lengths.size)
        present = {v.id for v in self.program.variables()}
        return {v: size for v, size in each.items() if v.id in present}

    def _cost(self) -> tuple[cp.Expression, Sequence[cp.Constraint]]:
        problem, n = self.problem, self.problem.dimension
        squares = sparse.diags(np.repeat(position_weights(problem), n)).tocsc()
        cost = cp.quad_form(self.moved, squares, assume_PSD=True) + self.pull @ self.moved
        cost += cp.quad_form(self.x, self._turning_form(), assume_PSD=True)
        if self._velocities is not None and problem.arrival_weight > 0.0:
            cost += velocity_weight(problem) * cp.sum_squares(self._velocities[-1])
        weights = length_weights(problem)[1:]
        priced = np.flatnonzero(weights)
        if not len(priced):
            return cost, []
        length = self.lengths = cp.Variable(len(priced), name='|R e1|')
        epigraph: list[cp.Constraint] = [cp.SOC(length, self._headings[1 + priced].T)]
        least = problem.floor.clearance(n)
        if least > 0.0:
            epigraph.append(length >= least)  # valid: the floor says the same
        return cost + weights[priced] @ length, epigraph

    def _turning_form(self) -> sparse.csc_matrix:
        """Return the form of the inputs, and of R_N, whose pull towards R_g is linear."""
        n = self.problem.dimension
        differences = sparse.csc_matrix(input_map(self.problem))
        weighted = input_weight(self.problem) * (differences.T @ differences)
        last = np.zeros(self.problem.horizon + 1)
        last[-1] = attitude_weight(self.problem)
        weighted = weighted + sparse.diags(last)
        return sparse.kron(weighted, sparse.eye(coordinate_count(n))).tocsc()
