# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Bounds counted again: what a method's tangents prove, by code that shares nothing with it.

What a tangent proves where nothing is split is in :mod:`orbimpc_ros.mpc.proof.tangents`; here are
the trees of splits. The least of a tangent over all headings of a part is known in closed form;
where a tangent is one of a cost that bends the other way, Cholesky's method says whether it is
below the cost all the same. What proofs in exact arithmetic do is done here in floats, fast enough
for every tick (see :mod:`orbimpc_ros.mpc.proof.verifier`).

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.kernels import compiled, inlined
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.proof.choices import choices_bound
from orbimpc_ros.mpc.proof.grounds import LEAF, ChoiceGrounds, Left, Tangent, tangent
from orbimpc_ros.mpc.proof.sides import Sides
from orbimpc_ros.mpc.proof.slopes import (
    ROUNDING,
    hessian_of,
    lack,
    least_along,
    set_slopes,
    terms_of,
)
from orbimpc_ros.mpc.proof.tangents import tangents_bound

ALL = 2.0 * np.pi - 1e-9  # [rad], a sector that leaves nothing out
HALF = np.pi - 1e-9
EMPTY = 1e-12  # [rad] that the ends of a sector may pass each other by, for rounding


class Recount:
    """Counts the bounds of one problem again.

    Args:
        problem: whose bounds; constraints that are not known here can only make trajectories
            dearer.
    """

    def __init__(self, problem: Problem) -> None:
        n, count = problem.dimension, problem.horizon
        self._problem, self._terms = problem, terms_of(problem)
        self._width = _width(problem)
        self._start = np.zeros((5, self._width))
        x, rest = np.zeros((count, self._width)), np.zeros((count, n))
        self._hessian = hessian_of(self._terms, rest)
        self._stiffness = hessian_of(self._terms, rest, 1.0) - self._hessian
        here, bends = State.at(np.zeros(n), np.eye(n)), np.zeros(count)
        self._pulled = n * (1 + problem.inertial) * (problem.terminal == 'constraint')
        pull = np.zeros(self._pulled)
        for grounds in (tangent(x, bends), Tangent(x, bends, pull, 0.0, bends, rest)):
            self.bound(here, rest, grounds, 1.0)  # compiles
        if problem.obstacles or problem.max_rate or (n == 3 and problem.floor.exists):
            self.expect_choices()

    def expect_choices(self) -> None:
        """Compile now, or load, what the first tree of choices would have to wait for."""
        problem = self._problem
        known, point = np.zeros(1, np.int64), np.zeros((1, problem.horizon, self._width))
        here = State.at(np.zeros(problem.dimension), np.eye(problem.dimension))
        chords = max(0, problem.horizon - self._sides.always(here).begin)
        tethers, none = np.zeros((1, chords, problem.dimension)), np.zeros(0, np.int64)
        leaf = known + LEAF, known, known, known, known, point, known > 0, known
        tree = ChoiceGrounds(*leaf, none, none, np.zeros(0), tethers)
        self.bound(here, point[0, :, : problem.dimension], tree, 1.0)

    @staticmethod
    def reads(problem: Problem) -> bool:
        """Return whether bounds of a problem can be counted again."""
        known = problem.floor.shape in ('none', 'circle', 'polygon')
        flat = problem.dimension == 3 and problem.floor.shape == 'polygon'
        return _width(problem) == 9 or (known and not flat)

    def bound(
        self,
        state: State,
        goals: Array,
        grounds: Left,
        unit: float,
        enough: float = np.inf,
    ) -> float:
        """Return what grounds prove: a cost that no trajectory undercuts; -inf for nothing.

        Args:
            state: where trajectories start.
            goals: g_1..g_N, shape (N, n) [m].
            grounds: of a method; whatever they are, the bound holds.
            unit: of the bends, in that of the cost.
            enough: a bound beyond which nothing has to be counted.
        """
        start = self._begun(state)
        if isinstance(grounds, ChoiceGrounds):
            return self._of_choices(state, start, goals - state.position, grounds, unit)
        known = self._terms, self._hessian, start, goals - state.position
        if isinstance(grounds, Tangent):
            return self._of_tangent(known, grounds, state.coasted is not None)
        if self._width == 9 or self._problem.rotation_order == 2:
            return -np.inf  # of which nothing is split
        ahead = state.attitude
        heading = math.atan2(ahead[1, 0], ahead[0, 0])
        return float(recounted(*known, heading, grounds, unit, enough))

    def _begun(self, state: State) -> Array:
        """Return what a state says: p_0, the disturbance, R_0, R_g, and what decides R_1."""
        start, n = self._start, self._problem.dimension
        start[0, :n], start[1, :n], start[2] = (
            state.velocity,
            state.disturbance,
            self._seen(state.rotation),
        )
        if state.wanted is not None:
            start[3] = self._seen(state.wanted)
        if self._problem.rotation_order == 2:
            given = state.coasted
            if given is None:
                given = state.rotation + self._problem.step * state.rotation_rate
            start[4] = self._seen(given)
        return start

    def _seen(self, rotation: Array) -> Array:
        """Return the coordinates of a rotation, as far as the cost sees them."""
        return coordinates(rotation) if self._width == 9 else rotation[:, 0]

    @cached_property
    def _sides(self) -> Sides:
        return Sides(self._problem, self._terms)

    def _of_choices(
        self, state: State, start: Array, goals: Array, tree: ChoiceGrounds, unit: float
    ) -> float:
        """Return what a tree of choices proves; its multipliers are in natural units."""
        count, n = goals.shape
        always, known = self._sides.always(state), self._sides.alternatives(state)
        leaves, nodes, rows = len(tree.points), len(tree.splits), len(tree.presses)
        fits = tree.points.shape == (leaves, count, self._width) and nodes > 0
        fits &= tree.tethers.shape == (leaves, max(0, count - always.begin), n)
        fits &= all(len(each) == nodes for each in tree[:5])
        fits &= all(len(each) == rows for each in tree[8:11])
        fits &= len(tree.empty) == len(tree.ends) == leaves
        fits &= n == 2 or self._problem.floor.shape != 'circle'
        if not fits or self._pulled or self._terms.order == 2 or self._terms.lengths.any():
            return -np.inf
        places, stated = self._sides.places(state), (known, self._sides.faces, always)
        return float(choices_bound(self._terms, start, goals, places, stated, tree, unit))

    def _of_tangent(self, known: tuple, leaf: Tangent, coasting: bool) -> float:
        """Return what a tangent proves; its numbers are in the problem's own units."""
        terms, hessian, start, goals = known
        count = len(goals)
        sizes = (*leaf.point.shape, len(leaf.bends), len(leaf.tops), len(leaf.pull))
        fits = sizes == (count, self._width, count, count, self._pulled)
        fits &= leaf.ways.shape == goals.shape
        if not fits or leaf.stiffness < 0.0 or (leaf.stiffness and not self._pulled):
            return -np.inf
        if leaf.stiffness:
            hessian = hessian + leaf.stiffness * self._stiffness
        return float(tangents_bound(terms, hessian, start, goals, leaf, coasting))


