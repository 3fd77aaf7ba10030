# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The bound of a tree of choices: that nothing is left out, and what the tangents of leaves prove.

A leaf adds y (b - a . x) to the cost for each row a . x >= b that holds there, with multipliers
y >= 0, and tau . (z_{k+1} - z_k) - c |tau| for turns of c at most. A tangent of that is least
where headings go down its slopes. A leaf is empty where the rows alone come to more than nothing.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.kernels import compiled
from orbimpc_ros.mpc.proof.patches import FINEST, set_patch
from orbimpc_ros.mpc.proof.sides import ARCS, CAPS, FACES, FIRST_CAP, PATCHES, SIDES
from orbimpc_ros.mpc.proof.slopes import ROUNDING, least_along, set_slopes
from orbimpc_ros.mpc.proof.tangents import (
    least_decided,
    least_over_orbitope,
    share_length,
    top_of,
    vector_size,
)

QUARTERS = 4  # of a circle, that arcs begin with
DEEPEST = 40  # halvings of them
TRIANGLES = 4  # that a patch is split into
SURE = 1e-12  # by so much more than can be reached is surely out of reach


@compiled
def _sides_of(known, j, faces):
    """Return the first of the sides that a choice has to begin with, and how many there are."""
    kind = known.kinds[j]
    if kind == ARCS:
        return 0, QUARTERS
    if kind == PATCHES:
        return 0, FIRST_CAP
    if kind == CAPS:
        return FIRST_CAP, len(faces.patches) - FIRST_CAP
    return 0, len(faces.normals) if kind == FACES else known.extents.shape[1]


@compiled
def _parts_of(known, j, tree, holder):
    """Return which sides a side is split into: how often halved, the first, and how many; or 0."""
    kind, level, side = known.kinds[j], tree.levels[holder], tree.sides[holder]
    if kind == ARCS and 0 <= level < DEEPEST:
        return level + 1, 2 * side, 2
    if kind in (PATCHES, CAPS) and 0 <= level < FINEST:
        return level + 1, TRIANGLES * side, TRIANGLES
    return level, side, 0


@compiled
def set_row(known, j, at, i, faces, normal):
    """Set the normal of a row of a side; return its offset.

    Args:
        known: the choices.
        j: which of them.
        at: how often its quarters, or patches, were halved, and which side.
        i: which row.
        faces: what sides are made of.
        normal: to be set, shape (n,).
    """
    kind, (level, side), n = known.kinds[j], at, len(normal)
    if kind == SIDES:
        normal[:] = 0.0
        normal[side % n] = 1.0 if side >= n else -1.0
        offset = known.extents[j, side]
    elif kind == FACES:
        normal[:] = faces.normals[side]
        offset = known.sizes[j]
    elif kind in (PATCHES, CAPS):
        share = set_patch(faces.patches, level, side, normal)
        across = np.sqrt(max(0.0, 1.0 - share * share))
        offset = known.sizes[j] * share - known.spreads[j] * across
    else:
        width = 0.5 * np.pi / 2.0**level
        middle = width * (side + 0.5)
        normal[0], normal[1] = np.cos(middle), np.sin(middle)
        offset = known.sizes[j] * np.cos(0.5 * width) - known.spreads[j] * np.sin(0.5 * width)
    for c in range(n):
        offset += normal[c] * known.centres[j, i, c]
    return offset


@compiled
def _out_of_reach(places, known, j, at, faces, normal):
    """Return whether no headings get beyond one of the rows of a side."""
    for i in range(known.counts[j]):
        place = known.places[j] + i
        left = size = set_row(known, j, at, i, faces, normal)
        size = abs(size)
        for c in range(len(normal)):
            left -= normal[c] * places.free[place, c]
            size += abs(places.free[place, c]) + abs(known.centres[j, i, c])
        reach = np.abs(places.maps[place]).sum()
        if left > reach + SURE * (1.0 + size + reach):
            return True
    return False


@compiled
def _holder(made, parents, t, j):
    """Return the last node on the way to t, itself included, that is a side of a choice; or -1."""
    while t > 0:
        if made[t] == j:
            return t
        t = parents[t]
    return -1


@compiled
def _first_in_order(made, parents, tree, ordered, t, j):
    """Return the first face of a step that is in order with those of the steps before it."""
    least = 0
    while t > 0:
        if j < ordered and made[t] < j:
            least = max(least, tree.sides[t])
        t = parents[t]
    return least


