# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A limit of the change of speed on top of any other method.

Without that limit a problem costs no more, so the bound of another method for it holds with it.
Where its trajectory changes speed too fast, the speeds along its directions are chosen anew, which
is convex: R_k = sigma_k Q_k with Q_k held, and sigma in a chain.

Mathematics: docs/mathematics.md, 3.10.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy import sparse

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.geometry.rotations import HEADING_UNDEFINED, carried
from orbimpc_ros.mpc.model.dynamics import trajectory_of
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.approach import LEEWAY, Approach
from orbimpc_ros.mpc.problem.pace import WITHIN, entry_speed, first_change_is_decided
from orbimpc_ros.mpc.proof.stated import Statement
from orbimpc_ros.mpc.search.engine import Engine
from orbimpc_ros.mpc.solve.conic import extended, run, solver_for
from orbimpc_ros.mpc.solve.program import Program
from orbimpc_ros.mpc.solve.regions import Regions
from orbimpc_ros.mpc.solve.registry import method_for
from orbimpc_ros.mpc.solve.request import Found, Request

ACCURATE = 1e-9  # of Clarabel

Side = tuple[Array, Array, float]  # what headings add along a normal, that, and how much it takes


class PacedSpeeds:
    """Solves problems with a limit of the change of speed that no search knows by itself.

    Args:
        problem: what to solve.
        tolerance: relative gap at which the search without the limit stops.
        coasting: whether states come with a ``coasted`` rotation.
        among: whether states will come with hazards.
    """

    takes_guess = trusts_guess = True

    def __init__(
        self, problem: Problem, tolerance: float, *, coasting: bool = False, among: bool = False
    ) -> None:
        self._problem, freed = problem, replace(problem, max_acceleration=0.0)
        ahead = replace(freed, approach=Approach())  # directions are given, and as wide as they are
        if problem.floor.exists:
            ahead = replace(ahead, max_rate=0.0)
        self._program = Program(ahead, coasting=coasting)
        self._method = method_for(freed, tolerance, coasting=coasting, among=among)
        self._statement, self._stiff = Statement(problem), np.full((problem.horizon,) * 2, np.inf)

    @staticmethod
    def solves(problem: Problem) -> bool:
        """Return whether there is a limit, and no faster method for it."""
        return problem.max_acceleration > 0.0 and not Engine.solves(problem)

    def solve(self, request: Request) -> Found:
        """Return the best trajectory with the bound of the problem without the limit.

        Raises:
            Infeasible: not even without the limit is there a trajectory.
        """
        found = self._method.solve(request)
        known = [] if request.guess is None else [request.guess.x]
        if found.x is not None:
            held = self._holds(request.state, found.x)
            known += [found.x] if held else self._slowed(request, found.x)
        start = self._problem, request.state, request.goals
        costs = [trajectory_of(*start, x).cost for x in known]
        if not known:
            reason = 'no speeds along the way found change within max_acceleration'
            return replace(found, x=None, cost=np.inf, reason=reason)
        best = int(np.argmin(costs))
        return replace(found, x=known[best], cost=costs[best], reason='')

    def _holds(self, state: State, x: Array) -> bool:
        sizes = np.linalg.norm(x[:, : self._problem.dimension], axis=1)
        before = np.concatenate([[entry_speed(self._problem, state)], sizes[:-1]])
        decided = int(first_change_is_decided(self._problem, state))
        return bool((np.abs(sizes - before)[decided:] <= self._problem.speed_change).all())

    def _slowed(self, request: Request, x: Array) -> list[Array]:
        """Return the best rotations along the directions of others, if there are any.

        Once as they are, and once with those kept that the vehicle was headed in before it got as
        slow as it can within a step: where it is to stand still, directions are arbitrary. There
        is time for the first only where time is up.
        """
        state, n = request.state, self._problem.dimension
        if first_change_is_decided(self._problem, state):
            return []
        slow = HEADING_UNDEFINED, self._problem.speed_change
        beside, aims = list(self._beside(request, x[:, :n])), self._problem.approach
        ways = [_directions(state, x[:, :n], each) for each in slow[: 1 if request.late else 2]]
        if aims.exists:
            least = math.cos(aims.cone + LEEWAY)
            ways = [each for each in ways if each[-1, :n] @ aims.axis(state) >= least]
        found = (self._along(request, each, beside) for each in ways)
        return [each for each in found if each is not None]

    def _along(self, request: Request, aligned: Array, beside: list[Side]) -> Array | None:
        """Return the best coordinates sigma_k Q_k, shape (N, d), given those of Q_k.

        Bodies are passed on the sides that they are beside.
        """
        data = self._program.stated(request)
        sigma, lifted = self._lifted(aligned)
        rows, offsets = self._limits(request.state, aligned[:, : self._problem.dimension], beside)
        entries = np.zeros((len(rows), lifted.shape[1]))
        entries[:, sigma] = rows
        dims = data['dims']  # the orbitopes hold what is no longer than 1
        kept = dims.zero + dims.nonneg + sum(dims.soc)
        flat = SimpleNamespace(zero=dims.zero, nonneg=dims.nonneg, soc=dims.soc, psd=[])
        data = {
            'P': lifted.T @ data['P'] @ lifted,
            'c': lifted.T @ data['c'],
            'A': sparse.csc_matrix(data['A'][:kept] @ lifted),
            'b': data['b'][:kept],
            'dims': flat,
        }
        answer = run(solver_for(extended(data, entries, offsets), ACCURATE), None)
        if answer is None or str(answer.status) != 'Solved':
            return None
        return np.asarray(np.clip(np.asarray(answer.x)[sigma], 0.0, 1.0)[:, None] * aligned)

    def _lifted(self, aligned: Array) -> tuple[np.ndarray, Any]:
        """Return the columns of sigma, and what all others and sigma come to in the program."""
        x = self._program.statement.x
        size = self._program.statement.columns
        others = np.setdiff1d(np.arange(size), x)
        sigma = len(others) + np.arange(len(x))
        places = np.concatenate([others, x.ravel()])
        columns = np.concatenate([np.arange(len(others)), np.repeat(sigma, x.shape[1])])
        values = np.concatenate([np.ones(len(others)), aligned[:, : x.shape[1]].ravel()])
        shape = size, len(others) + len(x)
        return sigma, sparse.csc_matrix((values, (places, columns)), shape=shape)

    def _beside(self, request: Request, headings: Array) -> Iterator[Side]:
        """Yield the half-spaces on whose sides headings, shape (N, n), pass all bodies."""
        regions = Regions(self._problem, self._statement, request, self._stiff)
        near = regions.beside(headings, math.inf)
        for held in regions.tangents(headings, near, {}).values():
            for row, _ in held:
                yield row.shares, row.normal, row.offset

    def _limits(self, state: State, axes: Array, beside: list[Side]) -> tuple[Array, Array]:
        """Return rows A and right-hand sides b of A sigma <= b: what the program does not state."""
        problem, count = self._problem, len(axes)
        chain, eye, entry = np.eye(count) - np.eye(count, k=-1), np.eye(count), np.zeros(count)
        entry[0] = entry_speed(problem, state)
        most = WITHIN * problem.speed_change
        passed = np.array([-reach * (axes @ normal) for reach, normal, _ in beside])
        passed = passed.reshape(-1, count)
        edges = -np.array([each for *_, each in beside])
        met = np.maximum(passed, 0.0).sum(axis=1) > edges  # others are beside at any speeds
        rows = chain, -chain, eye, -eye, passed[met]
        least = np.array(problem.floor.least(axes))
        if problem.approach.exists:
            least[-1] = max(least[-1], problem.least_heading)
        offsets = most + entry, most - entry, np.ones(count), -least, edges[met]
        return np.vstack(rows), np.concatenate(offsets)


def _directions(state: State, headings: Array, slow: float) -> Array:
    """Return coordinates of rotations along headings, shape (N, n); of a slow one, as before.

    At rotation order 2 the first one is where the vehicle coasts.
    """
    sizes = np.linalg.norm(headings, axis=1)
    units, before = np.array(headings), state.attitude[:, 0]
    for k in range(len(units)):
        units[k] = headings[k] / sizes[k] if sizes[k] > slow else before
        before = units[k]
    if state.coasted is None:
        return coordinates(carried(state.attitude, units))
    rest = carried(state.coasted, units[1:])
    return coordinates(np.concatenate([state.coasted[None], rest]))