def _width(problem: Problem) -> int:
    """Return how many coordinates of a rotation the cost sees."""
    w = problem.weights
    if problem.dimension == 3 and problem.rotation_order == 1 and not (w.input or w.attitude):
        return 3
    return 2 if problem.dimension == 2 else 9


@inlined
def _set_slopes_from(base, hessian, x, slopes):
    """Do as :func:`set_slopes`, on from a point where the cost, and all of it, is known."""
    point, value, size, known, sharpest = base
    count, n = x.shape
    for c in range(n):
        for j in range(count):
            slopes[j, c] = known[j, c]
        for k in range(count):
            way = x[k, c] - point[k, c]
            if way == 0.0:
                continue
            size += sharpest * count * abs(way)  # no entry of a Hessian is larger
            for j in range(count):
                slopes[j, c] += hessian[k, j] * way
        for k in range(count):
            value += 0.5 * (known[k, c] + slopes[k, c]) * (x[k, c] - point[k, c])
    return value, size


@inlined
def _least_beyond(gx, gy, size, nx, ny, least, aside):
    """Return the least g . z over the part of the disk beyond a face n . z >= least.

    Args:
        gx: of the slope g.
        gy: of it.
        size: of it.
        nx: of the face's normal n.
        ny: of it.
        least: how far the face is from the centre.
        aside: how far its corners are to the sides.
    """
    inward = gx * nx + gy * ny
    best = -size
    if -inward < least * size:
        best = least * inward - aside * abs(gy * nx - gx * ny)
    return best


@compiled
def _reached(normals, least, angle):
    """Return the least speed that a floor allows in a direction."""
    away = 1.0
    if len(normals) > 0:
        share = 2.0 * np.pi / len(normals)
        away = np.cos(angle - share * np.round(angle / share))
    return least / away


