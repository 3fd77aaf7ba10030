# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Rows as a plain table of 80 columns: a heading for each problem, a line for each contender."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from operator import attrgetter

from benchmarks.bench.rows import BenchRow

HEAD = ('', 'n', 'p50 ms', 'p99 ms', 'gap', 'objective', 'x p50', 'x p99', '')
WIDTHS = (22, 5, 8, 8, 6, 10, 7, 7, 7)


def text(rows: Sequence[BenchRow]) -> str:
    """Return the table; ``x`` are multiples of our time on the same instances."""
    lines = [_aligned(HEAD)]
    for problem, group in itertools.groupby(rows, attrgetter('problem')):
        lines.append(problem)
        for row in group:
            lines += [_aligned(_cells(row)), *(f'    {note}' for note in _notes(row))]
    return '\n'.join(lines)


def _aligned(cells: Sequence[str]) -> str:
    name, *others = zip(cells, WIDTHS, strict=True)
    return ''.join([name[0].ljust(name[1]), *(c.rjust(width) for c, width in others)]).rstrip()


def _cells(row: BenchRow) -> tuple[str, ...]:
    verdict = ('MISSED' if row.missed else 'met') if row.required and row.measured else ''
    return (
        f'  {row.contender}',
        str(row.n) if row.n else '-',
        _number(row.p50_ms, '.3g'),
        _number(row.p99_ms, '.3g'),
        _number(row.worst_gap, '.0e'),
        _number(row.objective, '.5g'),
        _number(row.ratio_p50, '.1f'),
        _number(row.ratio_p99, '.1f'),
        verdict,
    )


def _notes(row: BenchRow) -> Iterator[str]:
    if row.required:
        yield 'required: ' + ', '.join(f'{_short(k)} {v:g}' for k, v in row.required.items())
    if row.note:
        yield row.note


def _number(value: float, form: str) -> str:
    return '-' if math.isnan(value) else format(value, form)


def _short(name: str) -> str:
    """Return a field's limit as words: ratio_p50 becomes ``x p50 >=``."""
    if name.startswith('ratio_'):
        return f'x {name.removeprefix("ratio_")} >='
    return f'{name.replace("_ms", " ms").replace("worst_", "")} <='
