# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
r"""Families of goal motion, all written over one basis.

Every family is :math:`g(t) = \sum_i x_i(t)\,\theta_i` over the seven columns

.. math:: 1,\ t,\ t^2,\ C = e^{-\delta t}\cos\omega t,\ S = e^{-\delta t}\sin\omega t,\ tC,\ tS,

whose last two are what :math:`\omega` and :math:`\delta` move coefficients along: a small change of
the frequency or the damping is linear in them. A family is then told by its Jacobian alone, the
coefficients that each of its parameters moves, and one Gauss-Newton step serves them all.

Mathematics: docs/mathematics.md, 7.4.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.geometry.rotations import exp, skew

NAMES = ('still', 'velocity', 'acceleration', 'turn', 'swing', 'carrier', 'damped')
STILL, VELOCITY, ACCELERATION, TURN, SWING, CARRIER, DAMPED = range(len(NAMES))
OSCILLATING = (TURN, SWING, CARRIER, DAMPED)  # with a frequency to be found
ODDS = np.array([-5.0, 0.0, -5.0, -3.0, -5.0, -6.0, -6.0])  # logarithms, before any sighting
COLUMNS = 7
ONE, LINEAR, SQUARE, COSINE, SINE, T_COSINE, T_SINE = range(COLUMNS)

SLOWEST, FASTEST = 0.02, 4.0 * math.pi  # angular frequencies considered [rad/s]
PLACE = 3.0  # prior standard deviations: of where a motion begins [m]
SPEED = 5.0  # [m/s]
THRUST = 1.0  # half an acceleration [m/s^2]
SIZE, PUSH = 3.0, 5.0  # of a swing: its size [m], its acceleration [m/s^2]
PULSE = 1.0  # angular frequency and damping [1/s]
TINY = 1e-12  # [1/m^2] in the place's stead, so that nothing is ever singular


class Layout(NamedTuple):
    """What is known of the families before any sighting, for n dimensions and P parameters.

    The rows of a Jacobian are: place (n), velocity (n), then two coefficients of n (t^2, or cosine
    and sine; for a circle its relative size and its attitude), angular frequency and damping.

    Attributes:
        used: which rows a family has, shape (K, P).
        precision: of the priors, shape (K, P); rows that are not used have 1.
        constant: the part of the Jacobian that never changes, shape (K, P, 7, n).
    """

    used: Array
    precision: Array
    constant: Array


@lru_cache(maxsize=2)
def layout(n: int) -> Layout:
    """Return the layout for n = 2 or 3."""
    first, second, rate = 2 * n, 3 * n, 4 * n
    used = np.zeros((len(NAMES), 4 * n + 2), dtype=bool)
    used[:, :n] = True
    used[[VELOCITY, ACCELERATION, CARRIER], n:first] = True
    used[ACCELERATION, first:second] = True
    used[TURN, first : first + 1 + n * (n - 1) // 2] = True
    used[[SWING, CARRIER, DAMPED], first:rate] = True
    used[list(OSCILLATING), rate] = True
    used[DAMPED, rate + 1] = True
    width = np.full(used.shape, PULSE)
    width[:, :n], width[:, n:first], width[:, first:rate] = PLACE, SPEED, SIZE
    width[ACCELERATION, first:second] = THRUST
    precision = np.where(used, 1.0 / width**2, 1.0)
    constant = np.zeros((*used.shape, COLUMNS, n))
    for i in range(n):
        constant[:, i, ONE, i] = 1.0
        constant[[VELOCITY, ACCELERATION, CARRIER], n + i, LINEAR, i] = 1.0
        constant[ACCELERATION, first + i, SQUARE, i] = 1.0
        constant[[SWING, CARRIER, DAMPED], first + i, COSINE, i] = 1.0
        constant[[SWING, CARRIER, DAMPED], second + i, SINE, i] = 1.0
    return Layout(*map(sealed, (used, precision, constant)))


def shape_rows(family: int, n: int) -> tuple[int, int]:
    """Return the first row of an oscillation's shape, and the one after its last."""
    return 2 * n, 2 * n + 1 + n * (n - 1) // 2 if family == TURN else 4 * n


def shape_precision(family: int, rate: float) -> float:
    """Return the prior precision of an oscillation's shape at a frequency [rad/s], in 1/m^2.

    A circle is as large as its speed makes it, a swing as its acceleration allows.
    """
    if family == TURN:
        return (rate / SPEED) ** 2
    return 1.0 / SIZE**2 + (rate * rate / PUSH) ** 2


