# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
r"""Scalings of the weights: the paper's sums, or integrals with dimensionless weights.

The paper's objective sums over steps, so the same weights give other plans at another step or
speed. With integrals over the horizon, in units of the distance flown in a unit of time,

.. math::
    q \int \|s - g\|^2 dt + r \int \|R^{(o)}\|_F^2 dt + \ell \int \|R e_1\| dt + m \|s_N - g_N\|^2
    + a \|R_N - R_g\|_F^2,

their meaning is independent of both: problems that differ only in step and full speed are the same
problem in natural units, and a finer step only resolves it better.

Mathematics: docs/mathematics.md, 1.6.
"""

from __future__ import annotations

from dataclasses import replace

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.problem.problem import Problem, Weights

SCALINGS = ('paper', 'time')
UNITS = 20  # units of time in a horizon: the default weights smooth headings over a fortieth of it


def weighed(problem: Problem, scaling: str) -> Problem:
    """Return a problem with its weights converted to those of the paper's sums.

    Args:
        problem: with the weights to convert.
        scaling: ``paper``, weights of sums already; ``time``, dimensionless ones on integrals over
            the horizon of squared distance, squared inputs and share of full speed or thrust, and
            on squared final distances. The unit of time is a twentieth of the horizon, that of
            length the distance flown in it from rest.

    Raises:
        BadInput: no such scaling.
    """
    if scaling not in SCALINGS:
        raise BadInput.choice('weights.scaling', scaling, SCALINGS)
    return problem if scaling == 'paper' else replace(problem, weights=_summed(problem))


def _summed(problem: Problem) -> Weights:
    given, time = problem.weights, problem.horizon * problem.step / UNITS
    speed = problem.forward * time if problem.inertial else problem.forward
    area, share = (speed * time) ** 2, problem.step / time
    return Weights(
        position=given.position * share / area,
        input=given.input * share * time ** (2 * problem.rotation_order),
        length=given.length / (problem.forward * time),  # the sum adds h z |R e1| per step
        terminal=given.terminal / area,
        attitude=given.attitude,
    )
