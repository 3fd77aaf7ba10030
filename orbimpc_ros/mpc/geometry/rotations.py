# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
r"""The rotation groups SO(2) and SO(3), and their convex hulls, the orbitopes.

A tangent vector is an angular velocity times time: shape (1,) [rad] for n = 2, (3,) [rad] for
n = 3, expressed in the body frame, so that :math:`Q \exp(h \hat\omega)` turns a body at rate
:math:`\omega` for :math:`h` seconds.

A matrix R of conv SO(n) has the coordinates that the programs optimise:

- n = 2: :math:`R = [[a, -b], [b, a]]`, coordinates :math:`(a, b)`, :math:`\|R\|_F^2 = 2(a^2+b^2)`;
- n = 3: the nine entries column by column.

Either way the first n coordinates are the thrust axis :math:`R e_1`.

Mathematics: docs/mathematics.md, 2.1 to 2.4.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed

ROLL_UNDEFINED = 1e-6  # below this length of the fitted vector the roll is undetermined
SMALL = 1e-2  # [rad] below it series are more accurate than closed forms
HEADING_UNDEFINED = 1e-9  # below this speed fraction R e1 has no meaningful direction
PROJECTIONS = ('nearest', 'thrust_aligned')
MEMBERSHIP_TOLERANCE = 1e-6  # allowance for rounding of matrices from files, outside conv SO(n)


def skew(omega: Array) -> Array:
    r"""Return :math:`\hat\omega`, shape (n, n), of a tangent vector of shape (1,) or (3,)."""
    if len(omega) == 1:
        return np.array([[0.0, -omega[0]], [omega[0], 0.0]])
    x, y, z = omega
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def exp(phi: Array) -> Array:
    """Return the rotation, shape (n, n), by the tangent vector ``phi`` [rad].

    Rodrigues' formula, in terms that keep full precision near zero.
    """
    if len(phi) == 1:
        c, s = math.cos(phi[0]), math.sin(phi[0])
        return np.array([[c, -s], [s, c]])
    angle, hat = math.sqrt(phi @ phi) / math.pi, skew(phi)
    half = np.sinc(0.5 * angle)  # (1 - cos a) / a^2 is half the square of that
    return np.asarray(np.eye(3) + np.sinc(angle) * hat + 0.5 * half * half * (hat @ hat))


def log(rotation: Array) -> Array:
    """Return the shortest tangent vector [rad], shape (1,) or (3,), with ``exp(log(Q)) = Q``.

    It is found from the unit quaternion, which is accurate at every angle including pi.
    """
    if rotation.shape == (2, 2):
        return np.array([math.atan2(rotation[1, 0], rotation[0, 0])])
    w, *vector = to_quaternion(rotation)
    axis = np.array(vector)
    if w < 0.0:
        w, axis = -w, -axis
    norm = math.sqrt(axis @ axis)
    return axis * (2.0 * math.atan2(norm, w) / norm if norm > 1e-12 else 2.0)


def turned(phi: Array, vector: Array) -> tuple[Array, Array]:
    r"""Return the mean of a vector that turns with the body over an interval, and its double mean.

    :math:`\int_0^1 e^{s\hat\phi} v\, ds` and :math:`\int_0^1 (1-s) e^{s\hat\phi} v\, ds`, with
    :math:`\phi` of shape (1,) or (3,) [rad].
    """
    hat = skew(phi)
    across = hat @ vector
    back = hat @ across
    angle = math.sqrt(phi @ phi)
    if angle < SMALL:
        a = angle * angle
        first, second, third = 0.5 - a / 24.0, 1.0 / 6.0 - a / 120.0, 1.0 / 24.0 - a / 720.0
    else:
        first = (1.0 - math.cos(angle)) / angle**2
        second = (angle - math.sin(angle)) / angle**3
        third = (0.5 - first) / angle**2
    return vector + first * across + second * back, 0.5 * vector + second * across + third * back


def mean_axes(turns: Array) -> Array:
    """Return the mean thrust axes during turns at constant rates, shape (N, n, n), as (N, n)."""
    axis = np.eye(turns.shape[1])[0]
    if len(axis) == 3:
        return np.array([turned(log(turn), axis)[0] for turn in turns])
    angles = np.arctan2(turns[:, 1, 0], turns[:, 0, 0])
    half = np.sinc(angles / (2.0 * math.pi))
    return np.column_stack([np.sinc(angles / math.pi), 0.5 * angles * half * half])


def nearest(matrix: Array) -> Array:
    r"""Return the rotation nearest to ``matrix``, shape (n, n), in the Frobenius norm.

    :math:`U \operatorname{diag}(1, .., \det(UV^T)) V^T`; the sign keeps the determinant at +1
    where the plain :math:`UV^T` of the paper is a reflection.
    """
    if matrix.shape == (2, 2):
        return _from_heading_2(np.array([matrix[0, 0] + matrix[1, 1], matrix[1, 0] - matrix[0, 1]]))
    u, _, vt = np.linalg.svd(matrix)
    u[:, -1] *= np.linalg.det(u) * np.linalg.det(vt)
    return u @ vt


def _all_thrust_aligned(matrices: Array, sizes: Array) -> Array:
    """Return the thrust-aligned rotations of matrices, shape (K, 3, 3), with headings of sizes.

    With the first axis a = R e1 / |R e1|, thrust |R e1| has the same effect as the relaxed R; the
    second axis, along c2 - (a.c2) a + c3 x a, gives the roll that fits R best (2.4b).
    """
    second, third, axes = matrices[:, :, 1], matrices[:, :, 2], matrices[:, :, 0] / sizes
    rolled = second - np.einsum('kc,kc->k', axes, second)[:, None] * axes
    rolled += _crossed(third, axes)
    spans = _lengths(rolled)
    weak = spans[:, 0] < ROLL_UNDEFINED
    if weak.any():  # all rolls fit equally: take one across the coordinate axis farthest from a
        other = np.eye(3)[np.argmin(np.abs(axes[weak]), axis=1)]
        rolled[weak] = _crossed(axes[weak], other)
        spans = _lengths(rolled)
    rolled /= spans
    return np.stack([axes, rolled, _crossed(axes, rolled)], axis=2)


def _crossed(rows: Array, others: Array) -> Array:
    """Return the cross products of rows, shape (K, 3), of which NumPy's takes six times as long."""
    after, last = rows[:, [1, 2, 0]], rows[:, [2, 0, 1]]
    return after * others[:, [2, 0, 1]] - last * others[:, [1, 2, 0]]


