# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""What is said to be infeasible, and refuted, is so by another solver: a mixed-integer program."""

import numpy as np
import pytest
from problems import rotation
from scipy.optimize import Bounds, LinearConstraint, milp

from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.problem import Box, Problem, State
from orbimpc_ros.mpc.problem.case import Case
from orbimpc_ros.mpc.problem.sought import Sought
from orbimpc_ros.mpc.proof.document import verified
from orbimpc_ros.mpc.proof.prove import held
from orbimpc_ros.mpc.proof.reading import parsed
from orbimpc_ros.mpc.proof.refute import refutation_of
from orbimpc_ros.mpc.solve.solver import Solver

FACES = 48  # of what holds a disk, or is held by it
FAR = 50.0  # [m] more than any position
NOBODY = 2  # what milp says of what nothing satisfies


def drawn(seed):
    """Return an arrival near the rim of what is in reach, behind a box or two."""
    rng = np.random.default_rng([seed, 90])
    boxes = []
    for _ in range(int(rng.integers(3))):
        middle, half = rng.uniform(-3.0, 3.0, 2), rng.uniform(0.3, 1.5, 2)
        if np.any(np.abs(middle) > half + 0.2):
            boxes.append(Box(middle - half, middle + half))
    count = int(rng.integers(2, 5))
    problem = Problem(
        horizon=count, terminal='constraint', obstacles=tuple(boxes),
        no_corner_cutting=bool(rng.integers(2)),
    )  # fmt: skip
    way = rotation(rng, 2)
    goal = way[:, 0] + rng.uniform(0.6, 1.2) * (count - 1) * rotation(rng, 2)[:, 0]
    return Case(problem, State.at(np.zeros(2), way), np.tile(goal, (count, 1)))


class Statement:
    """A problem over R_1 e1..R_{N-1} e1, and for each box and step which side it is on.

    Disks are polygons that hold them, or that they hold.
    """

    def __init__(self, case, outer):
        (self.problem, state, goals), self.rows, self.least = case, [], []
        self.n, self.first = self.problem.horizon, state.rotation[:, 0]
        self.sides = []  # positions of each choice
        shared = self.problem.no_corner_cutting and self.n > 1
        for box in self.problem.boxes:
            for k in range(1, self.n + 1 - shared):
                self.sides.append((box, range(k, k + 1 + shared)))
        self.width = 2 * (self.n - 1) + 4 * len(self.sides)
        angles = 2.0 * np.pi * np.arange(FACES) / FACES
        size = 1.0 if outer else np.cos(np.pi / FACES)
        for k in range(1, self.n):
            for angle in angles:
                self.add({k: (-np.cos(angle), -np.sin(angle))}, {}, -size)
        for way in (*np.eye(2), *-np.eye(2)):
            self.beyond(self.n, way, way @ goals[-1])
        for j, (box, steps) in enumerate(self.sides):
            self.part(j, box, steps)

    def add(self, headings, chosen, least):
        row = np.zeros(self.width)
        for k, values in headings.items():
            row[2 * (k - 1) : 2 * k] = values
        for column, value in chosen.items():
            row[2 * (self.n - 1) + column] = value
        self.rows.append(row)
        self.least.append(least)

    def beyond(self, k, way, least, side=None):
        """Ask that way . s_k >= least, of who is on a side."""
        given = {} if side is None else {side: -FAR}
        left = least - way @ self.first - (0.0 if side is None else FAR)
        self.add(dict.fromkeys(range(1, k), way), given, left)

    def part(self, j, box, steps):
        for i, way in enumerate((*-np.eye(2), *np.eye(2))):
            least = -box.minimum[i] if i < 2 else box.maximum[i - 2]
            for k in steps:
                self.beyond(k, way, least, 4 * j + i)
        self.add({}, {4 * j + i: 1.0 for i in range(4)}, 1.0)

    @property
    def feasible(self):
        known = 2 * (self.n - 1)
        ends = np.where(np.arange(self.width) < known, 2.0, 1.0)
        low = np.where(np.arange(self.width) < known, -2.0, 0.0)
        found = milp(
            np.zeros(self.width),
            integrality=np.arange(self.width) >= known,
            bounds=Bounds(low, ends),
            constraints=LinearConstraint(np.array(self.rows), np.array(self.least), np.inf),
        )
        assert found.status in (0, NOBODY), found.message
        return found.status == 0


def said(case):
    try:
        Solver(case.problem).solve(case.state, case.goals)
    except Infeasible:
        return True
    return False


@pytest.mark.parametrize('seed', range(40))
def test_what_is_refuted_has_no_solution_and_what_has_one_is_not(seed):
    case = drawn(seed)
    made = held(lambda: refutation_of(Sought(*case)))
    if Statement(case, outer=False).feasible:
        assert made is None
        assert not said(case)
    elif not Statement(case, outer=True).feasible:
        assert said(case)
        assert made is not None
        assert verified(parsed(made.text().encode())).proved == np.inf


@pytest.mark.parametrize('orders', [(1, 1), (1, 2), (2, 1), (2, 2)])
@pytest.mark.parametrize('dimension', [2, 3])
def test_an_arrival_far_out_of_reach_is_infeasible_even_if_there_is_no_time(dimension, orders):
    problem = Problem(dimension, *orders, horizon=5, terminal='constraint')
    state = State.at(np.zeros(dimension), np.eye(dimension))
    goals = np.full((5, dimension), 100.0)
    with pytest.raises(Infeasible, match='beyond what 5 steps can reach'):
        Solver(problem).solve(state, goals, out_of_time=lambda: True)