@compiled
def _complete(places, known, symmetry, tree, nodes, t, faces, normal):
    """Note the parts of a node; return whether they are all that can be reached of it.

    Nodes that are counted among them beyond that stay parts of none. What is out of order, or one
    of the faces of a step that nothing sees, may be left out: there is a trajectory as cheap.
    """
    made, parents = nodes
    j, first, count = tree.splits[t], tree.parts[t], tree.counts[t]
    if j >= len(known.kinds):
        return False
    if first <= t or first + count > len(made):
        return False
    holder, level = _holder(made, parents, t, j), 0
    begin, sides = _sides_of(known, j, faces)
    if holder >= 0:
        level, begin, sides = _parts_of(known, j, tree, holder)
        if sides == 0:
            return False
    part, least = first, _first_in_order(made, parents, tree, symmetry.ordered, t, j)
    for side in range(begin, begin + sides):
        if part < first + count and tree.sides[part] == side and tree.levels[part] == level:
            if parents[part] >= 0:
                return False
            made[part], parents[part] = j, t
            part += 1
        elif side < least or (side > 0 and j == symmetry.unseen):
            continue
        elif not _out_of_reach(places, known, j, (level, side), faces, normal):
            return False
    return True


@compiled
def _press(places, row, y, normal, offset, forces):
    """Add what a multiplier of a row does to forces; return its worth, and what may cancel."""
    worth, size = y * offset, y * abs(offset)
    for c in range(len(normal)):
        pull = y * normal[c]
        worth -= pull * places.free[row, c]
        size += abs(pull * places.free[row, c])
        for k in range(len(forces)):
            forces[k, c] += pull * places.maps[row, k]
    return worth, size


@compiled
def _tie(always, tethers, unit, forces):
    """Add what multipliers of turns do to forces; return their worth, and what may cancel."""
    worth, size = 0.0, 0.0
    for i in range(len(tethers)):
        k, square = always.begin + i, 0.0
        for c in range(forces.shape[1]):
            pull = unit * tethers[i, c]
            square += pull * pull
            forces[k, c] -= pull
            if k > 0:
                forces[k - 1, c] += pull
            else:
                worth -= pull * always.first[c]
        worth -= always.chord * np.sqrt(square)
        size += 2.0 * np.sqrt(square)
    return worth, size


@compiled
def _lean(places, cones, leans, unit, normal, forces):
    """Add what multipliers of cones do to forces; return their worth, and what may cancel.

    A vector that comes to less than nothing with some of its cone is raised along the axis a. One
    that is y (a - cos(angle) u), |u| <= 1, comes to no less than -y e with what is eased by e.
    """
    worth, size, n = 0.0, 0.0, len(normal)
    for i in range(len(leans)):
        place, sine, along, offset = cones.places[i], cones.sines[i], 0.0, 0.0
        for c in range(n):
            normal[c] = unit * leans[i, c]
            along += normal[c] * cones.axes[i, c]
        length = vector_size(normal, n)
        raised = max(0.0, sine * length - along) / (1.0 - sine) + ROUNDING * length
        for c in range(n):
            normal[c] += raised * cones.axes[i, c]
            offset += normal[c] * cones.tips[i, c]
        along, length = along + raised, vector_size(normal, n)
        if cones.eased[i] > 0.0 and along > 0.0:
            deep = np.sqrt(max(0.0, along * along - (sine * length) ** 2))
            offset -= cones.eased[i] * length * length / (along + deep)
        more, cancelled = _press(places, place, 1.0, normal, offset, forces)
        worth, size = worth + more, size + cancelled + length
    return worth, size


@compiled
def _held(places, known, always, tree, nodes, leaf, unit, faces, forces):
    """Set the forces of a leaf's multipliers; return their worth, and what may cancel.

    The worth is NaN where they are none, or hold elsewhere.
    """
    (made, parents), (t, number), normal = nodes, leaf, np.empty(forces.shape[1])
    forces[:] = 0.0
    worth, size = _tie(always, tree.tethers[number], unit, forces)
    if tree.leans.size:
        leans = tree.leans[number]
        more, cancelled = _lean(places, always.cones, leans, unit, normal, forces)
        worth, size = worth + more, size + cancelled
    begin, end = tree.ends[number - 1] if number > 0 else 0, tree.ends[number]
    if not 0 <= begin <= end <= len(tree.presses):
        return np.nan, size
    for e in range(begin, end):
        y, holder, i, at = unit * tree.presses[e], tree.holders[e], tree.rows[e], t
        while at > holder and at > 0:
            at = parents[at]
        if not (y >= 0.0 and at == holder and i >= 0):
            return np.nan, size
        if holder == 0:
            if i >= len(always.places):
                return np.nan, size
            place, offset = always.places[i], always.offsets[i]
            normal[:] = always.normals[i]
        else:
            j = made[holder]
            if i >= known.counts[j]:
                return np.nan, size
            side = tree.levels[holder], tree.sides[holder]
            place, offset = known.places[j] + i, set_row(known, j, side, i, faces, normal)
        more, cancelled = _press(places, place, y, normal, offset, forces)
        worth, size = worth + more, size + cancelled
    return worth, size


