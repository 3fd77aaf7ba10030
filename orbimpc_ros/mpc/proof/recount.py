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
from orbimpc_ros.mpc.model.condensed import LONGEST
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.approach import LEEWAY
from orbimpc_ros.mpc.problem.pace import entry_speed
from orbimpc_ros.mpc.proof.choices import choices_bound
from orbimpc_ros.mpc.proof.grounds import (
    LEAF,
    ChoiceGrounds,
    Grounds,
    Left,
    Tangent,
    fits,
    tangent,
)
from orbimpc_ros.mpc.proof.sides import Sides
from orbimpc_ros.mpc.proof.slopes import (
    HALF,
    ROUNDING,
    hessian_of,
    lack_arriving,
    least_along,
    set_slopes,
    terms_of,
)
from orbimpc_ros.mpc.proof.tangents import tangents_bound

FLOORS = ('none', 'circle', 'polygon')  # that are known here
ALL = 2.0 * np.pi - 1e-9  # [rad], a sector that leaves nothing out
FLAT = 1e-12  # of the largest curvature, where there is none
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
        hessian = hessian_of(self._terms, rest)
        ends, basis = np.linalg.eigh(hessian_of(self._terms, rest, 1.0) - hessian)
        moved = ends[::-1] > FLAT * ends[-1]  # directions that lead elsewhere at the end
        self._curvature = hessian, basis[:, ::-1].copy(), ends[::-1][moved].copy()
        here, bends = State.at(np.zeros(n), np.eye(n), wanted=np.eye(n)), np.zeros(count)
        self._pulled = n * (1 + problem.inertial) * (problem.terminal == 'constraint')
        self._aims = n == 2 and problem.approach.exists
        pull = np.zeros(self._pulled)
        for grounds in (tangent(x, bends), Tangent(x, bends, pull, 0.0, bends, rest)):
            self.bound(here, rest, grounds, 1.0)  # compiles
        if self._expects_trees:
            self.expect_choices()

    def expect_choices(self) -> None:
        """Compile now, or load, what the first tree of choices would have to wait for."""
        problem = self._problem
        if not self._knows_trees:
            return
        known, point = np.zeros(1, np.int64), np.zeros((1, problem.horizon, self._width))
        still = np.eye(problem.dimension)
        here = State.at(np.zeros(problem.dimension), still, wanted=still)
        goals = point[0, :, : problem.dimension]
        chords = max(0, problem.horizon - self._sides.always(here, goals).begin)
        tethers, none = np.zeros((1, chords, problem.dimension)), np.zeros(0, np.int64)
        leaf = known + LEAF, known, known, known, known, point, known > 0, known
        tree = ChoiceGrounds(*leaf, none, none, np.zeros(0), tethers)
        self.bound(here, goals, tree, 1.0)

    @staticmethod
    def reads(problem: Problem) -> bool:
        """Return whether bounds of a problem can be counted again."""
        return _width(problem) == 9 or problem.floor.shape in FLOORS

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
        problem, shape = self._problem, (self._problem.horizon, self._problem.dimension)
        if goals.shape != shape or not fits(grounds, *shape, self._width):
            return -np.inf
        start = self._begun(state)
        if isinstance(grounds, ChoiceGrounds):
            return self._of_choices(state, start, goals, grounds, (unit, enough))
        known = self._terms, self._curvature, start, goals - state.position
        if isinstance(grounds, Tangent):
            return self._of_tangent(known, grounds, state.coasted is not None)
        if (self._width == 9 or problem.rotation_order == 2) or (
            problem.dimension == 3 and len(grounds.splits) > 1
        ):
            return -np.inf  # of which nothing is split
        if not self._pulls(grounds):
            return -np.inf
        ahead, limited = state.attitude, problem.max_acceleration > 0.0
        entry = entry_speed(problem, state) if limited else 0.0
        begun = math.atan2(ahead[1, 0], ahead[0, 0]), entry, *self._last(state)
        return float(recounted(*known, begun, grounds, unit, enough))

    def _last(self, state: State) -> tuple[float, float]:
        """Return the direction of the last heading, and the angle it may be off by [rad]."""
        if not self._aims:
            return 0.0, math.pi
        axis = self._problem.approach.axis(state)
        return math.atan2(axis[1], axis[0]), self._problem.approach.cone + LEEWAY

    def _pulls(self, grounds: Grounds) -> bool:
        """Return whether what pulls at the end of each leaf fits the problem, or nothing does."""
        nodes, pulls, stiffness = len(grounds.splits), grounds.pulls, grounds.stiffness
        if not pulls.size:
            return not len(pulls)
        fits = (pulls.shape, stiffness.shape) == ((nodes, self._pulled), (nodes,))
        return fits and bool((stiffness >= 0.0).all())

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

    def knows(self, grounds: Left) -> bool:
        """Return whether what grounds of this kind prove of the problem can be counted."""
        return self._knows_trees or not isinstance(grounds, ChoiceGrounds)

    @cached_property
    def _knows_trees(self) -> bool:
        """Return whether half-spaces and turns, as known here, are all that is asked for."""
        problem = self._problem
        turns = problem.rotation_order == 2 and problem.max_rate > 0.0
        return problem.floor.shape in FLOORS and not turns

    @property
    def _expects_trees(self) -> bool:
        """Return whether trees of choices are to be counted though nothing moves."""
        problem, floor = self._problem, self._problem.floor
        sectors = problem.turns_are_angles and problem.widest_turn < HALF  # are no choices
        faces = floor.shape != 'circle' and (self._pulled or self._terms.lengths.any())
        turned = problem.max_rate and not sectors
        spatial = problem.dimension == 3  # where the cone program may take over
        coned = problem.has_cones or problem.approach.exists
        split = floor.shape == 'polygon' and problem.horizon > LONGEST
        return bool(split or problem.obstacles or turned or spatial or faces or coned)

    def _of_choices(
        self, state: State, start: Array, goals: Array, tree: ChoiceGrounds, asked: tuple
    ) -> float:
        """Return what a tree of choices proves; its multipliers are in natural units."""
        if not self._knows_trees:
            return -np.inf
        count = len(goals)
        always, places = self._sides.always(state, goals), self._sides.places(state)
        nodes, leant = len(tree.splits), len(always.cones.places)
        if tree.tethers.shape[1] != max(0, count - always.begin):
            return -np.inf
        if tree.leans.size and tree.leans.shape[1] != leant:
            return -np.inf
        known = self._sides.standing  # of which a tree without splits has no use
        if nodes > 1:
            known = self._sides.alternatives(state, goals, places)
        coasting = state.coasted is not None
        stated = known, self._sides.faces, always, self._sides.symmetry(known, always)
        away = goals - state.position
        return float(
            choices_bound(self._terms, start, away, coasting, places, stated, tree, *asked)
        )

    def _of_tangent(self, known: tuple, leaf: Tangent, coasting: bool) -> float:
        """Return what a tangent proves; its numbers are in the problem's own units."""
        terms, curvature, start, goals = known
        if len(leaf.pull) != self._pulled or not leaf.stiffness >= 0.0:
            return -np.inf
        if leaf.stiffness and not self._pulled:
            return -np.inf
        return float(tangents_bound(terms, curvature, start, goals, leaf, coasting))


