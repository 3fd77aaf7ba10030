# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Regions of one request: their half-spaces, and how to split them.

A region restricts each *choice*: the direction of each heading, and the side of each body on which
each step passes (:mod:`orbimpc_ros.mpc.proof.splits`). Half-spaces describe its convex hull: for a
heading in a sector or patch, no slower than the floor, the half-space beyond the chord; for a ball
of radius rho, passed on a side with normals within an angle d of c, the control points satisfy

    c . P_i >= rho cos d - D sin d,

where D is the largest distance between control points. The choice that promises the greatest
increase of the bound is split: with all other multipliers fixed, the dual function along the
multiplier t >= 0 of a new row a.x >= beta is

    D(t) = D(0) + t (beta - a.x) - t^2/2 a.H^-1 a,

a parabola, with the solution x and the Hessian H of the rotations, so that the bound of a child is
at least D(0) + max(0, beta - a.x)^2 / (2 a.H^-1 a).

Mathematics: docs/mathematics.md, 3.5, 3.7, 4.9 and 5.3.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import lru_cache
from typing import Any

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.check import turn_margin
from orbimpc_ros.mpc.geometry.rotations import HEADING_UNDEFINED
from orbimpc_ros.mpc.geometry.separation import separation
from orbimpc_ros.mpc.model.dynamics import Condensed
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.proof.flight import DECIDED
from orbimpc_ros.mpc.proof.rows import side_of
from orbimpc_ros.mpc.proof.sets import about
from orbimpc_ros.mpc.proof.splits import GONE, ICOSAHEDRON, WHOLE, Cut, Region, begin, narrowed
from orbimpc_ros.mpc.proof.stated import Bodies, Statement
from orbimpc_ros.mpc.proof.tree import ARCS, CUT, FACES, NOWHERE, PATCHES, POINTS, QUARTERS, SIDES
from orbimpc_ros.mpc.solve.relaxation import HEADING, Row
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.turns import Turns

SATISFIED = 1e-7  # violation below which a choice is satisfied; a tenth of the check's tolerance
TURNED = 5e-7  # [rad] half the check's tolerance of turns
REFUTED = 1e-6  # distance from which on a half-space counts as out of reach
FINEST = 1e-6  # [rad] such a narrow sector misses its floor by less than rounding
WORST_CONDITION = 1e12
AROUND = 4  # arcs that the full circle is split into

ALWAYS = -1  # key, in place of a choice, of half-spaces that hold in every region
CONE = -2  # in place of a row number: rows on headings for cones in space

NO_CORNERS: Array = np.zeros((3, 3))  # of all directions

Held = tuple[Row, ...]
Rows = dict[int, Held]  # half-spaces by choice
Side = tuple[Array, float]  # the half-space of a choice: normal, shape (n,), and offset