def _lengths(rows: Array) -> Array:
    """Return the lengths of rows, shape (K, 1)."""
    return np.sqrt(np.einsum('kc,kc->k', rows, rows))[:, None]


def project_all(matrices: Array, first: Array, how: str) -> Array:
    """Return the rotations to which points of conv SO(n) are projected, each of shape (K, n, n).

    How is one of :data:`PROJECTIONS`. Where a heading is undefined, the previous rotation is held,
    ``first`` at the start.
    """
    sizes = _lengths(matrices[:, :, 0])
    defined = np.flatnonzero(sizes[:, 0] >= HEADING_UNDEFINED)
    if len(defined) == len(matrices):
        return _projected(matrices, sizes, how)
    choices = np.concatenate([first[None], _projected(matrices[defined], sizes[defined], how)])
    return choices[np.searchsorted(defined, np.arange(len(matrices)), side='right')]


def _projected(matrices: Array, sizes: Array, how: str) -> Array:
    """Return the rotations of matrices, shape (K, n, n), with headings of sizes, shape (K, 1)."""
    if matrices.shape[-1] == 2:  # nearest and thrust-aligned are the same
        return matrices / sizes[:, :, None]
    if how == 'thrust_aligned':
        return _all_thrust_aligned(matrices, sizes)
    return np.array([nearest(matrix) for matrix in matrices]).reshape(matrices.shape)


def turned_onto(rotation: Array, axis: Array) -> Array:
    """Turn a rotation, shape (n, n), by the least angle that makes a unit vector its first axis."""
    if len(axis) == 2:
        return _from_heading_2(axis)
    (a, b, c), (u, v, w) = rotation[:, 0].tolist(), axis.tolist()
    across = np.array([b * w - c * v, c * u - a * w, a * v - b * u])
    sine, cosine = math.sqrt(across @ across), a * u + b * v + c * w
    if cosine > 0.0:
        hat = skew(across)
        return (np.eye(3) + hat + hat @ hat / (1.0 + cosine)) @ rotation
    if sine < HEADING_UNDEFINED:  # half a turn about any orthogonal axis, here the second
        return exp(math.pi * rotation[:, 1]) @ rotation
    return exp(math.atan2(sine, cosine) / sine * across) @ rotation


def aside_of(axis: Array, towards: Array) -> Array:
    """Return the direction across an axis, shape (n,), on the side of a point."""
    aside = towards - axis * (axis @ towards)
    # Across a parallel or opposite direction any orthogonal vector will do.
    if np.linalg.norm(aside) <= HEADING_UNDEFINED * np.linalg.norm(towards):
        other = np.eye(len(axis))[np.argmin(np.abs(axis))]
        aside = other - axis * (axis @ other)
    return np.asarray(aside / np.linalg.norm(aside))


def turned_within(unit: Array, wanted: Array, widest: float) -> Array:
    """Return a direction, shape (n,), turned towards another by at most an angle."""
    along = float(unit @ wanted)
    if math.atan2(float(np.linalg.norm(wanted - along * unit)), along) <= widest:
        return wanted
    return np.asarray(math.cos(widest) * unit + math.sin(widest) * aside_of(unit, wanted))


