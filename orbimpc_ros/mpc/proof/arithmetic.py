# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Two arithmetics from one source: floats, compiled if numba is installed, and fractions.

Sums, products and quotients of fractions are exact. Floats are rounded, and so are square roots,
cosines and sines in both arithmetics: the :func:`slack` of a bound's terms covers the rounding, and
is subtracted from the bound.

Mathematics: docs/proofs.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from functools import cache, lru_cache
from types import FunctionType
from typing import Any

import numpy as np

from orbimpc_ros.mpc.kernels import COMPILED, compiled, entry_point

Number = Any  # a float or a Fraction
BITS = 160  # after the point, of rounded numbers; of those below 1, significant ones
UNIT = 1 << BITS
FINE = 200  # bits after the point, of angles
PI = Fraction(3141592653589793238462643383279502884197169399375105820974944, 10**60)
HALF_TURN = math.floor(PI * (1 << FINE))
# [rad] A turn, rounded up, of each type of numbers.
TURN: dict[Any, Number] = {
    float: math.nextafter(2.0 * math.pi, 7.0),
    Fraction: Fraction(HALF_TURN + 1, 1 << FINE - 1),
}
FLOATS = 1e-15  # rounding of floats, relative to the size of terms
SWEEPS = 8  # of Jacobi's method: a matrix is diagonal after three or four
FRACTIONS = Fraction(1, 1 << 110)  # rounding of fractions, likewise


IN_FLOATS: dict[Callable, Callable] = {}  # implementations of generic functions for floats


def generic(function: Callable) -> Callable:
    """Register a function for both arithmetics: plain Python, or machine code by :func:`floats`."""
    IN_FLOATS[function] = function
    return function


def by_type(in_floats: Callable, in_fractions: Callable) -> Callable:
    """Return a generic function with an implementation for floats, and one for all else."""

    def either(x: Number) -> Any:
        return in_floats(x) if isinstance(x, float) else in_fractions(x)

    IN_FLOATS[either] = in_floats
    return either


def floats(function: Callable) -> Callable:
    """Return a generic function compiled for floats; the machine code is cached on disk."""
    made = _bound_to_floats(function)
    return entry_point(made, error_model='python') if COMPILED else function


def _bound_to_floats(function: Callable) -> Callable:
    """Return a generic function that calls the implementations for floats of generic functions."""
    source, scope = IN_FLOATS[function], dict(function.__globals__)
    for name in source.__code__.co_names:
        if scope.get(name) in IN_FLOATS:
            scope[name] = _part(scope[name])
    made = FunctionType(source.__code__, scope, source.__name__)
    made.__module__, made.__qualname__ = source.__module__, source.__qualname__
    return made


@cache
def _part(function: Callable) -> Callable:
    """Return a generic function compiled for floats, once for all of its callers."""
    return compiled(_bound_to_floats(function), error_model='python')


def _root_above(x: Fraction) -> Fraction:
    if not x > 0:
        return x * 0
    places = _places(x)
    return Fraction(math.isqrt((x.numerator << 2 * places) // x.denominator) + 1, 1 << places)


@lru_cache(maxsize=65536)
def _direction(angle: Fraction) -> tuple[Fraction, Fraction]:
    """Return cosine and sine, each with an error below 2^-120."""
    finely = (angle.numerator << FINE) // angle.denominator
    x = (finely + HALF_TURN) % (2 * HALF_TURN) - HALF_TURN >> FINE - BITS
    cosine, sine = _series(UNIT, 1, x * x >> BITS), _series(abs(x), 2, x * x >> BITS)
    return Fraction(cosine, UNIT), Fraction(sine if x > 0 else -sine, UNIT)


def _series(term: int, k: int, square: int) -> int:
    """Return 1 - x^2 / 2! + .., or x - x^3 / 3! + .., given their first term and x^2."""
    total, sign = 0, 1
    while term:
        total += sign * term
        term, k, sign = (term * square >> BITS) // (k * (k + 1)), k + 2, -sign
    return total


def _places(x: Fraction) -> int:
    return BITS + max(0, x.denominator.bit_length() - x.numerator.bit_length())


def _coarse(x: Fraction) -> Fraction:
    places = _places(x)
    return Fraction((x.numerator << places) // x.denominator, 1 << places)


# The largest rounding error of sums, from the size of their terms.
slack = by_type(lambda size: FLOATS * size, FRACTIONS.__mul__)
# A square root, rounded up in fractions; 0 for negative numbers.
root = by_type(lambda x: math.sqrt(x) if x > 0.0 else 0.0, _root_above)
# The cosine and the sine of an angle.
direction = by_type(lambda angle: (math.cos(angle), math.sin(angle)), _direction)
# A number with fewer digits, and with an error far below the slack.
coarse = by_type(lambda x: x, _coarse)


def as_fractions(array: np.ndarray) -> np.ndarray:
    """Return an array of floats as one of fractions."""
    return np.frompyfunc(Fraction, 1, 1)(array)


def roots(x: np.ndarray) -> np.ndarray:
    """Return the square root of each element."""
    return np.sqrt(x) if x.dtype == float else np.frompyfunc(root, 1, 1)(x)


@generic
def least_eigenvalue(matrix):
    """Return a tight lower bound on the least eigenvalue of a matrix, shape (4, 4).

    By Jacobi's method, in place: rotate one pair of rows after another.
    """
    size = 0 * matrix[0, 0]
    for i in range(4):
        for j in range(4):
            size = size + abs(matrix[i, j])
    for _ in range(SWEEPS):
        for i in range(3):
            for j in range(i + 1, 4):
                if abs(matrix[i, j]) > slack(size):
                    _turn(matrix, i, j)
    least = min(matrix[0, 0], matrix[1, 1], matrix[2, 2], matrix[3, 3])
    for i in range(3):
        for j in range(i + 1, 4):
            least = least - 2 * abs(matrix[i, j])
    return least - 16 * slack(size)


@generic
def _turn(matrix, i, j):
    """Rotate rows and columns i and j of a symmetric matrix so that entry i, j vanishes."""
    off = (matrix[j, j] - matrix[i, i]) / (2 * matrix[i, j])
    slope = coarse(1 / (abs(off) + root(1 + off * off)))
    slope = slope if off >= 0 else -slope
    cosine, shift = coarse(1 / root(1 + slope * slope)), coarse(slope * matrix[i, j])
    matrix[i, i] = matrix[i, i] - shift
    matrix[j, j] = matrix[j, j] + shift
    matrix[i, j] = matrix[j, i] = 0 * shift
    for k in range(4):
        if k != i and k != j:
            a, b = matrix[k, i], matrix[k, j]
            matrix[k, i] = matrix[i, k] = coarse(cosine * (a - slope * b))
            matrix[k, j] = matrix[j, k] = coarse(cosine * (b + slope * a))
