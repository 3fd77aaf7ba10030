"""IPOPT through CasADi: the condensed annulus problem, exact derivatives, one cold start.

A local solver: it proves nothing about the global optimum. One thread.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from orbimpc_ros.lab.bench.contenders.condensed import Condensed
from orbimpc_ros.lab.bench.contenders.contender import Answer
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Problem, State


class Ipopt:
    """The nonlinear program of a planar problem with the true floor, without arrival.

    Args:
        problem: what to solve.
        tolerance: IPOPT's.
    """

    def __init__(self, problem: Problem, tolerance: float) -> None:
        self._condensed, self._low = Condensed(problem), problem.floor.fraction
        steps = problem.horizon
        z, linear, constant = ca.SX.sym('z', steps, 2), ca.SX.sym('b', steps, 2), ca.SX.sym('c')
        quadratic = ca.DM(self._condensed.quadratic)
        moduli = ca.sum2(z * z)
        cost = ca.trace(z.T @ quadratic @ z) + ca.sum1(ca.sum2(linear * z)) + constant
        if self._condensed.length:
            cost += self._condensed.length * ca.sum1(ca.sqrt(moduli[:-1]))
        parameters = ca.vertcat(ca.vec(linear), constant)
        program = {'x': ca.vec(z), 'p': parameters, 'f': cost, 'g': moduli}
        quiet: dict[str, Any] = {'print_time': False, 'ipopt.print_level': 0, 'ipopt.sb': 'yes'}
        self._solver = ca.nlpsol('plan', 'ipopt', program, {**quiet, 'ipopt.tol': tolerance})
        self._value = np.nan

    def solve(self, state: State, goals: Array) -> None:
        """Solve from the present heading, held."""
        linear, constant = self._condensed.linear(state, goals)
        start = np.repeat(state.attitude[:, 0], len(linear))
        parameters = np.append(linear.ravel(order='F'), constant)
        found = self._solver(x0=start, p=parameters, lbg=self._low**2, ubg=1.0)
        self._value = float(found['f'])

    def answer(self) -> Answer:
        """Return the local optimum's cost."""
        return Answer(self._value if self._solver.stats()['success'] else np.nan)
