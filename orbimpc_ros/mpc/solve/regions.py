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
from collections.abc import Iterable, Mapping

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.check import turn_margin
from orbimpc_ros.mpc.geometry.rotations import HEADING_UNDEFINED
from orbimpc_ros.mpc.geometry.separation import separation
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.proof.flight import DECIDED
from orbimpc_ros.mpc.proof.splits import (
    GONE,
    ICOSAHEDRON,
    WHOLE,
    Cut,
    Region,
    begin,
    narrowed,
)
from orbimpc_ros.mpc.proof.stated import Bodies, Root, Statement
from orbimpc_ros.mpc.proof.tree import (
    ARCS,
    CUT,
    FACES,
    NOWHERE,
    PATCHES,
    POINTS,
    QUARTERS,
    SIDES,
)
from orbimpc_ros.mpc.solve.relaxation import HEADING, Row
from orbimpc_ros.mpc.solve.request import Request
from orbimpc_ros.mpc.solve.turns import Turns

SATISFIED = 1e-7  # violation below which a choice is satisfied; a tenth of the check's tolerance
TURNED = 5e-7  # [rad] half the check's tolerance of turns
REFUTED = 1e-6  # distance from which on a half-space counts as out of reach
FINEST = 1e-6  # [rad] such a narrow sector misses its floor by less than rounding
AROUND = 4  # arcs that the full circle is split into

ALWAYS = -1  # key, in place of a choice, of half-spaces that hold in every region
CONE = -2  # in place of a row number: rows on headings for cones in space

Held = tuple[Row, ...]
Sides = tuple[Array, Array]  # of P parts: normals, shape (P, n), and offsets of points, (P, m)


