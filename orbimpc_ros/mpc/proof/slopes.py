# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The cost as bounds are counted from it: rolled out step by step, its slopes, and its curvature.

Neither the maps nor the matrices of the methods are used.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.kernels import compiled
from orbimpc_ros.mpc.model.translation import Step, step_of
from orbimpc_ros.mpc.problem import Problem

ROUNDING = 1e-15  # a step: of the numbers that cancel in a bound
SHIFT = 1e-15  # a step: of the largest curvature, what rounding may hide of another
HALF = np.pi - 1e-9  # [rad], a turn from which on all directions are within reach
GROWTH, HALVINGS = 16.0, 8  # of shifts that are tried for want of convexity


class CostTerms(NamedTuple):
    """A problem, as far as its bounds depend on it.

    Attributes:
        motion: what p adds to s in a step, and what is kept of p; then what R_k e1, R_{k+1} e1 and
            the disturbance add to s and to p.
        weights: on |s_k - g_k|^2, shape (N,).
        lengths: on |R_k e1|, k = 0..N, shape (N + 1,).
        turning: weights on |R_{k+1} - R_k|^2, |R_N - R_g|^2 and |p_N|^2, of what is seen of R; at
            order 2 the first is on |R_{k+1} - 2 R_k + R_{k-1}|^2.
        order: of rotations.
        floor: least speed; how far directions may turn in a step [rad], 0 for any; by how much
            speeds may change, inf for any.
        normals: of a polygonal floor's faces, shape (F, 2).
    """

    motion: tuple[float, ...]
    weights: Array
    lengths: Array
    turning: tuple[float, float, float]
    order: int
    floor: tuple[float, float, float]
    normals: Array


def terms_of(problem: Problem) -> CostTerms:
    """Return the terms of a problem."""
    once, w = step_of(problem.translation, problem.step, problem.forward), problem.weights
    double = 2.0 if problem.dimension == 2 else 1.0  # coordinates of R that are there twice
    weights = np.full(problem.horizon, float(w.position))
    weights[-1] += w.terminal + problem.arrival_weight
    late = float(once.follow[-1] / (once.push[-1] + once.follow[-1]))
    lengths = np.full(problem.horizon + 1, w.length * problem.step * problem.forward)
    lengths[0] *= 1.0 - late
    lengths[-1] *= late
    braking = problem.arrival_weight * problem.step**2 if problem.inertial else 0.0
    order = problem.rotation_order
    turning = double * w.input / problem.step ** (2 * order), double * w.attitude, float(braking)
    count = problem.floor.faces if problem.floor.shape == 'polygon' else 0
    corners = 2.0 * np.pi * np.arange(count) / max(count, 1)
    fraction = float(problem.floor.clearance(problem.dimension))
    parted = problem.floor.exists and problem.dimension == 2  # others have no sectors
    turn = float(problem.step * problem.max_rate) if parted else 0.0
    change = float(problem.speed_change) if parted else np.inf
    floor = fraction, turn if turn < HALF else 0.0, change
    normals = np.column_stack([np.cos(corners), np.sin(corners)])
    return CostTerms(_motion(once), weights, lengths, turning, order, floor, normals)


def _motion(once: Step) -> tuple[float, ...]:
    """Return what a step adds to positions and velocities: see :class:`CostTerms`."""
    none, moved = (0.0, 0.0), [0.0, 0.0]
    if len(once.transition) > 1:
        moved = [float(once.transition[0, 1]), float(once.transition[1, 1])]
    for values in once[1:]:
        moved += (*values.tolist(), *none)[:2]
    return tuple(moved)


def hessian_of(terms: CostTerms, rest: Array, stiffness: float = 0.0) -> Array:
    """Return the Hessian over one coordinate of R_1 e1..R_N e1, from gradients, shape (N, N).

    Args:
        terms: of a problem.
        rest: zeros, shape (N, n).
        stiffness: weight on half the square of where s_N and p_N end.
    """
    n = rest.shape[1]
    start, pull, columns = np.zeros((5, n)), np.zeros(2 * n if stiffness else 0), []
    for k in range(len(rest)):
        x, slopes = np.zeros_like(rest), np.zeros_like(rest)
        x[k, 0] = 1.0
        set_slopes(terms, start, rest, (pull, stiffness), x, slopes)
        columns.append(slopes[:, 0])
    return np.array(columns)


@compiled
def set_slopes(terms, start, goals, arrival, x, slopes):
    """Set the gradient of the cost but for lengths at x; return that cost, and what may cancel.

    Args:
        terms: the problem.
        start: p_0, the disturbance, R_0 and R_g, the rest is not read here, shape (5, d).
        goals: g_1..g_N less s_0, shape (N, n).
        arrival: what pulls at s_N - g_N and at p_N, shape (m,), and the weight on half the square
            of either; where a plan has to arrive, both vanish.
        x: coordinates of R_1..R_N, of which the first n are those of R_k e1, shape (N, d).
        slopes: to be set, shape (N, d).
    """
    value, size = 0.0, 0.0
    for c in range(x.shape[1]):
        turned, cancelled = _turn(terms, start, x, c, slopes)
        value, size = value + turned, size + cancelled
        if c < goals.shape[1]:
            flown, cancelled = _fly(terms, start, goals, arrival, x, c, slopes)
            value, size = value + flown, size + cancelled
    return value, size


