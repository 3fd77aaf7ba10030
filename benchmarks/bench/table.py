# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Rows as a plain table."""

from __future__ import annotations

import math
from collections.abc import Sequence

from benchmarks.bench.rows import BenchRow
from benchmarks.columns import aligned

HEAD = (
    *('problem', 'contender', 'n', 'p50 ms', 'p99 ms', 'gap', 'objective', 'x p50', 'x p99'),
    *('required', '', 'note'),
)
NUMBERS = range(2, 9)


def text(rows: Sequence[BenchRow]) -> str:
    """Return the table; ``x`` are multiples of our time on the same instances."""
    return aligned([HEAD, *(_cells(row) for row in rows)], NUMBERS)


def _cells(row: BenchRow) -> tuple[str, ...]:
    verdict = ('missed' if row.missed else 'met') if row.required and row.measured else ''
    return (
        row.problem,
        row.contender,
        str(row.n) if row.n else '-',
        _number(row.p50_ms, '.3g'),
        _number(row.p99_ms, '.3g'),
        _number(row.worst_gap, '.0e'),
        _number(row.objective, '.6g'),
        _number(row.ratio_p50, '.1f'),
        _number(row.ratio_p99, '.1f'),
        ', '.join(f'{_short(k)} {v:g}' for k, v in (row.required or {}).items()),
        verdict,
        row.note,
    )


def _number(value: float, form: str) -> str:
    return '-' if math.isnan(value) else format(value, form)


def _short(name: str) -> str:
    """Return a field's limit as words: ratio_p50 becomes ``x p50 >=``."""
    if name.startswith('ratio_'):
        return f'x {name.removeprefix("ratio_")} >='
    return f'{name.replace("_ms", " ms").replace("worst_", "")} <='
