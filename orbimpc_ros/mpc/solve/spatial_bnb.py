# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The search for vehicles among boxes in space, in machine code where numba is installed.

Mathematics: docs/mathematics.md, 4.10.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.geometry.cells import Cell
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.kernels.half_spaces import (
    DONE,
    LEAST,
    NODES,
    STALLS,
    VALUE,
    Choices,
    Space,
    begin,
    search,
    tree,
)
from orbimpc_ros.mpc.kernels.penalty import SLICE
from orbimpc_ros.mpc.kernels.penalty_terms import scratch
from orbimpc_ros.mpc.model import dynamics
from orbimpc_ros.mpc.model.condensed import Condensed, knowns, suits_dense_code
from orbimpc_ros.mpc.model.cost import (
    attitude_weight,
    input_weight,
    position_weights,
    wanted_coordinates,
)
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.solve.disjunction import Disjunction, disjunctions_of
from orbimpc_ros.mpc.solve.general import General
from orbimpc_ros.mpc.solve.request import Found, Request
from orbimpc_ros.mpc.solve.side_tree import SideProof, places_of
from orbimpc_ros.mpc.solve.so3_multipliers import CANCELLED, ROUNDING, USUAL
from orbimpc_ros.mpc.solve.unconstrained import other_axes, thrust_axis

MOST = 6400  # nodes of a search
BUDGET = 100.0 * SLICE  # multiplications of a node
FARTHEST = 12.0  # |R - R'|_F^2 of any two rotations
UNGUIDED = np.empty((0, 3))


class SpatialSearch:
    """Solves problems of SE(3) among boxes, with no other constraint but orbitopes and a polygon.

    What the kernel cannot settle, it leaves to the general search, unless there is a deadline.

    Args:
        problem: what to solve.
        tolerance: relative gap at which a search stops.
    """

    takes_guess = True
    trusts_guess = False  # it is followed through the sides that it passes boxes on

    def __init__(self, problem: Problem, tolerance: float, *, coasting: bool = False) -> None:
        self._problem, self._tolerance = problem, tolerance
        condensed, n = Condensed(problem), problem.horizon
        self._thrust = thrust_axis(problem, condensed)
        self._others = other_axes(problem, condensed)
        self._general = General(problem, tolerance)
        self._choices, self._offsets, self._positions = _choices(problem)
        self._space = _space(problem, self._thrust.inverse, self._others.inverse)
        groups, most = len(self._choices.first), int(self._choices.sizes.max())
        self._tree = tree(n, groups, MOST, most)
        self._work = scratch(n, 2 * groups)
        # The first call compiles, or loads what was compiled before: at start-up, not in a tick.
        at_rest = State.at(np.zeros(3), np.eye(3))
        self._begin(Request(at_rest, np.zeros((n, 3))))
        self._search(UNGUIDED)

    @staticmethod
    def solves(problem: Problem) -> bool:
        """Return whether this method applies to a problem, and is fast on this machine."""
        return (
            COMPILED
            and (problem.dimension, problem.rotation_order) == (3, 1)
            and len(problem.obstacles) == len(problem.boxes) > 0
            and problem.floor.shape in ('none', 'polygon')
            and problem.terminal == 'penalty'
            and problem.weights.input > 0.0
            and problem.weights.length == problem.max_rate == problem.arrival_weight == 0.0
            and problem.horizon >= 2 * problem.translation_order
            and suits_dense_code(problem)
            and not (problem.approach.exists or problem.has_cones)
        )

    def solve(self, request: Request) -> Found:
        """Return the best trajectory with the bound proved.

        See :class:`orbimpc_ros.mpc.solve.disjunctive_bnb.DisjunctiveSearch` for the rest.
        """
        self._begin(request)
        guide, done = self._guide(request), False
        while not done and self._nodes < MOST:
            done = self._search(guide)
            if request.late:
                break
        settled = done and not self._tree.counts[STALLS]
        if not settled and not request.hurried:
            return self._general.solve(request._replace(guess=None))
        found = self._found(settled)
        known = self._space, self._choices, self._tree, len(self._problem.boxes)
        return replace(found, proof=SideProof(*known).proof())

    def _begin(self, request: Request) -> None:
        """Begin a search: work out what depends on state and goals alone."""
        state, goals, space = request.state, request.goals, self._space
        axes, rest = np.zeros((len(goals) + 5, 3)), np.zeros((3, 6))
        axes[:-1] = knowns(state, goals)
        rest[0] = state.rotation[:, 1:].T.ravel()
        rest[1] = wanted_coordinates(self._problem, state)[3:]
        space.start[:, :3] = self._thrust.minimiser @ axes
        space.start[:, 3:] = self._others.minimiser @ rest
        still = np.concatenate([state.rotation[None, :, 0], np.zeros((len(goals), 3))])
        coasting, _ = dynamics.translation_rollout(self._problem, state, still)
        space.coasting[:] = coasting[1:] - state.position
        space.scale[0] = max(1.0, float(np.abs(self._thrust.bent @ axes).max()) / USUAL)
        self._least = _form(self._thrust.least, axes) + _form(self._others.least, rest)
        self._rounding = ROUNDING * _form(self._thrust.constant, axes)
        self._choices.offsets[:] = self._offsets
        on_positions = self._choices.normals[self._positions]
        self._choices.offsets[self._positions] -= on_positions @ state.position
        begin(self._tree, self._ceiling(coasting[1:] - goals) - self._least)

    def _ceiling(self, coasting: Array) -> float:
        """Return a cost that no trajectory exceeds.

        Args:
            coasting: where it would be without R_1 e1..R_N e1, from the goals, shape (N, 3).
        """
        problem = self._problem
        farthest = np.linalg.norm(coasting, axis=1) + self._space.farthest
        turning = input_weight(problem) * problem.horizon / problem.step**2
        turning += attitude_weight(problem)
        return float(position_weights(problem) @ farthest**2 + turning * FARTHEST)

    def _guide(self, request: Request) -> Array:
        """Return a guess's thrust axes and positions, shape (2N, 3), or (0, 3) without one."""
        if request.guess is None:
            return UNGUIDED
        return places_of(self._space, request.guess.x[:, :3])

    @property
    def _nodes(self) -> int:
        return int(self._tree.counts[NODES])

    def _search(self, guide: Array) -> bool:
        """Solve a node; return whether the search is complete."""
        known, room = (self._least, self._rounding), min(MOST, self._nodes + 1)
        asked = self._space, self._choices, guide, known, self._tolerance, self._tree, self._work
        return bool(search(*asked, room, BUDGET) == DONE)

    def _found(self, settled: bool) -> Found:
        """Return the best of a search, with the bound that it has proved.

        Raises:
            Infeasible: every branch was refuted.
        """
        numbers, nodes = self._tree.numbers, self._nodes
        bound = self._least + float(numbers[LEAST]) - CANCELLED / ROUNDING * self._rounding
        if numbers[VALUE] < np.inf:
            return Found(self._tree.best.copy(), self._least + float(numbers[VALUE]), bound, nodes)
        if settled:
            raise Infeasible('no trajectory satisfies the constraints: every branch is infeasible')
        return Found(None, np.inf, bound, nodes)


