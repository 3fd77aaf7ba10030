# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
r"""The meaning of a problem's weights: the paper's sums, or integrals without a unit.

The paper adds up steps, so that the same weights ask for something else at another step or speed.
As integrals over the horizon, with lengths measured by what the vehicle flies in a unit of time,

.. math::
    q \int \|s - g\|^2 dt + r \int \|R^{(o)}\|_F^2 dt + \ell \int \|R e_1\| dt + m \|s_N - g_N\|^2
    + a \|R_N - R_g\|_F^2,

they ask for the same at any: problems that differ in step and full speed alone are then the same
problem in natural units, and a finer step only resolves it better.

Mathematics: docs/mathematics.md, 1.6.
"""

from __future__ import annotations

from dataclasses import replace

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.problem.problem import Problem, Weights

SCALINGS = ('paper', 'time')
UNITS = 20  # of time in a horizon: the default weights smooth headings over a fortieth of it


def weighed(problem: Problem, scaling: str) -> Problem:
    """Return a problem whose weights are sums, as problems have them.

    Args:
        problem: with the weights as they were given.
        scaling: ``paper``, they are sums already; ``time``, they are numbers without a unit, on
            integrals over the horizon: of squared distance, of squared inputs and of the share of
            full speed or thrust; and on the squared distances at its end. Its twentieth is the unit
            of time, what the vehicle flies in one, from rest, the unit of length.

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
        length=given.length / (problem.forward * time),  # a step of it is h z |R e1|
        terminal=given.terminal / area,
        attitude=given.attitude,
    )
