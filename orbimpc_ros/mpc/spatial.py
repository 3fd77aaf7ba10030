"""The convex program over SO(3) in machine code, where numba is installed.

Condensed: positions are eliminated, and a terminal constraint is met by every point of the search,
so that what is left are orbitopes, lengths and half-spaces on thrust axes. What this cannot settle
it leaves to the general program, such as the proof that there is no solution.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from orbimpc_ros.mpc import dynamics
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.condensed import Condensed, suits_dense_code
from orbimpc_ros.mpc.disjunction import Slot
from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.kernels.multipliers import minimise
from orbimpc_ros.mpc.kernels.terms import Terms, multipliers, scratch
from orbimpc_ros.mpc.orbitopes import coordinates
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.relaxation import Halfspace, Relaxation, Relaxed

SIGMA = (1.0, 3.0, 1e6)  # first, growth, last; times the scale of the forces at work
USUAL = 100.0  # forces of problems near their goal
PRECISION = 1e-8  # on constraints
GAP = 1e-8  # relative
ROUNDING = 1e-15  # of the largest numbers that cancel in a cost
INERT = -1.0  # offset of a row that is always satisfied


class Spatial:
    """Answers for :class:`orbimpc_ros.mpc.program.Program` on most problems of SE(3).

    Args:
        problem: what to solve.
        slots: what half-spaces may be put on: headings only.
        coasting: whether states come with a ``coasted`` rotation (for rotation order 2).
    """

    def __init__(self, problem: Problem, slots: Sequence[Slot] = (), *, coasting: bool = False):
        self.problem, self._slots = problem, tuple(slots)
        self._given = problem.rotation_order - 1  # at order 2, R_1 is not free
        self._coasting = coasting and bool(self._given)
        self._condensed = Condensed(problem)
        self._hessian = np.array([self._condensed.hessian, self._condensed.turning])
        self._inverse = np.linalg.inv(self._hessian[:, self._given :, self._given :])
        self._meet_arrival()
        self._length = problem.weights.length * problem.step * problem.forward
        self._make_room()
        self._general: Relaxed | None = None
        # The first call compiles, or loads what was compiled before: at start-up, not in a tick.
        self.bind(_rest(self._coasting), np.zeros((problem.horizon, 3)))
        self.solve()

    def _make_room(self) -> None:
        """Set up what the kernel works on; rho, if there is one, has the first place."""
        n = self._places = self.problem.horizon - self._given + self._coasting
        self._kernel_inverse = np.zeros((2, n, n))
        self._kernel_inverse[:, self._coasting :, self._coasting :] = self._inverse
        self._slide = np.zeros((n, 9))
        self._lengths = np.full(n, self._length)
        self._lengths[-1] = 0.0  # R_N pushes nothing any more
        if self._coasting:
            self._lengths[0] = 0.0  # linear in rho
        self._work, self._held = scratch(n), multipliers(n)

    @staticmethod
    def solves(problem: Problem, slots: Sequence[Slot] = ()) -> bool:
        """Return whether this applies to a problem, and is fast on this machine."""
        return (
            COMPILED
            and problem.dimension == 3
            and problem.weights.input > 0.0
            and problem.max_rate == problem.arrival_weight == 0.0
            and all(slot.on == 'heading' for slot in slots)
            and problem.horizon >= 2 * max(problem.rotation_order, problem.translation_order)
            and suits_dense_code(problem)
        )

    def bind(self, state: State, goals: Array) -> None:
        """See :meth:`orbimpc_ros.mpc.relaxation.Relaxed.bind`."""
        self._bound_to = (state, goals)
        before = coordinates(state.rotation)
        pulled, constant = self._condensed.affine(state, goals)
        turned, more = self._condensed.beside(before[3:])
        q, constant = np.hstack([pulled, turned]), constant + more
        first = np.zeros((self._given, 9))
        if self._given and not self._coasting:
            first[0] = coordinates(state.rotation + self.problem.step * state.rotation_rate)
            constant += self._length * float(np.linalg.norm(first[0, :3]))
        self._first = first
        x = self._minimiser(q, first, self._arrival(state, goals))
        bent = _by_column(self._hessian, x)
        self._least = constant + float(np.sum(x * (0.5 * bent + q)))
        self._start = x[self._given :]
        if self._coasting:
            assert state.coasted is not None
            self._slide_on(coordinates(state.coasted), bent + q)
        self._scale = max(1.0, float(np.abs(bent).max()) / USUAL)
        self._rounding = ROUNDING * constant

    def _minimiser(self, q: Array, first: Array, arrival: Array) -> Array:
        """Return R_1..R_N of least cost, orbitopes aside, for R_1 as given, where it is given.

        Args:
            q: linear term of the cost, shape (N, 9).
            first: R_1, shape (1, 9), or none.
            arrival: what the rows of the arrival come to, shape (rows, 3).
        """
        given = self._given
        bent = _by_column(self._hessian[:, given:, :given], first)
        x = -_by_column(self._inverse, q[given:] + bent)
        left = arrival - self._reached[:, 1 : 1 + given] @ first[:, :3]
        x[:, :3] += self._lift @ left
        return np.concatenate([first, x])

    def _slide_on(self, coasted: Array, gradient: Array) -> None:
        """Let R_1 = rho * coasted with rho free, from what is best for rho = 0.

        Everything else follows rho on a line, along which the cost is a parabola.
        """
        nothing = np.zeros_like(gradient), np.zeros((len(self._reached), 3))
        along = self._minimiser(nothing[0], coasted[None], nothing[1])
        curvature = float(np.sum(along * _by_column(self._hessian, along)))
        slope = float(np.sum(along * gradient)) + self._length
        rho = -slope / curvature
        self._least -= 0.5 * slope * slope / curvature
        self._start = np.vstack([np.zeros(9), self._start + rho * along[1:]])
        self._start[0, 0] = rho
        self._slide[0, 0], self._slide[1:] = 1.0, along[1:]
        self._slide /= np.sqrt(curvature)
        self._first = coasted[None]

    def solve(self, halfspaces: Iterable[Halfspace] = ()) -> Relaxation:
        """See :meth:`orbimpc_ros.mpc.relaxation.Relaxed.solve`."""
        imposed = list(halfspaces)
        terms = self._terms(imposed)
        for _ in range(2):
            x, _, bound, _, settled = self._minimise(terms)
            if settled:
                return Relaxation(self._rotations(x), self._least + bound)
            self._held = multipliers(self._places)  # what was held misled: once more without
        return self._leave(imposed)

    def _minimise(self, terms: Terms) -> tuple[Array, float, float, int, bool]:
        first, growth, last = SIGMA
        return minimise(
            terms,
            self._start,
            self._held,
            (self._scale * first, growth, self._scale * last),
            (PRECISION, GAP, self._least, self._rounding),
            self._work,
        )

    def _rotations(self, x: Array) -> Array:
        if not self._coasting:
            return np.concatenate([self._first, x])
        return np.concatenate([min(1.0, max(0.0, x[0, 0])) * self._first, x[1:]])

    def _leave(self, imposed: list[Halfspace]) -> Relaxation:
        """Leave a solve to the general program."""
        if self._general is None:
            from orbimpc_ros.mpc.program import Program  # brings CVXPY, half of a start-up

            self._general = Program(self.problem, self._slots, coasting=self._coasting)
        self._general.bind(*self._bound_to)
        return self._general.solve(imposed)

    def _meet_arrival(self) -> None:
        """Take the directions that an arrival forbids out of the inverse Hessian."""
        every = dynamics.arrival_map(self.problem)
        self._reached = every if self.problem.terminal == 'constraint' else every[:0]
        rows = self._reached[:, 1 + self._given :]
        raised = self._inverse[0] @ rows.T
        self._lift = raised @ np.linalg.inv(rows @ raised)
        self._inverse[0] -= self._lift @ raised.T

    def _arrival(self, state: State, goals: Array) -> Array:
        """Return what R_1 e1..R_N e1 must come to in each of the arrival's rows."""
        missing = [goals[-1] - dynamics.drift(self.problem, state)[-1], -state.velocity]
        rows = len(self._reached)
        return np.array(missing)[:rows] - self._reached[:, :1] * state.rotation[:, 0]

    def _terms(self, imposed: Iterable[Halfspace]) -> Terms:
        rows, offsets = np.zeros((self._places, 3)), np.full(self._places, INERT)
        for slot, normal, offset in imposed:
            step = self._slots[slot].step
            if step > self._given:
                place = step - 1 - self._given + self._coasting
                rows[place], offsets[place] = normal, offset
            elif self._coasting:
                rows[0, 0], offsets[0] = normal @ self._first[0, :3], offset
            elif normal @ self._first[0, :3] < offset - PRECISION:
                raise Infeasible('R_1 is given, and on the wrong side of a half-space')
        return Terms(
            self._kernel_inverse, self._slide, self._lengths, rows, offsets, self._coasting
        )


def _by_column(matrices: Array, x: Array) -> Array:
    """Return one matrix times the first three columns of x, the other times the last six."""
    return np.hstack([matrices[0] @ x[:, :3], matrices[1] @ x[:, 3:]])


def _rest(coasting: bool) -> State:
    still = np.eye(3)
    return State.at(np.zeros(3), still, coasted=still if coasting else None)
