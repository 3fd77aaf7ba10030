# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Multipliers of constraints between steps: sides of bodies, turns, a glide slope, an arrival.

Each adds a term to the cost that is not positive on any feasible trajectory, as a value at the
tangent point and forces, which are its gradient. In either arithmetic.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

from orbimpc_ros.mpc.proof.arithmetic import direction, generic, slack
from orbimpc_ros.mpc.proof.sets import about, size_of
from orbimpc_ros.mpc.proof.splits import WHOLE
from orbimpc_ros.mpc.proof.tree import POINTS


@generic
def side_of(stated, choice, part, span, corners, normal):
    """Set the normal of the half-space on the side of a body to which a choice is restricted.

    Args:
        stated: the problem.
        choice: a side of a body.
        part: of all choices.
        span: of all choices.
        corners: of all choices.
        normal: to be set, shape (n,) at least.

    Returns:
        The least distance of a control point from the moved body's position along the normal; by
        how much less that of the others may be; the size of both terms, negative without a side.
    """
    n, bodies, zero = stated.n, stated.bodies, 0 * stated.full
    count, side = bodies.places.shape[1], part[choice]
    j, k = choice // count - 2, choice % count
    radius, grown = bodies.extents[j, 2 * n], bodies.margins[0, j, k]
    if side == WHOLE:
        return zero, zero, zero - 1
    if radius == 0:
        normal[:] = zero
        normal[side % n] = zero + (1 if side >= n else -1)
        out = bodies.extents[j, side]
        return out + grown, zero, abs(out) + abs(grown)
    if n == 2:
        low, high = span[choice]
        half = min(stated.full / 4, (high - low) / 2 + slack(abs(low) + abs(high)))
        (least, aside), (normal[0], normal[1]) = direction(half), direction((low + high) / 2)
    else:
        (normal[0], normal[1], normal[2]), least, aside = about(corners[choice])
    if radius + grown <= 0 or least <= stated.narrow:
        return zero, zero, zero - 1
    off = aside * bodies.margins[1, j, k]
    return least * (radius + grown), off, radius + abs(grown) + off


@generic
def pressed(stated, region, depth, tree, begun, leaf, work):
    """Add the forces of multipliers of half-spaces next to bodies, of a leaf or of nodes above it.

    Returns:
        Their value; the size of its terms; whether all of them have such a half-space.
    """
    motion, bodies, zero = stated.motion, stated.bodies, 0 * stated.full
    value, size, normal, n = zero, zero, work.vectors[0], stated.n
    count, degree, flown = len(work.slopes), motion.degree, work.flown
    end, rows = tree.press_end[leaf], POINTS * count * len(bodies.at)
    for e in range(begun, end):
        y, row = tree.press[e], tree.press_row[e]
        if not (y >= 0 and 0 <= row < rows * (depth + 1)):
            return value, size, False
        if y == 0:
            continue
        d, row = depth - row // rows, row % rows
        choice, at = row // POINTS + 2 * count, row % POINTS
        j, k = choice // count - 2, choice % count
        i = bodies.at[j, k, at]
        part, span, corners = region.part[d], region.span[d], region.corners[d]
        out, off, terms = side_of(stated, choice, part, span, corners, normal)
        if i < 0 or terms < 0:
            return value, size, False
        value, size = value + y * (out - off), size + y * terms
        # An inner Bernstein control point is ahead of, or behind, the nearest end by its velocity.
        late, led = 1 if 2 * i > degree else 0, zero
        if 0 < i < degree:
            led = -motion.lead if late == 1 else motion.lead
        for c in range(n):
            force, middle = y * normal[c], bodies.places[j, k, at, c]
            place = flown[0, k + late, c] + led * flown[1, k + late, c]
            value = value + force * (middle - place)
            size = size + abs(force) * (abs(middle) + abs(place))
            flown[2, k + late, c] = flown[2, k + late, c] - force
            flown[3, k + late, c] = flown[3, k + late, c] - force * led
    return value, size, True


@generic
def towed(stated, tether, point, tied, slopes):
    """Add the slopes of multipliers of turns; return as :func:`pressed` does."""
    chord, n = stated.chord, stated.n
    value, size = 0 * chord, 0 * chord
    for k in range(len(tether)):
        steep = size_of(tether[k], n)
        if steep == 0:
            continue
        if chord < 0 or k < stated.begun:
            return value, size, False
        value, size = value - chord * steep, size + chord * steep
        for c in range(n):
            before = point[k - 1, c] if k > 0 else tied[c]
            value = value + tether[k, c] * (point[k, c] - before)
            size = size + abs(tether[k, c]) * (abs(point[k, c]) + abs(before))
            slopes[k, c] = slopes[k, c] + tether[k, c]
            if k > 0:
                slopes[k - 1, c] = slopes[k - 1, c] - tether[k, c]
    return value, size, True


@generic
def slid(stated, slide, flown):
    """Add the forces of multipliers of the glide slope; return as :func:`pressed` does."""
    value, size = 0 * stated.chord, 0 * stated.chord
    sine, cosine = stated.sine - 2 * slack(stated.cosine), stated.cosine + 2 * slack(stated.cosine)
    for k in range(len(slide)):
        down, square = -slide[k, 2], slide[k, 0] ** 2 + slide[k, 1] ** 2
        if down == 0 and square == 0:
            continue
        if not sine > 0 or down < 0 or cosine * cosine * square > sine * sine * down * down:
            return value, size, False
        eased = down * stated.goals[k, 3] / stated.cosine
        value, size = value - eased, size + 2 * eased
        for c in range(3):
            force = slide[k, c] * (flown[0, k + 1, c] - stated.goals[k, c])
            value, size = value + force, size + abs(force)
            flown[2, k + 1, c] = flown[2, k + 1, c] + slide[k, c]
    return value, size, True


@generic
def pulled(stated, pull, flown):
    """Add the forces of multipliers of an arrival.

    Returns:
        Their value; the size of its terms.
    """
    value, size, count = 0 * stated.chord, 0 * stated.chord, len(stated.goals)
    for i in range(len(pull)):
        for c in range(pull.shape[1]):
            missed = flown[i, count, c] - (stated.goals[count - 1, c] if i == 0 else 0 * value)
            force = pull[i, c] * missed
            value, size = value + force, size + abs(force)
            flown[2 + i, count, c] = flown[2 + i, count, c] + pull[i, c]
    return value, size
