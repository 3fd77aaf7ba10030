# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planar floor with a turn rate: branch and bound over headings within sectors.

A search begins from the trajectories that the previous plan and its own relaxations round to, and
proves by sectors how good the best of them is (:mod:`orbimpc_ros.mpc.kernels.sectors`). Whatever
it is stopped at, its best trajectory holds floor and turn rate, and its bound holds.

Mathematics: docs/mathematics.md, 4.10.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace

import numpy as np

from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.kernels.active_set import Quadratic
from orbimpc_ros.mpc.kernels.best_first import LEAST, MADE, NODES, PAUSED, VALUE
from orbimpc_ros.mpc.kernels.sectors import HALF, begin_sectors, offer, search, sectors
from orbimpc_ros.mpc.kernels.steering import Ring
from orbimpc_ros.mpc.model.condensed import Condensed, regular
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.approach import LEEWAY
from orbimpc_ros.mpc.problem.pace import entry_speed
from orbimpc_ros.mpc.proof.tree import ProofTree
from orbimpc_ros.mpc.solve.request import Found, Request
from orbimpc_ros.mpc.solve.split_tree import NOWHERE, TURN, Splits, with_ways_round

LONGEST = 120  # horizon; up to it a search proves in a tick what sparse solves do not
ROOM = 600_000  # nodes times steps that there is memory for
MOST = 20_000  # nodes of a search
SLICE = 3e5  # multiplications between two looks at the time: about a millisecond
SETTLED = 90.0  # tolerances at which a search may stop


class SectorSearch:
    """Solves planar problems of rotation order 1 whose only limits are a floor and changes.

    Those of the heading, by a turn rate, those of the speed, by an acceleration, or both. The last
    heading may be limited besides.

    Args:
        problem: what to solve.
        tolerance: relative gap at which a plan is good enough to stop.
    """

    takes_guess, trusts_guess = True, False  # anywhere is good enough to start from

    def __init__(self, problem: Problem, tolerance: float, *, coasting: bool = False) -> None:
        self._tolerance = SETTLED * tolerance
        self._condensed = Condensed(problem)
        self._hessian, self._inverse, self._excess = regular(self._condensed.hessian)
        faces = problem.floor.faces if problem.floor.shape == 'polygon' else 0
        self._problem, self._approach = problem, problem.approach
        self._floor = float(problem.floor.fraction), faces, problem.widest_turn
        self._most = min(MOST, ROOM // problem.horizon)
        self._tree = sectors(problem.horizon, self._most)
        # The first call compiles, or loads what was compiled before: at start-up, not in a tick.
        start = State.at(np.zeros(2), np.eye(2), wanted=np.eye(2))
        with suppress(Infeasible):
            self.solve(Request(start, np.ones((problem.horizon, 2)), out_of_time=lambda: True))

    @staticmethod
    def solves(problem: Problem) -> bool:
        """Return whether this method applies to a problem, and is fast on this machine."""
        return (
            COMPILED
            and (problem.dimension, problem.rotation_order) == (2, 1)
            and problem.floor.shape in ('polygon', 'circle')
            and (problem.max_rate > 0.0 or problem.max_acceleration > 0.0)
            and problem.terminal == 'penalty'
            and problem.weights.length == problem.arrival_weight == 0.0
            and not problem.obstacles
            and not (problem.approach.exists and problem.widest_turn >= HALF)
            and problem.horizon <= LONGEST
        )

    def solve(self, request: Request) -> Found:
        """Return the best trajectory found, with the best bound proved.

        Raises:
            Infeasible: no turn leads to a last heading that is allowed.
        """
        q, constant = self._condensed.affine(request.state, request.goals)
        ahead = request.state.attitude[:, 0]
        first, entry = math.atan2(ahead[1], ahead[0]), entry_speed(self._problem, request.state)
        change, last = self._problem.speed_change, self._last(request.state)
        ring = Ring(*self._floor, first, entry, change, *last)
        quadratic, tree = Quadratic(self._hessian, self._inverse, q), self._tree
        if not begin_sectors(quadratic, ring, tree):
            raise Infeasible('no turn meets the cone of approach')
        # A copy: code for arrays that are read-only or strided would be compiled in a tick.
        start = tree.free if request.guess is None else np.array(request.guess.x, order='C')
        for x in (start, entry * ahead * np.ones((len(start), 1))):
            if tree.numbers[VALUE] == np.inf:  # else there is no need to go straight on
                offer(quadratic, ring, constant, tree, x, tree.low[0], tree.high[0], np.inf)
        asked = quadratic, ring, constant, self._tolerance, tree, self._most, SLICE
        while search(*asked) == PAUSED and not request.late:
            if request.enough.met(self._found(constant)):
                break
        made = int(tree.counts[MADE])
        proof = self._proof(made, first, last) if request.leaves_time_for(made) else None
        return replace(self._found(constant), proof=proof)

    def _last(self, state: State) -> tuple[float, float]:
        """Return the direction of the last heading, and the angle it may be off by [rad]."""
        if not self._approach.exists:
            return 0.0, math.pi
        axis = self._approach.axis(state)
        return math.atan2(axis[1], axis[0]), self._approach.cone + LEEWAY

    def _found(self, constant: float) -> Found:
        """Return the best of a search so far, with the bound that it has proved."""
        numbers = self._tree.numbers
        best, cost = self._tree.best.copy(), float(numbers[VALUE]) + constant
        bound = float(numbers[LEAST]) - self._excess + constant
        return Found(best, cost, bound, int(self._tree.counts[NODES]))

    def _proof(self, made: int, heading: float, last: tuple[float, float]) -> ProofTree:
        """Return the tree of a search from a heading on, to a last one within an angle [rad]."""
        tree, turn, steps = self._tree, self._floor[2], len(self._hessian)
        known = tree.splits[:made], tree.parts[:made], tree.angles[:made], tree.points[:made]
        splits = Splits(*(each.copy() for each in known))
        if turn >= HALF:  # directions begin opposite to the heading
            return splits.proof(origins=np.full(steps, heading - math.pi))
        proof, (axis, aside) = splits.proof(origins=NOWHERE), last
        if not self._approach.exists:
            return proof
        reach = steps * turn + aside
        first = math.ceil((heading - reach - axis) / TURN)
        ways = math.floor((heading + reach - axis) / TURN) - first + 1
        return with_ways_round(proof, ways, axis + TURN * first) if ways > 1 else proof
