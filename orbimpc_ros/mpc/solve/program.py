# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The convex program behind every plan: compiled once, then only updated in place and solved.

Compiling the statement gives Clarabel's data (P, q, A, b). The state enters b, linearly, and the
goals q; half-spaces that a search imposes enter a few entries of A and b. A tick is therefore one
matrix-vector product, an update and a solve; CVXPY is not touched again.

Mathematics: docs/mathematics.md, 4.8.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import Infeasible, SolverFailure
from orbimpc_ros.mpc.geometry.orbitopes import coordinate_count, coordinates
from orbimpc_ros.mpc.model.cost import (
    attitude_weight,
    first_length,
    length_weights,
    position_weights,
    velocity_weight,
    wanted_coordinates,
)
from orbimpc_ros.mpc.model.dynamics import adrift
from orbimpc_ros.mpc.model.trajectory import trajectory_of
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.solve.conic import SOLVED, Certifier, extended, run, solver_for
from orbimpc_ros.mpc.solve.direct_statement import DirectStatement
from orbimpc_ros.mpc.solve.disjunction import Slot
from orbimpc_ros.mpc.solve.relaxation import (
    NO_CONES,
    NO_PULL,
    Halfspace,
    Multipliers,
    Point,
    Relaxation,
)
from orbimpc_ros.mpc.solve.request import Request

SMALL = 1e-2  # a cost below this is solved once more, scaled up
TINY = 1e-11  # well below the 1e-9 that gaps are measured against at the least
INERT = 1.0  # an empty slot reads 0 <= 1
STUCK = ('NumericalError', 'InsufficientProgress')
NEAR = 1e-9  # on constraints, of an answer that is not accurate otherwise
ROUGH = 1e-4  # on constraints, of an answer that is good enough to branch on
FAR = 1.0  # a goal is far from this many horizons on

Cut = tuple[Array, Array, float]  # a row over R_1 e1..R_N e1, a unit normal, an offset


