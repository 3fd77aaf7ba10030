r"""The lifted relaxation of the circular floor: a bound that always holds, and a start.

Products of the trajectory's variables are replaced by second moments, so that the floor on
:math:`z_k = R_k e_1` becomes linear: :math:`f^2 \le \operatorname{tr} E[z_k z_k^T] \le 1`. Only
products within (1, s_k, z_k, z_{k+1}) are ever needed, because the dynamics are a chain; one small
moment matrix per step therefore bounds as well as one dense matrix for the whole horizon, at a cost
that grows linearly with it.

Redundant rows that tighten: the arrival s_N = g_N multiplied by every variable of the last link,
and for the length t_k >= |z_k| also t_k >= (E|z_k|^2 + f) / (1 + f), the chord of the square root.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cvxpy as cp
import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.condensed import first_length, input_weight, position_weights
from orbimpc_ros.mpc.conic import solved, solver_for
from orbimpc_ros.mpc.problem import Problem, State

TOLERANCE = 1e-8


@dataclass(frozen=True)
class Lifted:
    """The optimum of the lifted relaxation.

    Attributes:
        headings: first moments of z_1..z_N, shape (N, n).
        lower_bound: no trajectory costs less.
    """

    headings: Array
    lower_bound: float


class Lift:
    """The lifted relaxation of a problem of orders (1, 1) with a circular floor, N >= 2.

    For n = 3 the input cost counts the first column of R alone; the bound holds all the same.

    Args:
        problem: what to bound.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        n, steps = problem.dimension, problem.horizon
        self._goals = cp.Parameter((steps, n))  # seen from s_1, which the state decides
        self._heading = cp.Parameter(n)
        self._arrival = cp.Parameter((n, n), PSD=True)
        self._means = cp.Variable(steps * n)
        self._links = [_Link(n, first=k == 1) for k in range(1, steps)]
        constraints = [row for link in self._links for row in link.constraints()]
        for link, following in zip(self._links, self._links[1:], strict=False):
            constraints += link.followed_by(following, problem.step * problem.forward)
        length, epigraph = self._length()
        constraints += [*self._bounds(), *epigraph, *self._arrives(), self._read_out()]
        cost = self._position_cost() + self._input_cost() + length
        self._program = cp.Problem(cp.Minimize(cost), constraints)
        self._compiled(np.zeros((steps, n)), np.zeros(n))  # now, not in a tick

    def solve(self, state: State, goals: Array) -> Lifted:
        """Return the relaxation's optimum for a state and goals g_1..g_N, shape (N, n).

        Raises:
            Infeasible: not even the relaxation has a solution.
            SolverFailure: the solver stopped without an answer to trust.
        """
        problem = self._problem
        heading = state.rotation[:, 0]
        seen = goals - (state.position + problem.step * problem.forward * heading)
        data = self._compiled(seen, heading)
        answer = solved(solver_for(data, TOLERANCE))
        constant = input_weight(problem) / problem.step**2 * (heading @ heading)
        constant += position_weights(problem) @ np.sum(seen**2, axis=1)
        bound = float(answer.obj_val_dual) + float(constant) + first_length(problem, state)
        first = data['param_prob'].var_id_to_col[self._means.id]
        means = np.asarray(answer.x)[first : first + self._means.size]
        return Lifted(means.reshape(goals.shape), bound)

    def _compiled(self, goals: Array, heading: Array) -> dict[str, Any]:
        self._goals.value, self._heading.value = goals, heading
        self._arrival.value = np.outer(goals[-1], goals[-1])
        return self._program.get_problem_data(cp.CLARABEL, enforce_dpp=True)[0]

    def _read_out(self) -> cp.Constraint:
        """Tie a plain variable to the first moments of z_1..z_N, to find them in a solution."""
        return self._means == cp.hstack([self._links[0].z, *(k.z_next for k in self._links)])

    def _squared_headings(self) -> list[cp.Expression]:
        return [self._links[0].zz, *(link.zz_next for link in self._links)]

    def _position_cost(self) -> cp.Expression:
        """|s_k - g_k|^2 in moments, k = 2..N, without the constant |g_k|^2."""
        advance = self._problem.step * self._problem.forward
        weights = position_weights(self._problem)
        cost: cp.Expression = cp.Constant(0.0)
        for k, link in enumerate(self._links, start=1):
            mean, square = link.next_position(advance)
            cost += weights[k] * (cp.trace(square) - 2.0 * self._goals[k] @ mean)
        return cost

    def _input_cost(self) -> cp.Expression:
        first = self._links[0]
        cost = cp.trace(first.zz) - 2.0 * self._heading @ first.z
        for link in self._links:
            cost += cp.trace(link.zz_next + link.zz - 2.0 * link.z_z_next)
        return input_weight(self._problem) / self._problem.step**2 * cost

    def _length(self) -> tuple[cp.Expression, list[cp.Constraint]]:
        problem, floor = self._problem, self._problem.floor.fraction
        weight = problem.weights.length * problem.step * problem.forward
        if weight == 0.0:
            return cp.Constant(0.0), []
        length = cp.Variable(len(self._links))
        rows: list[cp.Constraint] = [length >= floor]
        for k, link in enumerate(self._links):
            chord = (cp.trace(link.zz) + floor) / (1.0 + floor)
            rows += [cp.SOC(length[k], link.z), length[k] >= chord]
        return weight * cp.sum(length), rows

    def _bounds(self) -> list[cp.Constraint]:
        """The floor, the rim and the rate limit, all linear in second moments."""
        problem, rows = self._problem, []
        for square in self._squared_headings():
            rows += [cp.trace(square) >= problem.floor.fraction**2, cp.trace(square) <= 1.0]
        if problem.max_rate > 0.0:
            rows += [
                cp.trace(link.zz_next + link.zz - 2.0 * link.z_z_next) <= problem.chord**2
                for link in self._links
            ]
        return rows

    def _arrives(self) -> list[cp.Constraint]:
        if self._problem.terminal != 'constraint':
            return []
        advance, last = self._problem.step * self._problem.forward, self._links[-1]
        goal = cp.reshape(self._goals[-1], (self._problem.dimension, 1), order='C')
        mean, square = last.next_position(advance)
        rows: list[cp.Constraint] = [mean == self._goals[-1], square == self._arrival]
        rows.append(last.s_z_next + advance * last.z_z_next == goal @ _row(last.z_next))
        rows.append(last.s_z + advance * last.zz == goal @ _row(last.z))
        if not last.first:
            rows.append(last.ss + advance * last.s_z.T == goal @ _row(last.s))
        return rows