@compiled
def _leaf_bound(terms, start, goals, coasting, tangent, forces, held, slopes, enough):
    """Return what a leaf's tangent proves; over SO(3) as much of it as is enough, step by step."""
    (worth, cancelled), arrival, rest, n = held, np.zeros(0), 0.0, forces.shape[1]
    (point, ways), decided = tangent, terms.order - 1
    value, size = set_slopes(terms, start, goals, (arrival, 0.0), point, slopes)
    for k in range(len(point)):
        square, length = 0.0, terms.lengths[k + 1]
        for c in range(point.shape[1]):
            along = slopes[k, c] * point[k, c]
            value -= along
            size += abs(along)
            if c < n:
                slopes[k, c] -= forces[k, c]
            square += slopes[k, c] ** 2
        size += length
        if k < decided:
            known = start[4], terms.floor[0], coasting
            rest -= least_decided(slopes[k], length, n, known)
        elif point.shape[1] == 9:
            if len(ways) > 0:
                rest -= share_length(slopes[k], ways[k], length, terms.floor[0])
            rest += _by_columns(slopes[k])
        else:
            rest -= least_along(length - np.sqrt(square), 0.0, terms.floor[0])
        if not abs(rest) < np.inf:  # or no number
            return -np.inf
    value += worth + terms.lengths[0] * vector_size(start[2], n)
    bound = value - rest - ROUNDING * len(point) * (size + cancelled + abs(rest))
    for k in range(decided, len(point) if point.shape[1] == 9 else 0):
        if bound >= enough:
            break
        bound += _by_columns(slopes[k]) + least_over_orbitope(slopes[k], top_of(slopes[k]))
    return bound


@compiled
def _by_columns(slope):
    """Return the most of -<G, R> over matrices R whose columns are no longer than 1."""
    most = 0.0
    for c in range(3):
        most += np.sqrt(slope[3 * c] ** 2 + slope[3 * c + 1] ** 2 + slope[3 * c + 2] ** 2)
    return most


@compiled
def _reach(terms, start, coasting, forces):
    """Return the most that headings, which the state may decide, come to along forces."""
    reach, decided = 0.0, terms.order - 1
    if decided:
        known = start[4], terms.floor[0], coasting
        reach -= least_decided(-forces[0], 0.0, forces.shape[1], known)
    for k in range(decided, len(forces)):
        reach += np.sqrt((forces[k] ** 2).sum())
    return reach


@compiled
def choices_bound(terms, start, goals, coasting, places, stated, tree, unit, enough):
    """Return the least bound of all leaves; -inf where they are not all there is.

    Args:
        terms: the problem.
        start: p_0, the disturbance, R_0, R_g and, at order 2, what decides R_1, shape (5, d).
        goals: g_1..g_N less s_0, shape (N, n).
        coasting: whether R_1 is what decides it, or any share of that.
        places: where headings lead.
        stated: the choices, what sides are made of, what holds of all trajectories, and
            which steps can be told apart.
        tree: of the choices that were made.
        unit: of the multipliers, in that of the cost.
        enough: a bound beyond which nothing has to be counted.
    """
    known, faces, always, symmetry = stated
    count, number, least = len(tree.splits), -1, np.inf
    nodes = np.full(count, -1), np.full(count, -1)
    slopes, forces = np.empty(tree.points.shape[1:]), np.empty(goals.shape)
    normal = np.empty(goals.shape[1])
    for t in range(count):
        if t > 0 and nodes[1][t] < 0:
            return -np.inf
        if tree.splits[t] >= 0:
            if not _complete(places, known, symmetry, tree, nodes, t, faces, normal):
                return -np.inf
            continue
        number += 1
        if number >= len(tree.points):
            return -np.inf
        leaf = t, number
        held = _held(places, known, always, tree, nodes, leaf, unit, faces, forces)
        if tree.empty[number]:
            reach = _reach(terms, start, coasting, forces)
            if not held[0] > reach + ROUNDING * len(forces) * (held[1] + reach):
                return -np.inf
            continue
        tangent = tree.points[number], tree.ways[number] if len(tree.ways) > 0 else forces[:0]
        told = tangent, forces, held, slopes, min(enough, least)
        value = _leaf_bound(terms, start, goals, coasting, *told)
        if not value > -np.inf:  # or no number
            return -np.inf
        least = min(least, value)
    return least
