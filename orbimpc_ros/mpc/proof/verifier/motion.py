# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""How thrust axes z_0..z_N move a vehicle: positions, velocities, and the motion within steps."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise
from typing import Any, NamedTuple

from .exact import ONE, ZERO, Vector
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
    flown: Vector
    push: Fraction
    add: Fraction
    follow: Fraction
    after: Fraction
    blow: Fraction
    gust: Fraction


Begin = tuple[Fraction, Fraction, Fraction]  # s_0, p_0 and w along an axis


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


def rolled(model: StatedModel, begin: Begin, z: Vector) -> tuple[Vector, Vector]:
    """Return s_0..s_N and p_0..p_N along an axis, given s_0, p_0 and w, and z_0..z_N there."""
    s, p, w = begin
    blown, hastened = model.blow * w, model.gust * w
    positions, velocities = [s], [p]
    for now, then in pairwise(z):
        s += model.push * now + model.follow * then + blown
        if model.inertial:
            s += model.step * p
            p += model.add * now + model.after * then + hastened
        positions.append(s)
        velocities.append(p)
    return positions, velocities


def places(model: StatedModel, begins: list[Begin], first: Vector, horizon: int) -> list[Step]:
    """Return the control points of each step, in whose hull it is (Bernstein).

    Args:
        model: of the motion.
        begins: s_0, p_0 and w along each axis.
        first: z_0.
        horizon: N.
    """
    still = [ZERO] * horizon
    free = [_controls(model, begin, [z, *still]) for begin, z in zip(begins, first, strict=True)]
    units = ([ZERO] * (j + 1) + [ONE] + [ZERO] * (horizon - j - 1) for j in range(horizon))
    reach = [_controls(model, (ZERO, ZERO, ZERO), unit) for unit in units]
    return [
        [
            Place([axis[k][i] for axis in free], [each[k][i] for each in reach])
            for i in range(model.degree + 1)
        ]
        for k in range(horizon)
    ]


def _controls(model: StatedModel, begin: Begin, z: Vector) -> list[Vector]:
    """Return the control points of each step along an axis."""
    s, v = rolled(model, begin, z)
    if not model.inertial:
        v = [model.forward * each + begin[2] for each in z]
    lead = model.step / model.degree
    inner = [[], [1], [1, 2]][model.degree - 1]
    found = []
    for k in range(len(z) - 1):
        points = s[k], s[k] + lead * v[k], s[k + 1] - lead * v[k + 1], s[k + 1]
        found.append([points[i] for i in (0, *inner, 3)])
    return found