def _width(problem: Problem) -> int:
    """Return how many coordinates of a rotation the cost sees."""
    w = problem.weights
    if problem.dimension == 2:
        return 2
    return 9 if w.input or w.attitude else 3


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
def _within_reach(low, high, fast, normals, least):
    """Return the ends of a sector where a polygonal floor is beyond no speed that there is.

    The floor is nearest along its normals, and beyond the most speed about its corners, or
    everywhere: then the upper end is below the lower one.
    """
    if len(normals) == 0:
        return low, high
    if fast < least - EMPTY:
        return low, low - 1.0
    share = 2.0 * np.pi / len(normals)
    aside = np.arccos((least - EMPTY) / max(least, fast))
    if aside < 0.5 * share:
        nearest = share * np.round(low / share)
        if low > nearest + aside:
            nearest += share
        low = max(low, nearest - aside)
        nearest = share * np.round(high / share)
        if high < nearest - aside:
            nearest -= share
        high = min(high, nearest + aside)
    return low, high


@compiled
def _least_within(gx, gy, low, high, normals, least, slow, fast):
    """Return the least g . z over directions from low to high and the speeds of a step.

    What is slowest is round, or straight between a floor's corners: if g . z is not least on the
    rim, then at an end of the sector, at one of them, or where the round part begins.
    """
    after_low = gx * np.sin(low) - gy * np.cos(low)  # of the way down, -g
    before_high = gy * np.cos(high) - gx * np.sin(high)
    between = after_low >= 0.0 and before_high >= 0.0
    if high - low >= HALF:  # what is outside is narrower
        between = after_low >= 0.0 or before_high >= 0.0 or high - low >= ALL
    if between:
        return -np.sqrt(gx * gx + gy * gy) * fast
    best = np.inf
    for angle in (low, high):
        along = gx * np.cos(angle) + gy * np.sin(angle)
        best = min(best, along * fast, along * max(slow, _reached(normals, least, angle)))
    if len(normals) > 0:
        share = 2.0 * np.pi / len(normals)
        corner = share * (np.ceil(low / share - 0.5) + 0.5)
        while corner < high:
            along = gx * np.cos(corner) + gy * np.sin(corner)
            best = min(best, along * max(slow, _reached(normals, least, corner)))
            corner += share
        aside = np.arccos(least / max(least, slow))  # of a normal, where both are as slow
        for off in (-aside, aside):
            angle = share * np.ceil((low - off) / share) + off
            while angle < high and slow > least:
                best = min(best, slow * (gx * np.cos(angle) + gy * np.sin(angle)))
                angle += share
    return best


