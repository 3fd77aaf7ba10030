# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The choices of a problem, stated anew: faces of a floor, sides of boxes, directions from discs.

Places are linear in the headings: R_k e1 themselves, the ends of steps, the control points of the
motion within steps. What is known of a part of all trajectories are half-spaces of places, one or
more for each choice that was made. Neither the maps nor the tables of the methods are used.

Mathematics: docs/mathematics.md, 3.5 to 3.8, and docs/proofs.md.
"""

from __future__ import annotations

import itertools
import math
from functools import cached_property
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.cells import STEEPEST_CAP, cap, icosahedron
from orbimpc_ros.mpc.geometry.faces import normals
from orbimpc_ros.mpc.model.motion import controls
from orbimpc_ros.mpc.problem import Ball, Box, Problem, State
from orbimpc_ros.mpc.problem.cones import Relief, relief
from orbimpc_ros.mpc.problem.traffic import traffic_of
from orbimpc_ros.mpc.proof.slopes import CostTerms

FACES, ARCS, SIDES, PATCHES, CAPS = range(5)  # what kinds of sides a choice has
FIRST_CAP = 20  # of the patches that a sphere begins with

Rows = tuple[np.ndarray, Array, Array]  # places, normals and offsets of half-spaces


class Alternatives(NamedTuple):
    """All choices, in the order in which problems state them: floors, boxes, bodies; in arrays.

    Attributes:
        kinds: ``FACES`` of a polygonal floor, ``ARCS`` of a circle, ``SIDES`` of a box, ``PATCHES``
            of a sphere, or of its cap within the tilt (``CAPS``), shape (C,).
        places: the first place that each is about; the others follow, shape (C,).
        counts: how many places, shape (C,).
        centres: what places are relative to, shape (C, m, n).
        sizes: of a polygonal floor the distance of its faces, of a circle its radius, shape (C,).
        spreads: how far apart the places of a step get at most, 0 of a single one, shape (C,).
        extents: of boxes, how far out each side is, lower ones first, shape (C, 2 n).
    """

    kinds: np.ndarray
    places: np.ndarray
    counts: np.ndarray
    centres: Array
    sizes: Array
    spreads: Array
    extents: Array


class Faces(NamedTuple):
    """What sides are made of.

    Attributes:
        normals: of the faces of a polygonal floor, shape (F, n).
        patches: corners of the triangles that patches of a sphere begin with, the icosahedron's 20
            and then those of the cap within the tilt, shape (M, 3, 3); none in the plane.
    """

    normals: Array
    patches: Array


class Cones(NamedTuple):
    """What holds of all trajectories: places no farther from an axis than an angle, below 90 deg.

    With p from the tip, and a the axis, cos(angle) |p| - a . p <= e; that is 0 unless it is eased.

    Attributes:
        places: shape (C,).
        axes: unit vectors, shape (C, n).
        sines: of the angles, shape (C,).
        tips: shape (C, n).
        eased: e, shape (C,).
    """

    places: np.ndarray
    axes: Array
    sines: Array
    tips: Array
    eased: Array


class Always(NamedTuple):
    """What holds of all trajectories: half-spaces of places, turns, and cones.

    Half-spaces are those of turns, of an arrival, and what cones are beyond at least.

    Attributes:
        places: shape (R,).
        normals: shape (R, n).
        offsets: shape (R,).
        chord: how far R e1 moves in a step at most.
        begin: the first of the steps 0..N-1 of which that is so; N where turns are not limited.
        first: R_0 e1, shape (n,).
        cones: of a first turn, the tilt, the glide slope, and the approach.
    """

    places: np.ndarray
    normals: Array
    offsets: Array
    chord: float
    begin: int
    first: Array
    cones: Cones


class Symmetry(NamedTuple):
    """Which steps can be told apart, where a floor's faces are all that there is to choose.

    Attributes:
        ordered: the first steps that all else sees nothing of but the sum of their headings and
            their lengths: to put them in the order of their faces changes no cost; 0 for none.
        unseen: the step that nothing else sees; -1 for none.
    """

    ordered: int
    unseen: int


class Places(NamedTuple):
    """Where headings lead, lengths in units of what a step moves a vehicle at most.

    Where an inertial vehicle has to arrive, p_N is the last of them, in such a unit a step.

    Attributes:
        maps: what R_1 e1..R_N e1 add to each place, shape (P, N).
        free: where it is without them, shape (P, n).
    """

    maps: Array
    free: Array


class Sides:
    """The choices of a problem for any state.

    Args:
        problem: what was solved.
        terms: of its cost.
    """

    def __init__(self, problem: Problem, terms: CostTerms) -> None:
        self._problem, self._terms = problem, terms
        count = problem.horizon
        none, units = np.zeros(count + 3), np.eye(count + 3)
        led = self._led(units[: count + 1], none, units[count + 1], units[count + 2])
        self._maps, self._known = np.ascontiguousarray(led[:, 1 : count + 1]), led[:, [0, -2, -1]]

    def places(self, state: State) -> Places:
        """Return where headings lead from a state, less s_0."""
        known = np.array([state.rotation[:, 0], state.velocity, state.disturbance])
        return Places(self._maps, self._known @ known)

    def _led(self, z: Array, origin: Array, velocity: Array, disturbance: Array) -> Array:
        """Return where headings z_0..z_N, shape (N + 1, c), lead, shape (P, c)."""
        drift, keep, push, add, follow, after, blow, gust = self._terms.motion
        problem = self._problem
        s, p = [origin], [velocity]
        for before, ahead in itertools.pairwise(z):
            s.append(s[-1] + drift * p[-1] + push * before + follow * ahead + blow * disturbance)
            p.append(keep * p[-1] + add * before + after * ahead + gust * disturbance)
        velocities = np.array(p) if problem.inertial else problem.forward * z + disturbance
        degree, ends = problem.translation.degree, np.array(s)
        within = controls(degree, problem.step, ends, velocities)
        moved = [ends[1:], within.reshape(-1, z.shape[1])]
        if self._arrivals > 1:
            moved.append(problem.step * velocities[-1:])
        return np.concatenate([z[1:], np.concatenate(moved) / problem.length_unit])

    # --- what always holds

    def always(self, state: State, goals: Array) -> Always:
        """Return what turn limits ask for, at rotation order 1, an arrival, and cones.

        Args:
            state: where trajectories start.
            goals: g_1..g_N, shape (N, n) [m].
        """
        known = self._turned(state)
        if not (self._arrivals or self._has_cones):
            return known
        away = (goals - state.position) / self._problem.length_unit
        eased = relief(self._problem, state, goals) if self._problem.has_cones else None
        more = self._arrived(away[-1]), *self._thrust(state, eased)
        places, normals, offsets = map(np.concatenate, zip(known[:3], *more, strict=True))
        cones = self._cones(state, away, eased, known.cones)
        return known._replace(places=places, normals=normals, offsets=offsets, cones=cones)

    @property
    def _has_cones(self) -> bool:
        return self._problem.has_cones or self._problem.approach.exists

    @property
    def _arrivals(self) -> int:
        """Return how many places have to be somewhere: s_N, and p_N where there is inertia."""
        return (1 + self._problem.inertial) * (self._problem.terminal == 'constraint')

    def _arrived(self, goal: Array) -> Rows:
        """Return the half-spaces that leave but an arrival: up, down, by axis.

        Args:
            goal: g_N less s_0, shape (n,).
        """
        n, ends = len(goal), (2 * self._problem.horizon - 1, len(self._maps) - 1)
        outward = np.stack([np.eye(n), -np.eye(n)], axis=1).reshape(-1, n)
        places = np.repeat(np.array(ends[: self._arrivals], np.int64), 2 * n)
        offsets = np.zeros(len(places))
        offsets[: 2 * n] = (outward @ goal)[: len(offsets)]
        return places, np.tile(outward, (self._arrivals, 1)), offsets

    def _thrust(self, state: State, eased: Relief | None) -> list[Rows]:
        """Return how far along the axes of cones headings are, which have a least size."""
        problem, steps = self._problem, np.arange(self._problem.horizon)
        found: list[Rows] = []
        least, n = problem.floor.clearance(problem.dimension), problem.dimension
        if eased is not None and problem.tilt and least:
            up = np.repeat(np.eye(n)[-1:], len(steps), axis=0)
            found.append((steps, up, math.cos(problem.tilt) * least - eased.tilt))
        if problem.approach.exists:
            axis = problem.approach.axis(state)[None]
            least = math.cos(problem.approach.cone) * problem.least_heading
            found.append((steps[-1:], axis, np.array([least])))
        return found

    def _cones(self, state: State, away: Array, eased: Relief | None, turned: Cones) -> Cones:
        """Return the cones of a first turn, the tilt, the glide slope, and the approach.

        Args:
            state: where trajectories start.
            away: g_1..g_N less s_0, in units of a step, shape (N, n).
            eased: how far outside of its cones each step may be.
            turned: that of a first turn, if there is one.
        """
        problem, steps = self._problem, np.arange(self._problem.horizon)
        found, still = [turned], np.zeros(away.shape)
        up = np.repeat(np.eye(away.shape[1])[-1:], len(steps), axis=0)
        if eased is not None and problem.tilt:
            sines = np.full(len(steps), math.sin(problem.tilt))
            found.append(Cones(steps, up, sines, still, eased.tilt))
        if eased is not None and problem.glide_slope:
            cosine = math.cos(problem.glide_slope)  # the sine of its angle from the vertical
            lower = eased.slope / (cosine * problem.length_unit)
            sines, tips = np.full(len(steps), cosine), away - lower[:, None] * up
            found.append(Cones(len(steps) + steps, up, sines, tips, np.zeros(len(steps))))
        if problem.approach.exists:
            axis, sine = problem.approach.axis(state)[None], math.sin(problem.approach.cone)
            found.append(Cones(steps[-1:], axis, np.array([sine]), still[:1], np.zeros(1)))
        return Cones(*map(np.concatenate, zip(*found, strict=True)))

    def _turned(self, state: State) -> Always:
        """Return what turn limits ask for, at rotation order 1."""
        problem, count = self._problem, self._problem.horizon
        ahead, first = state.attitude[:, 0], state.rotation[:, 0].copy()
        if not problem.turns_are_angles:
            return self._chords._replace(first=first)
        turn, least = min(math.pi, problem.step * problem.max_rate), problem.floor.fraction
        uneven = math.sqrt(1.0 + least * least - 2.0 * least * math.cos(turn))
        cone = problem.first_turn_is_a_cone
        # Headings are no farther from the present one than turns add up to.
        steps = np.arange(2 if cone else 1, 1 + min(count, math.ceil(math.pi / turn) - 1))
        share = np.cos(turn * steps)
        offsets = np.minimum(share, least * share)
        places, outward = steps - 1, np.tile(ahead, (len(steps), 1))
        chord, cones = max(2.0 * math.sin(0.5 * turn), uneven), self._chords.cones
        if cone:
            origin, sine = np.zeros((1, len(ahead))), np.array([math.sin(turn)])
            cones = Cones(np.zeros(1, np.int64), ahead[None].copy(), sine, origin, np.zeros(1))
        if cone and len(ahead) == 2:  # the same by its edges
            (x, y), s, c = ahead, math.sin(turn), math.cos(turn)
            edges = [[s * x - c * y, s * y + c * x], [s * x + c * y, s * y - c * x]]
            places, offsets = np.append(places, [0, 0]), np.append(offsets, [0.0, 0.0])
            outward = np.concatenate([outward, edges])
        return Always(places, outward, offsets, chord, 1, first, cones)

    @cached_property
    def _chords(self) -> Always:
        """Return what turn limits ask for without a floor, if there is one; R_0 is not known."""
        problem, none = self._problem, np.zeros(0)
        chord = 2.0 * math.sin(0.5 * min(math.pi, problem.step * problem.max_rate))
        begin = 0 if problem.max_rate else problem.horizon
        outward = np.zeros((0, problem.dimension))
        nowhere = none.astype(np.int64)
        cones = Cones(nowhere, outward, none, outward, none)
        return Always(nowhere, outward, none, chord, begin, none, cones)

    # --- choices

    def symmetry(self, known: Alternatives, always: Always) -> Symmetry:
        """Return which steps can be told apart, given all that there is to hold them."""
        count = self._problem.horizon
        if not self._alike.ordered:
            return self._alike
        alone = len(known.kinds) == count and bool((known.kinds == FACES).all())
        alone &= always.begin == count and bool((always.places == 2 * count - 1).all())
        alone &= not len(always.cones.places)
        return self._alike if alone else Symmetry(0, -1)

    @cached_property
    def _alike(self) -> Symmetry:
        """Return which steps the cost and an arrival can tell apart."""
        count, terms = self._problem.horizon, self._terms
        end = self._maps[2 * count - 1]
        costly = terms.weights[:-1].any() or any(terms.turning) or terms.order > 1
        alike = _are_equal(end[:-1]) and _are_equal(terms.lengths[1:-1])
        if costly or self._problem.inertial or not alike:
            return Symmetry(0, -1)
        seen = end[-1] or terms.lengths[-1]
        return Symmetry(count - 1, -1 if seen else count - 1)

    @cached_property
    def faces(self) -> Faces:
        """Return what sides are made of."""
        problem, floor, n = self._problem, self._problem.floor, self._problem.dimension
        sides = normals(n, floor.faces) if floor.shape == 'polygon' else np.zeros((0, n))
        if n == 2:
            return Faces(np.array(sides), np.zeros((0, 3, 3)))
        capped = 0.0 < problem.tilt <= STEEPEST_CAP
        patches = [icosahedron(), cap(problem.tilt)] if capped else [icosahedron()]
        return Faces(np.array(sides), np.concatenate(patches))

    def alternatives(self, state: State, goals: Array, places: Places) -> Alternatives:
        """Return the choices of trajectories from a state, in natural units.

        Args:
            state: where trajectories start.
            goals: g_1..g_N, shape (N, n) [m].
            places: where headings lead.
        """
        standing, moving = self.standing, self._bodies(state, places)
        if self._problem.boxes:
            origin = state.position / self._problem.length_unit
            moved = standing.extents + np.concatenate([origin, -origin])
            standing = standing._replace(extents=moved)
        if len(self.faces.patches) > FIRST_CAP and self._problem.floor.shape == 'circle':
            eased = relief(self._problem, state, goals).tilt > 0.0
            kinds = standing.kinds.copy()
            kinds[: len(eased)] = np.where(eased, PATCHES, CAPS)
            standing = standing._replace(kinds=kinds)
        if moving is None:
            return standing
        return Alternatives(*map(np.concatenate, zip(standing, moving, strict=True)))

    @cached_property
    def standing(self) -> Alternatives:
        """Return what needs no state; extents of boxes are counted from the origin."""
        parts = self._floors(), self._boxes()
        return Alternatives(*map(np.concatenate, zip(*parts, strict=True)))

    @property
    def _round(self) -> int:
        """Return the kind of sides that there are of what is round."""
        return ARCS if self._problem.dimension == 2 else PATCHES

    @property
    def _most(self) -> int:
        return self._problem.translation.degree + 1

    @property
    def _within(self) -> slice:
        """Return which places are those within steps; an arrival's may follow."""
        count = self._problem.horizon
        return slice(2 * count, (2 + self._most) * count)

    def _none(self, count: int) -> Alternatives:
        """Return choices that are not stated yet."""
        n, (kinds, places, counts) = self._problem.dimension, np.zeros((3, count), np.int64)
        centres, (sizes, spreads) = np.zeros((count, self._most, n)), np.zeros((2, count))
        extents = np.zeros((count, 2 * n))
        return Alternatives(kinds, places, counts, centres, sizes, spreads, extents)

    def _floors(self) -> Alternatives:
        floor, count = self._problem.floor, self._problem.horizon
        made = self._none(count if floor.exists else 0)
        made.kinds[:] = FACES if floor.shape == 'polygon' else self._round
        made.places[:], made.counts[:] = np.arange(len(made.places)), 1
        made.sizes[:] = floor.fraction if floor.exists else 0.0
        return made

    def _boxes(self) -> Alternatives:
        """Return the sides that ends of steps are on; of both ends, if corners are not cut."""
        problem, count = self._problem, self._problem.horizon
        shared = int(problem.no_corner_cutting and count > 1)
        groups = count - shared
        made = self._none(len(problem.boxes) * groups)
        made.kinds[:], made.counts[:] = SIDES, 1 + shared
        for j, box in enumerate(problem.boxes):
            own = slice(j * groups, (j + 1) * groups)
            made.places[own] = count + np.arange(groups)
            made.extents[own] = _extents(box, np.zeros(box.dimension)) / problem.length_unit
        return made

    def _bodies(self, state: State, places: Places) -> Alternatives | None:
        """Return what is round or moves, if anything: of each step all of it, then its end."""
        traffic = traffic_of(self._problem, state)
        if traffic is None:
            return None
        count, m, unit = self._problem.horizon, self._most, self._problem.length_unit
        made = self._none(2 * count * len(traffic.bodies))
        first = 2 * count + m * np.arange(count)[:, None] + [0, m - 1]
        made.places[:] = np.tile(first.ravel(), len(traffic.bodies))
        made.counts[0::2], made.counts[1::2] = m, 1
        share = np.linspace(0.0, 1.0, m)[:, None]
        begin, end = traffic.shifts[:, :-1, None], traffic.shifts[:, 1:, None]
        middles = np.array([_middle(each, state.position) for each in traffic.bodies])
        centres = (begin + share * (end - begin) + middles[:, None, None]) / unit
        made.centres[0::2] = centres.reshape(-1, m, centres.shape[-1])
        made.centres[1::2, 0] = made.centres[0::2, -1]
        made.spreads[0::2] = self._spreads(places, centres).ravel()
        for j, (body, grown) in enumerate(zip(traffic.bodies, traffic.grown, strict=True)):
            own, more = slice(2 * j * count, 2 * (j + 1) * count), np.repeat(grown, 2)
            if isinstance(body, Ball):
                made.kinds[own] = self._round
                made.sizes[own] = np.maximum(0.0, body.radius + more) / unit
            else:
                extents = _extents(body, state.position) + more[:, None]
                made.kinds[own], made.extents[own] = SIDES, extents / unit
        return made

    def _spreads(self, places: Places, centres: Array) -> Array:
        """Return how far apart places of a step get at most, relative to bodies, shape (J, N)."""
        count = self._problem.horizon
        free = places.free[self._within].reshape(count, self._most, -1) - centres
        apart = np.linalg.norm(free[:, :, :, None] - free[:, :, None], axis=-1)
        return np.asarray((self._parted + apart).max(axis=(-1, -2)))

    @cached_property
    def _parted(self) -> Array:
        """Return how far apart headings get the places of a step, shape (N, m, m)."""
        maps = self._maps[self._within].reshape(-1, self._most, self._maps.shape[1])
        return np.asarray(np.abs(maps[:, :, None] - maps[:, None]).sum(axis=-1))


def _are_equal(numbers: Array) -> bool:
    return bool((numbers == numbers[:1]).all())


def _extents(box: Box, origin: Array) -> Array:
    """Return how far out the sides of a box are, lower ones first, shape (2 n,) [m]."""
    return np.concatenate([origin - box.minimum, box.maximum - origin])


def _middle(body: Ball | Box, origin: Array) -> Array:
    """Return what the sides of a body are relative to [m]: a ball's centre, or s_0."""
    return body.centre - origin if isinstance(body, Ball) else np.zeros(len(origin))
