# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""How thrust axes z_0..z_N move a vehicle: positions, velocities, and the motion within steps."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise
from typing import Any, NamedTuple

from .exact import ONE, ZERO, Vector, across
from .reading import Refused, weight, whole, word


class StatedModel(NamedTuple):
    """How a step moves along each axis.

    s -> s + h p + push z_k + follow z_{k+1} + blow w, and of its velocity, which stays 0 at
    translation order 1, p -> p + add z_k + after z_{k+1} + gust w.

    Attributes:
        step: h [s].
        inertial: whether it is of translation order 2.
        forward: speed, or acceleration, of a thrust axis of one.
        degree: of the motion within a step, as a polynomial of time.
        flown: how far each z_0..z_N is flown along.
    """

    step: Fraction
    inertial: bool
    forward: Fraction
    degree: int
    flown: list[Fraction]
    push: Fraction
    add: Fraction
    follow: Fraction
    after: Fraction
    blow: Fraction
    gust: Fraction


Begin = tuple[Vector, Vector, Vector]  # s_0, p_0 and w


class Place(NamedTuple):
    """Where a vehicle is: free + sum_k reach_k z_k, of z_1..z_N."""

    free: Vector
    reach: Vector


Step = list[Place]  # its control points, from its begin to its end


def model(problem: dict[str, Any], horizon: int) -> StatedModel:
    """Return the model that a problem states."""
    order = whole(problem['translation_order'], 'translation_order', 1, 2)
    kind = word(problem['discretisation'], 'discretisation', ('euler', 'exact', 'held'))
    h = weight(problem['step'], 'step')
    z = weight(problem['forward'], 'forward')
    models = {
        (1, 'euler'): (1, h * z, ZERO, ZERO, ZERO, h, ZERO),
        (1, 'exact'): (2, h * z / 2, ZERO, h * z / 2, ZERO, h, ZERO),
        (2, 'euler'): (1, ZERO, h * z, ZERO, ZERO, ZERO, h),
        (2, 'exact'): (3, h * h * z / 3, h * z / 2, h * h * z / 6, h * z / 2, h * h / 2, h),
        (2, 'held'): (2, ZERO, ZERO, h * h * z / 2, h * z, h * h / 2, h),
    }
    if not (h and z) or (order, kind) not in models:
        raise Refused('step, forward or discretisation is none that there is')
    late = {'euler': ZERO, 'exact': Fraction(1, 2), 'held': ONE}[kind]
    flown = [h * z * share for share in (1 - late, *[ONE] * (horizon - 1), late)]
    degree, *moved = models[order, kind]
    return StatedModel(h, order == 2, z, degree, flown, *moved)


def flown(
    model: StatedModel, begin: Begin, first: Vector, horizon: int
) -> tuple[list[Place], list[Place]]:
    """Return positions s_0..s_N and velocities at those times.

    What a z_j adds depends on how long ago it is alone, so that one of them says it of all.

    Args:
        model: of the motion.
        begin: s_0, p_0 and w.
        first: z_0.
        horizon: N.
    """
    nothing, once = Vector([0]), Vector([1])
    free = _rolled(model, begin, [first, *[first * ZERO] * horizon])
    added = _rolled(model, (nothing,) * 3, [nothing, once, *[nothing] * (horizon - 1)])  # by z_1
    positions, velocities = (
        [
            Place(known, Vector([*of_one.numbers[k:0:-1], *[0] * (horizon - k)], of_one.unit))
            for k, known in enumerate(alone)
        ]
        for alone, (of_one,) in zip(free, map(across, added), strict=True)
    )
    return positions, velocities


def _rolled(model: StatedModel, begin: Begin, z: list[Vector]) -> tuple[list[Vector], list[Vector]]:
    """Return s_0..s_N and the velocities at those times, given z_0..z_N."""
    s, p, w = begin
    blown, hastened = w * model.blow, w * model.gust
    positions, velocities = [s], [p]
    for now, then in pairwise(z):
        s = s + now * model.push + then * model.follow + blown
        if model.inertial:
            s = s + p * model.step
            p = p + now * model.add + then * model.after + hastened
        positions.append(s)
        velocities.append(p)
    return positions, velocities if model.inertial else [each * model.forward + w for each in z]


def steps(model: StatedModel, positions: list[Place], velocities: list[Place]) -> list[Step]:
    """Return the control points of each step, in whose hull it is (Bernstein)."""
    lead = model.step / model.degree
    inner = [[], [1], [1, 2]][model.degree - 1]
    found = []
    for begin, end in pairwise(zip(positions, velocities, strict=True)):
        points = begin[0], _led(*begin, lead), _led(*end, -lead), end[0]
        found.append([points[i] for i in (0, *inner, 3)])
    return found


def _led(place: Place, velocity: Place, time: Fraction) -> Place:
    """Return where a velocity leads from a place in a time."""
    return Place(*(x + v * time for x, v in zip(place, velocity, strict=True)))