class Regions:
    """The regions of a problem from the state of the last request.

    Args:
        problem: what to solve.
        inverse: H^-1, shape (N, N); infinite if H is singular.
        turns: the turn limit, if it bounds angles.

    Attributes:
        turns: the turn limit, if it bounds angles.
        first: index of the first heading that is not fixed by the state.
        bodies: number of bodies.
        origins: as in :class:`~orbimpc_ros.mpc.proof.tree.ProofTree`.
        floors: choices of headings with a floor.
    """

    def __init__(
        self,
        problem: Problem,
        inverse: Array,
        turns: Turns | None = None,
    ) -> None:
        self.problem, self._statement, self.turns = problem, Statement(problem), turns
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
        if np.isfinite(inverse).all():
            along = np.einsum('mi,ij,mj->m', self._reach, inverse, self._reach)
            self._curvature = np.where(along > 0.0, along, np.inf)
        self._flat: Sides | None = None  # faces of the floor, if its choices are faces
        if floor.exists and not floor.radius and (n == 3 or floor.shape != 'polygon'):
            outward = floor.normals(n)
            assert outward is not None
            self._flat = outward, np.full((len(outward), 1), floor.fraction)
        self._faces = floor.faces if floor.shape == 'polygon' and n == 2 else 0
        self._first_arc = -math.pi / self._faces if self._faces else 0.0
        self._outward = np.vstack([-np.eye(n), np.eye(n)])
        self._extents: Array | None = None  # of the last bodies
        self._begun_at: tuple[Root | None, int] = None, 0  # limits and bodies of the last root
        self._root: Region | None = None

    def bind(self, request: Request) -> None:
        """Compute the data that depend only on state and goals."""
        problem, self._state, count = self.problem, request.state, self.problem.horizon
        state = self._state
        limits = self._statement.limits(state, request.goals)
        stated = self._stated = self._statement.of(state, request.goals, limits)
        self.first, self.bodies = stated.order - 1, len(stated.bodies.at)
        ordered = self._faces and stated.root.exchanged
        self.origins = np.full(count, self._first_arc) if ordered else NOWHERE
        self.floors = list(range(self.first, count)) if problem.floor.exists else []
        flags = stated.sets.cones[:, problem.dimension + 3] == 1.0  # patches cover the tilt's cap
        self._upright = set(stated.sets.cone_step[flags].tolist())
        known = np.array([state.rotation[:, 0], state.velocity, state.disturbance])
        self._free = self._started @ known
        if self.bodies:
            if stated.bodies.extents is not self._extents:  # they are the same if none moves
                self._place(stated.bodies)
            places = stated.bodies.places[:, :, : self._points.shape[2]]
            middles = np.where(self._held[..., None], places, places[:, :, :1])
            self._apart = self._free[self._points] - middles

    def _place(self, bodies: Bodies) -> None:
        """Set which control points bodies constrain, and the sizes of balls."""
        count, self._extents, at = self.problem.horizon, bodies.extents, bodies.at
        self._rows, steps = (at >= 0).sum(axis=2), np.arange(count)[:, None]
        at = at[:, :, : self._rows.max()]
        self._held = held = at >= 0
        # missing rows repeat the first
        self._points = count + self._controls * steps + np.where(held, at, at[:, :, :1])
        radii, margins = bodies.extents[:, -1:], bodies.margins[0]
        self._balls = np.flatnonzero(radii > 0.0)
        self._radii, nothing = radii[self._balls], (radii > 0.0) & (radii + margins <= 0.0)
        self._margins = np.where(nothing, -np.inf, margins)  # shrunk: the vehicle leaves it

    # --- regions

    def root(self) -> Region | None:
        """Return the region of the root; None if it is empty."""
        root, bodies = self._begun_at
        known = self._stated
        if known.root is not root or bodies != self.bodies or self.first:
            self._begun_at, self._root = (known.root, self.bodies), self._begin()
        return self._root

    def _begin(self) -> Region | None:
        count, n = (2 + self.bodies) * self.problem.horizon, self.problem.dimension
        part, span = np.full(count, WHOLE), np.zeros((count, 2))
        corners, known = np.zeros((count if n == 3 else 1, 3, 3)), self._stated
        decided = known.start[DECIDED : DECIDED + 1, :n]
        if begin(known, self.origins, part, span) == GONE:
            return None
        given = self.first and self._state.coasted is None
        if given and self.problem.floor.margin(decided)[0] < -SATISFIED:
            return None
        if self._flat is not None:
            part[: self.problem.horizon] = WHOLE
        return Region(part, span, corners)

    def part(self, known: Region, cut: Cut, i: int) -> Region | None:
        """Return part i of a region; None if it is empty."""
        part, span, corners = known.part.copy(), known.span, known.corners
        if cut.kind in (ARCS, CUT):
            span = span.copy()
        elif cut.kind in (PATCHES, QUARTERS):
            corners = corners.copy()
        node, made = np.array([cut.kind, cut.choice, 0, cut.parts]), Region(part, span, corners)
        left = narrowed(self._stated, node, cut.at, i, *made)
        return None if left == GONE else made

    def changed(self, before: Region, after: Region) -> dict[int, Held]:
        """Return the half-spaces of the choices that differ between a region and a part of it."""
        moved = (before.span != after.span).any(axis=1) | (before.part != after.part)
        return {choice: self.rows(choice, after) for choice in np.flatnonzero(moved).tolist()}

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

    def rows(self, choice: int, known: Region) -> Held:
        """Return the half-spaces of a choice in a region."""
        free = choice >= self.problem.horizon or self.problem.floor.exists
        if known.part[choice] == WHOLE or choice < self.first or not free:
            return ()
        normals, offsets = self._side(choice, known)
        return self.held(choice, normals[0], offsets[0])

    def _side(self, choice: int, known: Region) -> Sides:
        """Return the half-space of a choice in a region."""
        each = slice(choice, choice + 1)
        if self._is_flat(choice):
            return self._faced(choice, known.part[each])
        if self.problem.dimension == 2:
            return self._sectors(choice, known.span[each])
        return self._patched(choice, known.corners[each])

    def held(self, choice: int, normal: Array, offsets: Array) -> Held:
        """Return the half-spaces of a choice from a normal and the offsets of its points, (m,)."""
        places, number, free = self.points(choice)
        offsets = offsets - free @ normal
        return tuple(
            Row(place, self._reach[place], normal, offset, number + i)
            for i, (place, offset) in enumerate(zip(places.tolist(), offsets.tolist(), strict=True))
            if math.isfinite(offset) and self._moved[place]
        )

    def _is_flat(self, choice: int) -> bool:
        """Return True for headings beyond faces of the floor, and for boxes."""
        return self._flat is not None if choice < self.problem.horizon else not self._radius(choice)

    def _radius(self, choice: int) -> float:
        """Return the radius of the body of a choice; 0 for a box."""
        return float(self._stated.bodies.extents[choice // self.problem.horizon - 2, -1])

    def _faced(self, choice: int, parts: np.ndarray) -> Sides:
        """Return sides of a box, or faces of the floor."""
        if choice < self.problem.horizon:
            assert self._flat is not None
            return self._flat[0][parts], self._flat[1][parts]
        count, bodies = self.problem.horizon, self._stated.bodies
        j, k = choice // count - 2, choice % count
        offsets = bodies.extents[j, parts, None] + bodies.margins[0, j, k]
        return self._outward[parts], np.repeat(offsets, self._rows[j, k], axis=1)

    def _sectors(self, choice: int, spans: Array) -> Sides:
        """Return the half-spaces of sectors, shape (P, 2) [rad]."""
        middles, halves = spans.mean(axis=1), 0.5 * np.ptp(spans, axis=1)
        normals = np.column_stack([np.cos(middles), np.sin(middles)])
        if choice >= self.problem.horizon:
            least = np.where(halves < 0.5 * math.pi, np.cos(halves), 0.0)
            return normals, self._beyond(choice, least, np.sin(np.minimum(halves, 0.5 * math.pi)))
        offsets = np.empty((len(spans), 1))
        for i, (low, high) in enumerate(spans.tolist()):
            normals[i], offsets[i] = self._chord(low, high, normals[i])
        return normals, offsets

    def _chord(self, low: float, high: float, middle: Array) -> tuple[Array, float]:
        """Return normal and offset of the half-space that holds for headings in a sector."""
        half, slowest = 0.5 * (high - low), self._stated.sets.least
        if half >= math.pi:
            return middle, -np.inf
        if half > 0.5 * math.pi:
            return middle, math.cos(half)
        if not self._faces:
            return middle, slowest * math.cos(half)
        share, slack = 2.0 * math.pi / self._faces, self._stated.sets.narrow
        first, last = math.ceil(low / share - 0.5 + slack), math.floor(high / share - 0.5 - slack)
        angles = [low, *(share * (i + 0.5) for i in range(first, last + 1)), high]
        if len(angles) == 2:  # within a single face
            face = share * round(0.5 * (low + high) / share)
            return np.array([math.cos(face), math.sin(face)]), slowest
        off = np.array(angles) - share * np.round(np.array(angles) / share)
        along = np.cos(np.array(angles) - 0.5 * (low + high))
        return middle, float((slowest / np.cos(off) * along).min())

    def _patched(self, choice: int, corners: Array) -> Sides:
        """Return the half-spaces of patches, shape (P, 3, 3)."""
        units = corners / np.linalg.norm(corners, axis=2, keepdims=True)
        normals = np.cross(units, np.roll(units, -1, axis=1)).sum(axis=1)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        normals *= np.sign(np.einsum('pc,pc->p', normals, units[:, 0]))[:, None]
        least = np.einsum('pc,pec->pe', normals, units).min(axis=1)
        if choice < self.problem.horizon:
            return normals, self._stated.sets.least * least[:, None]
        return normals, self._beyond(choice, least, np.sqrt(np.maximum(0.0, 1.0 - least**2)))

    def _beyond(self, choice: int, least: Array, aside: Array) -> Array:
        """Return offsets (3.7c), shape (P, m), from cos d and sin d of the parts, shape (P,)."""
        count, bodies = self.problem.horizon, self._stated.bodies
        j, k = choice // count - 2, choice % count
        size = bodies.extents[j, -1] + bodies.margins[0, j, k]
        offsets = least * size - aside * bodies.margins[1, j, k]
        offsets = np.where((least > 0.0) & (size > 0.0), offsets, -np.inf)
        return np.repeat(offsets[:, None], self._rows[j, k], axis=1)

    def every(self, known: Region) -> dict[int, Held]:
        """Return the half-spaces of a region, by choice."""
        split = np.flatnonzero(known.part != WHOLE).tolist()
        rows = {choice: self.rows(choice, known) for choice in split}
        return {ALWAYS: self._always(), **{c: held for c, held in rows.items() if held}}

    def _always(self) -> Held:
        """Return half-spaces of all regions: for turns, and for an R_1 e1 of given direction."""
        stated, floor, found = self._stated, self.problem.floor, list[Row]()
        if self.first and self._state.coasted is not None and floor.exists:
            axis = stated.start[DECIDED, : self.problem.dimension]
            axis = axis / np.linalg.norm(axis)
            found.append(Row(0, self._reach[0], axis, float(floor.least(axis))))
        if self.turns is not None and (stated.n == 3 or self._flat is not None):
            number = CONE if stated.n == 3 else HEADING
            found += [row._replace(number=number) for row in self.turns.rows(self._state)]
        return tuple(found)

    def beyond(self, choice: int, normal: Array, offsets: Array, i: int) -> Held:
        """Return the half-space of point i of a choice, even if no heading moves the point."""
        places, number, free = self.points(choice)
        offset = float(offsets[i] - free[i] @ normal)
        return (Row(int(places[i]), self._reach[places[i]], normal, offset, number + i),)

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
        found = dict[int, float]()
        if self.problem.floor.exists:
            short = -self.problem.floor.margin(headings[1:])
            short[: self.first] = -np.inf
            found = {k: float(short[k]) for k in np.flatnonzero(short > SATISFIED).tolist()}
        if self.bodies:
            into, _ = self._entered(headings[1:])
            for j, k in zip(*(each.tolist() for each in np.nonzero(into > SATISFIED)), strict=True):
                found[(2 + j) * self.problem.horizon + k] = float(into[j, k])
        return found

    def _entered(self, headings: Array) -> tuple[Array, Array]:
        """Return the depths by which headings enter each body, and the directions out of it.

        Args:
            headings: R_1 e1..R_N e1, shape (N, n).

        Returns:
            Lengths, shape (J, N) [m], and unit vectors, shape (J, N, n).
        """
        places = (self._reach @ headings)[self._points] + self._apart
        far = np.concatenate([places.max(axis=2), -places.min(axis=2)], axis=-1)
        short = far + self._stated.bodies.extents[:, None, :-1]
        into, ways = short.min(axis=-1), self._outward[short.argmin(axis=-1)]
        if len(self._balls):
            ways[self._balls], away = separation(places[self._balls])
            into[self._balls] = self._radii - away
        return into + self._margins, ways

    def is_round(self, choice: int) -> bool:
        """Return True if a choice is one of a round floor or a ball, not of flat sides."""
        if choice < self.problem.horizon:
            return bool(self.problem.floor.radius)
        return self._radius(choice) > 0.0

    def tangents(
        self, headings: Array, choices: Iterable[int], kept: Mapping[int, Held]
    ) -> dict[int, Held]:
        """Return for each choice the half-space that headings satisfy, or violate the least.

        Args:
            headings: R_1 e1..R_N e1, shape (N, n).
            choices: of floors and bodies.
            kept: half-spaces by choice; flat choices among these are skipped.
        """
        found, ways = dict[int, Held](), None
        for choice in choices:
            if choice in kept and not self.is_round(choice):
                continue
            if choice < self.problem.horizon:
                side = self._tangent(headings[choice])
            else:
                ways = self._entered(headings)[1] if ways is None else ways
                side = self._passed(choice, ways)
            if side is not None:
                found[choice] = self.held(choice, *side)
        return found

    def _tangent(self, heading: Array) -> tuple[Array, Array] | None:
        """Return the tangent of a round floor, or the face that is violated least."""
        floor = self.problem.floor
        if floor.radius and np.linalg.norm(heading) <= HEADING_UNDEFINED:
            return None
        return floor.tangent(heading), np.array([floor.fraction])

    def _passed(self, choice: int, ways: Array) -> tuple[Array, Array]:
        """Return the half-space of a body with a given normal, ``ways[j, k]``."""
        count, bodies = self.problem.horizon, self._stated.bodies
        j, k = choice // count - 2, choice % count
        normal, out = ways[j, k], bodies.extents[j, -1]
        if not out > 0.0:
            out = bodies.extents[j, int(np.argmax(np.concatenate([-normal, normal])))]
        return normal, np.full(self._rows[j, k], out + bodies.margins[0, j, k])

    def beside(self, headings: Array, within: float) -> list[int]:
        """Return the choices of balls within a distance of a path, and of all boxes.

        Of bodies that are listed twice, for the ends of a step and for all of it, take the latter.
        """
        if not self.bodies:
            return []
        count, (into, _) = self.problem.horizon, self._entered(headings)
        boxes = len(self.problem.boxes)
        found = np.argwhere((into > -within) | (self._stated.bodies.extents[:, -1:] == 0.0))
        pairs = ((j, k) for j, k in found.tolist() if j < boxes or (j - boxes) % 2)
        return [(2 + j) * count + k for j, k in pairs]

    # --- branching

    def cut(self, choice: int, known: Region) -> Cut | None:
        """Return the split of a choice in a region; None if there is nothing to split."""
        if choice < self.first:
            return None
        if known.part[choice] == WHOLE:
            return self._parted(choice)
        return None if self._is_flat(choice) else self._refined(choice, known)

    def _parted(self, choice: int) -> Cut:
        """Return the split of a choice that nothing restricts."""
        n, heading = self.problem.dimension, choice < self.problem.horizon
        if heading and self._flat is not None:
            return Cut(FACES, choice, len(self._flat[0]))
        if self._is_flat(choice):
            return Cut(SIDES, choice, 2 * n)
        if n == 2:
            faces = self._faces if heading else 0
            return Cut(ARCS, choice, faces or AROUND, self._first_arc if faces else 0.0)
        up = heading and choice in self._upright
        parts = len(self._stated.root.patches) - ICOSAHEDRON if up else ICOSAHEDRON
        return Cut(PATCHES, choice, parts)

    def _refined(self, choice: int, known: Region) -> Cut | None:
        """Return the split of a sector or a patch; None if it is too small."""
        if self.problem.dimension == 3:
            wide = np.ptp(known.corners[choice], axis=0).max() >= FINEST
            return Cut(QUARTERS, choice, 4) if wide else None
        low, high = known.span[choice].tolist()
        at, apart = 0.5 * (low + high), FINEST
        if choice < self.problem.horizon and self._faces:
            share, apart = 2.0 * math.pi / self._faces, self._stated.sets.narrow
            at = share * (math.floor(at / share) + 0.5)  # the nearest corner
        return Cut(CUT, choice, 2, at) if low + apart < at < high - apart else None

    def widest(self, known: Region) -> Cut | None:
        """Return the split of the heading with the widest sector or patch; None without one."""
        cuts = [self.cut(k, known) for k in range(self.first, self.problem.horizon)]
        found = [cut for cut in cuts if cut is not None]
        return max(found, key=lambda cut: self._width(cut.choice, known), default=None)

    def _width(self, k: int, known: Region) -> float:
        """Return how wide a sector [rad], or how large a patch is."""
        if known.part[k] == WHOLE:
            return np.inf
        wide = known.span[k] if self.problem.dimension == 2 else known.corners[k]
        return float(np.ptp(wide, axis=0).max())

    def sides(self, known: Region, cut: Cut) -> Sides:
        """Return the half-spaces of the parts of a split."""
        choice, every = cut.choice, np.arange(cut.parts)
        if cut.kind in (FACES, SIDES):
            return self._faced(choice, every)
        if cut.kind == ARCS:
            begun = cut.at + 2.0 * math.pi / cut.parts * every
            return self._sectors(choice, np.column_stack([begun, begun + begun[1] - begun[0]]))
        if cut.kind == CUT:
            low, high = known.span[choice]
            return self._sectors(choice, np.array([[low, cut.at], [cut.at, high]]))
        patches = self._stated.root.patches
        if cut.kind == PATCHES:
            first = 0 if cut.parts == ICOSAHEDRON else ICOSAHEDRON
            return self._patched(choice, patches[first : first + cut.parts])
        a, b, c = known.corners[choice]
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        quarters = np.array([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]])
        return self._patched(choice, quarters)

    def promise(self, choice: int, by: float) -> float:
        """Return an estimate of how much splitting a choice violated by this amount gains.

        Infinite for points that no heading moves, to split these first: no other choice can help.
        """
        curvature = float(self._curvature[self.points(choice)[0]].min())
        return by * by / (2.0 * curvature) if curvature < np.inf else np.inf

    def gains(self, choice: int, sides: Sides, headings: Array) -> tuple[Array, np.ndarray]:
        """Return the least increase of the bound for each part, and a row out of its reach.

        Args:
            choice: that is split.
            sides: of its P parts.
            headings: of the solution, shape (N, n).

        Returns:
            Gains, shape (P,), and rows that cannot be satisfied, or -1, shape (P,).
        """
        (normals, offsets), (places, _, free) = sides, self.points(choice)
        reach = self._reach[places]
        short = offsets - normals @ (free + reach @ headings).T
        gains = 0.5 * np.maximum(short, 0.0) ** 2 / self._curvature[places]
        left = offsets - normals @ free.T - np.abs(reach).sum(axis=1)
        rows = np.where(left.max(axis=1) > REFUTED, left.argmax(axis=1), -1)
        return gains.max(axis=1), np.where(choice >= self.problem.horizon, rows, -1)
