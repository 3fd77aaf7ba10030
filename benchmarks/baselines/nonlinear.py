# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
r"""Nonlinear MPC: CasADi and IPOPT on the very problem, exact derivatives, warm start.

Circle: :math:`f^2 \le |z_k|^2 \le 1`. Polygon, without integers: beyond one of the faces means that
some convex combination of their normals, its shares variables too, gives a half-space that holds,
:math:`\sum_i \lambda_{ki} n_i \cdot z_k \ge f`. Rate limit: as the planner has it, an angle with a
floor, else a longest chord. Balls that move: :math:`|s_k - c_{kj}|^2 + e_k \ge \rho_j^2`, where
:math:`e_k \ge 0` costs much more than it can save.
IPOPT is a local solver: it finds a stationary point, and does not say whether it is the best.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from benchmarks.baselines.program import Program, balls_of, coasting
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.faces import normals
from orbimpc_ros.mpc.model.condensed import Condensed
from orbimpc_ros.mpc.problem import Problem, State

QUIET: dict[str, Any] = {'print_time': False, 'ipopt.print_level': 0, 'ipopt.sb': 'yes'}
# Bounds are not relaxed, as is IPOPT's habit: a cost below that of every legal plan says nothing.
OPTIONS = {'ipopt.tol': 1e-9, 'ipopt.bound_relax_factor': 0.0, 'ipopt.max_iter': 500}
TINY = 1e-20  # keeps a root smooth
BALLS = 8  # in a program: more at a time, and the farthest are left out
TOUCH = 1e3  # cost of the square of a step's length inside of a ball


class Nonlinear(Program):
    """The nonlinear program in the thrust axes, solved from the previous plan moved on.

    Args:
        problem: what to plan.

    Raises:
        ImportError: CasADi is not installed.
    """

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        self._program = NonlinearProgram(problem, OPTIONS)
        self._among: NonlinearProgram | None = None  # balls, once there are some

    def axes(self, state: State, goals: Array) -> Array:
        """Return the local optimum's axes, or the start's where IPOPT gives up."""
        start, program = self.shifted(state), self._program
        if state.hazards:
            program = self._among = self._among or NonlinearProgram(self.problem, OPTIONS, BALLS)
        found, _ = program.solve(state, goals, start)
        return start if found is None else found


class NonlinearProgram:
    """The nonlinear program of a planar problem of orders (1, 1), length and arrival left out.

    Args:
        problem: what to state.
        options: of CasADi and IPOPT.
        balls: how many it stays clear of at most.

    Raises:
        ImportError: CasADi is not installed.
    """

    def __init__(self, problem: Problem, options: Mapping[str, Any], balls: int = 0) -> None:
        import casadi as ca  # of the extra `study`: whoever uses another controller needs it not

        self._condensed, self._faces = Condensed(problem), normals(2, problem.floor.faces)
        steps, self._polygon = problem.horizon, problem.floor.shape == 'polygon'
        z, linear, first = ca.SX.sym('z', steps, 2), ca.SX.sym('q', steps, 2), ca.SX.sym('a', 1, 2)
        quadratic = ca.DM(self._condensed.hessian)
        cost = 0.5 * ca.trace(z.T @ quadratic @ z) + ca.sum1(ca.sum2(linear * z))
        circle = problem.floor.shape == 'circle'
        squares = (ca.sum2(z * z), problem.floor.fraction**2 if circle else -np.inf, 1.0)
        limits, variables = [squares], [ca.vec(z)]
        if self._polygon:
            shares = ca.SX.sym('shares', steps, len(self._faces))
            variables.append(ca.vec(shares))
            beyond = ca.sum2((z @ ca.DM(self._faces).T) * shares)
            limits += [(beyond, problem.floor.fraction, np.inf), (ca.sum2(shares), 1.0, 1.0)]
        if problem.max_rate > 0.0:
            limits.append(_turns(problem, ca.vertcat(first, z[:-1, :]), z))
        self._problem, self._balls, parameters = problem, balls, [ca.vec(linear), first.T]
        if balls:
            among = _kept_out(problem, balls, z)
            cost += TOUCH / problem.length_unit**2 * ca.sum1(among.depths)
            variables.append(among.depths)
            parameters.append(among.parameters)
            limits += [(each, 0.0, np.inf) for each in among.limited]
        self._low = np.repeat([low for _, low, _ in limits], steps)
        self._high = np.repeat([high for *_, high in limits], steps)
        program = {
            'x': ca.vertcat(*variables),
            'p': ca.vertcat(*parameters),
            'f': cost,
            'g': ca.vertcat(*(limit for limit, _, _ in limits)),
        }
        self._angular = problem.turns_are_angles
        self._solver = ca.nlpsol('plan', 'ipopt', program, {**QUIET, **options})
        self._free = 2 * steps  # variables without bounds of their own

    def _before(self, state: State) -> Array:
        """Return the axis that the first turn is measured from, shape (2,)."""
        return state.attitude[:, 0] if self._angular else state.rotation[:, 0]

    def _places(self, state: State) -> Array:
        """Return, ball by ball, from where coasting is seen, then its radius; zeros for none."""
        seen = np.zeros((self._balls, 2 * self._problem.horizon + 1))
        if state.hazards:
            centres, radii = balls_of(self._problem, state)
            away = coasting(self._problem, state) - centres
            nearest = np.argsort(np.linalg.norm(away, axis=2).min(axis=1))[: self._balls]
            seen[: len(nearest), :-1] = away[nearest].transpose(0, 2, 1).reshape(len(nearest), -1)
            seen[: len(nearest), -1] = radii[nearest]
        return seen.ravel()

    def solve(self, state: State, goals: Array, start: Array) -> tuple[Array | None, float]:
        """Return axes z_1..z_N, shape (N, 2), and their cost; None and NaN without convergence.

        Args:
            state: where the plan starts.
            goals: g_1..g_N, shape (N, 2) [m].
            start: axes to start from, shape (N, 2).
        """
        linear, constant = self._condensed.affine(state, goals)
        x = [start.ravel(order='F')]
        if self._polygon:
            nearest = np.argmax(start @ self._faces.T, axis=1)
            x.append(np.eye(len(self._faces))[nearest].ravel(order='F'))
        p = np.append(linear.ravel(order='F'), self._before(state))
        if self._balls:
            x.append(np.zeros(len(start)))
            p = np.append(p, self._places(state))
        x_0 = np.concatenate(x)
        low, high = np.full(len(x_0), -np.inf), np.full(len(x_0), np.inf)
        low[self._free :] = 0.0
        if self._polygon:
            high[self._free : self._free + start.shape[0] * len(self._faces)] = 1.0
        found = self._solver(
            x0=x_0,
            lbx=low,
            ubx=high,
            p=p,
            lbg=self._low,
            ubg=self._high,
        )
        if not self._solver.stats()['success']:
            return None, np.nan
        axes = np.asarray(found['x'])[: self._free].reshape(2, -1).T
        return axes, float(found['f']) + constant


class _Among(NamedTuple):
    """What a program has to do with balls, as CasADi's expressions.

    Attributes:
        depths: e_1..e_N, variables of at least 0 [m^2].
        parameters: ball by ball, where coasting leads as it sees it, and its radius.
        limited: ball by ball, what has to be at least 0 at the steps.
    """

    depths: Any
    parameters: Any
    limited: list[Any]


def _kept_out(problem: Problem, balls: int, z: Any) -> _Among:
    """Return what keeps plans of thrust axes z out of so many balls."""
    import casadi as ca

    steps, parameters, limited = problem.horizon, [], []
    depths, moved = ca.SX.sym('e', steps), ca.DM(problem.maps.reach[:, 1:]) @ z
    for _ in range(balls):
        coasted, radius = ca.SX.sym('c', steps, 2), ca.SX.sym('r')
        parameters += [ca.vec(coasted), radius]
        limited.append(ca.sum2((coasted + moved) ** 2) + depths - radius**2)
    return _Among(depths, ca.vertcat(*parameters), limited)


def _turns(problem: Problem, before: Any, z: Any) -> tuple[Any, float, float]:
    """Return what the rate limit bounds at each step, and its least and largest value."""
    import casadi as ca

    if not problem.turns_are_angles:
        return ca.sum2((z - before) ** 2), -np.inf, problem.chord**2
    sizes = ca.sqrt(ca.sum2(z * z) * ca.sum2(before * before) + TINY)
    return ca.sum2(z * before) - np.cos(problem.widest_turn) * sizes, 0.0, np.inf
