# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Results: rows in a file that is whole after each of them, a table, a picture."""

from __future__ import annotations

import itertools
import json
import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bench.interleaved import OURS, Samples, differences, percentiles
from benchmarks.machine import machine, versions
from orbimpc_ros.tool.files import write_whole

OWN = ('note', 'beaten', 'failed', 'capped')  # fields that the file does not have
LATE = 'ticks late by over a period'  # what rows of many planners count, besides their times
HULLS = 'SE(2) hull N='  # how the problems begin whose time is looked at over N
SAME = 1e-4  # relative: objectives closer than this agree
HEAD = ('', 'n', 'p50 ms', 'p99 ms', 'gap', 'objective', 'x p50', 'x p99', '')
WIDTHS = (22, 5, 8, 8, 6, 10, 7, 7, 7)
INDENT = 4  # of remarks


@dataclass(frozen=True)
class BenchRow:
    """One solver on one problem; what was not measured is NaN, in JSON null.

    Attributes:
        problem: what was solved.
        contender: by whom.
        n: solves measured; 0 for who is absent.
        p50_ms: median time [ms].
        p99_ms: 99th percentile [ms].
        worst_gap: largest relative gap it proved; NaN if it proves nothing.
        objective: median, of the instances it solved; of a live measurement, the figure that
            the problem's name ends with.
        ratio_p50: its median over ours, on common instances.
        ratio_p99: the same at the 99th percentile.
        required: limits by field: ratios at least, everything else at most.
        note: for the table alone.
        beaten: whether it found a trajectory that costs less than ours.
        capped: solves that ran into their time limit: its times and ratios are at least these.
        failed: whether the measurement itself, or our own solver, broke off.
    """

    problem: str
    contender: str
    n: int = 0
    p50_ms: float = math.nan
    p99_ms: float = math.nan
    worst_gap: float = math.nan
    objective: float = math.nan
    ratio_p50: float = math.nan
    ratio_p99: float = math.nan
    required: Mapping[str, float] | None = None
    note: str = ''
    beaten: bool = False
    failed: bool = False
    capped: int = 0

    def as_json(self) -> dict[str, Any]:
        """Return the fields of the file, with None for NaN."""
        values = {k: v for k, v in asdict(self).items() if k not in OWN}
        bare = {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in values.items()}
        return {**bare, 'required': dict(self.required) if self.required else None}

    @property
    def measured(self) -> bool:
        """Return whether there is anything to judge."""
        return self.n > 0

    @property
    def rival(self) -> bool:
        """Return whether somebody else was timed on the same problem as we."""
        return self.contender != OURS and not math.isnan(self.ratio_p50)

    @property
    def missed(self) -> list[str]:
        """Return the fields that miss what is required of them; a NaN misses everything."""
        return [k for k, limit in (self.required or {}).items() if not self._meets(k, limit)]

    def _meets(self, name: str, limit: float) -> bool:
        value = getattr(self, name)
        return bool(value >= limit if name.startswith('ratio') else value <= limit)


def rows_of(
    problem: str,
    samples: Mapping[str, Samples],
    required: Mapping[str, Mapping[str, float]],
    gap: float = 0.0,
) -> list[BenchRow]:
    """Return a row per solver, ours first; objectives agree that are no farther than ``gap``."""
    ours, same = samples[OURS], max(SAME, gap)
    return [
        _row(problem, name, (each, ours), required.get(name), same)
        for name, each in samples.items()
    ]


def _row(
    problem: str,
    name: str,
    sides: tuple[Samples, Samples],
    required: Mapping[str, float] | None,
    same: float,
) -> BenchRow:
    theirs, ours = sides
    common = sorted(theirs.times.keys() & ours.times.keys())
    broken = theirs is ours and bool(ours.refused)
    if not common:
        note = theirs.refused or 'nothing to compare'
        return BenchRow(problem, name, required=required, note=note, failed=broken)
    p50, p99 = percentiles([theirs.times[i] for i in common])
    base_50, base_99 = percentiles([ours.times[i] for i in common])
    solutions = theirs.solutions.values()
    return BenchRow(
        problem=problem,
        contender=name,
        n=len(theirs.times),
        p50_ms=p50,
        p99_ms=p99,
        worst_gap=_largest([a.gap for a in solutions]),
        objective=float(np.nanmedian([a.objective for a in solutions])),
        ratio_p50=p50 / base_50,
        ratio_p99=p99 / base_99,
        required=required,
        note=_note(theirs, ours, same),
        beaten=not _relaxed(theirs) and bool((differences(theirs, ours) < -same).any()),
        failed=broken,
        capped=sum(each.capped for each in solutions),
    )


