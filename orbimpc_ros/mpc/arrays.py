# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Validation of untrusted fields, numbers and arrays; frozen types that are equal by content."""

from __future__ import annotations

import difflib
import math
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from orbimpc_ros.mpc.errors import BadInput

Array = NDArray[np.floating[Any]]


def frozen(value: ArrayLike, shape: tuple[int, ...], culprit: str) -> Array:
    """Return ``value`` as a read-only float array of the given shape; (-1,) is of any length.

    Raises:
        BadInput: not numbers, another shape, NaN or infinite.
    """
    with suppress(TypeError, ValueError, OverflowError):
        entries = numbers_of(value, culprit) if isinstance(value, list) else value
        array: Any = entries if _is_sealed(entries) else np.array(entries, dtype=float)
        fits = array.ndim == 1 if shape == (-1,) else array.shape == shape
        if fits and np.isfinite(array).all():
            return sealed(array)
    sizes = '' if shape == (-1,) else f'{"x".join(map(str, shape))} '
    raise BadInput(culprit, value, f'{sizes}finite numbers')


def _is_sealed(value: Any) -> bool:
    """Return True for an array of floats that nobody can change: it need not be copied."""
    plain = type(value) is np.ndarray and value.dtype == float and value.base is None
    return plain and not value.flags.writeable


def sealed(array: Array) -> Array:
    """Make a trusted array of any shape read-only, so that frozen types stay frozen."""
    array.setflags(write=False)
    return array


def number(
    value: Any,
    culprit: str,
    low: float = -math.inf,
    high: float = math.inf,
    *,
    above: bool = False,
) -> float:
    """Return ``value`` as a finite float in [low, high] (in (low, high] if ``above``).

    Raises:
        BadInput: not a number, not finite or out of range.
    """
    with suppress(OverflowError):  # an integer beyond the range of floats
        if _is_number(value):
            result = float(value)
            if math.isfinite(result) and low <= result <= high and not (above and result == low):
                return result
    first = '(' if above or low == -math.inf else '['  # infinity itself is not allowed
    last = ')' if high == math.inf else ']'
    raise BadInput(culprit, repr(value), f'a number in {first}{low:g}, {high:g}{last}')


def whole(value: Any, culprit: str, low: int, high: int) -> int:
    """Return ``value`` as an integer in [low, high].

    Raises:
        BadInput: not an integer or out of range.
    """
    is_whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if is_whole and low <= value <= high:
        return int(value)
    raise BadInput(culprit, repr(value), f'an integer in [{low}, {high}]')


def word(value: Any, culprit: str, words: Collection[str]) -> str:
    """Return ``value`` if it is one of a few words.

    Raises:
        BadInput: it is none of them; the closest one is named.
    """
    if isinstance(value, str) and value in words:
        return value
    close = difflib.get_close_matches(str(value), words, n=1)
    meant = f'; did you mean {close[0]!r}?' if close else ''
    raise BadInput(culprit, value, ' | '.join(each or "''" for each in words) + meant)


def fields_of(
    value: Any, culprit: str, needed: Iterable[str], optional: Iterable[str] = ()
) -> Mapping[str, Any]:
    """Return ``value`` if it is a mapping with all needed fields and no unknown ones."""
    allowed = (*needed, *optional)
    if not isinstance(value, dict):
        raise BadInput(culprit, value, f'a mapping of {", ".join(allowed)}')
    for name in value:
        if name not in allowed:
            raise BadInput.unknown(f'{culprit} field', str(name), allowed)
    for name in needed:
        if name not in value:
            hint = f'needed: {", ".join(needed)}'
            raise BadInput.stating(f'{culprit} field {name}', 'missing', hint)
    return value


def numbers_of(value: Any, culprit: str) -> Any:
    """Return ``value`` if it is a list of numbers, or of lists of the same length of them.

    NumPy accepts words and truth values, too.
    """
    if not (isinstance(value, list) and all(map(_is_number, np.array(value, object).ravel()))):
        raise BadInput(culprit, value, 'a list of finite numbers, or lists of the same length')
    return value


def _is_number(value: Any) -> bool:
    numeric = isinstance(value, (int, float, np.integer, np.floating))
    return numeric and not isinstance(value, bool)


class ByContent:
    """Equality and hash by content for frozen dataclasses with arrays, which support neither."""

    def _content(self) -> tuple[object, ...]:
        values = (getattr(self, each.name) for each in fields(self))  # type: ignore[arg-type]
        return tuple(map(_comparable, values))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, ByContent) or type(self) is not type(other):
            return NotImplemented
        return self._content() == other._content()

    def __hash__(self) -> int:
        return hash((type(self), self._content()))


class Sealed(ByContent):
    """Frozen dataclasses whose arrays are read-only."""

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)


def _comparable(value: object) -> object:
    if isinstance(value, Mapping):
        return frozenset((key, _comparable(each)) for key, each in value.items())
    if isinstance(value, list):
        return tuple(map(_comparable, value))
    if not isinstance(value, np.ndarray):
        return value
    return value.shape, (value + 0.0).tobytes()  # adding zero turns -0.0 into 0.0, which it equals