@compiled
def _least_between(gx, gy, length, bend, normals, least, low, high, slow, fast):
    """Return the least g . z + l |z| - bend |z|^2 / 2 over a sector and the speeds of a step."""
    if bend == 0.0 and length == 0.0 and high - low < HALF:
        return _least_within(gx, gy, low, high, normals, least, slow, fast)
    rim = _least_within(gx, gy, low, high, normals[:0], 1.0, 1.0, 1.0)
    if bend == 0.0:
        return min((length + rim) * slow, (length + rim) * fast)
    return least_along(length + rim, bend, least)


@inlined
def _tangents_least(lengths, floor, curvature, known, x, bends, unit, steep):
    """Set slopes and their sizes; return a tangent's least where headings go their own ways down.

    And the sum of what may cancel in it.
    """
    (slopes, sizes), (value, size, stiffness) = steep, known
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
        value -= lack_arriving(curvature, bends, unit, stiffness) * reach
    return value - ROUNDING * len(x) * size, size


@inlined
def _held(lengths, normals, floor, steep, bends, unit, region, bound, enough):
    """Return a tangent's bound with what it gains where headings are held in their regions.

    It is counted step by step, until the bound is enough.
    """
    (slopes, sizes), (value, size) = steep, bound
    faces, low, high, slow, fast = region
    aside = np.sqrt(1.0 - floor * floor)
    for k in range(len(bends)):
        face, between = faces[k], high[k] - low[k] < ALL or slow[k] > floor or fast[k] < 1.0
        if sizes[k] <= ROUNDING * size or not (face >= 0 or between):
            continue
        gx, gy, bend, length = slopes[k, 0], slopes[k, 1], unit * bends[k], lengths[k + 1]
        if face < 0:
            first, last = low[k], high[k]
            if fast[k] < 1.0:
                first, last = _within_reach(first, last, fast[k], normals, floor)
            ends = first, max(first, last), slow[k], fast[k]
            least = _least_between(gx, gy, length, bend, normals, floor, *ends)
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
    """Carry what is known of a step's range to its neighbours; return whether any is left."""
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
    (faces, low, high, slow, fast), (least, turn, change) = regions, terms.floor
    k, first, angle = splits[t], parts[t], angles[t]
    count, by_faces = faces.shape[1], np.isnan(angle)
    by_speeds = k >= count
    made = len(terms.normals) if by_faces else 2
    if made == 0 or first <= t or first + made > len(splits):
        return False
    if by_speeds and (by_faces or k >= 2 * count or change == np.inf):
        return False
    if by_speeds:
        lows, highs, widest, k = slow, fast, change, k - count
    else:
        lows, highs, widest = low, high, turn
    if faces[t, k] >= 0 or reached[first : first + made].any():
        return False
    if not (by_faces or lows[t, k] <= angle <= highs[t, k]):
        return False
    for i in range(made):
        part = first + i
        reached[part], faces[part] = True, faces[t]
        for ends in (low, high, slow, fast):
            if len(ends) > 1:
                ends[part] = ends[t]
        if by_faces:
            faces[part, k] = i
            continue
        ends = highs if i == 0 else lows
        ends[part, k] = angle
        if widest > 0.0:
            reached[part] = _narrowed(lows[part], highs[part], k, widest)
        for j in range(count if change < np.inf else 0):
            within = low[part, j], high[part, j], fast[part, j]
            begin, end = _within_reach(*within, terms.normals, least)
            reached[part] &= begin <= end + EMPTY
    return True


@compiled
def _ways_round(begun, turn, count):
    """Return by how many full turns the first way round to the last heading is off, and how many.

    Where that heading is not limited, or turns are not, there is one way.
    """
    heading, _, last, within = begun
    if turn <= 0.0 or within >= HALF:
        return 0.0, 1
    away, reach = last - heading, count * turn + within
    first = np.ceil((-reach - away) / (2.0 * np.pi))
    return first, int(np.floor((reach - away) / (2.0 * np.pi)) - first) + 1


