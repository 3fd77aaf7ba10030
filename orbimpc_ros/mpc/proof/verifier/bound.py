# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The bound of a leaf: the least value of a tangent of the cost, over what is known.

With bends t_k, f_t(x) = f(x) + sum_k t_k |x_k|^2 / 2, its tangent c + g . x at x', and lengths l_k,
no trajectory costs less than

    c + sum_k min (g_k . x_k + l_k |z_k| - t_k |x_k|^2 / 2).

Derivation: docs/proofs.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from operator import sub
from typing import Any, NamedTuple

from . import least
from .cost import Added, hessian, tangent
from .exact import TINY, UNIT, ZERO, Matrix, Vector, across, lacking, size_above, size_below
from .reading import Refused, Work, fields, rows, vector, weight
from .regions import Region, Side
from .splits import leaves, root
from .stated import StatedProblem


class StatedLeaf(NamedTuple):
    """Where a tangent touches, and multipliers; docs/proofs.md has what each is."""

    point: list[Vector]
    bends: Vector
    pull: list[Vector]
    stiffness: Fraction
    tops: Vector
    shares: list[Vector]
    presses: Vector
    slides: list[Vector]
    tethers: list[Vector]
    meets: Vector


def bounds(posed: StatedProblem, tree: Any, origins: Any, work: Work) -> list[Fraction]:
    """Return the bounds of a tree's leaves, of which all that there is has the least."""
    found = []
    for leaf, part in leaves(posed, tree, root(posed, origins), work.spend):
        work.spend(_work(posed, leaf, part))
        found.append(bound(posed, leaf, part))
    if not found:
        raise Refused('the tree has no leaf')
    return found


def _work(posed: StatedProblem, stated: Any, region: Region) -> int:
    """Return about how many microseconds a leaf takes."""
    count, around = posed.horizon, sum(map(len, posed.limits.cones))
    work = 25 * count + 10 * around + count * len(region.rows) + count * count * posed.width // 8
    bends = stated.get('bends') if isinstance(stated, dict) else None
    bent = isinstance(bends, list) and any(isinstance(x, (int, float)) and x < 0 for x in bends)
    return work + bent * count**3 // 4


def bound(posed: StatedProblem, stated: Any, region: Region) -> Fraction:
    """Return the bound that a leaf proves: a tangent's least value over a region.

    Without a point the cost is as good as nothing, which it is not below: multipliers are left.
    """
    fields(stated, 'a leaf', (), StatedLeaf._fields)
    posed = posed if 'point' in stated else posed.costless
    leaf = _leaf(posed, stated, region)
    push, paid = _pushed(posed, leaf)
    tows, held = towed(posed, leaf.tethers)
    tows, borne = pressed(across(tows), leaf.presses, region.rows)
    touched = across(leaf.point)
    value, slopes = tangent(posed, touched, Added(leaf.bends, leaf.stiffness, across(push), tows))
    flown = posed.weights.length[0] * size_below(posed.axis(posed.state.first))
    value += math.floor(UNIT * (flown + paid + held + borne - _unbent(posed, leaf, touched)))
    steps = (_of_step(posed, leaf, region, k, g) for k, g in enumerate(across(slopes)))
    return Fraction(value + sum(steps), UNIT)


def _leaf(posed: StatedProblem, stated: Any, region: Region) -> StatedLeaf:
    """Read a leaf; what it does not mention is zero."""
    horizon, n = posed.horizon, posed.n

    def numbers(name: str, count: int) -> Vector:
        return vector(stated[name], name, count) if name in stated else Vector([0] * count)

    def vectors(name: str, length: int) -> list[Vector]:
        if name not in stated:
            return [Vector([0] * length)] * horizon
        return rows(stated[name], name, horizon, length)

    return StatedLeaf(
        vectors('point', posed.width),
        numbers('bends', horizon),
        numbers('pull', n * (1 + posed.model.inertial) if posed.arrives else 0).pieces(n),
        weight(stated.get('stiffness', 0.0), 'stiffness') if posed.arrives else ZERO,
        numbers('tops', horizon),
        vectors('shares', n),
        numbers('presses', len(region.rows)),
        vectors('slides', n),
        vectors('tethers', n),
        numbers('meets', n if posed.radius is not None else 0),
    )


def _pushed(posed: StatedProblem, leaf: StatedLeaf) -> tuple[list[Vector], Fraction]:
    """Return forces F on s_k - g_k, and on p_N, and an a such that a + sum F . (..) <= 0.

    What meets the goal within a radius has c . (s_N - g_N) <= radius |c|; what arrives is there.
    """
    push, last = [*leaf.slides, *[Vector([0] * posed.n)] * posed.model.inertial], posed.horizon - 1
    paid = sum((slid(posed, k, c) for k, c in enumerate(leaf.slides) if c), ZERO)
    for k, pull in enumerate(leaf.pull, last):
        push[k] += pull
    if posed.radius is not None:
        push[last] += leaf.meets
        paid -= posed.radius * size_above(leaf.meets)
    return push, paid


def pressed(
    tows: list[Vector], presses: Vector, sides: Sequence[Side]
) -> tuple[list[Vector], Fraction]:
    """Return forces F, axis by axis, added to some, and an a such that a + sum_k F_k . z_k <= 0.

    A row n . v >= b that is pressed by y >= 0 adds y (b - n . v), v = free + sum_k reach_k z_k.
    """
    borne = ZERO
    for y, (place, normal, low) in zip(presses, sides, strict=True):
        if y < 0:
            raise Refused('presses are negative')
        if y:
            borne += y * (low - normal @ place.free)
            reach = place.reach.pieces(len(tows[0]))[0]
            tows = [own - reach * (y * x) for own, x in zip(tows, normal, strict=True)]
    return tows, borne


