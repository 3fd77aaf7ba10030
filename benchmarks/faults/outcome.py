# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Outcomes of single cases, rows of the matrix, and the table."""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from benchmarks.faults.harness import Fixtures

HEAD = ('row', 'cases', 'unsafe', 'worst', 'allowed', 'unit', 'ok', 'remarks')
NUMBERS = range(1, 5)
NEVER = 'never'
SHOWN = 3  # failures that a row names


@dataclass(frozen=True)
class Outcome:
    """The outcome of one case.

    Attributes:
        case: which it was, in a few words.
        unsafe: commands that should never have been sent.
        reaction: how late it reacted, in the row's unit; NaN if nothing had to happen.
        failure: what else went wrong, in words; empty if nothing did.
    """

    case: str
    unsafe: int = 0
    reaction: float = math.nan
    failure: str = ''


@dataclass(frozen=True)
class FaultCase:
    """A fault: a row of the matrix before it is injected.

    Attributes:
        name: for ``--only``.
        title: what is done.
        allowed: latest reaction, in ``unit``.
        cases: yields the outcomes, of every case there is if asked for the long form.
        unit: of reactions.
    """

    name: str
    title: str
    allowed: float
    cases: Callable[[Fixtures, bool], Iterator[Outcome]]
    unit: str = 'ticks'


@dataclass
class MatrixRow:
    """A row of the matrix: the outcomes so far of a fault case, and the time that it took [s]."""

    case: FaultCase
    outcomes: list[Outcome] = field(default_factory=list)
    seconds: float = 0.0

    @property
    def unsafe(self) -> int:
        """Return how many commands should never have been sent."""
        return sum(each.unsafe for each in self.outcomes)

    @property
    def worst(self) -> float:
        """Return the latest reaction; NaN where none was due."""
        found = [each.reaction for each in self.outcomes if not math.isnan(each.reaction)]
        return max(found, default=math.nan)

    @property
    def failures(self) -> list[str]:
        """Return what went wrong, case by case."""
        return [text for each in self.outcomes if (text := self._failure(each))]

    def _failure(self, outcome: Outcome) -> str:
        late = outcome.reaction > self.case.allowed
        when = f'{outcome.reaction:.3g} {self.case.unit}' if outcome.reaction < math.inf else NEVER
        wrong = [
            outcome.failure,
            f'{outcome.unsafe} unsafe commands' if outcome.unsafe else '',
            f'reaction: {when}' if late else '',
        ]
        text = ', '.join(filter(None, wrong))
        return f'{outcome.case}: {text}' if text else ''

    @property
    def ok(self) -> bool:
        """Return whether every case was safe and in time, and there was one."""
        return bool(self.outcomes) and not self.failures

    def as_json(self) -> dict[str, Any]:
        """Return the row for a JSON file."""
        about = {name: getattr(self.case, name) for name in ('name', 'title', 'allowed', 'unit')}
        cases = [_plain(asdict(each)) for each in self.outcomes]
        summed = {
            'unsafe': self.unsafe,
            'worst': self.worst,
            'ok': self.ok,
            'seconds': self.seconds,
        }
        return _plain({**about, **summed, 'failures': self.failures, 'cases': cases})


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    """Return values without those that JSON does not have."""
    words = {math.inf: NEVER}
    return {k: None if v != v else words.get(v, v) if isinstance(v, float) else v
            for k, v in values.items()}  # fmt: skip


def table(rows: Sequence[MatrixRow]) -> str:
    """Return the rows as a plain table."""
    return _aligned([HEAD, *(_cells(row) for row in rows)], NUMBERS)


def _cells(row: MatrixRow) -> tuple[str, ...]:
    shown = row.failures[:SHOWN]
    more = len(row.failures) - len(shown)
    remarks = '; '.join([*shown, f'and {more} more'] if more else shown)
    return (
        row.case.title,
        str(len(row.outcomes)),
        str(row.unsafe),
        '-' if math.isnan(row.worst) else f'{row.worst:.3g}',
        f'{row.case.allowed:g}',
        row.case.unit,
        'yes' if row.ok else 'NO',
        remarks,
    )


def _aligned(lines: Sequence[Sequence[str]], numbers: Container[int]) -> str:
    """Return lines of cells as columns; those of ``numbers`` are flush right, the others left."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    shown = []
    for line in lines:
        padded = (c.rjust(w) if i in numbers else c.ljust(w)
                  for i, (c, w) in enumerate(zip(line, widths, strict=True)))  # fmt: skip
        shown.append('  '.join(padded).rstrip())
    return '\n'.join(shown)
