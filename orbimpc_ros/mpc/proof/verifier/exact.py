# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Fractions, and brackets of what is none: square roots, sines, cosines, semidefinite matrices."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from operator import mul
from typing import NamedTuple

BITS = 160  # after the point, of what is rounded
UNIT = 1 << BITS
SLIGHT = 1 << 40  # units by which sines, cosines and PI may be off, and more than they are
TINY = Fraction(SLIGHT, UNIT)
PI = Fraction(3141592653589793238462643383279502884197169399375105820974944, 10**60)
FINE = 200  # bits after the point, of angles
HALF_TURN = math.floor(PI * (1 << FINE))
TURN = Fraction(math.nextafter(2.0 * math.pi, 7.0))  # a double beyond 2 pi
NARROW = Fraction(1, 10**9)  # [rad] by which what is treated as below half a turn, or a turn, is
ZERO, ONE = Fraction(0), Fraction(1)
MOST = Fraction(sys.float_info.max)
SHIFTS = (0, *(UNIT >> bits for bits in range(60, -1, -4)))


@dataclass(slots=True, frozen=True)
class Vector:
    """Fractions over one denominator: sums of whole numbers take a fraction of the time.

    Attributes:
        numbers: what is divided.
        unit: by what.
    """

    numbers: list[int]
    unit: int = 1

    @classmethod
    def of(cls, values: Iterable[Fraction | float]) -> Vector:
        """Return numbers over their least common denominator."""
        ratios = [each.as_integer_ratio() for each in values]
        unit = math.lcm(*[below for _, below in ratios])
        return cls([each * (unit // below) for each, below in ratios], unit)

    def __len__(self) -> int:
        return len(self.numbers)

    def __bool__(self) -> bool:
        return any(self.numbers)

    def __getitem__(self, i: int) -> Fraction:
        return Fraction(self.numbers[i], self.unit)

    def __iter__(self) -> Iterator[Fraction]:
        return (Fraction(each, self.unit) for each in self.numbers)

    def over(self, unit: int) -> list[int]:
        """Return what is divided by a multiple of the unit."""
        more = unit // self.unit
        return self.numbers if more == 1 else [more * each for each in self.numbers]

    def __add__(self, other: Vector) -> Vector:
        unit = math.lcm(self.unit, other.unit)
        pairs = zip(self.over(unit), other.over(unit), strict=True)
        return Vector([a + b for a, b in pairs], unit)

    def __sub__(self, other: Vector) -> Vector:
        return self + other * -ONE

    def __mul__(self, scale: Fraction) -> Vector:
        numbers = [scale.numerator * each for each in self.numbers]
        return Vector(numbers, scale.denominator * self.unit)

    def each(self, other: Vector) -> Vector:
        """Return the products of the numbers of both."""
        pairs = zip(self.numbers, other.numbers, strict=True)
        return Vector([a * b for a, b in pairs], self.unit * other.unit)

    def __matmul__(self, other: Vector) -> Fraction:
        products = self.each(other)
        return Fraction(sum(products.numbers), products.unit)

    def dot(self, other: Vector) -> int:
        """Return how many units the product is, rounded down."""
        products = self.each(other)
        return (sum(products.numbers) << BITS) // products.unit

    def rounded(self) -> list[int]:
        """Return how many units each is, rounded down."""
        return [(each << BITS) // self.unit for each in self.numbers]

    def above(self, i: int) -> int:
        """Return how many units a number is, rounded up."""
        return -((-self.numbers[i] << BITS) // self.unit)

    def pieces(self, size: int) -> list[Vector]:
        """Return it in pieces of a size."""
        starts = range(0, len(self), size)
        return [Vector(self.numbers[i : i + size], self.unit) for i in starts]


class Matrix(NamedTuple):
    """Rows of whole numbers over one denominator."""

    rows: list[list[int]]
    unit: int = 1

    @classmethod
    def of(cls, rows: Sequence[Vector]) -> Matrix:
        """Return vectors over a common denominator."""
        unit = math.lcm(*[each.unit for each in rows])
        return cls([each.over(unit) for each in rows], unit)

    @property
    def columns(self) -> Matrix:
        """Return it transposed."""
        return Matrix(list(map(list, zip(*self.rows, strict=True))), self.unit)

    @property
    def vectors(self) -> list[Vector]:
        """Return its rows."""
        return [Vector(each, self.unit) for each in self.rows]

    def __matmul__(self, x: Vector) -> Vector:
        if self.rows and len(self.rows[0]) != len(x):
            raise ValueError('vectors are not of one length')
        return Vector([sum(map(mul, row, x.numbers)) for row in self.rows], self.unit * x.unit)


def across(vectors: Sequence[Vector]) -> list[Vector]:
    """Return the first numbers of all, the second ones of all, and so on."""
    return Matrix.of(vectors).columns.vectors


def root_below(x: Fraction) -> Fraction:
    """Return a number that is at most the square root, and hardly less."""
    return Fraction(math.isqrt((x.numerator << 2 * BITS) // x.denominator), UNIT)


def root_above(x: Fraction) -> Fraction:
    """Return a number that is at least the square root, and hardly more."""
    return Fraction(math.isqrt((x.numerator << 2 * BITS) // x.denominator) + 1, UNIT)


def size_below(x: Vector) -> Fraction:
    """Return a number that is at most |x|."""
    return root_below(x @ x)


def size_above(x: Vector) -> Fraction:
    """Return a number that is at least |x|."""
    return root_above(x @ x)


def rounded_down(x: Fraction) -> float:
    """Return the largest double that is not above a number; -inf below all."""
    if abs(x) > MOST:
        return sys.float_info.max if x > 0 else -math.inf
    nearest = float(x)
    return nearest if Fraction(nearest) <= x else math.nextafter(nearest, -math.inf)


def direction(angle: Fraction) -> tuple[Fraction, Fraction]:
    """Return cosine and sine, each within TINY."""
    cosine, sine = heading(angle)
    return Fraction(cosine, UNIT), Fraction(sine, UNIT)


@lru_cache(maxsize=65536)
def heading(angle: Fraction) -> tuple[int, int]:
    """Return cosine and sine in units, each within SLIGHT of them."""
    finely = (angle.numerator << FINE) // angle.denominator
    x = (finely + HALF_TURN) % (2 * HALF_TURN) - HALF_TURN >> FINE - BITS
    cosine, sine = _series(UNIT, 1, x * x >> BITS), _series(abs(x), 2, x * x >> BITS)
    return cosine, sine if x > 0 else -sine


def _series(term: int, k: int, square: int) -> int:
    """Return 1 - x^2 / 2! + .., or x - x^3 / 3! + .., given their first term and x^2."""
    total, sign = 0, 1
    while term:
        total += sign * term
        term, k, sign = (term * square >> BITS) // (k * (k + 1)), k + 2, -sign
    return total


def lacking(matrix: Matrix) -> Fraction:
    """Return an e >= 0 such that matrix + e I is positive semidefinite.

    Cholesky's method on whole numbers, each division rounded down. What it factors differs from
    the matrix by at most 2 max(L) + 2 in each entry, in its unit. It succeeds at the latest where
    the diagonal dominates.
    """
    rows, unit = matrix
    count, top = len(rows), max(abs(each) for row in rows for each in row)
    if not top:
        return ZERO
    entries = [[(row[j] << BITS) // top for j in range(i + 1)] for i, row in enumerate(rows)]
    shifts = *SHIFTS, 2 * count * UNIT
    low, middle, high = 0, 0, len(shifts)
    while low < high:  # least of all nothing, and else by halves
        largest = _factored([[*row[:-1], row[-1] + shifts[middle]] for row in entries])
        if largest:
            lack, high = shifts[middle] + count * (2 * largest + 2), middle
        else:
            low = middle + 1
        middle = (low + high) // 2
    return Fraction(top * lack, unit * UNIT)


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