class _Link:
    """The moments of (1, s_k, z_k, z_{k+1}); in the first link s_1 is the origin and left out."""

    def __init__(self, n: int, *, first: bool) -> None:
        self.first = first
        size = 1 + (2 if first else 3) * n
        self.moments = cp.Variable((size, size), PSD=True)
        m, zero = self.moments, cp.Constant(np.zeros((n, n)))
        s, z = slice(1, 1 + n), slice(size - 2 * n, size - n)
        z_next = slice(size - n, size)
        self.z, self.z_next = m[0, z], m[0, z_next]
        self.zz, self.zz_next, self.z_z_next = m[z, z], m[z_next, z_next], m[z, z_next]
        self.s = cp.Constant(np.zeros(n)) if first else m[0, s]
        self.ss, self.s_z, self.s_z_next = (
            (zero, zero, zero) if first else (m[s, s], m[s, z], m[s, z_next])
        )

    def constraints(self) -> list[cp.Constraint]:
        """Return what makes the matrix a moment matrix."""
        return [self.moments[0, 0] == 1.0]

    def next_position(self, advance: float) -> tuple[cp.Expression, cp.Expression]:
        """Return the first and second moments of s_{k+1} = s_k + advance z_k."""
        mean = self.s + advance * self.z
        square = self.ss + advance * (self.s_z + self.s_z.T) + advance**2 * self.zz
        return mean, square

    def followed_by(self, other: _Link, advance: float) -> list[cp.Constraint]:
        """Return the agreement of two neighbours on what they share: 1, s_{k+1} and z_{k+1}."""
        mean, square = self.next_position(advance)
        return [
            other.s == mean,
            other.z == self.z_next,
            other.zz == self.zz_next,
            other.ss == square,
            other.s_z == self.s_z_next + advance * self.z_z_next,
        ]


def _row(vector: cp.Expression) -> cp.Expression:
    return cp.reshape(vector, (1, vector.shape[0]), order='C')