def columns(times: Array, rates: Array | float, dampings: Array | float) -> Array:
    """Return the seven columns at ``times``, with a last axis of 7; the arguments broadcast."""
    phase = rates * times
    fading = np.exp(-dampings * times)
    x = np.empty((*phase.shape, COLUMNS))
    x[..., ONE] = 1.0
    x[..., LINEAR] = times
    x[..., SQUARE] = times * times
    x[..., COSINE] = fading * np.cos(phase)
    x[..., SINE] = fading * np.sin(phase)
    x[..., T_COSINE] = times * x[..., COSINE]
    x[..., T_SINE] = times * x[..., SINE]
    return x


def jacobian(family: int, coefficients: Array) -> Array:
    """Return the coefficients that each parameter of an oscillation moves, shape (P, 7, n)."""
    n = coefficients.shape[1]
    rows = layout(n).constant[family].copy()
    a, b, rate = coefficients[COSINE], coefficients[SINE], 4 * n
    rows[rate, T_COSINE], rows[rate, T_SINE] = b, -a
    if family == DAMPED:
        rows[rate + 1, T_COSINE], rows[rate + 1, T_SINE] = -a, -b
    if family == TURN:
        # In metres of the rim, so that a circle of no size does not pass for a still goal.
        radius = max(float(np.linalg.norm(a)), TINY)
        rows[2 * n, COSINE], rows[2 * n, SINE] = a / radius, b / radius
        for i, axis in enumerate(np.eye(n * (n - 1) // 2) / radius):
            rows[2 * n + 1 + i, COSINE], rows[2 * n + 1 + i, SINE] = skew(axis) @ a, skew(axis) @ b
    return rows


def stepped(family: int, coefficients: Array, step: Array) -> Array:
    """Return coefficients after a step of the parameters that are not frequency or damping."""
    n = coefficients.shape[1]
    place, velocity, first, second = step[: 4 * n].reshape(4, n)
    moved = coefficients.copy()
    moved[ONE] += place
    moved[LINEAR] += velocity
    if family == TURN:
        rim = step[2 * n :] / max(float(np.linalg.norm(moved[COSINE])), TINY)
        turned = exp(rim[1 : 1 + n * (n - 1) // 2])
        moved[COSINE : SINE + 1] = (1.0 + rim[0]) * moved[COSINE : SINE + 1] @ turned.T
    else:
        moved[COSINE] += first
        moved[SINE] += second
    return moved


def circle(coefficients: Array) -> Array:
    """Return the circle nearest to an ellipse's coefficients, shape (7, n)."""
    u, sizes, v = np.linalg.svd(coefficients[COSINE : SINE + 1], full_matrices=False)
    nearest = coefficients.copy()
    nearest[COSINE : SINE + 1] = sizes.mean() * u @ v
    return nearest


def arc(coefficients: Array, middle: float) -> tuple[float, Array] | None:
    """Return the turn that moves as an acceleration does at a moment; None if that is straight.

    Args:
        coefficients: of the family ``ACCELERATION``, shape (7, n).
        middle: the moment [s].

    Returns:
        Its angular frequency [rad/s] and coefficients, shape (7, n).
    """
    square = coefficients[SQUARE]
    velocity = coefficients[LINEAR] + 2.0 * middle * square
    speed = float(velocity @ velocity)
    across = 2.0 * (square - (square @ velocity) / max(speed, TINY) * velocity)
    rate = math.sqrt(float(across @ across) / max(speed, TINY))
    if not SLOWEST < rate < FASTEST:
        return None
    outward, along = -across / rate**2, velocity / rate
    c, s = math.cos(rate * middle), math.sin(rate * middle)
    place = coefficients[ONE] + middle * coefficients[LINEAR] + middle**2 * square
    turn = np.zeros_like(coefficients)
    turn[ONE] = place - outward
    turn[COSINE], turn[SINE] = c * outward - s * along, s * outward + c * along
    return rate, turn


def later(coefficients: Array, rates: Array, dampings: Array, by: float) -> Array:
    """Return the same oscillations with time counted from a later moment [s], shape (K, 7, n).

    Their middles are left as they are, for the next fit finds them whatever they were.
    """
    moved = coefficients.copy()
    turn, fade = rates[:, None] * by, np.exp(-dampings[:, None] * by)
    a, b = coefficients[:, COSINE], coefficients[:, SINE]
    moved[:, COSINE] = fade * (a * np.cos(turn) + b * np.sin(turn))
    moved[:, SINE] = fade * (b * np.cos(turn) - a * np.sin(turn))
    return moved
