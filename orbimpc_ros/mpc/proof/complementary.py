# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Newton's method on the conditions of optimality over SO(3), from a solution to some digits.

The multipliers of S(R_k) >= 0 are L_k = F_k F_k', which are semidefinite whatever F_k is. Unknown
are R_k, F_k and the multipliers of rows that hold with equality; known is where the gradient of the
Lagrangian vanishes, where S(R_k) F_k = 0, and the rows.

Mathematics: docs/mathematics.md, 2.3, and docs/proofs.md.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.orbitopes import lmi, lmi_parts

SCARCE = 1e-2  # to spare
LEAST = 1e-14  # of the largest singular value: F_k is known but for a rotation


class Pair(NamedTuple):
    """A trajectory and what holds it.

    Attributes:
        x: coordinates of R_1..R_N, shape (N, 9).
        factors: F_1..F_N, shapes (4, r_k).
        multipliers: of the rows, shape (m,).
    """

    x: Array
    factors: tuple[Array, ...]
    multipliers: Array


def factor(dual: Array, slack: Array) -> Array:
    """Return F, shape (4, r), where a multiplier outweighs what S(R) has to spare, or may yet.

    A column too many goes to zero; without one too few, there is no way to the optimum.
    """
    sizes, axes = np.linalg.eigh(dual - slack)
    axes = axes[:, sizes > -SCARCE]
    kept = np.einsum('ij,ik,kj->j', axes, dual, axes)
    return np.asarray(axes * np.sqrt(np.maximum(kept, 0.0)))


def held(factors: tuple[Array, ...]) -> Array:
    """Return K*(F_k F_k'), shape (N, 9): the slopes that multipliers hold."""
    linear = lmi_parts()[1]
    return np.array([linear.T @ (f @ f.T).ravel() for f in factors])


def stepped(hessian: Array, q: Array, rows: tuple[Array, Array], pair: Pair) -> Pair:
    """Return a pair after a step of Newton's method.

    Args:
        hessian: of all coordinates, shape (9 N, 9 N).
        q: linear terms, shape (N, 9).
        rows: A, shape (m, 9 N), and b with A x = b.
        pair: near the optimum.
    """
    x, factors, multipliers = pair
    linear, (a, b) = lmi_parts()[1], rows
    sizes = [f.size for f in factors]
    turning, missed = np.zeros((x.size, sum(sizes))), []
    spans, firsts = np.zeros((sum(sizes), x.size)), np.cumsum([0, *sizes])
    spread = np.zeros((sum(sizes), sum(sizes)))
    for k, (r, f) in enumerate(zip(x, factors, strict=True)):
        own, coordinates = slice(firsts[k], firsts[k + 1]), slice(9 * k, 9 * k + 9)
        place, count = lmi(r), f.shape[1]
        missed.append((place @ f).ravel())
        spread[own, own] = np.kron(place, np.eye(count))
        each = linear.T.reshape(9, 4, 4) @ f  # symmetric: half of what F adds to the slope
        turning[coordinates, own] = -2.0 * each.reshape(9, -1)
        spans[own, coordinates] = each.reshape(9, -1).T
    missing = hessian @ x.ravel() + (q - held(factors)).ravel() + a.T @ multipliers
    none, still = np.zeros((sum(sizes), len(b))), np.zeros((len(b), sum(sizes)))
    system = np.block(
        [[hessian, turning, a.T], [spans, spread, none], [a, still, np.zeros((len(b), len(b)))]]
    )
    right = -np.concatenate([missing, *missed, a @ x.ravel() - b])
    step = np.linalg.lstsq(system, right, rcond=LEAST)[0]
    moved, turned, pressed = np.split(step, [x.size, x.size + sum(sizes)])
    changes = np.split(turned, firsts[1:-1])
    made = tuple(f + g.reshape(f.shape) for f, g in zip(factors, changes, strict=True))
    return Pair(x + moved.reshape(x.shape), made, multipliers + pressed)
