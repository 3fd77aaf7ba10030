# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The search as a method of the solver: a request in, a trajectory and the tree of its proof out.

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

LONGEST = 120  # horizon; up to it a search proves in a tick what sparse solves do not
LONGEST_INERTIAL = 58  # without a floor: beyond it interior steps take longer than sparse solves
ROOM = 1_000_000  # nodes times steps that there is memory for
SLICE = 3e5  # multiplications between two looks at the time: less than a millisecond
SPACES = 4  # threads whose memory is kept
NONE: Array = np.zeros((0, 2))  # of guesses
SETTLED = 90.0  # tolerances at which a search may stop where steps depend on each other


class Engine:
    """Solves problems of the plane by branch and bound over stage sets.

    Args:
        problem: what to solve, in natural units.
        tolerance: relative gap at which a plan is good enough to stop.
    """

    trusts_guess = False  # anywhere is good enough to start from

    def __init__(self, problem: Problem, tolerance: float, *, coasting: bool = False) -> None:
        self._problem, self._tolerance = problem, tolerance
        self._condensed = Condensed(problem)
        self._hessian, self._inverse, self._excess = regular(self._condensed.hessian)
        self._lengths = length_weights(problem)[1:].astype(float)
        floor = problem.floor
        fraction = float(floor.fraction) if floor.exists else 0.0
        self._floor = fraction, floor.faces if floor.shape == 'polygon' else 0
        self._widest = problem.widest_turn if floor.exists else math.pi
        self.takes_guess = floor.exists  # disks are relaxed from anywhere
        if problem.max_rate or problem.max_acceleration or floor.shape == 'circle':
            self._tolerance *= SETTLED
        # The first call compiles, or loads what was compiled before: at start-up, not in a tick.
        start = State.at(np.zeros(2), np.eye(2), wanted=np.eye(2))
        with suppress(Infeasible):
            goals = np.ones((problem.horizon, 2))
            self.solve(Request(start, goals, out_of_time=lambda: True))

    @staticmethod
    def solves(problem: Problem) -> bool:
        """Return whether there are stage sets for all limits of a problem, and machine code."""
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
            Infeasible: no turn leads to a last heading that is allowed.
        """
        ring, quad = self._ring(request.state), self._quadratic(request)
        tree, room = _working_space(get_ident(), self._problem.horizon)
        # A copy: code for arrays that are read-only or strided would be compiled in a tick.
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
        """Return the floor, and what limits headings and speeds from a state on."""
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
    """Return what a search over N = ``steps`` steps works in.

    Its nodes take the place of those of the search before it in this thread, which is over.
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
    """Return the best of a search so far, with the bound that it has proved.

    Args:
        best: the best trajectory, shape (N, n).
        numbers: of its tree, see :mod:`orbimpc_ros.mpc.kernels.best_first`.
        counts: so.
        constant: what costs lack.
        excess: what making H regular added to costs at most.
    """
    value, bound = float(numbers[VALUE]), float(numbers[LEAST])
    found = best.copy() if value < np.inf else None
    return Found(found, value + constant, bound - excess + constant, int(counts[NODES]))


def proof_of(
    nodes: np.ndarray, at: Array, point: Array, kept: Array, pull: Array = NOTHING
) -> ProofTree:
    """Return the tree of a search as the proof of its bound.

    Args:
        nodes: as proofs have them, but that leaves are not numbered, shape (M, 5).
        at: as proofs have it, shape (M,).
        point: where the tangent of each node's bound touches, shape (M, N, n).
        kept: curvatures that steps keep there, shape (M, N).
        pull: multipliers of the arrival there, shape (M, 1, n), if there is one.
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