def slid(posed: StatedProblem, k: int, c: Vector) -> Fraction:
    """Return an a such that a + c . d <= 0 for all d = s_{k+1} - g_{k+1} along the glide slope.

    Within the cone above the goal c . d <= 0, and as much more as that is eased.
    """
    slope = posed.limits.slope
    if slope is None or c[2] > 0:
        raise Refused('slides are not along the glide slope')
    aside = (c[0] * c[0] + c[1] * c[1]) * (slope.cosine + TINY) ** 2
    if aside > (c[2] * max(ZERO, slope.sine - TINY)) ** 2:
        raise Refused('slides are not along the glide slope')
    return c[2] * slope.eased[k] / (slope.cosine - TINY)


def towed(posed: StatedProblem, tethers: list[Vector]) -> tuple[list[Vector], Fraction]:
    """Return forces F, shape (N, n), and an a such that a + sum_k F_k . z_k <= 0.

    Where |z_{k+1} - z_k| <= c, a tether y adds y . (z_{k+1} - z_k) - c |y|.
    """
    tied = posed.limits.tether
    if not any(tethers):
        return tethers, ZERO
    if tied is None:
        raise Refused('tethers where no turns are limited')
    held = -(tethers[0] @ tied.begin) - tied.length * sum(map(size_above, tethers), ZERO)
    later = [*tethers[1:], Vector([0] * posed.n)]
    return [y - z for y, z in zip(tethers, later, strict=True)], held


def _unbent(posed: StatedProblem, leaf: StatedLeaf, touched: list[Vector]) -> Fraction:
    """Return by how much a tangent of the cost with its bends can be above it, with |x_k| <= 1.

    Where its matrix lacks e of being semidefinite, that is less than e |x - x'|^2 / 2, which is at
    most e (1 + |x'_k|^2), added up.
    """
    if posed.width == 9 and leaf.bends:
        raise Refused('bends over SO(3) are beyond this format')
    if min(leaf.bends.numbers) >= 0:
        return ZERO
    if posed.order == 2:
        raise Refused('negative bends at rotation order 2 are beyond this format')
    (*bent, bends), unit = Matrix.of([*hessian(posed, leaf.stiffness), leaf.bends])
    bent = [[*row[:k], row[k] + bends[k], *row[k + 1 :]] for k, row in enumerate(bent)]
    return lacking(Matrix(bent, unit)) * (posed.horizon + sum(x @ x for x in touched))


def _of_step(posed: StatedProblem, leaf: StatedLeaf, region: Region, k: int, slope: Vector) -> int:
    """Return what a step adds to a bound, in units: its part of the tangent, where it is least.

    Rounding slopes takes off less than a unit of each coordinate, none of which is above one.
    """
    if k == 0 and posed.order == 2:
        return math.floor(UNIT * _least_decided(posed, slope, leaf.bends.above(k)))
    value, near, share = -posed.width, slope.rounded(), leaf.shares[k].rounded()
    face = region.faces[k]
    if posed.width == 9:
        rest = [*map(sub, near, share), *near[posed.n :]]
        value, near = value + least.over_orbitope(rest, leaf.tops.above(k)), share
    elif face is not None:
        rest = list(map(sub, near, share))
        value, near = value + least.beyond(rest, posed.floor, face), share
    elif any(share):
        rest = list(map(sub, near, share))
        value, near = value + _least_in_cones(posed, region, k, share), rest
    return value + _least(posed, region, k, near, leaf.bends.above(k))


def _least(posed: StatedProblem, region: Region, k: int, slope: list[int], bend: int) -> int:
    """Return the least slope . z + l |z| - bend |z|^2 / 2 over what z_{k+1} can be, less faces."""
    length, sector = posed.weights.length[k + 1], region.sectors[k]
    if sector is not None and posed.floor.faces and not bend and not length:
        return least.reached(slope, posed.floor, sector)
    steepest = least.around(slope) if sector is None else least.within(slope, sector)
    cones = posed.limits.cones[k]
    steepest = max([steepest, *(least.towards(slope, cone) for cone in cones)])
    steepest += math.floor(UNIT * length) if length else 0
    found = least.over_speeds(steepest, bend, *region.speeds[k])  # a polygon is beyond, too
    return (
        found
        if bend or length or not cones
        else max(found, _least_in_cones(posed, region, k, slope))
    )


def _least_in_cones(posed: StatedProblem, region: Region, k: int, share: list[int]) -> int:
    """Return the least share . z over what one of the cones of a step holds.

    Where a cone ends, at its least speed, it is flat. What is linear is least around that; but not
    where anything else holds directions, too: there z may be shorter than the least speed.
    """
    if not posed.limits.cones[k]:
        raise Refused('shares have no cone that holds them')
    slowest, fastest = region.speeds[k]
    return max(
        least.over_speeds(least.towards(share, cone), 0, max(slowest, cone.slowest), fastest)
        for cone in posed.limits.cones[k]
    )


def _least_decided(posed: StatedProblem, slope: Vector, bend: int) -> Fraction:
    """Return the least where a body rate decides the first rotation, but for its length."""
    if bend:
        raise Refused('what is decided bends')
    state, length = posed.state, posed.weights.length[1]
    known = state.second if state.coasted is None else state.coasted
    there = slope @ known + length * size_below(posed.axis(known))
    return there if state.coasted is None else min(ZERO, there)
