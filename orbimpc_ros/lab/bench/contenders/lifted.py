"""The true floor by one dense Hermitian matrix of moments of (1, z_1..z_N), in CVXPY.

z_k is R_k e1 as a complex number. The relaxation: Z >= 0, f^2 <= Z_kk <= 1; the arrival row,
and the same row times every conj(z_j), which is linear in Z and tightens; for the length
t_k >= |z_k|, t_k >= f and the chord t_k >= (Z_kk + f)/(1 + f). Stated once, DPP, one thread.
"""

from __future__ import annotations

import warnings

import cvxpy as cp
import numpy as np

from orbimpc_ros.lab.bench.contenders.condensed import Condensed
from orbimpc_ros.lab.bench.contenders.contender import Answer
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Problem, State


class Lifted:
    """The lifted relaxation of a planar problem of orders (1, 1) with a circular floor.

    Args:
        problem: what to bound.
        gap: relative gap that Clarabel is asked for.
    """

    def __init__(self, problem: Problem, gap: float) -> None:
        self._condensed, self._gap = Condensed(problem), gap
        steps, low = problem.horizon, problem.floor.fraction
        self._real, self._imaginary = cp.Parameter(steps), cp.Parameter(steps)
        self._to_go = [cp.Parameter(), cp.Parameter()]
        moments = cp.Variable((steps + 1, steps + 1), hermitian=True)
        self._z, inner = moments[1:, 0], moments[1:, 1:]
        squares = cp.real(cp.diag(moments))[1:]
        rows = [moments >> 0, moments[0, 0] == 1, squares >= low**2, squares <= 1]
        if problem.terminal == 'constraint':
            rows += self._arrives(inner)
        cost = cp.real(cp.sum(cp.multiply(self._condensed.quadratic, inner)))
        cost += self._real @ cp.real(self._z) + self._imaginary @ cp.imag(self._z)
        length, epigraph = self._lengths(squares, low)
        self._program = cp.Problem(cp.Minimize(cost + length), [*rows, *epigraph])
        self._value = np.nan

    def _arrives(self, inner: cp.Expression) -> list[cp.Constraint]:
        """Ask for arrival . z = d, and the same times every conj(z_j), in real numbers."""
        row, (d_x, d_y), z = self._condensed.arrival, self._to_go, self._z
        times = inner.T @ row  # sum_k row_k z_k conj(z_j), Z_kj = z_k conj(z_j)
        return [
            row @ cp.real(z) == d_x,
            row @ cp.imag(z) == d_y,
            cp.real(times) == d_x * cp.real(z) + d_y * cp.imag(z),
            cp.imag(times) == d_y * cp.real(z) - d_x * cp.imag(z),
        ]

    def _lengths(
        self, squares: cp.Expression, low: float
    ) -> tuple[cp.Expression, list[cp.Constraint]]:
        if self._condensed.length == 0.0:
            return cp.Constant(0.0), []
        norms = cp.Variable(squares.shape[0] - 1)
        chord = (squares[:-1] + low) / (1.0 + low)
        rows = [norms >= cp.abs(self._z[:-1]), norms >= low, norms >= chord]
        return self._condensed.length * cp.sum(norms), rows

    def solve(self, state: State, goals: Array) -> None:
        """Set the parameters and solve."""
        linear, constant = self._condensed.linear(state, goals)
        self._real.value, self._imaginary.value = linear.T
        for parameter, value in zip(self._to_go, self._condensed.to_go(state, goals), strict=True):
            parameter.value = value
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')  # of inaccurate solutions: objectives are compared
            self._program.solve(
                solver=cp.CLARABEL, enforce_dpp=True, max_threads=1, tol_gap_rel=self._gap
            )
        self._value = float(self._program.value) + constant

    def answer(self) -> Answer:
        """Return the bound; it is the optimum where the relaxation is tight."""
        return Answer(self._value, self._gap)
