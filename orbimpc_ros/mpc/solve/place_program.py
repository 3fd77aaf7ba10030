# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The convex program of a quadratic over thrust axes alone, in machine code.

In the plane R e1 is all of R; in space it is all that the cost sees where neither inputs nor an
attitude have a weight. Then the program is a quadratic over z_1..z_N within balls, beyond
half-spaces (:mod:`orbimpc_ros.mpc.kernels.places`), which a dual active-set method solves
a hundred times as fast as an interior-point method that is set up anew for every choice of rows.

Mathematics: docs/mathematics.md, 4.12.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import Infeasible
from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.geometry.rotations import carried
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.kernels.places import (
    INTERRUPTED,
    REFUTED,
    SOLVED,
    Asked,
    Places,
    active_set,
    minimise,
)
from orbimpc_ros.mpc.model.condensed import Condensed, suits_dense_code
from orbimpc_ros.mpc.model.motion import control_maps
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.solve.relaxation import Multipliers, Relaxation, Relaxed, Row
from orbimpc_ros.mpc.solve.request import Request

SLICE = 1e6  # multiplications between two looks at the time: about a millisecond
WORST_CONDITION = 1e7  # beyond it, rounding ends too many solves


class PlaceProgram:
    """The convex program of a problem, solved for any rows on places.

    Args:
        problem: what to solve.

    Attributes:
        multipliers: see :class:`orbimpc_ros.mpc.solve.relaxation.Relaxed`.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.multipliers: Multipliers | None = None
        steps, n = problem.horizon, problem.dimension
        self._condensed = Condensed(problem)
        hessian = self._condensed.hessian
        self._inverse = np.linalg.inv(hessian)
        self._inverse = 0.5 * (self._inverse + self._inverse.T)
        turned = np.diff(np.eye(steps + 1), axis=0)[int(problem.turns_are_angles) :, 1:]
        turned = turned if problem.max_rate else turned[:0]
        controls = control_maps(problem)[:, :, 1:]
        maps = np.concatenate([np.eye(steps), controls.reshape(-1, steps), turned])
        last = len(maps) - len(turned)
        balls = np.concatenate([np.arange(steps), last + np.arange(len(turned))])
        gram = maps @ self._inverse @ maps.T
        self._known = Places(hessian, maps, 0.5 * (gram + gram.T), balls)
        self._held = active_set(steps, len(maps), n)
        self._request: Request | None = None
        self._general: Relaxed | None = None
        # The first call compiles, or loads what was compiled before: at start-up, not in a tick.
        start = State.at(np.zeros(n), np.eye(n), wanted=np.eye(n))
        self.relax(Request(start, np.zeros((steps, n))))

    @staticmethod
    def solves(problem: Problem) -> bool:
        """Return whether this applies to a problem, and is fast on this machine."""
        plane = problem.dimension == 2
        weights = problem.weights
        return (
            COMPILED
            and problem.rotation_order == 1
            and (plane or weights.input == weights.attitude == 0.0)
            and (plane or not problem.turns_are_angles)
            and problem.terminal == 'penalty'
            and weights.length == 0.0
            and not problem.has_cones
            and not problem.approach.exists
            and suits_dense_code(problem)
            and bool(np.linalg.cond(Condensed(problem).hessian) < WORST_CONDITION)
        )

    def _bind(self, request: Request) -> None:
        """Work out what depends on state and goals alone."""
        problem, self._request, state = self.problem, request, request.state
        self._q, self._constant = self._condensed.affine(state, request.goals)
        self._free = self._known.maps @ (-self._inverse @ self._q)
        self._centres = np.zeros((len(self._known.balls), problem.dimension))
        self._radii = np.ones(len(self._centres))
        self._radii[problem.horizon :] = problem.chord
        if problem.max_rate and not problem.turns_are_angles:
            self._centres[problem.horizon] = state.rotation[:, 0]
        self._edges = _edges(problem, state) if problem.first_turn_is_a_cone else None

    def relax(
        self, request: Request, rows: Sequence[Row] = (), chords: Array | None = None
    ) -> Relaxation:
        """See :meth:`orbimpc_ros.mpc.solve.relaxation.Relaxed.relax`."""
        if request is not self._request:
            self._bind(request)
        asked, count, bound = self._asked(rows, chords), 0, -np.inf
        while True:
            status, value, count = minimise(self._known, asked, self._held, count, SLICE)
            bound = max(bound, value + self._constant)
            if status != INTERRUPTED or request.late:
                break
        self.multipliers = self._multipliers(count, len(rows))
        if status == REFUTED:
            raise Infeasible('no trajectory satisfies the constraints')
        if status != SOLVED:
            return self._anew(request, rows, chords, bound)
        return Relaxation(self._coordinates(request.state), bound)

    def _anew(
        self, request: Request, rows: Sequence[Row], chords: Array | None, bound: float
    ) -> Relaxation:
        """Leave what rounding has ended to the general program, unless there is a deadline."""
        if request.hurried:
            return Relaxation(None, bound)
        if self._general is None:
            from orbimpc_ros.mpc.solve.program import Program  # takes Clarabel

            self._general = Program(self.problem)
        try:
            return self._general.relax(request, rows, chords)
        finally:
            self.multipliers = self._general.multipliers

    def _multipliers(self, count: int, asked: int) -> Multipliers:
        held, (steps, n) = self._held, (self.problem.horizon, self.problem.dimension)
        sizes, tether = np.zeros(asked), np.zeros((steps, n))
        for i, row in enumerate(held.rows[:count].tolist()):
            if 0 <= row < asked:  # what follows are the edges of a first turn's cone
                sizes[row] += held.u[i]
            elif row < -steps:  # tangents to the balls of chords, the last of the last step
                tether[-1 - row - len(self._known.balls)] -= held.u[i] * held.normals[i]
        nothing = np.zeros((0, n)), np.zeros((0, 0))
        return Multipliers(held.values[:steps].copy(), sizes, *nothing, tether, 0.0 * tether)

    def _coordinates(self, state: State) -> Array:
        """Return the rotation coordinates of the last solution, shape (N, d)."""
        axes = self._held.values[: self.problem.horizon].copy()
        return axes if self.problem.dimension == 2 else coordinates(carried(state.attitude, axes))

    def _asked(self, rows: Sequence[Row], chords: Array | None) -> Asked:
        steps, n = self.problem.horizon, self.problem.dimension
        places, normals, offsets = (
            [row.place for row in rows],
            [row.normal for row in rows],
            [row.offset for row in rows],
        )
        if self._edges is not None:
            places += [0] * len(self._edges)
            normals += list(self._edges)
            offsets += [0.0] * len(self._edges)
        radii = self._radii
        if chords is not None:
            radii = radii.copy()
            radii[steps:] = np.minimum(radii[steps:], chords)
        known = (
            np.array(places, np.int64),
            np.array(normals).reshape(-1, n),
            np.array(offsets, float),
        )
        return Asked(self._q, self._free, self._centres, radii, *known)


def _edges(problem: Problem, state: State) -> Array:
    """Return normals of the edges of the cone of a first turn in the plane, shape (2, 2)."""
    x, y = state.attitude[:, 0]
    s, c = math.sin(problem.widest_turn), math.cos(problem.widest_turn)
    return np.array([[s * x - c * y, s * y + c * x], [s * x + c * y, s * y - c * x]])
