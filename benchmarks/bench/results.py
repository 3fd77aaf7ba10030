# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Rows of results, their table, and their values for the JSON file, written after each row."""

from __future__ import annotations

import itertools
import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from operator import attrgetter
from typing import Any

import numpy as np

from benchmarks.bench.interleaved import OURS, Samples
from orbimpc_ros.mpc.arrays import Array

OWN = ('note', 'beaten', 'failed')  # fields that are not in the file
LATE = 'ticks late by over a period'  # counted in rows of many planners, in addition to times
HULLS = 'SE(2) hull N='  # prefix of the problems whose time is fitted over N
SAME = 1e-4  # relative difference up to which objectives agree
LAYOUT = '  {:<20}{:>5}{:>8}{:>8}{:>6}{:>10}{:>7}{:>7}{:>7}'
HEAD = ('', 'n', 'p50 ms', 'p99 ms', 'gap', 'objective', 'x p50', 'x p99', '')
WIDTH, INDENT = 80, 4 * ' '


@dataclass(frozen=True)
class BenchRow:
    """The results of one solver on one problem; unmeasured values are NaN, or null in JSON."""

    problem: str  # title
    contender: str  # name of the solver
    n: int = 0  # solves measured; 0 for a solver that is absent
    p50_ms: float = math.nan  # median time [ms]
    p99_ms: float = math.nan  # 99th percentile [ms]
    worst_gap: float = math.nan  # largest relative gap it proved; NaN if it proves nothing
    # median over the instances it solved; of a live measurement, the figure that the problem's
    # title ends with
    objective: float = math.nan
    ratio_p50: float = math.nan  # its median over ours, on common instances
    ratio_p99: float = math.nan  # the same at the 99th percentile
    # limits by field: ratios at least, everything else at most
    required: Mapping[str, float] | None = None
    note: str = ''  # for the table alone
    beaten: bool = False  # whether it found a trajectory that costs less than ours
    failed: bool = False  # whether the measurement itself, or our own solver, failed

    def as_json(self) -> dict[str, Any]:
        """Return the fields of the file, with None for NaN."""
        values = {k: v for k, v in asdict(self).items() if k not in OWN}
        bare = {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in values.items()}
        return {**bare, 'required': dict(self.required) if self.required else None}

    @property
    def missed(self) -> list[str]:
        """Return the measured fields that miss their limits; a NaN misses every limit."""
        limits = (self.required or {}).items() if self.n else ()
        return [name for name, limit in limits if not self._meets(name, limit)]

    def _meets(self, name: str, limit: float) -> bool:
        value = getattr(self, name)
        return bool(value >= limit if name.startswith('ratio') else value <= limit)


def percentiles(times: Sequence[float] | Array) -> tuple[float, float]:
    """Return median and 99th percentile."""
    p50, p99 = np.percentile(times, [50, 99])
    return float(p50), float(p99)


def rows_of(
    problem: str,
    samples: Mapping[str, Samples],
    required: Mapping[str, Mapping[str, float]],
    gap: float = 0.0,
) -> list[BenchRow]:
    """Return a row per solver, ours first; objectives within ``gap`` of each other agree."""
    return [
        _measured(BenchRow(problem, name, required=required.get(name)), each, samples[OURS], gap)
        for name, each in samples.items()
    ]


def _measured(row: BenchRow, theirs: Samples, ours: Samples, gap: float) -> BenchRow:
    """Return the row of a solver with its measurements, also relative to ours."""
    common = sorted(theirs.times.keys() & ours.times.keys())
    row = replace(row, note=theirs.refused, failed=theirs is ours and bool(ours.refused))
    if not common:
        return replace(row, note=theirs.refused or 'nothing to compare')
    p50, p99 = percentiles([theirs.times[i] for i in common])
    base_50, base_99 = percentiles([ours.times[i] for i in common])
    solutions, same = theirs.solutions.values(), max(SAME, gap)
    gaps = [each.gap for each in solutions if not math.isnan(each.gap)]
    found, own = (
        np.array([each.solutions[i].objective for i in common]) for each in (theirs, ours)
    )
    off = (found - own) / np.maximum(1e-9, np.abs(own))
    capped = sum(each.capped for each in solutions)
    return replace(
        row,
        n=len(theirs.times),
        p50_ms=p50,
        p99_ms=p99,
        worst_gap=max(gaps, default=math.nan),
        objective=float(np.nanmedian([each.objective for each in solutions])),
        ratio_p50=p50 / base_50,
        ratio_p99=p99 / base_99,
        note=theirs.refused if theirs is ours else _note(off, same, capped, theirs, ours),
        beaten=bool((off < -same).any()),
    )


def _note(off: Array, same: float, capped: int, theirs: Samples, ours: Samples) -> str:
    """Return remarks on objectives and time limit."""
    counts = {
        'no solution on': np.isnan(off).sum(),
        'worse on': (off > same).sum(),
        'BETTER than ours on': (off < -same).sum(),
    }
    notes = [f'{text} {count}' for text, count in counts.items() if count]
    if capped:
        notes.append(f'time limit hit on {capped}: ratios are at least')
    if theirs.refused:
        notes.append(theirs.refused)
    few = f' on {len(off)} of {len(ours.solutions)}' if len(off) < len(ours.solutions) else ''
    return ', '.join(notes) or f'objectives agree{few}'


def growth(rows: Sequence[BenchRow]) -> list[BenchRow]:
    """Return a row with the exponent of N in the median time of the hull's problems."""
    rows = [row for row in rows if row.problem.startswith(HULLS) and row.n]
    if len(rows) < 3:
        return []
    sizes = [float(row.problem.rpartition('=')[2]) for row in rows]
    slope, _ = np.polyfit(np.log(sizes), np.log([row.p50_ms for row in rows]), 1)
    title = f'{HULLS}{sizes[0]:.0f}..{sizes[-1]:.0f}: exponent of N'
    wanted = {'objective': 1.1}
    return [BenchRow(title, OURS, len(rows), objective=float(slope), required=wanted)]


def table(rows: Sequence[BenchRow]) -> str:
    """Return the table; columns ``x`` are multiples of our time on the same instances."""
    lines = [LAYOUT.format(*HEAD).rstrip()]
    for problem, group in itertools.groupby(rows, attrgetter('problem')):
        lines.append(problem)
        for row in group:
            lines.append(LAYOUT.format(*_cells(row)).rstrip())
            for note in filter(None, (_required(row), row.note)):
                lines += textwrap.wrap(note, WIDTH, initial_indent=INDENT, subsequent_indent=INDENT)
    return '\n'.join(lines)


def _cells(row: BenchRow) -> tuple[str, ...]:
    numbers = (
        *((row.p50_ms, '.3g'), (row.p99_ms, '.3g'), (row.worst_gap, '.0e')),
        *((row.objective, '.5g'), (row.ratio_p50, '.1f'), (row.ratio_p99, '.1f')),
    )
    shown = ('-' if math.isnan(value) else format(value, form) for value, form in numbers)
    verdict = ('MISSED' if row.missed else 'met') if row.required and row.n else ''
    return (row.contender, str(row.n or '-'), *shown, verdict)


def _required(row: BenchRow) -> str:
    """Return the limits as text, such as ``x p50 >= 10`` for ratio_p50."""
    limits = (
        f'x {name[6:]} >= {limit:g}'
        if name.startswith('ratio_')
        else f'{name.replace("_ms", " ms").replace("worst_", "")} <= {limit:g}'
        for name, limit in (row.required or {}).items()
    )
    return f'required: {", ".join(limits)}' if row.required else ''
