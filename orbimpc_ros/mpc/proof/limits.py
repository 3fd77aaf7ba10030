# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The limits of a problem from one state, as proofs state them: cones, bodies, speeds.

Whatever a state eases (who is outside of a cone, or inside of a margin) is a number here, which
proofs take for granted.

Mathematics: docs/mathematics.md, 3.7 to 3.10, and docs/proofs.md.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Ball, Box, Problem, State
from orbimpc_ros.mpc.problem.approach import LEEWAY
from orbimpc_ros.mpc.problem.cones import relief
from orbimpc_ros.mpc.problem.pace import entry_speed
from orbimpc_ros.mpc.problem.traffic import traffic_of

END, ENDS, STEP = range(3)  # what of a step is on one side of a body
NOTHING: Array = np.zeros(0)


class Cone(NamedTuple):
    """Directions that headings of some steps are in.

    At its least speed it ends flat: z . axis >= cos(angle) max(|z|, least).

    Attributes:
        axis: of any length, n numbers.
        angle: [rad].
        least: share of full speed.
        steps: k >= 1.
    """

    axis: tuple[float, ...]
    angle: float
    least: float
    steps: tuple[int, ...]


class Body(NamedTuple):
    """A box, or a ball, that plans are outside of.

    Attributes:
        low: corner, shape (n,); of a ball its centre [m].
        high: corner; of a ball its centre.
        radius: of a ball [m]; 0 of a box.
        of: what of each step is on one of its sides: its ``END``; both ``ENDS``, from the second
            step on; or all of the ``STEP``, that is, its control points.
        shifts: by how much it has moved by the ends of steps 0..N, shape (N + 1, n) [m].
        grown: by how much it counts as larger in each step, shape (N,) [m].
    """

    low: Array
    high: Array
    radius: float
    of: int
    shifts: Array
    grown: Array


class Limits(NamedTuple):
    """What a problem's own numbers do not say.

    Attributes:
        cones: of the tilt, where it is not eased, and of the approach.
        glide_slope: angle [rad]; 0 without.
        eased: by how much s_1..s_N may be outside of it, shape (N,) [m].
        bodies: in the order in which choices number them.
        entry: share of full speed that changes begin from.
        change: by how much it changes in a step at most; infinity without a limit.
    """

    cones: tuple[Cone, ...] = ()
    glide_slope: float = 0.0
    eased: Array = NOTHING
    bodies: tuple[Body, ...] = ()
    entry: float = 0.0
    change: float = math.inf


NO_LIMITS = Limits()


def limits_of(problem: Problem, state: State, goals: Array) -> Limits:
    """Return the limits of a problem from a state to goals g_1..g_N, shape (N, n) [m]."""
    plain = not (problem.has_cones or problem.approach.exists or problem.max_acceleration)
    if plain and not (problem.obstacles or state.hazards):
        return NO_LIMITS
    cones, slope = list[Cone](), 0.0
    eased: Array = NOTHING
    if problem.has_cones:
        outside = relief(problem, state, goals)
        if problem.tilt:
            steps = tuple((1 + np.flatnonzero(outside.tilt == 0.0)).tolist())
            cones.append(Cone((0.0, 0.0, 1.0), problem.tilt, 0.0, steps))
        if problem.glide_slope:
            slope, eased = problem.glide_slope, outside.slope
    if problem.approach.exists:
        axis, wide = tuple(problem.approach.axis(state).tolist()), problem.approach.cone + LEEWAY
        cones.append(Cone(axis, wide, problem.least_heading, (problem.horizon,)))
    entry, change = 0.0, math.inf
    if problem.max_acceleration and problem.rotation_order == 1:
        entry, change = entry_speed(problem, state), problem.speed_change
    return Limits(tuple(cones), slope, eased, bodies_of(problem, state), entry, change)


def bodies_of(problem: Problem, state: State) -> tuple[Body, ...]:
    """Return what plans are outside of: boxes at rest; then each other body twice.

    Of these the end of a step alone is held closer than the hull of its control points.
    """
    n, count = problem.dimension, problem.horizon
    still, kept = np.zeros((count + 1, n)), np.zeros(count)
    of = ENDS if problem.no_corner_cutting else END
    found = [Body(each.minimum, each.maximum, 0.0, of, still, kept) for each in problem.boxes]
    traffic = traffic_of(problem, state)
    if traffic is None:
        return tuple(found)
    for body, shifts, grown in zip(traffic.bodies, traffic.shifts, traffic.grown, strict=True):
        found += [_moving(body, of, shifts, grown) for of in (END, STEP)]
    return tuple(found)


def _moving(body: Box | Ball, of: int, shifts: Array, grown: Array) -> Body:
    if isinstance(body, Ball):
        return Body(body.centre, body.centre, body.radius, of, shifts, grown)
    return Body(body.minimum, body.maximum, 0.0, of, shifts, grown)
