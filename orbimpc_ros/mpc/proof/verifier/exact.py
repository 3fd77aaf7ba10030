# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Fractions, and brackets of what is none: square roots, sines, cosines, semidefinite matrices."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from functools import lru_cache
from operator import mul
from typing import NamedTuple

BITS = 160  # after the point, of square roots and of what Cholesky's method works with
TINY = Fraction(1, 1 << 120)  # by which sines, cosines and PI may be off, and more than they are
PI = Fraction(3141592653589793238462643383279502884197169399375105820974944, 10**60)
TURN = Fraction(math.nextafter(2.0 * math.pi, 7.0))  # a double beyond 2 pi
NARROW = Fraction(1, 10**9)  # [rad] by which what is treated as below half a turn, or a turn, is
ZERO, ONE = Fraction(0), Fraction(1)
SHIFTS = (0, *(1 << (2 * BITS - bits) for bits in range(60, -1, -4)))  # of 1 << 2 BITS

Vector = list[Fraction]


class Whole(NamedTuple):
    """Numbers over a common denominator: sums of whole numbers take a fraction of the time."""

    numbers: list[int]
    unit: int


def whole(x: Sequence[Fraction]) -> Whole:
    """Return numbers over their least common denominator."""
    unit = math.lcm(*(each.denominator for each in x))
    return Whole([each.numerator * (unit // each.denominator) for each in x], unit)


def dot(x: Sequence[Fraction], y: Sequence[Fraction]) -> Fraction:
    """Return x . y."""
    return times([whole(x)], y)[0]


def times(rows: Sequence[Whole], x: Sequence[Fraction]) -> Vector:
    """Return row . x of each row."""
    numbers, unit = whole(x)
    if any(len(row.numbers) != len(numbers) for row in rows):
        raise ValueError('vectors are not of one length')
    return [Fraction(sum(map(mul, row.numbers, numbers)), row.unit * unit) for row in rows]


def add(x: Vector, y: Vector) -> Vector:
    """Return x + y."""
    return [a + b for a, b in zip(x, y, strict=True)]


def less(x: Vector, y: Vector) -> Vector:
    """Return x less y, which may be shorter."""
    return [*(a - b for a, b in zip(x, y, strict=False)), *x[len(y) :]]


def root_below(x: Fraction) -> Fraction:
    """Return a number that is at most the square root, and hardly less."""
    return Fraction(math.isqrt((x.numerator << 2 * BITS) // x.denominator), 1 << BITS)


def root_above(x: Fraction) -> Fraction:
    """Return a number that is at least the square root, and hardly more."""
    return Fraction(math.isqrt((x.numerator << 2 * BITS) // x.denominator) + 1, 1 << BITS)


def size_below(x: Vector) -> Fraction:
    """Return a number that is at most |x|."""
    return root_below(dot(x, x))


def size_above(x: Vector) -> Fraction:
    """Return a number that is at least |x|."""
    return root_above(dot(x, x))


def rounded_down(x: Fraction) -> float:
    """Return the largest double that is not above a number."""
    nearest = float(x)
    return nearest if Fraction(nearest) <= x else math.nextafter(nearest, -math.inf)


@lru_cache(maxsize=65536)
def direction(angle: Fraction) -> tuple[Fraction, Fraction]:
    """Return cosine and sine, each within TINY."""
    turned = angle - 2 * PI * round(angle / (2 * PI))
    unit = 1 << BITS
    x = round(turned * unit)
    cosine = sine = 0
    term, k = unit, 0
    while term:  # term = x^k / k!, with the signs of both series
        if k % 2:
            sine += term if k % 4 == 1 else -term
        else:
            cosine += term if k % 4 == 0 else -term
        k += 1
        term = term * x // (k * unit) if term * x >= 0 else -(-term * x // (k * unit))
    return Fraction(cosine, unit), Fraction(sine, unit)


def lacking(matrix: list[Vector]) -> Fraction:
    """Return an e >= 0 such that matrix + e I is positive semidefinite."""
    numbers, unit = whole([each for row in matrix for each in row])
    count = len(matrix)
    return lacking_whole([numbers[count * i : count * (i + 1)] for i in range(count)], unit)


def lacking_whole(matrix: list[list[int]], unit: int) -> Fraction:
    """Return an e >= 0 such that matrix / unit + e I is positive semidefinite.

    Cholesky's method on whole numbers, each division rounded down. What it factors differs from
    the matrix by at most 2 max(L) + 2 in each entry, in its unit. It succeeds at the latest where
    the diagonal dominates.
    """
    count = len(matrix)
    top = max(abs(each) for row in matrix for each in row)
    if not top:
        return ZERO
    entries = [[(row[j] << 2 * BITS) // top for j in range(i + 1)] for i, row in enumerate(matrix)]
    for shift in (*SHIFTS, 2 * count << 2 * BITS):
        shifted = [[*row[:-1], row[-1] + shift] for row in entries]
        largest = _factored(shifted)
        if largest:
            return Fraction(top * (shift + count * (2 * largest + 2)), unit << 2 * BITS)
    raise AssertionError('the diagonal dominates')


def _factored(rows: list[list[int]]) -> int:
    """Put Cholesky's factor in a matrix's place; return its largest entry, 0 if it has none."""
    for i, row in enumerate(rows):
        for j in range(i):
            other = rows[j]
            row[j] = (row[j] - sum(map(mul, row[:j], other[:j]))) // other[j]
        square = row[i] - sum(map(mul, row[:i], row[:i]))
        if square <= 0:
            return 0
        row[i] = math.isqrt(square)
        if not row[i]:
            return 0
    return max(abs(entry) for row in rows for entry in row)
