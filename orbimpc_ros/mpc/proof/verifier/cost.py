# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The cost of a trajectory but for lengths, with its gradient: a sum of squares, and convex."""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple

from .exact import ONE, ZERO, Vector, dot, less
from .motion import rolled
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


def cost(posed: StatedProblem, x: list[Vector], added: Added) -> tuple[Fraction, list[Vector]]:
    """Return the cost but for lengths at x_1..x_N, shape (N, d), and its gradient."""
    value, slopes = _turning(posed, [posed.state.first, *x])
    for i in range(posed.n):
        flown, on_axis = _flight(posed, i, [posed.state.first[i], *(z[i] for z in x)], added)
        value += flown
        for slope, more in zip(slopes, on_axis, strict=True):
            slope[i] += more
    return value, slopes[1:]


def _flight(posed: StatedProblem, i: int, z: Vector, added: Added) -> tuple[Fraction, Vector]:
    """Return the cost of positions along axis i, given z_0..z_N there, and its gradient."""
    positions, velocities = rolled(posed.model, posed.state.begins[i], z)
    missed, p = less(positions[1:], [goal[i] for goal in posed.goals]), velocities[-1]
    braking, pushed = posed.weights.braking, [each[i] for each in added.push]
    weighed = [weight * off for weight, off in zip(posed.weights.position, missed, strict=True)]
    towed = [each[i] for each in added.towed]
    value = dot(weighed, missed) + dot(pushed, missed) + dot(towed, z[1:]) + braking * p * p
    forces = [ZERO, 2 * braking * p]  # what s_N and p_N weigh
    for j, (pull, off) in enumerate(zip(added.pull[i :: posed.n], (missed[-1], p), strict=False)):
        value += pull * off + added.stiffness * off * off / 2
        forces[j] += pull + added.stiffness * off
    on_s = [2 * each + force for each, force in zip(weighed, pushed, strict=True)]
    first, *slopes = _backwards(posed, on_s, forces)
    return value, [first, *(each + force for each, force in zip(slopes, towed, strict=True))]


def _backwards(posed: StatedProblem, forces: Vector, last: Vector) -> Vector:
    """Return the gradient in z_0..z_N of what weighs s_1..s_N, and s_N and p_N once more."""
    model, slopes = posed.model, [ZERO] * (posed.horizon + 1)
    on_s, on_p = last
    for k in range(posed.horizon, 0, -1):
        on_s += forces[k - 1]
        slopes[k] += model.follow * on_s
        slopes[k - 1] += model.push * on_s
        if model.inertial:
            slopes[k] += model.after * on_p
            slopes[k - 1] += model.add * on_p
            on_p += model.step * on_s
    return slopes


def _turning(posed: StatedProblem, rotations: list[Vector]) -> tuple[Fraction, list[Vector]]:
    """Return the cost of inputs and of the last attitude, with its gradient."""
    value, weights = ZERO, posed.weights
    slopes = [[ZERO] * posed.width for _ in rotations]
    stencil = (-1, 1) if posed.order == 1 else (1, -2, 1)
    weight = weights.input / posed.model.step ** (2 * posed.order)
    for k in range(len(rotations) - posed.order if weight else 0):
        for i in range(posed.width):
            change = sum((c * rotations[k + j][i] for j, c in enumerate(stencil)), ZERO)
            force = weight * change
            value += force * change
            for j, c in enumerate(stencil):
                slopes[k + j][i] += 2 * c * force
    for i in range(posed.width) if weights.attitude else ():
        off = rotations[-1][i] - posed.state.wanted[i]
        value += weights.attitude * off * off
        slopes[-1][i] += 2 * weights.attitude * off
    return value, slopes


@lru_cache(maxsize=4)
def hessian(posed: StatedProblem, stiffness: Fraction) -> list[Vector]:
    """Return the Hessian of the cost in z_1..z_N along one axis, shape (N, N): differences."""
    zero = [[ZERO] * posed.width for _ in range(posed.horizon)]
    pull = [ZERO] * posed.n * (1 + posed.model.inertial)
    still = [[ZERO] * posed.n] * posed.horizon
    added = Added(pull, stiffness, still, still)
    resting = cost(posed, zero, added)[1]
    found = []
    for k in range(posed.horizon):
        zero[k][0] = ONE
        moved = cost(posed, zero, added)[1]
        zero[k][0] = ZERO
        found.append([a[0] - b[0] for a, b in zip(moved, resting, strict=True)])
    return found