def _space(problem: Problem, thrust: Array, others: Array) -> Space:
    """Return the quadratic of a problem, given its inverse Hessians, shape (N, N) each."""
    n, reach = problem.horizon, problem.maps.reach[:, 1:].copy()
    moved = np.vstack([np.eye(n), reach])
    inverse = np.zeros((2, 2 * n, 2 * n))
    inverse[0] = moved @ thrust @ moved.T
    inverse[0] = 0.5 * (inverse[0] + inverse[0].T)
    inverse[1, :n, :n] = others
    farthest = np.abs(reach).sum(axis=1)
    return Space(inverse, reach, np.zeros((n, 9)), np.zeros((n, 3)), farthest, np.ones(1))


def _choices(problem: Problem) -> tuple[Choices, Array, np.ndarray]:
    """Return the choices of a problem, their offsets in the world, and which are of positions.

    Groups with the same alternatives share half-spaces.
    """
    disjunctions = disjunctions_of(problem)
    cells: list[tuple[bool, Cell]] = []
    first: dict[int, int] = {}
    for each in disjunctions:
        if id(each.cells) not in first:
            first[id(each.cells)] = len(cells)
            cells += [(each.on == 'position', cell) for cell in each.cells]
    offsets = np.array([cell.offset for _, cell in cells])
    made = Choices(
        np.array([first[id(each.cells)] for each in disjunctions]),
        np.array([len(each.cells) for each in disjunctions]),
        np.array([_places(problem, each) for each in disjunctions]),
        np.array([cell.normal for _, cell in cells]),
        offsets.copy(),
    )
    return made, offsets, np.array([on_position for on_position, _ in cells])


def _places(problem: Problem, disjunction: Disjunction) -> list[int]:
    """Return the two places of a disjunction, counted as in :class:`Choices`."""
    before = -1 + problem.horizon * (disjunction.on == 'position')
    return [*(before + k for k in disjunction.steps), -1][:2]


def _form(form: Array, known: Array) -> float:
    return float(np.vdot(known, form @ known))
