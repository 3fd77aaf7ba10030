# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Certificates as JSON: names that come once, finite numbers, files of a bounded size."""

from __future__ import annotations

import json
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