@compiled
def _least_within(gx, gy, low, high, normals, least):
    """Return the least g . z over directions from low to high and speeds from the floor to 1.

    The floor's boundary is round, or straight between its corners: if g . z is not least on the
    rim, then at an end of the sector or at one of them.
    """
    after_low = gx * np.sin(low) - gy * np.cos(low)  # of the way down, -g
    before_high = gy * np.cos(high) - gx * np.sin(high)
    between = after_low >= 0.0 and before_high >= 0.0
    if high - low >= HALF:  # what is outside is narrower
        between = after_low >= 0.0 or before_high >= 0.0
    if between:
        return -np.sqrt(gx * gx + gy * gy)
    best = np.inf
    for angle in (low, high):
        along = gx * np.cos(angle) + gy * np.sin(angle)
        best = min(best, along, along * _reached(normals, least, angle))
    if len(normals) > 0:
        share = 2.0 * np.pi / len(normals)
        corner = share * (np.ceil(low / share - 0.5) + 0.5)
        while corner < high:
            along = gx * np.cos(corner) + gy * np.sin(corner)
            best = min(best, along * _reached(normals, least, corner))
            corner += share
    return best


@compiled
def _least_between(gx, gy, length, bend, normals, least, low, high):
    """Return the least g . z + l |z| - bend |z|^2 / 2 over directions from low to high."""
    if bend == 0.0 and length == 0.0 and high - low < HALF:
        return _least_within(gx, gy, low, high, normals, least)
    rim = _least_within(gx, gy, low, high, normals[:0], 1.0)
    return least_along(length + rim, bend, least)


@inlined
def _tangents_least(lengths, floor, hessian, base, x, bends, unit, steep):
    """Set slopes and their sizes; return a tangent's least where headings go their own ways down.

    And the sum of what may cancel in it.
    """
    slopes, sizes = steep
    value, size = _set_slopes_from(base, hessian, x, slopes)
    curved, reach = False, 0.0
    for k in range(len(x)):
        bend, square, along, steepness = unit * bends[k], 0.0, 0.0, 0.0
        for c in range(x.shape[1]):
            slopes[k, c] += bend * x[k, c]
            along += slopes[k, c] * x[k, c]
            square += x[k, c] * x[k, c]
            steepness += slopes[k, c] * slopes[k, c]
        sizes[k] = np.sqrt(steepness)
        least = least_along(lengths[k + 1] - sizes[k], bend, floor)
        value += 0.5 * bend * square - along + least
        size += abs(bend) * square + abs(along) + abs(least)
        reach += 1.0 + square
        curved |= bend < 0.0
    if curved:
        value -= lack(hessian, bends, unit) * reach
    return value - ROUNDING * len(x) * size, size


@inlined
def _held(lengths, normals, floor, steep, bends, unit, region, bound, enough):
    """Return a tangent's bound with what it gains where headings are held in their regions.

    It is counted step by step, until the bound is enough.
    """
    (slopes, sizes), (value, size) = steep, bound
    faces, low, high = region
    aside = np.sqrt(1.0 - floor * floor)
    for k in range(len(bends)):
        face, between = faces[k], high[k] - low[k] < ALL
        if sizes[k] <= ROUNDING * size or not (face >= 0 or between):
            continue
        gx, gy, bend, length = slopes[k, 0], slopes[k, 1], unit * bends[k], lengths[k + 1]
        if face < 0:
            least = _least_between(gx, gy, length, bend, normals, floor, low[k], high[k])
        elif bend == 0.0 and length == 0.0:
            nx, ny = normals[face, 0], normals[face, 1]
            least = _least_beyond(gx, gy, sizes[k], nx, ny, floor, aside)
        else:
            return -np.inf
        value += least - least_along(length - sizes[k], bend, floor)
        value -= ROUNDING * len(bends) * abs(least)
        if value >= enough:
            break
    return value


@compiled
def _narrowed(low, high, k, turn):
    """Carry what is known of a direction to its neighbours; return whether any are left."""
    left = low[k] <= high[k] + EMPTY
    for j in range(k + 1, len(low)):
        low[j], high[j] = max(low[j], low[j - 1] - turn), min(high[j], high[j - 1] + turn)
        left &= low[j] <= high[j] + EMPTY
    for j in range(k - 1, -1, -1):
        low[j], high[j] = max(low[j], low[j + 1] - turn), min(high[j], high[j + 1] + turn)
        left &= low[j] <= high[j] + EMPTY
    return left