def carried(attitude: Array, headings: Array) -> Array:
    """Return |z_k| Q_k, shape (K, n, n), with Q_k turned from Q_{k-1} onto z_k, unless z_k = 0.

    Q_0 is the ``attitude``, z_1..z_K the headings, shape (K, n).
    """
    sizes = np.linalg.norm(headings, axis=1)
    there = np.flatnonzero(sizes >= HEADING_UNDEFINED)
    axes = headings[there] / sizes[there, None]
    turned = [attitude]
    for axis in axes:
        turned.append(turned_onto(turned[-1], axis))
    latest = np.searchsorted(there, np.arange(len(headings)), side='right')
    return sizes[:, None, None] * np.array(turned)[latest]


def to_quaternion(rotation: Array) -> Array:
    """Return the unit quaternion (w, x, y, z) of a rotation of shape (2, 2) or (3, 3)."""
    if rotation.shape == (2, 2):
        half = 0.5 * math.atan2(rotation[1, 0], rotation[0, 0])
        return np.array([math.cos(half), 0.0, 0.0, math.sin(half)])
    rows = lmi(coordinates(rotation))  # 4 q q^T; Shepperd's method: divide by the largest component
    quaternion = rows[int(np.argmax(np.diag(rows)))]
    return quaternion / math.sqrt(quaternion @ quaternion)


def from_quaternion(quaternion: Array, dimension: int) -> Array:
    """Return the rotation, shape (n, n), of a unit quaternion (w, x, y, z); for n = 2 its yaw.

    The yaw is the heading of the body's x axis seen from above, as in REP-103.
    """
    w, x, y, z = quaternion.tolist()
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return rotation if dimension == 3 else _from_heading_2(rotation[:2, 0])


def _from_heading_2(axis: Array) -> Array:
    norm = math.hypot(axis[0], axis[1])
    a, b = axis / norm if norm > 0.0 else (1.0, 0.0)
    return np.array([[a, -b], [b, a]])


def coordinate_count(n: int) -> int:
    """Return the number of coordinates of a matrix of conv SO(n)."""
    return 2 if n == 2 else 9


def frobenius_factor(n: int) -> float:
    """Return c with squared Frobenius norm = c * (sum of squared coordinates)."""
    return 2.0 if n == 2 else 1.0


def coordinates(matrix: Array) -> Array:
    """Return the coordinates, shape (..., 2) or (..., 9), of matrices of shape (..., n, n)."""
    if matrix.shape[-1] == 2:
        return matrix[..., :, 0]
    return np.swapaxes(matrix, -1, -2).reshape(*matrix.shape[:-2], 9)


def matrix(x: Array) -> Array:
    """Return the matrices, shape (..., n, n), of coordinates of shape (..., 2) or (..., 9)."""
    if x.shape[-1] == 2:
        r = np.empty((*x.shape[:-1], 2, 2))
        r[..., 0, 0] = r[..., 1, 1] = x[..., 0]
        r[..., 1, 0] = x[..., 1]
        r[..., 0, 1] = -x[..., 1]
        return r
    return np.swapaxes(x.reshape(*x.shape[:-1], 3, 3), -1, -2)


def lmi(x: Array) -> Array:
    """Return the paper's matrix, shape (4, 4), of coordinates (9,): PSD exactly on conv SO(3)."""
    x11, x21, x31, x12, x22, x32, x13, x23, x33 = x
    return np.array(
        [
            [1 + x11 + x22 + x33, x32 - x23, x13 - x31, x21 - x12],
            [x32 - x23, 1 + x11 - x22 - x33, x21 + x12, x13 + x31],
            [x13 - x31, x21 + x12, 1 - x11 + x22 - x33, x32 + x23],
            [x21 - x12, x13 + x31, x32 + x23, 1 - x11 - x22 + x33],
        ]
    )


@lru_cache(maxsize=1)
def lmi_parts() -> tuple[Array, Array]:
    """Return c, shape (16,), and A, shape (16, 9), of the affine map: lmi(x).ravel() = A x + c."""
    constant = lmi(np.zeros(9)).ravel()
    linear = np.column_stack([lmi(e).ravel() - constant for e in np.eye(9)])
    return sealed(constant), sealed(linear)


def margin(rotation: Array) -> Array:
    """Return margins of matrices, shape (..., n, n), inside conv SO(n), negative outside.

    n = 2: 1 - |(a, b)|. n = 3: the smallest eigenvalue of the 4x4 matrix, found from signed
    singular values s1 >= s2 >= |s3| alone (Sanyal, Sottile, Sturmfels, *Orbitopes*).
    """
    if rotation.shape[-1] == 2:
        return np.asarray(1.0 - np.hypot(rotation[..., 0, 0], rotation[..., 1, 0]))
    singular = np.linalg.svd(rotation, compute_uv=False)
    s1, s2 = singular[..., 0], singular[..., 1]
    s3 = singular[..., 2] * np.where(np.linalg.det(rotation) < 0.0, -1.0, 1.0)
    # The other three sign patterns never exceed this one when s1 >= s2 >= |s3|.
    return 1.0 - (s1 + s2 - s3)
