# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The search as a method of the solver: from a request to a trajectory and its proof tree.

Mathematics: docs/mathematics.md, 4.3.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from threading import get_ident

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.kernels.best_first import LEAST, MADE, NODES, PAUSED, VALUE
from orbimpc_ros.mpc.model.condensed import Condensed, regular
from orbimpc_ros.mpc.model.dynamics import length_weights
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.approach import LEEWAY
from orbimpc_ros.mpc.problem.pace import entry_speed
from orbimpc_ros.mpc.proof.tree import LEAF, NOTHING, ProofTree
from orbimpc_ros.mpc.search.relax import Quadratic, Room, room_for
from orbimpc_ros.mpc.search.ring import Ring
from orbimpc_ros.mpc.search.tree import (
    KIND,
    ROW,
    Tree,
    begin,
    search,
    tree_for,
)
from orbimpc_ros.mpc.solve.request import Found, Request

LONGEST = 120  # horizon up to which a search proves more in a tick than sparse solves do
LONGEST_INERTIAL = 58  # without a floor: beyond it interior steps take longer than sparse solves
ROOM = 1_000_000  # memory of the search, in nodes times steps
SLICE = 3e5  # multiplications between checks of the deadline: less than a millisecond
SPACES = 4  # number of threads whose memory is kept
NONE: Array = np.zeros((0, 2))  # no guess
SETTLED = 90.0  # factor on the tolerance of the search if constraints couple steps


class Engine:
    """Solver of problems in the plane by branch and bound over stage sets.

    Args:
        problem: to solve, in natural units.
        tolerance: relative gap at which a plan is good enough to stop.
    """

    trusts_guess = False  # any starting point will do

    def __init__(self, problem: Problem, tolerance: float, *, coasting: bool = False) -> None:
        self._problem, self._tolerance = problem, tolerance
        self._condensed = Condensed(problem)
        self._hessian, self._inverse, self._excess = regular(self._condensed.hessian)
        self._lengths = length_weights(problem)[1:].astype(float)
        floor = problem.floor
        fraction = float(floor.fraction) if floor.exists else 0.0
        self._floor = fraction, floor.faces if floor.shape == 'polygon' else 0
        self._widest = problem.widest_turn if floor.exists else math.pi
        self.takes_guess = floor.exists  # relaxations over disks need none
        if problem.max_rate or problem.max_acceleration or floor.shape == 'circle':
            self._tolerance *= SETTLED
        # The first call compiles or loads machine code: at start-up, not in a tick.
        start = State.at(np.zeros(2), np.eye(2), wanted=np.eye(2))
        with suppress(Infeasible):
            goals = np.ones((problem.horizon, 2))
            self.solve(Request(start, goals, out_of_time=lambda: True))

    @staticmethod
    def solves(problem: Problem) -> bool:
        """Return True if stage sets express all limits of a problem, and there is machine code."""
        floor, changes = problem.floor, problem.max_rate > 0.0 or problem.max_acceleration > 0.0
        disks = not (floor.exists or changes or problem.approach.exists)
        straight = (disks or floor.shape == 'polygon') and not problem.weights.length
        return (
            COMPILED
            and (problem.dimension, problem.rotation_order) == (2, 1)
            and (straight or (floor.shape == 'circle' and changes))
            and problem.terminal == 'penalty'
            and not problem.obstacles
            and not (problem.approach.exists and floor.fraction < problem.least_heading)
            and problem.horizon <= (LONGEST_INERTIAL if disks and problem.inertial else LONGEST)
        )

    def solve(self, request: Request) -> Found:
        """Return the best trajectory found, with the tree that proves a bound.

        Raises:
            Infeasible: no turns lead to an allowed last heading.
        """
        ring, quad = self._ring(request.state), self._quadratic(request)
        tree, room = _working_space(get_ident(), self._problem.horizon)
        # Copied, since for a read-only or strided array other code would be compiled in a tick.
        guess = NONE if request.guess is None else np.array(request.guess.x, order='C')
        if not begin(quad, ring, tree, guess, room):
            raise Infeasible('no turn meets the cone of approach')
        asked = quad, ring, self._tolerance, tree, room, SLICE
        while search(*asked) == PAUSED:
            if request.late or request.enough.met(self._found(tree, quad)):
                break
        made = int(tree.counts[MADE])
        known = tree.nodes[:made], tree.at[:made], tree.point[:made]
        proof = proof_of(*known, np.zeros((made, len(tree.best))))
        return replace(self._found(tree, quad), proof=proof)

    def _found(self, tree: Tree, quad: Quadratic) -> Found:
        return found_of(tree.best, tree.numbers, tree.counts, quad.constant, self._excess)

    def _quadratic(self, request: Request) -> Quadratic:
        """Return the cost: a quadratic of R_1 e1..R_N e1."""
        q, constant = self._condensed.affine(request.state, request.goals)
        return Quadratic(self._hessian, self._inverse, q, self._lengths, constant)

    def _ring(self, state: State) -> Ring:
        """Return the floor and the limits of headings and speeds from a state."""
        problem, ahead = self._problem, state.attitude[:, 0]
        entry, change, last, within = 1.0, np.inf, 0.0, math.pi
        if problem.max_acceleration > 0.0:
            entry, change = entry_speed(problem, state), problem.speed_change
        if problem.approach.exists:
            axis = problem.approach.axis(state)
            last, within = math.atan2(axis[1], axis[0]), problem.approach.cone + LEEWAY
        first = math.atan2(ahead[1], ahead[0])
        return Ring(*self._floor, self._widest, first, entry, change, last, within)