class Program:
    """The convex program of a problem, compiled for repeated solves.

    Args:
        problem: what to solve.
        slots: what half-spaces may be put on from solve to solve.
        coasting: whether states come with a ``coasted`` rotation (for rotation order 2).
        tolerance: Clarabel's, on feasibility and on the gap.

    Attributes:
        multipliers: see :class:`orbimpc_ros.mpc.solve.relaxation.Relaxed`.
        chords: see there.
    """

    def __init__(
        self,
        problem: Problem,
        slots: Sequence[Slot] = (),
        *,
        coasting: bool = False,
        tolerance: float = 1e-9,
    ) -> None:
        self.problem = problem
        if problem.approach.exists:  # the least heading, which no search has to fill in
            slots = (*slots, Slot('heading', problem.horizon))
        self._statement = _statement(problem, slots, coasting and problem.rotation_order == 2)
        self.chords: int = self._statement.chords
        self._tolerance = tolerance
        self._heaviest = float(position_weights(problem).max())
        axes = problem.weights.input == problem.weights.attitude == 0.0
        self._seen = problem.dimension if axes else coordinate_count(problem.dimension)
        self._stopping, self._steadying = velocity_weight(problem), attitude_weight(problem)
        self._scale = 1.0
        self._solver: Any = None
        self._request: Request | None = None
        self.multipliers: Multipliers | None = None
        self._asked: list[int] = []  # the rows of the half-spaces in force
        self._compile()

    def _bind(self, request: Request) -> None:
        """Put state and goals into the data of the solves to come."""
        self._request, state, goals = request, request.state, request.goals
        self._b = self._b_0.copy()
        self._b[self._rows] += self._signs * self._statement.values(state, goals)
        self._origins = np.broadcast_to(adrift(self.problem, state), goals.shape)
        seen = goals - self._origins
        weights = position_weights(self.problem)
        constant = float(np.sum(weights[:, None] * seen * seen))
        hastened = self.problem.maps.hastened[-1, 0] * state.disturbance
        constant += self._stopping * float(hastened @ hastened)
        wanted = wanted_coordinates(self.problem, state)
        constant += self._steadying * float(wanted @ wanted)
        self._constant = constant + first_length(self.problem, state)
        self._bind_cost(-2.0 * weights[:, None] * seen, 2.0 * self._stopping * hastened)
        if self._steadying > 0.0:  # else there may be thrust axes in the place of rotations
            self._q[self._columns[-1]] -= 2.0 * self._steadying * wanted / self._scale
        if self._statement.coasting:
            assert state.coasted is not None
            self._a_0[self._coasted] = -coordinates(state.coasted)
        if self.problem.first_turn_is_a_cone:
            self._a_0[self._cones[0].axis] = state.attitude[:, 0]
        if self.problem.approach.exists:
            self._approach(state)
        at_rest, per_speed, per_spin = self._limits
        speed = float(np.linalg.norm(state.velocity))
        self._largest = at_rest + speed * per_speed + np.abs(state.rotation_rate).max() * per_spin

    def _approach(self, state: State) -> None:
        """Put the direction of approach in: of its cone, and of the least heading along it."""
        approach, (row, entries) = self.problem.approach, self._slots[-1]
        axis = approach.axis(state)
        self._a_0[self._cones[-1].axis] = axis
        self._a_0[entries] = -axis
        self._b[row] = -math.cos(approach.cone) * self.problem.least_heading

    def relax(
        self,
        request: Request,
        halfspaces: Iterable[Halfspace] = (),
        chords: Array | None = None,
    ) -> Relaxation:
        """See :meth:`orbimpc_ros.mpc.solve.relaxation.Relaxed.relax`."""
        if request is not self._request:
            self._bind(request)
        out_of_time = request.out_of_time
        a, b = self._a_0.copy(), self._b.copy()
        if chords is not None:
            rows = slice(len(self._rows) - self.chords, None)
            b[self._rows[rows]] = self._b_0[self._rows[rows]] + self._signs[rows] * chords
        cuts: list[Cut] = []
        self._asked, end = [], self._linear
        for slot, normal, offset in halfspaces:
            if isinstance(slot, Point):
                self._asked.append(end + len(cuts))
                cuts.append((slot.row, normal, offset))
                continue
            self._asked.append(self._slots[slot][0])
            row, entries = self._slots[slot]
            put = self._statement.slots[slot]
            if put.on == 'position':  # the variable is the displacement
                offset -= float(normal @ self._origins[put.step - 1])
            a[entries] = -normal
            b[row] = -offset
        if cuts:
            relaxed = self._solve_anew(a, b, self._scale, out_of_time, cuts)
        else:
            relaxed = self._solve_in_place(a, b, out_of_time)
        if request.late:
            return relaxed
        if not relaxed.is_accurate:
            if cuts:
                return relaxed
            before = self.multipliers
            anew = self._solve_anew(a, b, self._scale, out_of_time)
            if relaxed.bound > anew.bound:
                self.multipliers = before
            best = relaxed if anew.x is None else anew
            return Relaxation(best.x, max(relaxed.bound, anew.bound), best.dual_value)
        if relaxed.bound < SMALL * self._scale:
            return self._bound_anew(relaxed, a, b, out_of_time, cuts)
        return relaxed

    def _solve_in_place(
        self, a: Array, b: Array, out_of_time: Callable[[], bool] | None
    ) -> Relaxation:
        self._solver.update(q=self._q, A=a, b=b)
        answer = run(self._solver, out_of_time)
        if answer is None:  # nobody knows in which state a panic leaves a solver
            self._solver = solver_for({**self._data, 'P': self._p / self._scale}, self._tolerance)
        return self._relaxation(answer, a, b, self._q, self._scale)

    def _bound_anew(
        self,
        relaxed: Relaxation,
        a: Array,
        b: Array,
        out_of_time: Callable[[], bool] | None,
        cuts: Sequence[Cut],
    ) -> Relaxation:
        """Return a relaxation as accurate in proportion as where the cost is large.

        Near the goal the cost all but vanishes, and a gap that is small against one is not small
        against the cost. Solved once more with the cost scaled up, it is.
        """
        before = self.multipliers
        scaled = self._solve_anew(a, b, max(relaxed.bound, TINY), out_of_time, cuts)
        if relaxed.bound > scaled.bound:
            self.multipliers = before
        best = min((relaxed, scaled), key=self._cost)
        return Relaxation(best.x, max(relaxed.bound, scaled.bound), best.bound)

    def _cost(self, relaxed: Relaxation) -> float:
        request = self._request
        if relaxed.x is None or not relaxed.is_accurate or request is None:
            return np.inf
        return trajectory_of(self.problem, request.state, request.goals, relaxed.x).cost

    def _solve_anew(
        self,
        a: Array,
        b: Array,
        scale: float,
        out_of_time: Callable[[], bool] | None,
        cuts: Sequence[Cut] = (),
    ) -> Relaxation:
        """Solve with Clarabel set up for these very numbers, the cost divided by ``scale``.

        That settles nearly all that an update in place could not solve. Rows over R_1 e1..R_N e1
        may come on top.
        """
        matrix = self._data['A'].copy()
        matrix.data = a
        q = self._q * (self._scale / scale)
        data = {**self._data, 'P': self._p / scale, 'c': q, 'A': matrix, 'b': b}
        certifier = self._certifier
        if cuts:
            data = self._cut(data, cuts)
            certifier = Certifier({**data, 'P': self._p})
        answer = run(solver_for(data, self._tolerance), out_of_time)
        return self._relaxation(answer, data['A'].data, data['b'], q, scale, certifier)

    def _cut(self, data: dict[str, Any], cuts: Sequence[Cut]) -> dict[str, Any]:
        """Return data with half-spaces on top that all headings have a part in."""
        rows = np.zeros((len(cuts), data['A'].shape[1]))
        axes = self._columns[:, : self.problem.dimension]
        for i, (row, normal, _) in enumerate(cuts):
            rows[i, axes] = -np.outer(row, normal)
        return extended(data, rows, -np.array([offset for *_, offset in cuts]))

    def _relaxation(
        self,
        answer: Any,
        a: Array,
        b: Array,
        q: Array,
        scale: float,
        certifier: Certifier | None = None,
    ) -> Relaxation:
        """Return what an answer comes to, with the bound that its multipliers prove.

        Raises:
            Infeasible: its multipliers prove that nothing is feasible.
        """
        if answer is None:
            self.multipliers = None
            return Relaxation(None, -np.inf)
        self.multipliers = self._multipliers(answer, scale)
        status, certifier = str(answer.status), certifier or self._certifier
        if 'PrimalInfeasible' in status:
            if certifier.refutes(answer, a, b, self._largest):
                raise Infeasible('no trajectory satisfies the constraints')
            return Relaxation(None, -np.inf)
        proved = certifier.lower_bound(answer, a, b, q, scale, self._largest)
        bound = scale * proved + self._constant
        accurate = status in SOLVED or _is_within(answer, NEAR)
        if not (accurate or _is_within(answer, ROUGH)):
            return Relaxation(None, bound)
        assert self._request is not None
        x = np.asarray(answer.x)[self._columns]
        own = bound if accurate else -np.inf
        return Relaxation(self._statement.coordinates(x, self._request.state), bound, own)

    @property
    def _linear(self) -> int:
        """Return how many rows are equations or inequalities; those of cones follow."""
        return int(self._data['dims'].zero + self._data['dims'].nonneg)

    def _multipliers(self, answer: Any, scale: float) -> Multipliers:
        z = scale * np.asarray(answer.z)
        sizes, end = np.maximum(z[self._asked], 0.0), self._linear
        z = np.delete(z, slice(end, end + len(z) - len(self._b_0)))  # without rows on top
        arrived, rows = self._statement.arrival, np.flatnonzero(sizes)
        pull = self._signs[arrived] * z[self._rows[arrived]]
        leans, props, ways = self._leaning(z)
        tied, outward, tensions = self._tied(z)
        normals = np.zeros((len(rows), self.problem.dimension))  # none of half-spaces
        point = np.asarray(answer.x)[self._columns[:, : self._seen]]
        ways = ways if self._seen == 9 and self.problem.weights.length else NO_CONES
        return Multipliers(
            point,
            np.concatenate([rows, tied]),
            np.concatenate([normals, outward]),
            np.concatenate([sizes[rows], tensions]),
            pull,
            leans,
            props,
            ways,
        )

    def _tied(self, z: Array) -> tuple[np.ndarray, Array, Array]:
        """Return the numbers, directions and sizes of the multipliers of chords."""
        heads = self._rows[len(self._rows) - self.chords :]
        pulls = z[heads[:, None] + np.arange(1, 1 + self.problem.dimension)]
        sizes = np.sqrt(np.einsum('kc,kc->k', pulls, pulls))
        numbers = -1 - self.problem.horizon - np.arange(self.chords)
        return numbers, pulls / np.maximum(sizes, TINY)[:, None], sizes

    def _leaning(self, z: Array) -> tuple[Array, Array, Array]:
        """Return the multipliers of cones, shape (C, n), and of least headings along their axes.

        And the ways along which lengths are, shape (N, n).
        """
        if isinstance(self._statement, DirectStatement):
            return self._statement.leaning(z)
        a, props = self._data['A'], NO_PULL
        leans = [a.data[cone.aside] * z[a.indices[cone.axis]] for cone in self._cones]
        if self.problem.approach.exists:
            least, _ = self._slots[-1]
            props = np.maximum(z[[least]], 0.0)
        return np.array(leans).reshape(-1, self.problem.dimension), props, self._ways(z)

    def _ways(self, z: Array) -> Array:
        """Return along which way what holds lengths >= |R_k e1| has each of them, shape (N, n)."""
        n, weights = self.problem.dimension, length_weights(self.problem)[1:]
        ways, weighed = np.zeros((len(weights), n)), weights > 0.0
        sides = z[self._heads[:, None] + np.arange(1, 1 + n)]
        sizes = np.sqrt(np.einsum('kc,kc->k', sides, sides))
        ways[weighed] = -sides / np.maximum(weights[weighed], sizes)[:, None]
        return ways

    def _limits_of(self, speed: float, spin: float) -> Array:
        """Return the most that each column's variable can be, of a state's speed and spin."""
        largest = np.zeros(len(self._q_0))
        for variable, sizes in self._statement.largest(speed, spin).items():
            first = self._data['param_prob'].var_id_to_col[variable.id]
            largest[first : first + len(sizes)] = sizes
        return largest

    def _bind_cost(self, pull: Array, braking: Array) -> None:
        """Put the pull of the goals into q; goals far away are scaled down with the whole cost.

        So is what an arrival weight has against the velocity that the disturbance ends with.

        Otherwise a goal 1e4 full horizons away makes a feasible problem look infeasible to an
        interior-point method.
        """
        reach = self.problem.horizon * self.problem.step * self.problem.forward
        usual = FAR * (1.0 + 2.0 * self._heaviest * reach)
        scale = max(1.0, float(np.abs(pull).max()) / usual)
        if scale != self._scale:
            self._solver.update(P=self._p_0 / scale)
            self._scale = scale
        self._q: Array = self._q_0 / scale
        self._q[self._moved] += pull.ravel() / scale
        self._q[self._last] += braking[: len(self._last)] / scale

    def _compile(self) -> None:
        statement = self._statement
        data = statement.compiled()
        self._b_0 = np.array(data['b'])
        self._rows, self._signs, slot_rows = self._numbered_rows()
        self._data = data
        self._locate(data, slot_rows)
        self._solver = solver_for(data, self._tolerance)
        self._p: Any = sparse.csc_matrix(data['P'])
        self._p_0: Array = sparse.csc_matrix(sparse.triu(data['P'])).data
        self._certifier = Certifier(data)
        self._q_0: Array = np.array(data['c'])
        at_rest = self._limits_of(0.0, 0.0)
        # They grow in proportion to both.
        moving = self._limits_of(1.0, 0.0) - at_rest, self._limits_of(0.0, 1.0) - at_rest
        self._limits = at_rest, *moving

    def _locate(self, data: dict[str, Any], slot_rows: np.ndarray) -> None:
        """Find where rotations, positions, slots and the coasted rotation sit in the data."""
        statement, d = self._statement, self._statement.width
        column_of = data['param_prob'].var_id_to_col
        first = column_of[statement.x.id]
        self._columns = first + np.arange(d, statement.x.size).reshape(-1, d)
        self._moved = column_of[statement.moved.id] + np.arange(statement.moved.size)
        self._last = statement.last_velocity(column_of)
        self._a_0 = data['A'].data.copy()
        self._slots = []
        for slot, row in enumerate(int(row) for row in slot_rows):
            variable, over = statement.slot_variables(slot)
            columns = [column_of[variable.id] + i for i in over]
            entries = np.array([_entry(data['A'], row, c) for c in columns])
            self._a_0[entries] = 0.0
            self._b_0[row] = INERT
            self._slots.append((row, entries))
        self._heads = np.zeros(0, int)  # of the cones that hold lengths
        if statement.lengths is not None:
            columns = column_of[statement.lengths.id] + np.arange(statement.lengths.size)
            a = data['A']
            self._heads = np.array([a.indices[slice(*a.indptr[c : c + 2])].max() for c in columns])
        if statement.coasting:
            column = column_of[statement.fraction.id]
            self._coasted = _shared_entries(data['A'], column, first + d + np.arange(d))
        cones = []
        if self.problem.first_turn_is_a_cone:
            cones.append((statement.along, statement.across))
        if self.problem.approach.exists:
            cones.append((statement.towards, statement.aside))
        self._cones = [
            _cone(data['A'], column_of[along.id], column_of[across.id] + np.arange(across.size))
            for along, across in cones
        ]

    def _numbered_rows(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the row and sign of each right-hand side, and the row of each slot.

        Each of them stands alone in a row of b, as itself or with the sign changed: numbers in
        their place show up there.
        """
        size, slots = self._statement.size, len(self._statement.slots)
        numbers = np.arange(1.0, size + slots + 1.0)
        numbered = self._statement.compiled(numbers[:size], numbers[size:])['b'] - self._b_0
        found = np.flatnonzero(np.abs(numbered) > 0.5)
        order = found[np.argsort(np.abs(numbered[found]))]
        if not np.allclose(np.abs(numbered[order]), numbers):
            raise SolverFailure('CVXPY compiled the program in a way that is not understood')
        return order[:size], np.sign(numbered[order[:size]]), order[size:]


def _statement(problem: Problem, slots: Sequence[Slot], coasting: bool) -> Any:
    """Return a problem's cone program, without CVXPY where that is possible."""
    if DirectStatement.states(problem, coasting):
        return DirectStatement(problem, slots)
    from orbimpc_ros.mpc.solve.statement import Statement  # brings CVXPY, half of a start-up

    return Statement(problem, slots, coasting)


def _is_within(answer: Any, tolerance: float) -> bool:
    """Return whether an answer whose gap would not close satisfies the constraints all the same.

    Its bound tells how far from the optimum it is.
    """
    near = answer.r_prim <= tolerance and np.isfinite(answer.x).all()
    return bool(near and str(answer.status) in STUCK)


def _entry(a: sparse.csc_matrix, row: int, column: int) -> int:
    """Return where entry (row, column) of a compressed matrix is stored."""
    start, end = a.indptr[column], a.indptr[column + 1]
    return int(start + np.flatnonzero(a.indices[start:end] == row)[0])


class _Cone(NamedTuple):
    """Where a cone is in the data: rows that say how far aside a heading is of its axis.

    Attributes:
        axis: the entries of the axis.
        aside: those of how far aside it is.
    """

    axis: np.ndarray
    aside: np.ndarray


def _cone(a: sparse.csc_matrix, along: int, across: np.ndarray) -> _Cone:
    """Return the cone of a column, of how far along its axis a heading is, and others, aside."""
    axis = _shared_entries(a, along, across)
    rows = a.indices[axis].tolist()
    return _Cone(axis, np.array([_entry(a, r, c) for r, c in zip(rows, across, strict=True)]))


def _shared_entries(a: sparse.csc_matrix, scalar: int, columns: np.ndarray) -> np.ndarray:
    """Return the entries of a scalar's column in the first row that it shares with each column."""
    held = set(a.indices[a.indptr[scalar] : a.indptr[scalar + 1]])
    shared = [
        next(r for r in a.indices[a.indptr[c] : a.indptr[c + 1]] if r in held) for c in columns
    ]
    return np.array([_entry(a, int(row), scalar) for row in shared])