def _largest(gaps: list[float]) -> float:
    known = [gap for gap in gaps if not math.isnan(gap)]
    return max(known) if known else math.nan


def _relaxed(samples: Samples) -> bool:
    """Return whether a solver solves the relaxation: its result is a bound."""
    return any(each.relaxed for each in samples.solutions.values())


def _note(theirs: Samples, ours: Samples, same: float) -> str:
    """Return remarks on its objectives and its time limit."""
    if theirs is ours:
        return theirs.refused
    apart, notes = differences(theirs, ours), []
    failed, worse, better = np.isnan(apart).sum(), (apart > same).sum(), (apart < -same).sum()
    below = 'relaxed: a bound, lower' if _relaxed(theirs) else 'BETTER than ours'
    for count, what in ((failed, 'no solution'), (worse, 'worse'), (better, below)):
        if count:
            notes.append(f'{what} on {count}')
    capped = sum(each.capped for each in theirs.solutions.values())
    if capped:
        notes.append(f'time limit hit on {capped}: ratios are at least')
    if theirs.refused:
        notes.append(theirs.refused)
    fewer = f' on {len(apart)} of {len(ours.solutions)}' if len(apart) < len(ours.solutions) else ''
    return ', '.join(notes) or f'objectives agree{fewer}'


def growth(rows: Sequence[BenchRow]) -> list[BenchRow]:
    """Return how time grows with N over the hull's rows, whose problem ends with it: its exponent.

    Fitted to the medians, both logarithmic.
    """
    rows = [row for row in rows if row.problem.startswith(HULLS) and row.measured]
    if len(rows) < 3:
        return []
    sizes = [float(row.problem.rpartition('=')[2]) for row in rows]
    slope, _ = np.polyfit(np.log(sizes), np.log([row.p50_ms for row in rows]), 1)
    title = f'SE(2) hull N={sizes[0]:.0f}..{sizes[-1]:.0f}: exponent of N'
    wanted = {'objective': 1.1}
    return [BenchRow(title, OURS, len(rows), objective=float(slope), required=wanted)]


def table(rows: Sequence[BenchRow]) -> str:
    """Return the table; ``x`` are multiples of our time on the same instances."""
    lines = [_aligned(HEAD)]
    for problem, group in itertools.groupby(rows, attrgetter('problem')):
        lines.append(problem)
        for row in group:
            lines += [_aligned(_cells(row)), *itertools.chain(*map(_wrapped, _notes(row)))]
    return '\n'.join(lines)


def _wrapped(note: str) -> list[str]:
    return textwrap.wrap(
        note, sum(WIDTHS), initial_indent=INDENT * ' ', subsequent_indent=INDENT * ' '
    )


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


class Result:
    """What has been measured so far, on disk from the first row on.

    Args:
        file: takes the rows as JSON; None for nowhere.
        picture: takes a PNG at the end; None for none.
    """

    def __init__(self, file: Path | None, picture: Path | None) -> None:
        self._file, self._picture = file, picture
        self._head = {'machine': machine(), 'versions': versions()}
        self.rows: list[BenchRow] = []

    def add(self, rows: Sequence[BenchRow]) -> None:
        """Keep rows: whatever happens later, they are in the file."""
        self.rows += rows
        if self._file is not None:
            content = {**self._head, 'rows': [row.as_json() for row in self.rows]}
            text = json.dumps(content, indent=1, allow_nan=False) + '\n'
            write_whole(self._file, lambda new: new.write_text(text))

    def close(self) -> None:
        """Print the table and draw the picture of what there is."""
        print(table(self.rows))
        if self._picture is not None and self.rows:
            from benchmarks.bench.picture import draw

            draw(self.rows, self._picture)