@lru_cache(maxsize=2 * LONGEST)
def _working_space(thread: int, steps: int) -> tuple[Tree, Room]:
    """Return the working memory of a search over N = ``steps`` steps.

    Its nodes overwrite those of the previous search of this thread, which has ended.
    """
    nodes, memory = ROOM // steps, _memory(thread)
    sectors, start, point = (
        each[: nodes * steps].reshape(nodes, steps, -1)
        for each in (memory.sectors, memory.start, memory.point)
    )
    own = tree_for(steps, 1)
    made = memory._replace(best=own.best, speeds=own.speeds, turns=own.turns)
    return made._replace(sectors=sectors, start=start, point=point), room_for(steps)


@lru_cache(maxsize=SPACES)
def _memory(thread: int) -> Tree:
    """Return memory for the nodes of a search."""
    return tree_for(1, ROOM)


def found_of(
    best: Array, numbers: Array, counts: np.ndarray, constant: float, excess: float
) -> Found:
    """Return the incumbent of a search, with the bound proved so far.

    Args:
        best: the incumbent, shape (N, n).
        numbers: of the tree, see :mod:`orbimpc_ros.mpc.kernels.best_first`.
        counts: the same.
        constant: omitted from costs.
        excess: largest increase of costs by the regularisation of H.
    """
    value, bound = float(numbers[VALUE]), float(numbers[LEAST])
    found = best.copy() if value < np.inf else None
    return Found(found, value + constant, bound - excess + constant, int(counts[NODES]))


def proof_of(
    nodes: np.ndarray, at: Array, point: Array, kept: Array, pull: Array = NOTHING
) -> ProofTree:
    """Return the tree of a search as the proof of its bound.

    Args:
        nodes: as in proofs, but with leaves not numbered yet, shape (M, 5).
        at: as in proofs, shape (M,).
        point: tangent point of each node's bound, shape (M, N, n).
        kept: curvatures assigned to single steps in that bound, shape (M, N).
        pull: multipliers of the arrival in that bound, shape (M, 1, n), if there is one.
    """
    nodes, none = nodes.copy(), np.zeros(0, np.int64)
    (leaves,) = np.nonzero((nodes[:, KIND] == LEAF) & (nodes[:, ROW] == 0))
    nodes[leaves, ROW] = np.arange(len(leaves))
    return ProofTree(
        nodes,
        at.copy(),
        point[leaves],
        kept[leaves],
        np.zeros(len(leaves), np.int64),
        none,
        np.zeros(0),
        pull[leaves] if len(pull) else NOTHING,
    )
