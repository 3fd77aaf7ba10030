# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Selection of the solution method for a problem; the fastest methods come first.

Mathematics: docs/mathematics.md, 4.1.
"""

from __future__ import annotations

from importlib import import_module

from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.solve.request import Method

# (module, class). The first one whose ``solves`` returns True is chosen. Modules are imported one
# by one, since the later ones take longer to import.
METHODS = [
    ('search.engine', 'PlanarSearch'),
    ('search.round_floor', 'RoundFloor'),
    ('solve.planar_way', 'PlanarCatch'),
    ('solve.branch_and_bound', 'BranchAndBound'),
]
PACED = ('solve.paced_speeds', 'PacedSpeeds')  # imports Clarabel, hence only with max_acceleration


def method_for(
    problem: Problem, tolerance: float, *, coasting: bool = False, among: bool = False
) -> Method:
    """Return the fastest method for a problem in natural units, compiled for it.

    Args:
        problem: what to solve.
        tolerance: relative gap at which a search stops.
        coasting: whether states come with a ``coasted`` rotation.
        among: whether states come with hazards, which only the last method handles.
    """
    methods, given = (METHODS[-1:], {'among': True}) if among else (METHODS, {})
    for place, name in [PACED, *methods] if problem.max_acceleration else methods:
        method = getattr(import_module(f'orbimpc_ros.mpc.{place}'), name)
        if among or method.solves(problem):
            made: Method = method(problem, tolerance, coasting=coasting, **given)
            return made
    raise AssertionError('the last method solves every problem')


def general(problem: Problem, tolerance: float) -> Method:
    """Return the last method; its import takes longest."""
    place, name = METHODS[-1]
    made: Method = getattr(import_module(f'orbimpc_ros.mpc.{place}'), name)(problem, tolerance)
    return made
