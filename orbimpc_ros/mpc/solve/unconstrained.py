# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The minimiser of the quadratic alone, no orbitope in its way, as a linear map.

A coordinate of R_1..R_N depends on nothing but the same coordinate of what is known: for R e1 the
knowns of ``condensed.Condensed``, for the others R_0 and R_g; and, at rotation order 2, on R_1.
All coordinates of a kind share the maps, so a tick costs a product each.

Mathematics: docs/mathematics.md, 4.7.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.model.condensed import Condensed
from orbimpc_ros.mpc.problem import Problem


@dataclass(frozen=True)
class Unconstrained:
    """Maps from what is known, m rows of which R_1 is the last.

    Attributes:
        inverse: of the Hessian, on the steps decided and the directions that a terminal constraint
            leaves free, shape (steps decided, steps decided).
        minimiser: x_1..x_N, shape (N, m).
        bent: H x, shape (N, m).
        least: the cost, as a quadratic form, shape (m, m).
        constant: the cost of x = 0, as a quadratic form, shape (m, m).
    """

    inverse: Array
    minimiser: Array
    bent: Array
    least: Array
    constant: Array


def thrust_axis(problem: Problem, condensed: Condensed) -> Unconstrained:
    """Return the maps for coordinates of R e1; known are Condensed's knowns, then R_1 e1."""
    return _unbounded(
        problem, condensed.hessian, condensed.pulled, condensed.squared, _arrival(problem)
    )


def other_axes(problem: Problem, condensed: Condensed) -> Unconstrained:
    """Return the maps for coordinates of R e2 and R e3; known are those of R_0, R_g and R_1."""
    reached = np.zeros((0, problem.horizon)), np.zeros((0, 3))
    return _unbounded(
        problem, condensed.turning, condensed.turned, condensed.turned_squared, reached
    )


def _arrival(problem: Problem) -> tuple[Array, Array]:
    """Return the rows over z_1..z_N of a terminal constraint, and what they come to, of knowns.

    s_N = g_N and, at translation order 2, p_N = 0.
    """
    maps = problem.maps
    rows = maps.arrival
    if problem.terminal != 'constraint':
        rows = rows[:0]
    wanted = np.zeros((len(rows), problem.horizon + 5))
    wanted[:, 0] = -rows[:, 0]
    if len(rows):
        wanted[0, 1:3] = -maps.drift[-1, 0], -maps.blown[-1, 0]
        wanted[0, -2] = 1.0
        wanted[1:, 1:3] = -maps.carried[-1, 0], -maps.hastened[-1, 0]
    return rows[:, 1:], wanted


def _unbounded(
    problem: Problem, hessian: Array, q: Array, c: Array, arrival: tuple[Array, Array]
) -> Unconstrained:
    """Return the maps for a cost 1/2 x.Hx + (q known).x + known.c known, by elimination.

    Args:
        problem: says whether R_1 is known.
        hessian: H, shape (N, N).
        q: linear terms, of what is known but R_1, shape (N, m - 1).
        c: constants, of the same, shape (m - 1, m - 1).
        arrival: rows over x_1..x_N, and what they must come to, of what is known.
    """
    known = problem.rotation_order - 1  # R_1 is known at order 2
    q, c = np.pad(q, ((0, 0), (0, 1))), np.pad(c, (0, 1))
    first = np.zeros((known, q.shape[1]))
    first[:, -1] = 1.0
    rows, wanted = arrival
    inverse = np.linalg.inv(hessian[known:, known:])
    raised = inverse @ rows[:, known:].T
    lift = raised @ np.linalg.inv(rows[:, known:] @ raised)
    inverse = inverse - lift @ raised.T
    decided = lift @ (wanted - rows[:, :known] @ first)
    decided -= inverse @ (q[known:] + hessian[known:, :known] @ first)
    minimiser = np.concatenate([first, decided])
    bent = hessian @ minimiser
    least = c + minimiser.T @ (0.5 * bent + q)
    return Unconstrained(inverse, minimiser, bent, 0.5 * (least + least.T), c)
