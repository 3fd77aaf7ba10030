# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The cost of a trajectory but for lengths, with its gradient: a sum of squares, and convex."""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple

from .exact import ONE, ZERO, Vector, Whole, add, dot, less, times, whole
from .motion import Place
from .stated import StatedProblem


class Added(NamedTuple):
    """What is added to the cost, and nowhere above zero.

    Where a trajectory has to arrive, c = (s_N - g_N, p_N) vanishes, and pull . c and
    stiffness |c|^2 / 2 can be added. So is sum_k push_k . (s_k - g_k), shape (N, n), with what is
    known of positions; and sum_k towed_k . z_k, with what is known of axes that follow each other.
    """

    pull: Vector
    stiffness: Fraction
    push: list[Vector]
    towed: list[Vector]


class Squares(NamedTuple):
    """Squares of y = free + sum_k reach_k x_k, of each coordinate of rotations alike.

    Attributes:
        weights: of each square.
        free: of each coordinate, that of all squares.
        rows: reach, of each square.
        columns: reach, of each x_k.
    """

    weights: Vector
    free: list[Vector]
    rows: list[Whole]
    columns: list[Whole]

    @classmethod
    def of(cls, weights: Vector, places: list[Place]) -> Squares:
        """Return the squares of places."""
        free = map(list, zip(*(place.free for place in places), strict=True))
        columns = zip(*(place.reach for place in places), strict=True)
        rows = [whole(place.reach) for place in places]
        return cls(weights, list(free), rows, [whole(each) for each in columns])

    def pushed(self, i: int, x: Vector, weights: Vector, push: Vector) -> tuple[Fraction, Vector]:
        """Return sum weight y^2 + push y, of a coordinate, and its gradient in x."""
        y = add(self.free[i], times(self.rows, x))
        weighed = [weight * each for weight, each in zip(weights, y, strict=True)]
        pushed = add(weighed, push)
        return dot(pushed, y), times(self.columns, add(weighed, pushed))


def cost(posed: StatedProblem, x: list[Vector], added: Added) -> tuple[Fraction, list[Vector]]:
    """Return the cost but for lengths at x_1..x_N, shape (N, d), and its gradient."""
    (turned, flown), value, slopes = _squares(posed), ZERO, []
    weights, unpushed = _stiff(posed, added.stiffness), [ZERO] * len(turned.weights)
    for i, along in enumerate(map(list, zip(*x, strict=True))):
        slope, parts = [ZERO] * posed.horizon, [(turned, turned.weights, unpushed)]
        if i < posed.n:
            slope = [each[i] for each in added.towed]
            value += dot(slope, along)
            parts.append((flown, weights, _push(posed, added, i)))
        for squares, weighed, push in parts:
            if any(weighed) or any(push):
                worth, steeper = squares.pushed(i, along, weighed, push)
                value, slope = value + worth, add(slope, steeper)
        slopes.append(slope)
    return value, list(map(list, zip(*slopes, strict=True)))


def _push(posed: StatedProblem, added: Added, i: int) -> Vector:
    """Return what pushes s_1..s_N and p_N along axis i."""
    last = posed.horizon - 1
    found = [*(each[i] for each in added.push), *[ZERO] * posed.model.inertial]
    for j, pull in enumerate(added.pull[i :: posed.n]):
        found[last + j] += pull
    return found


def _stiff(posed: StatedProblem, stiffness: Fraction) -> Vector:
    """Return the weights on what is flown, more of them on s_N and p_N."""
    weights, last = _squares(posed)[1].weights, posed.horizon - 1
    return [*weights[:last], *(weight + stiffness / 2 for weight in weights[last:])]


@lru_cache(maxsize=4)
def _squares(posed: StatedProblem) -> tuple[Squares, Squares]:
    """Return what turns cost, of all coordinates; and s_k - g_k and p_N, of the axes of space."""
    order, still = posed.order, [ZERO] * posed.horizon
    stencil = [-ONE, ONE] if order == 1 else [ONE, -2 * ONE, ONE]
    turned, worth = [], posed.weights.input / posed.model.step ** (2 * order)
    for k in range(posed.horizon + 1 - order if worth else 0):
        first, *reach = *still[:k], *stencil, *still[: posed.horizon - order - k]
        turned.append(Place([first * each for each in posed.state.first], reach))
    weights = [worth] * len(turned)
    if posed.weights.attitude:
        turned.append(Place([-each for each in posed.state.wanted], [*still[1:], ONE]))
        weights.append(posed.weights.attitude)
    ends = zip(posed.positions[1:], posed.goals, strict=True)
    flown = [Place(less(place.free, goal), place.reach) for place, goal in ends]
    last = posed.velocities[-1:] if posed.model.inertial else []
    braking = [posed.weights.braking] * len(last)
    return Squares.of(weights, turned), Squares.of(
        [*posed.weights.position, *braking], [*flown, *last]
    )


@lru_cache(maxsize=4)
def hessian(posed: StatedProblem, stiffness: Fraction) -> list[Vector]:
    """Return the Hessian of the cost in z_1..z_N along one axis, shape (N, N)."""
    found = [[ZERO] * posed.horizon for _ in range(posed.horizon)]
    turned, flown = _squares(posed)
    for squares, weights in ((turned, turned.weights), (flown, _stiff(posed, stiffness))):
        for k, (numbers, unit) in enumerate(squares.columns):
            bent = [
                2 * weight * Fraction(y, unit) for weight, y in zip(weights, numbers, strict=True)
            ]
            found[k] = add(found[k], times(squares.columns, bent))
    return found
