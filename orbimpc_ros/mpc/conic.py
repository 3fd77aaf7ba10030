"""Clarabel on data that CVXPY compiled."""

from __future__ import annotations

from typing import Any

import clarabel
from scipy import sparse

from orbimpc_ros.mpc.errors import Infeasible, SolverFailure

REDUCED = 1e-7


def solver_for(data: dict[str, Any], tolerance: float) -> clarabel.DefaultSolver:
    """Return Clarabel set up on compiled data; its A, b and q may be updated in place.

    Args:
        data: from ``cvxpy.Problem.get_problem_data(cvxpy.CLARABEL)``.
        tolerance: on feasibility and on the gap.
    """
    return clarabel.DefaultSolver(
        sparse.csc_matrix(sparse.triu(data['P'])) if 'P' in data else _no_quadratic(data),
        data['c'],
        data['A'],
        data['b'],
        _cones(data['dims']),
        _settings(tolerance),
    )


def solved(solver: clarabel.DefaultSolver) -> Any:
    """Run a solver and return its solution.

    Clarabel's own idea of an almost solved problem, off by up to 1e-4, is not accepted: with
    :data:`REDUCED` the word means a solution to 1e-7, which plans' checks and gaps allow for.

    Raises:
        Infeasible: proved to have no solution.
        SolverFailure: stopped with any other status.
    """
    answer = solver.solve()
    status = str(answer.status)
    if status == 'PrimalInfeasible':
        raise Infeasible('no trajectory satisfies the constraints')
    if status not in ('Solved', 'AlmostSolved'):
        raise SolverFailure(f'Clarabel stopped with {status}')
    return answer


def _no_quadratic(data: dict[str, Any]) -> sparse.csc_matrix:
    return sparse.csc_matrix((len(data['c']),) * 2)


def _cones(dims: Any) -> list:
    """Return Clarabel's cones in the order in which CVXPY stacks the rows."""
    cones: list = []
    if dims.zero:
        cones.append(clarabel.ZeroConeT(dims.zero))
    if dims.nonneg:
        cones.append(clarabel.NonnegativeConeT(dims.nonneg))
    cones += [clarabel.SecondOrderConeT(size) for size in dims.soc]
    cones += [clarabel.PSDTriangleConeT(size) for size in dims.psd]
    return cones


def _settings(tolerance: float) -> clarabel.DefaultSettings:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    # In-place updates need the data to keep its shape.
    settings.presolve_enable = False
    settings.chordal_decomposition_enable = False
    settings.input_sparse_dropzeros = False
    settings.tol_feas = tolerance
    settings.tol_gap_abs = tolerance
    settings.tol_gap_rel = tolerance
    settings.reduced_tol_feas = REDUCED
    settings.reduced_tol_gap_abs = REDUCED
    settings.reduced_tol_gap_rel = REDUCED
    return settings
