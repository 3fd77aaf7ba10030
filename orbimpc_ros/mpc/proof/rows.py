# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Multipliers of constraints between steps: sides of bodies, turns, a glide slope, an arrival.

Each adds a term to the cost that is not positive on any feasible trajectory: its value at the
tangent point and the size of what it is summed from to a total, shape (2,), and forces, which are
its gradient. In either arithmetic.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

from orbimpc_ros.mpc.proof.arithmetic import direction, generic, slack
from orbimpc_ros.mpc.proof.flight import TIED
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
def counted(total, value, size):
    """Add a value and the size of its terms to the sums of a leaf."""
    total[0], total[1] = total[0] + value, total[1] + size


@generic
def _forced(total, flown, k, on, vector, place):
    """Add vector . (x - on_s place), where x = on_s s_k + on_p p_k, and its forces."""
    on_s, on_p = on
    for c in range(flown.shape[2]):
        x, middle = on_s * flown[0, k, c] + on_p * flown[1, k, c], on_s * place[c]
        counted(total, vector[c] * (x - middle), abs(vector[c]) * (abs(x) + abs(middle)))
        flown[2, k, c] = flown[2, k, c] + on_s * vector[c]
        flown[3, k, c] = flown[3, k, c] + on_p * vector[c]


@generic
def pressed(stated, region, depth, tree, begun, leaf, work):
    """Add the multipliers of half-spaces next to bodies, of a leaf or of nodes above it.

    Returns:
        Whether all of them have such a half-space.
    """
    motion, bodies, normal = stated.motion, stated.bodies, work.vectors[0]
    count, degree, end = len(work.slopes), motion.degree, tree.press_end[leaf]
    rows = POINTS * count * len(bodies.at)
    for e in range(begun, end):
        y, row = tree.press[e], tree.press_row[e]
        if not (y >= 0 and 0 <= row < rows * (depth + 1)):
            return False
        if y == 0:
            continue
        d, row = depth - row // rows, row % rows
        choice, at = row // POINTS + 2 * count, row % POINTS
        j, k = choice // count - 2, choice % count
        i = bodies.at[j, k, at]
        part, span, corners = region.part[d], region.span[d], region.corners[d]
        out, off, terms = side_of(stated, choice, part, span, corners, normal)
        if i < 0 or terms < 0:
            return False
        counted(work.total, y * (out - off), y * terms)
        for c in range(stated.n):
            normal[c] = -y * normal[c]
        # An inner Bernstein control point is ahead of, or behind, the nearest end by its velocity.
        late, led = 1 if 2 * i > degree else 0, 0 * y
        if 0 < i < degree:
            led = -motion.lead if late == 1 else motion.lead
        _forced(work.total, work.flown, k + late, (1, led), normal, bodies.places[j, k, at])
    return True


@generic
def towed(stated, tether, point, total, slopes):
    """Add the slopes of multipliers of turns; return whether there is a limit for each."""
    chord, n, tied = stated.chord, stated.n, stated.start[TIED]
    for k in range(len(tether)):
        steep = size_of(tether[k], n)
        if steep == 0:
            continue
        if chord < 0 or k < stated.begun:
            return False
        counted(total, -chord * steep, chord * steep)
        for c in range(n):
            pull, z, before = tether[k, c], point[k, c], point[k - 1, c] if k > 0 else tied[c]
            counted(total, pull * (z - before), abs(pull) * (abs(z) + abs(before)))
            slopes[k, c] = slopes[k, c] + pull
            if k > 0:
                slopes[k - 1, c] = slopes[k - 1, c] - pull
    return True


@generic
def slid(stated, slide, total, flown):
    """Add the multipliers of the glide slope; return whether they are in its dual cone."""
    sine, cosine = stated.sine - 2 * slack(stated.cosine), stated.cosine + 2 * slack(stated.cosine)
    for k in range(len(slide)):
        down, square = -slide[k, 2], slide[k, 0] ** 2 + slide[k, 1] ** 2
        if down == 0 and square == 0:
            continue
        if not sine > 0 or down < 0 or cosine * cosine * square > sine * sine * down * down:
            return False
        eased = down * stated.goals[k, 3] / stated.cosine
        counted(total, -eased, 2 * eased)
        _forced(total, flown, k + 1, (1, 0), slide[k], stated.goals[k])
    return True


@generic
def pulled(stated, pull, total, flown):
    """Add the multipliers of an arrival."""
    count = len(stated.goals)
    for i in range(len(pull)):
        _forced(total, flown, count, (1 - i, i), pull[i], stated.goals[count - 1])
