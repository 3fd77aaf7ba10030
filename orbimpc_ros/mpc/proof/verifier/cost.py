# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The cost of a trajectory but for lengths: a sum of squares, and convex; and its tangents."""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple

from .exact import ONE, Matrix, Vector, across
from .motion import Place
from .stated import StatedProblem


class Added(NamedTuple):
    """What is added to the cost: bends, and what is nowhere above zero.

    Where a trajectory has to arrive, c = (s_N - g_N, p_N) vanishes, and stiffness |c|^2 / 2 can be
    added.

    Attributes:
        bends: of sum_k bends_k |x_k|^2 / 2, shape (N,).
        stiffness: of an arrival.
        push: of sum_k push_k . (s_k - g_k), and of p_N where there is inertia; axis by axis.
        towed: of sum_k towed_k . z_k, axis by axis.
    """

    bends: Vector
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
    rows: Matrix
    columns: Matrix

    @classmethod
    def of(cls, weights: list[Fraction], places: list[Place]) -> Squares:
        """Return the squares of places."""
        rows = Matrix.of([place.reach for place in places])
        return cls(Vector.of(weights), across([each.free for each in places]), rows, rows.columns)

    def tangent(self, i: int, x: Vector, push: Vector) -> tuple[int, Vector]:
        """Return c and g: of a coordinate, sum weight y^2 + push y is nowhere below c + g . x.

        Its slope in y is q = 2 weight y + push; where x is zero, it is q . free - sum weight y^2.
        """
        y = self.free[i] + self.rows @ x
        weighed = self.weights.each(y)
        slope = weighed + weighed + push
        return slope.dot(self.free[i]) - weighed.dot(y) - 1, self.columns @ slope


def tangent(posed: StatedProblem, x: list[Vector], added: Added) -> tuple[int, list[Vector]]:
    """Return c, in units, and g: the cost and what is added are nowhere below c + sum_i g_i . x_i.

    Args:
        posed: whose cost it is.
        x: where it touches, coordinate by coordinate, shape (d, N).
        added: to the cost.
    """
    (turned, flown), value, slopes = _squares(posed, added.stiffness), 0, []
    still = Vector([0] * len(turned.weights))
    for i, along in enumerate(x):
        slope = added.bends.each(along)
        value -= slope.dot(along) // 2 + 1
        parts = [(turned, still)]
        if i < posed.n:
            slope = slope + added.towed[i]
            parts.append((flown, added.push[i]))
        for squares, push in parts:
            if squares.weights or push:
                worth, steeper = squares.tangent(i, along, push)
                value, slope = value + worth, slope + steeper
        slopes.append(slope)
    return value, slopes


def _squares(posed: StatedProblem, stiffness: Fraction) -> tuple[Squares, Squares]:
    """Return what turns cost; and what is flown, with as much more on s_N and p_N."""
    (turned, flown), last = _unstiffened(posed), posed.horizon - 1
    ends = Vector([0] * last + [1] * (len(flown.weights) - last))
    return turned, flown._replace(weights=flown.weights + ends * (stiffness / 2))


@lru_cache(maxsize=4)
def _unstiffened(posed: StatedProblem) -> tuple[Squares, Squares]:
    """Return what turns cost, of all coordinates; and s_k - g_k and p_N, of the axes of space."""
    order, horizon, state = posed.order, posed.horizon, posed.state
    stencil = [-1, 1] if order == 1 else [1, -2, 1]
    turned = [Place(state.wanted * -ONE, Vector([*[0] * (horizon - 1), 1]))]
    for k in range(horizon + 1 - order):
        first, *reach = *[0] * k, *stencil, *[0] * (horizon - order - k)
        turned.append(Place(state.first * Fraction(first), Vector(reach)))
    weights = [posed.weights.attitude] + [posed.weights.turned] * (len(turned) - 1)
    ends = zip(posed.positions[1:], posed.goals, strict=True)
    flown = [Place(place.free - goal, place.reach) for place, goal in ends]
    if posed.model.inertial:
        flown.append(posed.velocities[-1])
    return Squares.of(weights, turned), Squares.of(posed.weights.flown, flown)


@lru_cache(maxsize=4)
def hessian(posed: StatedProblem, stiffness: Fraction) -> list[Vector]:
    """Return the Hessian of the cost in z_1..z_N along one axis, shape (N, N)."""
    both = (
        [
            squares.columns @ (squares.weights + squares.weights).each(column)
            for column in squares.columns.vectors
        ]
        for squares in _squares(posed, stiffness)
    )
    return [a + b for a, b in zip(*both, strict=True)]
