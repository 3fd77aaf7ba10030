# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The tangent at an optimum over SO(3), with multipliers that complement a plan's rotations.

With G the gradient at a plan, the multipliers of S(R) >= 0 are sought among those that vanish on
the range of S(R): then a tangent's bound lacks the square of what G is off by, not G's error.

Mathematics: docs/mathematics.md, 2.3, and docs/proofs.md.
"""

from __future__ import annotations

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.orbitopes import coordinates, lmi, lmi_parts
from orbimpc_ros.mpc.model.condensed import Condensed
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.proof.certificate import Leaf
from orbimpc_ros.mpc.proof.stationary import arrival_of

INSIDE = 1e-4  # an eigenvalue of S(R), of 4 in all, that is not zero
REFINED = 2  # times that a linear system is solved for what it is off by
AT_END = 1e-7  # a thrust fraction this near to 0 or 1 is there


def tangents(problem: Problem, state: State, goals: Array, x: Array) -> list[Leaf]:
    """Return leaves of a plan over SO(3) without further limits: one better, one safer.

    Args:
        problem: in natural units.
        state: where the plan starts.
        goals: shape (N, 3).
        x: coordinates of its rotations R_1..R_N, shape (N, 9).
    """
    hessians, q = quadratic(problem, state, goals, 9)
    arrival, left = arrival_of(problem, state, goals)
    slopes = np.column_stack([h @ x[:, c] for c, h in enumerate(hessians)]) + q
    pulled = slopes.copy()
    if len(arrival):
        pulled[:, :3] += arrival.T @ _pull(slopes, arrival, x, problem.rotation_order - 1)
    held = np.array([complementary(r, g) for r, g in zip(x, pulled, strict=True)])
    if problem.rotation_order == 2:
        held[0] = 0.0
    base, basis = _freedom(problem, state, x)
    point, pull = touching(hessians, q - held, (arrival, left), base, basis)
    flat = Leaf(x, pull=np.zeros(left.size), tops=np.array([top(y) for y in slopes]))
    return [Leaf(point, pull=pull, tops=np.array([top(y) for y in held])), flat]


def quadratic(
    problem: Problem, state: State, goals: Array, width: int
) -> tuple[list[Array], Array]:
    """Return the Hessian of each coordinate, shape (N, N), and linear terms, shape (N, width)."""
    condensed, n = Condensed(problem), problem.dimension
    q = np.empty((problem.horizon, width))
    q[:, :n], _ = condensed.affine(state, goals)
    first = coordinates(state.rotation)
    wanted = np.zeros_like(first) if state.wanted is None else coordinates(state.wanted)
    q[:, n:] = condensed.turned @ np.array([first, wanted])[:, n:width]
    return [condensed.hessian] * n + [condensed.turning] * (width - n), q


def complementary(r: Array, slope: Array) -> Array:
    """Return K*(L), shape (9,), of the L >= 0 next to a slope's that vanishes on S(R)'s range."""
    values, vectors = np.linalg.eigh(lmi(r))
    inside, outside = vectors[:, values > INSIDE], vectors[:, values <= INSIDE]
    if not outside.shape[1]:
        return np.zeros(9)
    linear = lmi_parts()[1]
    turned = (linear @ slope).reshape(4, 4) / 4.0
    level = -np.trace(inside.T @ turned @ inside) / inside.shape[1]
    left = outside.T @ (turned + level * np.eye(4)) @ outside
    sizes, axes = np.linalg.eigh(left)
    kept = outside @ axes
    return np.asarray(linear.T @ (kept * np.maximum(sizes, 0.0) @ kept.T).ravel())


def top(held: Array) -> float:
    """Return tr L of K*(L) whose L is singular: the largest -<K*(L), R> over conv SO(3)."""
    return float(-np.linalg.eigvalsh((lmi_parts()[1] @ held).reshape(4, 4))[0])


def _pull(slopes: Array, arrival: Array, x: Array, decided: int) -> Array:
    """Return the multipliers of an arrival that fit a plan's slopes best, shape (m, 3).

    With them K(G)/4 + t I vanishes on the range of each S(R), for some t of each step.
    """
    linear, count = lmi_parts()[1], len(arrival) * 3
    rows, right = [], []
    for k in range(decided, len(x)):
        values, vectors = np.linalg.eigh(lmi(x[k]))
        inside = vectors[:, values > INSIDE]

        def seen(y: Array, axes: Array = inside) -> Array:
            return ((linear @ y).reshape(4, 4) / 4.0 @ axes).ravel()

        row = np.zeros((inside.size, count + len(x)))
        for j, share in enumerate(arrival[:, k]):
            for c in range(3):
                row[:, 3 * j + c] = share * seen(np.eye(9)[c])
        row[:, count + k] = inside.ravel()
        rows.append(row)
        right.append(-seen(slopes[k]))
    found = np.linalg.lstsq(np.vstack(rows), np.concatenate(right), rcond=None)[0]
    return np.asarray(found[:count]).reshape(len(arrival), 3)


def _freedom(problem: Problem, state: State, x: Array) -> tuple[Array, Array]:
    """Return y and B of all coordinates y + B v that the state has not decided, flat."""
    base, basis = np.zeros(x.size), np.eye(x.size)
    if problem.rotation_order == 1:
        return base, basis
    basis = basis[:, 9:]
    if state.coasted is None:
        base[:9] = x[0]
        return base, basis
    along = np.zeros(x.size)
    along[:9] = coordinates(state.coasted)
    fraction = float(x[0] @ along[:9]) / 3.0
    if AT_END < fraction < 1.0 - AT_END:
        return base, np.column_stack([along, basis])
    return round(fraction) * along, basis


def touching_freely(
    hessians: list[Array], q: Array, arrives: tuple[Array, Array]
) -> tuple[Array, Array]:
    """Return what :func:`touching` does where everything is free: axes by themselves, at once."""
    arrival, left = arrives
    n = left.shape[1]
    axial, pull = _least(hessians[0], q[:, :n], arrival, left)
    others = q[:, n:]
    if others.size:
        turned, _ = _least(hessians[-1], others, arrival[:0], np.zeros((0, others.shape[1])))
        axial = np.column_stack([axial, turned])
    return axial, pull.ravel()


def _least(bent: Array, q: Array, rows: Array, left: Array) -> tuple[Array, Array]:
    """Return where x'Bx/2 + q.x is least with A x = b, of each column, and the multipliers.

    What a tangent's slopes are off by there, its bound lacks. So that is solved for, until it is no
    more than rounding.
    """
    system = np.block([[bent, rows.T], [rows, np.zeros((len(rows), len(rows)))]])
    wanted = np.concatenate([-q, left])
    found = np.zeros_like(wanted)
    for _ in range(REFINED):
        missed = (wanted - system.astype(np.longdouble) @ found).astype(float)
        found = found + np.linalg.lstsq(system, missed, rcond=1e-15)[0]
    moved, pull = np.split(found, [len(bent)])
    return moved, pull


def touching(
    hessians: list[Array], q: Array, arrives: tuple[Array, Array], base: Array, basis: Array
) -> tuple[Array, Array]:
    """Return where the quadratic is least among what is free and arrives, and what pulls there."""
    width, bent = q.shape[1], np.zeros((q.size, q.size))
    for c, h in enumerate(hessians):
        bent[c::width, c::width] = h
    arrival, left = arrives
    rows = np.kron(arrival, np.eye(width)[: left.shape[1]])
    missed = left.ravel() - rows @ base
    rows, free = rows @ basis, basis.T @ bent @ basis
    moved, pull = _least(free, basis.T @ (bent @ base + q.ravel()), rows, missed)
    return (base + basis @ moved).reshape(q.shape), pull
