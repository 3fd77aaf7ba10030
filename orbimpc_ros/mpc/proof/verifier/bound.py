# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The bound of a leaf: the least value of a tangent of the cost, over what is known.

With bends t_k, f_t(x) = f(x) + sum_k t_k |x_k|^2 / 2, its gradient g at x', and lengths l_k, no
trajectory costs less than

    f_t(x') - g . x' + sum_k min (g_k . x_k + l_k |z_k| - t_k |x_k|^2 / 2).

Derivation: docs/proofs.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any, NamedTuple

from .cost import Added, cost, hessian
from .exact import TINY, ZERO, Vector, dot, lacking, less, size_above, size_below
from .least import (
    least_along,
    least_beyond,
    least_over_orbitope,
    least_reached,
    least_towards,
    least_within,
)  # fmt: skip
from .reading import Refused, fields, rows, vector, weight
from .regions import Region, Side
from .stated import StatedProblem, costless

LEAF = ('bends', 'pull', 'stiffness', 'tops', 'shares', 'presses', 'slides', 'tethers', 'meets')


class StatedLeaf(NamedTuple):
    """Where a tangent touches, and multipliers; docs/proofs.md has what each is."""

    point: list[Vector]
    bends: Vector
    pull: Vector
    stiffness: Fraction
    tops: Vector
    shares: list[Vector]
    presses: Vector
    slides: list[Vector]
    tethers: list[Vector]
    meets: Vector


def bound(posed: StatedProblem, stated: Any, region: Region) -> Fraction:
    """Return the bound that a leaf proves: a tangent's least value over a region.

    Without a point the cost is as good as nothing, which it is not below: multipliers are left.
    """
    if isinstance(stated, dict) and 'point' not in stated:
        posed = costless(posed)
        stated = {**stated, 'point': [[0.0] * posed.n] * posed.horizon}
    leaf = _leaf(posed, stated, region)
    push, paid = _pushed(posed, leaf)
    forces, held = towed(posed, leaf.tethers)
    forces, borne = pressed(forces, leaf.presses, region.rows)
    value, slopes = cost(posed, leaf.point, Added(leaf.pull, leaf.stiffness, push, forces))
    value += (
        paid + held + borne + posed.weights.length[0] * size_below(posed.state.first[: posed.n])
    )
    value -= _unbent(posed, leaf)
    return value + sum(_of_step(posed, leaf, region, k, g) for k, g in enumerate(slopes))


def _leaf(posed: StatedProblem, stated: Any, region: Region) -> StatedLeaf:
    """Read a leaf; what it does not mention is zero."""
    fields(stated, 'a leaf', ('point',), LEAF)
    horizon, n = posed.horizon, posed.n

    def numbers(name: str, count: int) -> Vector:
        return vector(stated.get(name, [0.0] * count), name, count)

    def vectors(name: str) -> list[Vector]:
        return rows(stated.get(name, [[0.0] * n] * horizon), name, horizon, n)

    pulled = n * (1 + posed.model.inertial) if posed.arrives else 0
    return StatedLeaf(
        rows(stated['point'], 'point', horizon, posed.width),
        numbers('bends', horizon),
        numbers('pull', pulled),
        weight(stated.get('stiffness', 0.0), 'stiffness') if posed.arrives else ZERO,
        numbers('tops', horizon),
        vectors('shares'),
        numbers('presses', len(region.rows)),
        vectors('slides'),
        vectors('tethers'),
        numbers('meets', 0 if posed.radius is None else n),
    )


def _pushed(posed: StatedProblem, leaf: StatedLeaf) -> tuple[list[Vector], Fraction]:
    """Return forces F, shape (N, n), and an a such that a + sum_k F_k . (s_k - g_k) <= 0.

    What meets the goal within a radius has c . (s_N - g_N) <= radius |c|.
    """
    push = leaf.slides.copy()
    paid = sum((slid(posed, k, c) for k, c in enumerate(push) if any(c)), ZERO)
    if posed.radius is not None:
        push[-1] = [x + y for x, y in zip(push[-1], leaf.meets, strict=True)]
        paid -= posed.radius * size_above(leaf.meets)
    return push, paid


def pressed(
    forces: list[Vector], presses: Vector, sides: Sequence[Side]
) -> tuple[list[Vector], Fraction]:
    """Return forces F, shape (N, n), added to some, and an a such that a + sum_k F_k . z_k <= 0.

    A row n . v >= b that is pressed by y >= 0 adds y (b - n . v), v = free + sum_k reach_k z_k.
    """
    borne = ZERO
    for y, (place, normal, least) in zip(presses, sides, strict=True):
        if y < 0:
            raise Refused('presses are negative')
        if y:
            borne += y * (least - dot(normal, place.free))
            push = [y * x for x in normal]
            pairs = zip(forces, place.reach, strict=True)
            forces = [less(own, [r * x for x in push]) if r else own for own, r in pairs]
    return forces, borne


def slid(posed: StatedProblem, k: int, c: Vector) -> Fraction:
    """Return an a such that a + c . d <= 0 for all d = s_{k+1} - g_{k+1} along the glide slope.

    Within the cone above the goal c . d <= 0, and as much more as that is eased.
    """
    slope = posed.limits.slope
    if slope is None or c[2] > 0:
        raise Refused('slides are not along the glide slope')
    aside = (c[0] * c[0] + c[1] * c[1]) * (slope.cosine + TINY) ** 2
    if aside > (c[2] * (slope.sine - TINY)) ** 2:
        raise Refused('slides are not along the glide slope')
    return c[2] * slope.eased[k] / (slope.cosine - TINY)


def towed(posed: StatedProblem, tethers: list[Vector]) -> tuple[list[Vector], Fraction]:
    """Return forces F, shape (N, n), and an a such that a + sum_k F_k . z_k <= 0.

    Where |z_{k+1} - z_k| <= c, a tether y adds y . (z_{k+1} - z_k) - c |y|.
    """
    tied = posed.limits.tether
    if not any(map(any, tethers)):
        return tethers, ZERO
    if tied is None:
        raise Refused('tethers where no turns are limited')
    held = -dot(tethers[0], tied.begin) - tied.length * sum(map(size_above, tethers), ZERO)
    later = [*tethers[1:], [ZERO] * posed.n]
    return [less(y, z) for y, z in zip(tethers, later, strict=True)], held


def _unbent(posed: StatedProblem, leaf: StatedLeaf) -> Fraction:
    """Return by how much a tangent of the cost with its bends can be above it, with |x_k| <= 1.

    Where its matrix lacks e of being semidefinite, that is less than e |x - x'|^2 / 2, which is at
    most e (1 + |x'_k|^2), added up.
    """
    if posed.width == 9 and any(leaf.bends):
        raise Refused('bends over SO(3) are beyond this format')
    if min(leaf.bends) >= 0:
        return ZERO
    if posed.order == 2:
        raise Refused('negative bends at rotation order 2 are beyond this format')
    matrix = [row.copy() for row in hessian(posed, leaf.stiffness)]
    for k, bend in enumerate(leaf.bends):
        matrix[k][k] += bend
    return lacking(matrix) * sum(1 + dot(x, x) for x in leaf.point)


def _of_step(
    posed: StatedProblem, leaf: StatedLeaf, region: Region, k: int, slope: Vector
) -> Fraction:
    """Return what a step adds to a bound: its part of the tangent, where that is least."""
    x, bend = leaf.point[k], leaf.bends[k]
    tangent = [g + bend * y for g, y in zip(slope, x, strict=True)] if bend else slope
    value = bend * dot(x, x) / 2 - dot(tangent, x)
    if k == 0 and posed.order == 2:
        return value + _least_decided(posed, tangent, bend)
    share, face = leaf.shares[k], region.faces[k]
    if posed.width == 9:
        value += least_over_orbitope(less(tangent, share), leaf.tops[k])
        tangent = share
    elif face is not None:
        value += least_beyond(less(tangent, share), posed.floor, face)
        tangent = share
    elif any(share):
        value += _least_in_cones(posed, region, k, share)
        tangent = less(tangent, share)
    return value + _least(posed, region, k, tangent, bend)


def _least(posed: StatedProblem, region: Region, k: int, slope: Vector, bend: Fraction) -> Fraction:
    """Return the least slope . z + l |z| - bend |z|^2 / 2 over what z_{k+1} can be, less faces."""
    length, sector = posed.weights.length[k + 1], region.sectors[k]
    if sector is not None and posed.floor.faces and not bend and not length:
        return least_reached(slope, posed.floor, sector)
    steepest = -size_above(slope) if sector is None else least_within(slope, sector)
    steepest = max([steepest, *(least_towards(slope, cone) for cone in posed.limits.cones[k])])
    # Where cones end, it is flat. What is linear is least around that.
    slowest, fastest = region.speeds[k]
    if not (bend or length):
        slowest = max(slowest, posed.limits.least[k])
    return least_along(steepest + length, bend, slowest, fastest)  # a polygon is beyond, too


def _least_in_cones(posed: StatedProblem, region: Region, k: int, share: Vector) -> Fraction:
    """Return the least share . z over what the cones of a step hold, whatever else does."""
    limits = posed.limits
    if not limits.cones[k]:
        raise Refused('shares have no cone that holds them')
    steepest = max(least_towards(share, cone) for cone in limits.cones[k])
    slowest, fastest = region.speeds[k]
    return least_along(steepest, ZERO, max(slowest, limits.least[k]), fastest)


def _least_decided(posed: StatedProblem, slope: Vector, bend: Fraction) -> Fraction:
    """Return the least where a body rate decides the first rotation, but for its length."""
    if bend:
        raise Refused('what is decided bends')
    state, length = posed.state, posed.weights.length[1]
    known = state.second if state.coasted is None else state.coasted
    there = dot(slope, known) + length * size_below(known[: posed.n])
    return there if state.coasted is None else min(ZERO, there)