class Regions:
    """The regions of a problem from the state of the last request.

    Args:
        problem: what to solve.

    Attributes:
        condensed: the quadratic of the problem.
        inverse: H^-1, shape (N, N); None if H is singular.
        turns: the turn limit, if it bounds angles.
        request: the last one.
        first: index of the first heading that is not fixed by the state.
        bodies: number of bodies.
        origins: as in :class:`~orbimpc_ros.mpc.proof.tree.ProofTree`.
        floors: choices of headings with a floor.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem, self._statement = problem, Statement(problem)
        self.turns = Turns(problem) if problem.turns_are_angles else None
        self.condensed, self.inverse = Condensed(problem), None
        n, count, floor = problem.dimension, problem.horizon, problem.floor
        controls, started = problem.maps.controls, problem.maps.started
        self._controls, still = controls.shape[1], np.zeros((count, 3))
        # Of headings, and then of the control points of all steps: the coefficients of R_1 e1..
        # R_N e1, those of R_0 e1, p_0 and w, and a.H^-1 a, infinite where nothing moves the point.
        self._reach = np.vstack([np.eye(count), controls.reshape(-1, count)])
        self._started = np.vstack([still, started.reshape(-1, 3)])
        self._moved: list[bool] = np.asarray(self._reach.any(axis=1)).tolist()
        self._headings = np.arange(count)[:, None]
        self._curvature = np.full(len(self._reach), np.inf)
        hessian = self.condensed.hessian
        if np.linalg.cond(hessian) <= WORST_CONDITION:  # the condition of a zero matrix is NaN
            self.inverse = np.linalg.inv(hessian)
            along = np.einsum('mi,ij,mj->m', self._reach, self.inverse, self._reach)
            self._curvature = np.where(along > 0.0, along, np.inf)
        self._farthest = np.abs(self._reach).sum(axis=1)
        # Normals of the floor's faces, if these are its choices.
        self._solid = problem.floor_normals if n == 3 or floor.shape != 'polygon' else None
        self._faces = floor.faces if floor.shape == 'polygon' and n == 2 else 0
        self._first_arc = -math.pi / self._faces if self._faces else 0.0
        self._outward = np.vstack([-np.eye(n), np.eye(n)])

    def bind(self, request: Request) -> None:
        """Compute the data that depend only on state and goals."""
        problem, state, count = self.problem, request.state, self.problem.horizon
        self.request, self._state = request, state
        limits = self._statement.limits(state, request.goals)
        stated = self._stated = self._statement.of(state, request.goals, limits)
        self.first, self.bodies = stated.order - 1, len(stated.bodies.at)
        ordered = self._faces and stated.exchanged
        self.origins = np.full(count, self._first_arc) if ordered else NOWHERE
        self.floors = list(range(self.first, count)) if problem.floor.exists else []
        driving = np.array([state.rotation[:, 0], state.velocity, state.disturbance])
        self._free = self._started @ driving
        self._seen: tuple[Any, Any] = None, None
        if self.bodies:
            self._place(stated.bodies)

    def _place(self, bodies: Bodies) -> None:
        """Set the control points that bodies constrain, and the sizes of balls."""
        at, steps = bodies.at, np.arange(self.problem.horizon)[:, None]
        self._rows = (at >= 0).sum(axis=2)
        at = at[:, :, : self._rows.max()]
        held, places = at >= 0, bodies.places[:, :, : at.shape[2]]
        # missing rows repeat the first
        points = self._controls * steps + np.where(held, at, at[:, :, :1])
        self._points = self.problem.horizon + points
        middles = np.where(held[..., None], places, places[:, :, :1])
        self._apart = self._free[self._points] - middles
        radii, margins = bodies.extents[:, -1:], bodies.margins[0]
        self._balls = np.flatnonzero(radii > 0.0)
        self._radii, nothing = radii[self._balls], (radii > 0.0) & (radii + margins <= 0.0)
        self._margins = np.where(nothing, -np.inf, margins)  # shrunk: the vehicle leaves it

    # --- regions

    def root(self) -> Region | None:
        """Return the region of the root; None if it is empty."""
        problem, stated = self.problem, self._stated
        count, n = (2 + self.bodies) * problem.horizon, problem.dimension
        part, span = np.full(count, WHOLE), np.zeros((count, 2))
        decided = stated.start[DECIDED : DECIDED + 1, :n]
        if begin(stated, self.origins, part, span) == GONE:
            return None
        fixed = self.first and self._state.coasted is None
        if fixed and problem.floor.margin(decided)[0] < -SATISFIED:
            return None
        if self._solid is not None:
            part[: problem.horizon] = WHOLE
        return Region(part, span, {})

    def part(self, region: Region, cut: Cut, i: int) -> Region | None:
        """Return part i of a region; None if it is empty."""
        corners, choice = region.corners, cut.choice
        if cut.kind in (PATCHES, QUARTERS):
            corners = corners | {choice: corners.get(choice, NO_CORNERS).copy()}
        made = Region(region.part.copy(), region.span.copy(), corners)
        node = cut.kind, choice, 0, cut.parts
        return None if narrowed(self._stated, node, cut.at, i, *made) == GONE else made

    def changed(self, before: Region, after: Region) -> Rows:
        """Return the half-spaces of the choices that differ between a region and a part of it."""
        moved = (before.span != after.span).any(axis=1) | (before.part != after.part)
        return {choice: self._within(choice, after) for choice in np.flatnonzero(moved).tolist()}

    def every(self, region: Region) -> Rows:
        """Return the half-spaces of a region."""
        split = np.flatnonzero(region.part != WHOLE).tolist()
        return {ALWAYS: self._always(), **{c: self._within(c, region) for c in split}}

    def _always(self) -> Held:
        """Return half-spaces of all regions: for turns, and for an R_1 e1 of given direction."""
        stated, floor, rows = self._stated, self.problem.floor, list[Row]()
        if self.first and self._state.coasted is not None and floor.exists:
            axis = stated.start[DECIDED, : self.problem.dimension]
            axis = axis / np.linalg.norm(axis)
            rows.append(Row(0, self._reach[0], axis, float(floor.least(axis))))
        if self.turns is not None and (stated.n == 3 or self._solid is not None):
            number = CONE if stated.n == 3 else HEADING
            rows += [row._replace(number=number) for row in self.turns.rows(self._state)]
        return tuple(rows)

    # --- half-spaces

    def points(self, choice: int) -> tuple[np.ndarray, int, Array]:
        """Return the points that a choice constrains: a heading, or control points of a step.

        Returns:
            Their places as in :class:`Row`, m of them; the row number of the first among presses,
            ``HEADING`` for a heading; and their positions without thrust relative to the body,
            shape (m, n).
        """
        count = self.problem.horizon
        if choice < count:
            return self._headings[choice], HEADING, self._free[choice : choice + 1]
        j, k = choice // count - 2, choice % count
        m = self._rows[j, k]
        number = POINTS * (choice - 2 * count)
        return self._points[j, k, :m], number, self._apart[j, k, :m]

    def held(self, choice: int, side: Side) -> Held:
        """Return the half-spaces on the points of a choice, without those that nothing moves."""
        (normal, least), (places, number, free) = side, self.points(choice)
        offsets = least - free @ normal
        return tuple(
            Row(place, self._reach[place], normal, offset, number + i)
            for i, (place, offset) in enumerate(zip(places.tolist(), offsets.tolist(), strict=True))
            if math.isfinite(offset) and self._moved[place]
        )

    def _within(self, choice: int, region: Region) -> Held:
        """Return the half-spaces of a choice in a region."""
        free = choice >= self.problem.horizon or self.problem.floor.exists
        if region.part[choice] == WHOLE or choice < self.first or not free:
            return ()
        return self.held(choice, self.side(choice, region))

    def side(self, choice: int, region: Region) -> Side:
        """Return the half-space of a choice that a region restricts."""
        n = self.problem.dimension
        if choice >= self.problem.horizon:
            normal: Array = np.zeros(n)
            out, off, size = side_of(self._stated, choice, *region, normal)
            return normal, out - off if size >= 0.0 else -np.inf
        if self._solid is not None:
            return self._solid[region.part[choice]], self.problem.floor.fraction
        if n == 2:
            return self._chord(*region.span[choice].tolist())
        axis, least = _patch(region.corners[choice].tobytes())
        return axis, self._stated.least * least

    def _chord(self, low: float, high: float) -> Side:
        """Return the half-space that holds for headings in a sector."""
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        normal, slowest = np.array([math.cos(middle), math.sin(middle)]), self._stated.least
        if half >= math.pi:
            return normal, -np.inf
        if half > 0.5 * math.pi:
            return normal, math.cos(half)
        if not self._faces:
            return normal, slowest * math.cos(half)
        share, slack = 2.0 * math.pi / self._faces, self._stated.narrow
        first, last = math.ceil(low / share - 0.5 + slack), math.floor(high / share - 0.5 - slack)
        angles = np.array([low, *(share * (i + 0.5) for i in range(first, last + 1)), high])
        if len(angles) == 2:  # within a single face
            face = share * round(middle / share)
            return np.array([math.cos(face), math.sin(face)]), slowest
        off = angles - share * np.round(angles / share)
        return normal, float((slowest / np.cos(off) * np.cos(angles - middle)).min())

    # --- violations

    def headings(self, x: Array) -> Array:
        """Return the headings R_0 e1..R_N e1, shape (N + 1, n), of rotation coordinates."""
        return np.concatenate([self._state.rotation[None, :, 0], x[:, : self.problem.dimension]])

    def turns_in_time(self, headings: Array) -> bool:
        """Return True if every turn is within its angle; relaxations bound only its chord."""
        if self.turns is None:
            return True
        return bool(turn_margin(self.problem, self._state, headings).min() >= -TURNED)

    def missed(self, headings: Array) -> dict[int, float]:
        """Return the violation of each choice that headings violate.

        Args:
            headings: R_0 e1..R_N e1, shape (N + 1, n).
        """
        violations = dict[int, float]()
        if self.problem.floor.exists:
            short = -self.problem.floor.margin(headings[1:])
            short[: self.first] = -np.inf
            violations = {k: float(short[k]) for k in np.flatnonzero(short > SATISFIED).tolist()}
        if self.bodies:
            into, _, _ = self._entered(headings)
            for j, k in zip(*(each.tolist() for each in np.nonzero(into > SATISFIED)), strict=True):
                violations[(2 + j) * self.problem.horizon + k] = float(into[j, k])
        return violations

    def _entered(self, headings: Array) -> tuple[Array, Array, Array]:
        """Return the depths by which headings enter each body, and the way out of it.

        Args:
            headings: R_0 e1..R_N e1, shape (N + 1, n); the last ones are remembered.

        Returns:
            Lengths, shape (J, N) [m]; unit vectors, shape (J, N, n); and the extents of the bodies
            along these, shape (J, N) [m].
        """
        content = headings.tobytes()
        if content != self._seen[0]:
            places = (self._reach @ headings[1:])[self._points] + self._apart
            far = np.concatenate([places.max(axis=2), -places.min(axis=2)], axis=-1)
            extents = self._stated.bodies.extents[:, :-1]
            short = far + extents[:, None]
            into, sides = short.min(axis=-1), short.argmin(axis=-1)
            normals, out = self._outward[sides], extents[np.arange(len(extents))[:, None], sides]
            if len(self._balls):
                normals[self._balls], away = separation(places[self._balls])
                into[self._balls], out[self._balls] = self._radii - away, self._radii
            self._seen = content, (into + self._margins, normals, out)
        return self._seen[1]

    def is_round(self, choice: int) -> bool:
        """Return True if a choice is one of a round floor or a ball, not of flat sides."""
        if choice < self.problem.horizon:
            return bool(self.problem.floor.radius)
        return bool(self._stated.bodies.extents[choice // self.problem.horizon - 2, -1])

    def _is_flat(self, choice: int) -> bool:
        """Return True for headings beyond faces of the floor, and for boxes."""
        heading = choice < self.problem.horizon
        return self._solid is not None if heading else not self.is_round(choice)

    def tangents(self, headings: Array, choices: Iterable[int], kept: Rows) -> Rows:
        """Return for each choice the half-space that headings satisfy, or violate the least.

        A floor's is beyond its tangent, or the face violated least; a body's on the way out of it.

        Args:
            headings: R_0 e1..R_N e1, shape (N + 1, n).
            choices: of floors and bodies.
            kept: half-spaces by choice; flat choices among these are skipped.
        """
        rows, count, floor = Rows(), self.problem.horizon, self.problem.floor
        beyond = floor.tangent(headings[1:]) if floor.exists else headings
        still = np.linalg.norm(headings[1:], axis=1) <= HEADING_UNDEFINED  # touch no round floor
        if self.bodies:
            _, normals, out = self._entered(headings)
            least = out + self._stated.bodies.margins[0]
        for choice in choices:
            j, k = choice // count - 2, choice % count
            if choice in kept and not self.is_round(choice):
                continue
            if j >= 0:
                rows[choice] = self.held(choice, (normals[j, k], float(least[j, k])))
            elif not (floor.radius and still[k]):
                rows[choice] = self.held(choice, (beyond[k], floor.fraction))
        return rows

    def beside(self, headings: Array, within: float) -> list[int]:
        """Return the choices of balls within a distance of a path, and of all boxes.

        Of bodies that are listed twice, for the ends of a step and for all of it, take the latter.
        """
        if not self.bodies:
            return []
        count, (into, _, _) = self.problem.horizon, self._entered(headings)
        boxes = len(self.problem.boxes)
        near = np.argwhere((into > -within) | (self._stated.bodies.extents[:, -1:] == 0.0))
        pairs = ((j, k) for j, k in near.tolist() if j < boxes or (j - boxes) % 2)
        return [(2 + j) * count + k for j, k in pairs]

    # --- branching

    def cut(self, choice: int, region: Region) -> Cut | None:
        """Return the split of a choice in a region; None if there is nothing to split."""
        if choice < self.first:
            return None
        if region.part[choice] == WHOLE:
            return self._parted(choice)
        return None if self._is_flat(choice) else self._refined(choice, region)

    def _parted(self, choice: int) -> Cut:
        """Return the split of a choice that nothing restricts."""
        n, heading, stated = self.problem.dimension, choice < self.problem.horizon, self._stated
        if heading and self._solid is not None:
            return Cut(FACES, choice, len(self._solid))
        if self._is_flat(choice):
            return Cut(SIDES, choice, 2 * n)
        if n == 2:
            faces = self._faces if heading else 0
            return Cut(ARCS, choice, faces or AROUND, self._first_arc if faces else 0.0)
        upright = heading and stated.capped[choice]
        parts = len(stated.patches) - ICOSAHEDRON if upright else ICOSAHEDRON
        return Cut(PATCHES, choice, parts)

    def _refined(self, choice: int, region: Region) -> Cut | None:
        """Return the split of a sector or a patch; None if it is too small."""
        if self.problem.dimension == 3:
            wide = np.ptp(region.corners[choice], axis=0).max() >= FINEST
            return Cut(QUARTERS, choice, 4) if wide else None
        low, high = region.span[choice].tolist()
        at, apart = 0.5 * (low + high), FINEST
        if choice < self.problem.horizon and self._faces:
            share, apart = 2.0 * math.pi / self._faces, self._stated.narrow
            at = share * (math.floor(at / share) + 0.5)  # the nearest corner
        return Cut(CUT, choice, 2, at) if low + apart < at < high - apart else None

    def widest(self, region: Region) -> Cut | None:
        """Return the split of the heading with the widest sector or patch; None without one."""
        cuts = [self.cut(k, region) for k in range(self.first, self.problem.horizon)]
        possible = [cut for cut in cuts if cut is not None]
        return max(possible, key=lambda cut: self._width(cut.choice, region), default=None)

    def _width(self, k: int, region: Region) -> float:
        """Return how wide a sector [rad], or how large a patch is."""
        if region.part[k] == WHOLE:
            return np.inf
        wide = region.span[k] if self.problem.dimension == 2 else region.corners[k]
        return float(np.ptp(wide, axis=0).max())

    def promise(self, choice: int, by: float) -> float:
        """Return an estimate of how much splitting a choice violated by this amount gains.

        Infinite for points that no heading moves, to split these first: no other choice can help.
        """
        curvature = float(self._curvature[self.points(choice)[0]].min())
        return by * by / (2.0 * curvature) if curvature < np.inf else np.inf

    def gain(self, choice: int, side: Side, headings: Array) -> tuple[float, int]:
        """Return the least increase of the bound by a half-space, and whether it is out of reach.

        Args:
            choice: that is restricted.
            side: its half-space.
            headings: of the solution, shape (N, n).

        Returns:
            The gain; the number, among presses, of a row that cannot be satisfied, else negative.
        """
        (normal, least), (places, number, free) = side, self.points(choice)
        offsets = least - free @ normal
        short = np.maximum(offsets - self._reach[places] @ (headings @ normal), 0.0)
        out = offsets - self._farthest[places]
        refuted = number >= 0 and out.max() > REFUTED
        gain = float((0.5 * short * short / self._curvature[places]).max())
        return gain, number + int(out.argmax()) if refuted else HEADING


@lru_cache(maxsize=4096)
def _patch(corners: bytes) -> tuple[Array, float]:
    """Return the axis of the cone around a patch, and the least cosine to it; many are alike."""
    axis, least, _ = about(np.frombuffer(corners).reshape(3, 3))
    return np.array(axis), least
