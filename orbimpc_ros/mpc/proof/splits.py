# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Splits of a tree: the restrictions of choices in each part, and whether parts cover their node.

In either arithmetic. A region has a row for each depth of the tree; a node's row is derived from
its parent's.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from orbimpc_ros.mpc.proof.arithmetic import generic, slack
from orbimpc_ros.mpc.proof.sets import TOLERANCE, around, dot
from orbimpc_ros.mpc.proof.tree import (
    ARCS,
    CHILDREN,
    CHOICE,
    CUT,
    FACES,
    KIND,
    PATCHES,
    QUARTERS,
    SIDES,
    SPEED,
)

WHOLE, ORDERED = -1, 1  # parts: without restrictions; sectors of steps in ascending order
HELD, GONE, WRONG = range(3)  # a part is valid, is empty, or is invalid
ICOSAHEDRON = 20  # triangles; those of the cap come after them
FARTHEST = 100  # [rad] angle from zero of arcs: beyond it turns would be counted inexactly


class Region(NamedTuple):
    """The restrictions of each choice at the D nodes on a path from the root, or of one node.

    The region of a single node has no axis of depths.

    Attributes:
        part: face or side; 0 for a sector or patch, ``ORDERED`` for a sector of exchangeable steps;
            ``WHOLE`` before any split, shape (D, C).
        span: least and greatest direction [rad] or speed, shape (D, C, 2).
        corners: of patches, shape (D, C, 3, 3); (D, 1, 3, 3) and unused in the plane.
    """

    part: np.ndarray
    span: Any
    corners: Any


class Cut(NamedTuple):
    """A split of a node: its kind, the choice, the number of parts, and where they meet."""

    kind: int
    choice: int
    parts: int
    at: float = 0.0


@generic
def begin(stated, origins, part, span):
    """Set the restrictions of all trajectories: parts, shape (C,), spans, shape (C, 2).

    Returns:
        ``HELD``; ``GONE`` without trajectories; ``WRONG`` if the origins are invalid.
    """
    count = len(stated.goals)
    part[:], span[:, 0], span[:, 1] = WHOLE, 0 * stated.full, stated.full
    for c in range(2 * count):
        span[c, 0], span[c, 1] = stated.spans[c, 0], stated.spans[c, 1]
        if span[c, 0] > span[c, 1]:
            return GONE
        if c < count and stated.turn >= 0:
            part[c] = 0
    for k in range(len(origins)):
        if stated.exchanged == 0 or origins[k] != origins[0] or not abs(origins[k]) <= FARTHEST:
            return WRONG
        part[k] = ORDERED if k < stated.exchanged else 0
        span[k, 0], span[k, 1] = origins[k], origins[k] + stated.full
    for q in range(len(stated.cone_step) if stated.n == 3 else 0):
        cone = stated.cones[q]
        if not _meets(stated, stated.cone_step[q], cone, cone[3], cone[4]):
            return GONE
    return HELD if _aimed(stated, part, span) else GONE


@generic
def _aimed(stated, part, span):
    """Cut the last heading's sector to the approach; return whether the region is not empty."""
    count = len(stated.goals)
    k = count - 1
    if stated.aside < 0 or k < stated.order - 1:
        return True
    low, high = stated.aim - stated.aside, stated.aim + stated.aside
    if part[k] != WHOLE:
        first = math.ceil((span[k, 0] - high) / stated.full)
        last = math.floor((span[k, 1] - low) / stated.full)
        if first > last:
            return False
        if first < last:
            return True
        low = max(span[k, 0], low + first * stated.full)
        high = min(span[k, 1], high + first * stated.full)
    part[k], span[k, 0], span[k, 1] = 0, low, high
    return _carried(span, k, 0, count, -stated.turn, stated.turn)


@generic
def _carried(span, k, begin, end, least, most):
    """Propagate a choice's span to those of other steps by the limits on changes per step.

    Args:
        span: of all choices, shape (C, 2).
        k: choice with the new span.
        begin: first choice to narrow.
        end: one past the last choice to narrow.
        least: least change per step.
        most: largest change per step; negative without a limit.

    Returns:
        Whether the region is not empty.
    """
    if span[k, 0] > span[k, 1]:
        return False
    if most < 0:
        return True
    for i in range(1, end - begin):
        for j, near, down, up in (
            (k + i, k + i - 1, least, most),
            (k - i, k - i + 1, -most, -least),
        ):
            if begin <= j < end:
                span[j, 0] = max(span[j, 0], span[near, 0] + down)
                span[j, 1] = min(span[j, 1], span[near, 1] + up)
                if span[j, 0] > span[j, 1]:
                    return False
    return True


