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

INSIDE = 1e-4  # an eigenvalue of S(R), of 4 in all, that is not zero
AT_END = 1e-7  # a thrust fraction this near to 0 or 1 is there


def tangents(problem: Problem, state: State, goals: Array, x: Array) -> list[Leaf]:
    """Return leaves of a plan over SO(3) without further limits: one better, one safer.

    Args:
        problem: in natural units.
        state: where the plan starts.
        goals: shape (N, 3).
        x: coordinates of its rotations R_1..R_N, shape (N, 9).
    """
    hessians, q = _quadratic(problem, state, goals)
    slopes = np.column_stack([h @ x[:, c] for c, h in enumerate(hessians)]) + q
    held = np.array([_complementary(r, g) for r, g in zip(x, slopes, strict=True)])
    if problem.rotation_order == 2:
        held[0] = 0.0
    point = _touching(problem, state, hessians, q - held, x)
    traces = np.array([_trace(y) for y in held])
    return [Leaf(point, tops=traces), Leaf(x, tops=np.array([_trace(y) for y in slopes]))]


def _quadratic(problem: Problem, state: State, goals: Array) -> tuple[list[Array], Array]:
    """Return the Hessian of each coordinate, shape (N, N), and linear terms, shape (N, 9)."""
    condensed = Condensed(problem)
    q = np.empty((problem.horizon, 9))
    q[:, :3], _ = condensed.affine(state, goals)
    wanted = np.zeros(9) if state.wanted is None else coordinates(state.wanted)
    others = np.array([coordinates(state.rotation), wanted])[:, 3:]
    q[:, 3:] = condensed.turned @ others
    return [condensed.hessian] * 3 + [condensed.turning] * 6, q


def _complementary(r: Array, slope: Array) -> Array:
    """Return K*(L), shape (9,), of the L >= 0 nearest to a slope's that vanishes on S(R)'s range."""
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


def _trace(held: Array) -> float:
    """Return tr L of K*(L) whose L is singular: the largest -<K*(L), R> over conv SO(3)."""
    return float(-np.linalg.eigvalsh((lmi_parts()[1] @ held).reshape(4, 4))[0])


def _touching(
    problem: Problem, state: State, hessians: list[Array], q: Array, x: Array
) -> Array:
    """Return where the gradient of the quadratic vanishes; R_1 keeps to what the state decides."""
    point = x.copy()
    if problem.rotation_order == 1:
        for c, h in enumerate(hessians):
            point[:, c] = np.linalg.solve(h, -q[:, c])
        return point
    rest = np.column_stack([
        np.linalg.solve(h[1:, 1:], -q[1:, c] - h[1:, 0] * point[0, c])
        for c, h in enumerate(hessians)
    ])  # fmt: skip
    fraction = 0.0 if state.coasted is None else float(x[0] @ coordinates(state.coasted)) / 3.0
    point[1:] = rest
    if AT_END < fraction < 1.0 - AT_END:
        assert state.coasted is not None
        point += _further(coordinates(state.coasted), hessians, q, point)
    return point


def _further(along: Array, hessians: list[Array], q: Array, point: Array) -> Array:
    """Return the move to where the thrust fraction of R_1 is best, too, shape (N, 9)."""
    move = np.zeros_like(point)
    move[0] = along
    pull = bent = 0.0
    for c, h in enumerate(hessians):
        move[1:, c] = np.linalg.solve(h[1:, 1:], -h[1:, 0] * along[c])
        pull += move[:, c] @ (h @ point[:, c] + q[:, c])
        bent += move[:, c] @ h @ move[:, c]
    return -pull / bent * move
