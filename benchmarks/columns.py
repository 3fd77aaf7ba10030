# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A table in plain text."""

from __future__ import annotations

from collections.abc import Container, Sequence


def aligned(lines: Sequence[Sequence[str]], numbers: Container[int]) -> str:
    """Return lines of cells as columns; those of ``numbers`` are flush right, the others left."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    shown = []
    for line in lines:
        padded = (c.rjust(w) if i in numbers else c.ljust(w)
                  for i, (c, w) in enumerate(zip(line, widths, strict=True)))  # fmt: skip
        shown.append('  '.join(padded).rstrip())
    return '\n'.join(shown)