@generic
def _is_split_right(stated, node, at, part, low, high):
    """Return whether a node's split is valid, given the restrictions of the choice there."""
    kind, c, parts, n = node[KIND], node[CHOICE], node[CHILDREN], stated.n
    extents, count = stated.bodies.extents, len(stated.goals)
    body, within, unsplit = c // count - 2, parts == 2 and low <= at <= high, part == WHOLE
    if not stated.order - 1 <= c < (2 + len(extents)) * count:
        return False
    if body == -1:
        return kind == SPEED and within
    if body >= 0 and extents[body, 2 * n] == 0:  # a box
        return kind == SIDES and unsplit and parts == 2 * n
    if body == -2 and n == 3 and len(stated.faces) > 0:
        return kind == FACES and unsplit and parts == len(stated.faces)
    if n == 2:
        arcs = kind == ARCS and parts >= 2 and abs(at) <= FARTHEST
        return arcs if unsplit else kind == CUT and within
    if not unsplit:
        return kind == QUARTERS and parts == 4
    capped = body == -2 and stated.capped[c] and parts == len(stated.patches) - ICOSAHEDRON
    return kind == PATCHES and (parts == ICOSAHEDRON or capped)


@generic
def part_of(stated, node, at, i, depth, region):
    """Set the restrictions of part i of a node from those of the node.

    Args:
        stated: the problem.
        node: its numbers, shape (5,).
        at: where it is cut.
        i: index of the child.
        depth: of the child; the node's own row is the previous one.
        region: to be set at this depth.

    Returns:
        ``HELD``; ``GONE`` if the part is empty; ``WRONG`` if the split is invalid.
    """
    c, part, span = node[CHOICE], region.part[depth], region.span[depth]
    if not 0 <= c < len(part):
        return WRONG
    former, before = region.part[depth - 1, c], region.span[depth - 1]
    low, high = before[c, 0], before[c, 1]
    if not _is_split_right(stated, node, at, former, low, high):
        return WRONG
    made = region.corners[depth]
    for e in range(len(part)):
        part[e], span[e, 0], span[e, 1] = region.part[depth - 1, e], before[e, 0], before[e, 1]
    for e in range(len(made)):
        for a in range(3):
            for b in range(3):
                made[e, a, b] = region.corners[depth - 1, e, a, b]
    return narrowed(stated, node, at, i, part, span, made)


@generic
def narrowed(stated, node, at, i, part, span, corners):
    """Narrow the restrictions of a node, in place, to its part i; return ``HELD`` or ``GONE``.

    Args are those of :func:`part_of`, and the restrictions of each choice.
    """
    kind, c, count = node[KIND], node[CHOICE], len(stated.goals)
    part[c] = i if kind in (SIDES, FACES) else max(part[c], 0)
    if kind == SIDES or (kind == FACES and len(stated.faces) == 0):
        return HELD
    if kind in (PATCHES, QUARTERS):
        _set_patch(stated.patches, node, i, corners[c])
    if kind in (FACES, PATCHES, QUARTERS):
        meets = c >= count or _meets(stated, c, *around(stated, part[c], corners, c))
        return HELD if meets else GONE
    if kind == ARCS:
        share = stated.full / node[CHILDREN]
        span[c, 0], span[c, 1] = at + i * share, at + (i + 1) * share
        return HELD
    span[c, 1 - i] = at
    return HELD if c >= 2 * count or _followed(stated, c, part, span) else GONE


@generic
def _followed(stated, c, part, span):
    """Propagate a cut of a heading or a speed; return whether the region is not empty."""
    count = len(stated.goals)
    if c >= count:
        return _carried(span, c, count, 2 * count, -stated.change, stated.change)
    if part[c] == ORDERED:
        full = stated.full  # all begin at the same direction
        return _carried(span, c, 0, stated.exchanged, 0 * full, 2 * full)
    held = _carried(span, c, 0, count, -stated.turn, stated.turn)
    free = stated.aside < 0 or part[count - 1] != 0
    return held and (free or _aimed(stated, part, span))


@generic
def _set_patch(patches, node, i, made):
    """Set the corners of part i of all directions, or of the given patch, shape (3, 3)."""
    if node[KIND] == PATCHES:
        first = 0 if node[CHILDREN] == ICOSAHEDRON else ICOSAHEDRON
        for j in range(3):
            for e in range(3):
                made[j, e] = patches[first + i, j, e]
        return
    for e in range(3):
        old = made[0, e], made[1, e], made[2, e]
        for j in range(3):
            made[j, e] = (old[j] + old[(j + 1) % 3 if i == 3 else i]) / 2


@generic
def _meets(stated, k, axis, cosine, sine):
    """Return whether a cone meets each of the cones of heading k in space.

    If speeds may be zero, all cones meet at their ends.
    """
    for q in range(len(stated.cone_step)):
        cone = stated.cones[q]
        apart = stated.least > 0 or cone[5] > 0
        convex = sine * cone[3] + cosine * cone[4] > 0  # together below a half turn
        least = cosine * cone[3] - sine * cone[4] - TOLERANCE * slack(1 + 0 * sine)
        if stated.cone_step[q] == k and apart and convex and dot(axis, cone, 3) < least:
            return False
    return True
