# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""JSON as it has to be: fields that are known, numbers that are doubles, lists of their length."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

LARGEST = 64 << 20  # bytes of a file


class Refused(ValueError):
    """What is no certificate, or none that is sound: with the reason, in one line."""


def read(path: str | Path) -> Any:
    """Return the document of a file.

    Raises:
        Refused: it is too large, or no JSON without doubled names and numbers that are none.
    """
    try:
        with Path(path).open('rb') as file:
            large = file.seek(0, 2) > LARGEST
            file.seek(0)
            text = b'' if large else file.read(LARGEST)
    except OSError as error:
        raise Refused(f'{path}: {error.strerror}') from None
    if large:
        raise Refused(f'{path}: larger than {LARGEST >> 20} MB')
    return parsed(text)


def parsed(text: bytes) -> Any:
    """Return the document of a file's content, as :func:`read` does."""
    try:
        return json.loads(text, object_pairs_hook=_without_doubles, parse_constant=_no_number)
    except (ValueError, RecursionError) as error:
        raise Refused(f'no JSON that is a certificate: {error}') from None


def _without_doubles(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len(dict(pairs)) < len(pairs):
        raise Refused('a name comes twice')
    return dict(pairs)


def _no_number(word: str) -> Any:
    raise Refused(f'{word} is not a finite number')


def fields(value: Any, name: str, needed: tuple[str, ...], optional: tuple[str, ...] = ()) -> None:
    """Refuse what is no mapping with the names that are needed, and none that is unknown."""
    if not isinstance(value, dict):
        raise Refused(f'{name} is not a mapping')
    for each in needed:
        if each not in value:
            raise Refused(f'{name} lacks {each}')
    for each in value:
        if each not in (*needed, *optional):
            raise Refused(f'{name} has an unknown {each!r}')


def number(value: Any, name: str) -> float:
    """Return a number that is a double."""
    try:
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            found = float(value)
            if math.isfinite(found):
                return found
    except OverflowError:
        pass
    raise Refused(f'{name} is not a finite number')


def whole(value: Any, name: str, low: int, high: int) -> int:
    """Return a whole number within bounds."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise Refused(f'{name} is not a whole number from {low} to {high}')
    return value


def word(value: Any, name: str, words: tuple[str, ...]) -> str:
    """Return one of some words."""
    if value not in words:
        raise Refused(f'{name} is not one of {", ".join(words)}')
    return str(value)


def items(value: Any, name: str, count: int | None = None) -> list[Any]:
    """Return a list, of a length if one is given."""
    if not isinstance(value, list) or count not in (None, len(value)):
        raise Refused(f'{name} is not a list' + ('' if count is None else f' of {count}'))
    return value