@compiled
def _parted(t, terms, grounds, regions, reached):
    """Hand the region of a split on to its parts; return whether they are all there is of it."""
    splits, parts, angles = grounds.splits, grounds.parts, grounds.angles
    faces, low, high = regions
    k, first, angle, turn = splits[t], parts[t], angles[t], terms.floor[1]
    by_faces = np.isnan(angle)
    made = len(terms.normals) if by_faces else 2
    if made == 0 or first <= t or first + made > len(splits) or k >= faces.shape[1]:
        return False
    if faces[t, k] >= 0 or reached[first : first + made].any():
        return False
    if not (by_faces or low[t, k] <= angle <= high[t, k]):
        return False
    for i in range(made):
        part = first + i
        reached[part], faces[part] = True, faces[t]
        if len(low) > 1:
            low[part], high[part] = low[t], high[t]
        if by_faces:
            faces[part, k] = i
            continue
        ends = high if i == 0 else low
        ends[part, k] = angle
        if turn > 0.0:
            reached[part] = _narrowed(low[part], high[part], k, turn)
    return True


@compiled
def _regions(grounds, heading, turn):
    """Return what each cell knows, the root's set: faces, least and greatest directions."""
    count, by_angles = len(grounds.origins), False
    for t in range(len(grounds.splits)):
        by_angles |= grounds.splits[t] >= 0 and not np.isnan(grounds.angles[t])
    sectors = len(grounds.splits) if by_angles else 1  # else all have the root's
    low, high = np.empty((sectors, count)), np.empty((sectors, count))
    for k in range(count):
        if turn > 0.0:
            low[0, k], high[0, k] = heading - (k + 1) * turn, heading + (k + 1) * turn
        else:
            low[0, k], high[0, k] = grounds.origins[k], grounds.origins[k] + 2.0 * np.pi
    return np.full((len(grounds.splits), count), -1), low, high


@compiled
def _least_of_leaves(terms, hessian, base, grounds, regions, reached, unit, enough):
    """Return the least bound of all leaves that are reached; -inf where one proves nothing."""
    splits, points, bends = grounds.splits, grounds.points, grounds.bends
    faces, low, high = regions
    lengths, normals, floor = terms.lengths, terms.normals, terms.floor[0]
    steep, least = (np.empty(points[0].shape), np.empty(points.shape[1])), np.inf
    for t in range(len(splits)):
        if not reached[t] or splits[t] >= 0:
            continue
        wanted = min(enough, least)
        bound = _tangents_least(lengths, floor, hessian, base, points[t], bends[t], unit, steep)
        value = bound[0]
        if not value >= wanted:
            own = min(t, len(low) - 1)
            region = faces[t], low[own], high[own]
            value = _held(lengths, normals, floor, steep, bends[t], unit, region, bound, wanted)
        if not value > -np.inf:  # or no number
            return -np.inf
        least = min(least, value)
    return least if least < np.inf else -np.inf


@compiled
def recounted(terms, hessian, start, goals, heading, grounds, unit, enough):
    """Return the least bound of all leaves; -inf where they are not all there is.

    Args:
        terms: the problem.
        hessian: of its cost over one coordinate of the headings, shape (N, N).
        start: p_0, the disturbance, R_0 e1 and R_g e1, shape (5, n).
        goals: g_1..g_N less s_0, shape (N, n).
        heading: of the attitude [rad], for turn limits.
        grounds: splits and tangents.
        unit: of the bends, in that of the cost.
        enough: a bound beyond which nothing is counted.
    """
    splits, point = grounds.splits, grounds.points[0]
    regions = _regions(grounds, heading, terms.floor[1])
    reached, slopes, spent = np.zeros(len(splits), np.bool_), np.empty(goals.shape), 0.0
    reached[0] = True
    for t in range(len(splits)):
        if reached[t] and splits[t] >= 0 and not _parted(t, terms, grounds, regions, reached):
            return -np.inf
    for c in range(start.shape[1]):
        spent += start[2, c] * start[2, c]
    spent = terms.lengths[0] * np.sqrt(spent)
    value, size = set_slopes(terms, start, goals, (np.zeros(0), 0.0), point, slopes)
    base = point, value, size, slopes, np.diag(hessian).max()
    asked = grounds, regions, reached, unit, enough - spent
    return spent + _least_of_leaves(terms, hessian, base, *asked)