@compiled
def _regions(grounds, begun, floor, ways):
    """Return what each cell knows, the roots' set: faces, directions from to, speeds from to.

    There is a root for each way round to the last heading.
    """
    (heading, entry, last, within), (least, turn, change) = begun, floor
    nodes, count, by_angles = len(grounds.splits), len(grounds.origins), ways[1] > 1
    for t in range(nodes):
        by_angles |= grounds.splits[t] >= 0 and not np.isnan(grounds.angles[t])
    sectors = nodes if by_angles else 1  # else all have the root's
    paced = sectors if change < np.inf else 1
    low, high = np.empty((sectors, count)), np.empty((sectors, count))
    slow, fast = np.empty((paced, count)), np.empty((paced, count))
    for way in range(ways[1]):
        for k in range(count):
            low[way, k], high[way, k] = grounds.origins[k], grounds.origins[k] + 2.0 * np.pi
            if turn > 0.0:
                low[way, k], high[way, k] = heading - (k + 1) * turn, heading + (k + 1) * turn
            if way < paced:
                slow[way, k] = max(least, entry - (k + 1) * change)
                fast[way, k] = min(1.0, entry + (k + 1) * change)
        if turn > 0.0 and within < HALF:
            middle, end = last + 2.0 * np.pi * (ways[0] + way), count - 1
            low[way, end] = max(low[way, end], middle - within)
            high[way, end] = min(high[way, end], middle + within)
            _narrowed(low[way], high[way], end, turn)
    return np.full((nodes, count), -1), low, high, slow, fast


@compiled
def _least_of_leaves(terms, curvature, posed, grounds, regions, reached, unit, enough):
    """Return the least bound of all leaves that are reached; -inf where one proves nothing."""
    splits, points, bends = grounds.splits, grounds.points, grounds.bends
    (start, goals, base), (faces, low, high, slow, fast) = posed, regions
    lengths, normals, floor = terms.lengths, terms.normals, terms.floor[0]
    least, slopes = np.inf, np.empty(points[0].shape)
    steep = slopes, np.empty(points.shape[1])
    for t in range(len(splits)):
        if not reached[t] or splits[t] >= 0:
            continue
        wanted = min(enough, least)
        if len(grounds.pulls) > 0:
            arrival = grounds.pulls[t], grounds.stiffness[t]
            value, size = set_slopes(terms, start, goals, arrival, points[t], slopes)
            known = value, size, arrival[1]
        else:
            value, size = _set_slopes_from(base, curvature[0], points[t], slopes)
            known = value, size, 0.0
        bound = _tangents_least(lengths, floor, curvature, known, points[t], bends[t], unit, steep)
        value = bound[0]
        if not value >= wanted:
            own, paced = min(t, len(low) - 1), min(t, len(slow) - 1)
            region = faces[t], low[own], high[own], slow[paced], fast[paced]
            value = _held(lengths, normals, floor, steep, bends[t], unit, region, bound, wanted)
        if not value > -np.inf:  # or no number
            return -np.inf
        least = min(least, value)
    return least if least < np.inf else -np.inf


@compiled
def recounted(terms, curvature, start, goals, begun, grounds, unit, enough):
    """Return the least bound of all leaves; -inf where they are not all there is.

    Args:
        terms: the problem.
        curvature: of its cost over one coordinate of the headings: see :func:`lack_arriving`.
        start: p_0, the disturbance, R_0 e1 and R_g e1, shape (5, n).
        goals: g_1..g_N less s_0, shape (N, n).
        begun: the heading of the attitude [rad], for turn limits; the speed that changes begin at;
            the direction of the last heading, and how far off it may be [rad].
        grounds: splits and tangents.
        unit: of the bends, in that of the cost.
        enough: a bound beyond which nothing is counted.
    """
    splits, point = grounds.splits, grounds.points[0]
    ways = _ways_round(begun, terms.floor[1], len(point))
    if not 1 <= ways[1] <= len(splits):
        return -np.inf
    regions = _regions(grounds, begun, terms.floor, ways)
    reached, slopes, spent = np.zeros(len(splits), np.bool_), np.empty(goals.shape), 0.0
    reached[: ways[1]] = True
    for t in range(len(splits)):
        if reached[t] and splits[t] >= 0 and not _parted(t, terms, grounds, regions, reached):
            return -np.inf
    for c in range(start.shape[1]):
        spent += start[2, c] * start[2, c]
    spent = terms.lengths[0] * np.sqrt(spent)
    value, size = set_slopes(terms, start, goals, (np.zeros(0), 0.0), point, slopes)
    base = point, value, size, slopes, np.diag(curvature[0]).max()
    asked = grounds, regions, reached, unit, enough - spent
    return spent + _least_of_leaves(terms, curvature, (start, goals, base), *asked)
