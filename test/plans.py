# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Plans for the plan checker: feasible ones, and feasible ones changed at one place."""

import numpy as np

from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.geometry.rotations import coordinates
from orbimpc_ros.mpc.plan import UNPROVED, assemble
from orbimpc_ros.mpc.problem import State
from orbimpc_ros.mpc.proof.document import Refused, parsed, verified
from orbimpc_ros.mpc.solve.solver import Solver

GOALS = np.tile([3.0, 1.0], (5, 1))
START = State.at([0.0, 0.0], np.eye(2))


def solved(problem, start=START, goals=GOALS, coasting=False):
    plan = Solver(problem, coasting=coasting).solve(start, goals)
    assert violations(problem, start, goals, plan) == []
    return plan


def assembled(problem, start, goals, x):
    """Return a consistent plan through given rotations: only limits can be violated."""
    return assemble(problem, start, goals, x, projection='nearest', proof=UNPROVED)


def straight(problem, fractions):
    """Return a consistent plan straight ahead at given speed fractions of R_1..R_N."""
    x = np.outer(fractions, coordinates(np.eye(problem.dimension)))
    start = State.at(np.zeros(problem.dimension), np.eye(problem.dimension))
    goals = np.zeros((problem.horizon, problem.dimension))
    return start, goals, assembled(problem, start, goals, x)


def steered(problem, start, speeds, angles):
    """Return a consistent plan in the plane with given speed fractions and headings of R_1..R_N."""
    x = (np.array([np.cos(angles), np.sin(angles)]) * speeds).T
    return assembled(problem, start, GOALS, x)


def judged(text):
    """Return a certificate's verdict, or why it is refused."""
    try:
        return 'holds' if verified(parsed(text.encode())).holds else 'does not hold'
    except Refused as error:
        return str(error)


def changed(array, index, value):
    copy = array.copy()
    copy[index] = value
    return copy


def only_complaint(problem, plan, start=START, goals=GOALS):
    found = violations(problem, start, goals, plan)
    assert len(found) == 1, found
    return found[0]