@compiled
def _turn(terms, start, x, c, slopes):
    """Set the gradient of inputs and last attitude along a coordinate, see :func:`set_slopes`."""
    turning, steadying, _ = terms.turning
    value, size, earlier, before = 0.0, 0.0, 0.0, start[2, c]
    for k in range(len(x)):
        ahead, slopes[k, c] = x[k, c], 0.0
        change = ahead - before
        cancelled = abs(change)
        if terms.order == 2:
            change, cancelled = change - (before - earlier), cancelled + abs(before - earlier)
        if k >= terms.order - 1:
            turned = turning * change
            value += turned * change
            size += terms.order * turning * cancelled
            slopes[k, c] = 2.0 * turned
            if k > 0:
                slopes[k - 1, c] -= 2.0 * terms.order * turned
            if k > 1 and terms.order == 2:
                slopes[k - 2, c] += 2.0 * turned
        earlier, before = before, ahead
    off = before - start[3, c]
    slopes[len(x) - 1, c] += 2.0 * steadying * off
    value += steadying * off * off
    return value, size / len(x) + value  # of neighbours alone: it does not add up


@compiled
def _fly(terms, start, goals, arrival, x, c, slopes):
    """Add the gradient of what positions and an arrival cost, see :func:`set_slopes`."""
    drift, keep, push, add, follow, after, blow, gust = terms.motion
    (pull, stiffness), braking, weights = arrival, terms.turning[2], terms.weights
    (count, n), forces = goals.shape, np.empty(len(x))
    s, p, before, missed, farthest, fastest = 0.0, start[0, c], start[2, c], 0.0, 0.0, 0.0
    blown, hastened, value = blow * start[1, c], gust * start[1, c], 0.0
    for k in range(count):
        ahead = x[k, c]
        s += drift * p + push * before + follow * ahead + blown
        p = keep * p + add * before + after * ahead + hastened
        missed = s - goals[k, c]
        force = weights[k] * missed
        value += force * missed
        forces[k] = 2.0 * force
        farthest, fastest, before = max(farthest, abs(s)), max(fastest, abs(p)), ahead
    value += braking * p * p
    size, on_s, on_p, earlier = value, 0.0, 2.0 * braking * p, 0.0
    if len(pull) > 0:
        on_s += pull[c] + stiffness * missed
        value += (pull[c] + 0.5 * stiffness * missed) * missed
        size += abs(pull[c]) * farthest + stiffness * missed * missed
    if len(pull) > n:
        on_p += pull[n + c] + stiffness * p
        value += (pull[n + c] + 0.5 * stiffness * p) * p
        size += abs(pull[n + c]) * fastest + stiffness * p * p
    for k in range(count - 1, -1, -1):
        on_s += forces[k]
        slopes[k, c] += earlier + follow * on_s + after * on_p
        size += (push + follow) * abs(on_s) + (add + after) * abs(on_p)
        earlier = push * on_s + add * on_p
        on_p = keep * on_p + drift * on_s
    return value, size


@compiled
def _is_convex(hessian, bends, unit, e, factor):
    """Return whether Hessian, bends and e I are positive definite, by Cholesky's method."""
    for i in range(len(hessian)):
        for j in range(i + 1):
            total = hessian[i, j]
            if i == j:
                total += unit * bends[i] + e
            for m in range(j):
                total -= factor[i, m] * factor[j, m]
            if i > j:
                factor[i, j] = total / factor[j, j]
            elif total > 0.0:
                factor[i, i] = np.sqrt(total)
            else:
                return False
    return True


@compiled
def lack(hessian, bends, unit):
    """Return an e >= 0 such that Hessian, bends and e I are positive semidefinite; inf for none."""
    top, count = 0.0, len(hessian)
    for k in range(count):
        top = max(top, np.abs(hessian[k]).max() + unit * abs(bends[k]))
    if top == 0.0:
        return 0.0
    factor = np.empty(hessian.shape)
    rounding = SHIFT * count * top
    e = rounding
    while not _is_convex(hessian, bends, unit, e, factor):
        if not e < count * top:  # from where on the diagonal dominates, unless there are NaN
            return np.inf
        e *= GROWTH
    if e > rounding:
        least = e / GROWTH
        for _ in range(HALVINGS):
            middle = np.sqrt(least * e)
            if _is_convex(hessian, bends, unit, middle, factor):
                e = middle
            else:
                least = middle
    return e + rounding


@compiled
def lack_arriving(curvature, bends, unit, stiffness):
    """Return what :func:`lack` does, of a Hessian with a weight on where headings end.

    That may be so large that nothing is seen beside it. So the directions that it has no say in
    are looked at by themselves, once the others are eliminated.

    Args:
        curvature: the Hessian, shape (N, N); an orthogonal matrix that makes the Hessian of half
            the square of where headings end diagonal, and its entries but for zeros, which come
            first.
        bends: shape (N,).
        unit: of the bends.
        stiffness: the weight.
    """
    hessian, basis, ends = curvature
    if stiffness == 0.0:
        return lack(hessian, bends, unit)
    bent, count, first = hessian.copy(), len(bends), len(ends)
    for k in range(count):
        bent[k, k] += unit * bends[k]
    turned = basis.T @ (bent @ basis)
    top = np.abs(turned).max()
    for i in range(first):
        pivot = turned[i, i] + stiffness * ends[i]
        if not pivot > 0.0:
            return np.inf
        for j in range(i + 1, count):
            share = turned[j, i] / pivot
            top = max(top, abs(share * turned[j, i]))
            for m in range(i + 1, count):
                turned[j, m] -= share * turned[i, m]
    if first == count:
        return 0.0
    rest = turned[first:, first:].copy()
    return lack(rest, np.zeros(count - first), 0.0) + SHIFT * count * top


@compiled
def least_along(slope, bend, least):
    """Return the least slope s - bend s^2 / 2 over speeds s from the least to 1."""
    if bend < 0.0 and least * bend > slope > bend:  # convex, and least where it is level
        return 0.5 * slope * slope / bend
    return min(slope * least - 0.5 * bend * least * least, slope - 0.5 * bend)
