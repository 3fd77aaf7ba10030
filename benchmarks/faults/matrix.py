# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Fault cases, outcomes of single tries, rows of the matrix, and its table."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

LAYOUT = '{:<59}  {:>5}  {:>6}  {:>7}  {:>7}  {:<5}  {:<3}  {}'
HEAD = ('row', 'cases', 'unsafe', 'worst', 'allowed', 'unit', 'ok', 'remarks')
NEVER = 'never'


@dataclass(frozen=True)
class Outcome:
    """The outcome of one case."""

    case: str  # description
    unsafe: int = 0  # commands that should never have been sent
    reaction: float = math.nan  # delay, in the row's unit; NaN if no reaction was due
    failure: str = ''  # description of other failures; empty without


@dataclass
class FaultCase:
    """A fault: a row of the matrix, with its outcomes so far."""

    name: str  # for ``--only``
    title: str  # description
    allowed: float  # latest reaction, in ``unit``
    # yields the outcomes, given a bench of harnesses and whether every case is to be tried
    cases: Callable[[Any, bool], Iterator[Outcome]]
    unit: str = 'ticks'  # of reactions
    outcomes: list[Outcome] = field(default_factory=list)
    seconds: float = 0.0  # so far

    @property
    def unsafe(self) -> int:
        """Return the number of commands that should never have been sent."""
        return sum(each.unsafe for each in self.outcomes)

    @property
    def worst(self) -> float:
        """Return the latest reaction; NaN if none was due."""
        found = [each.reaction for each in self.outcomes if not math.isnan(each.reaction)]
        return max(found, default=math.nan)

    @property
    def failures(self) -> list[str]:
        """Return the failures, case by case."""
        return [text for each in self.outcomes if (text := self._failure(each))]

    def _failure(self, outcome: Outcome) -> str:
        late = outcome.reaction > self.allowed
        when = f'{outcome.reaction:.3g} {self.unit}' if outcome.reaction < math.inf else NEVER
        wrong = [
            outcome.failure,
            f'{outcome.unsafe} unsafe commands' if outcome.unsafe else '',
            f'reaction: {when}' if late else '',
        ]
        text = ', '.join(filter(None, wrong))
        return f'{outcome.case}: {text}' if text else ''

    @property
    def ok(self) -> bool:
        """Return whether there were cases, and all were safe and in time."""
        return bool(self.outcomes) and not self.failures

    def as_json(self) -> dict[str, Any]:
        """Return the row for a JSON file."""
        known = ('name', 'title', 'allowed', 'unit', 'unsafe', 'ok', 'seconds', 'failures')
        found = {name: getattr(self, name) for name in known}
        cases = [asdict(each) | {'reaction': _number(each.reaction)} for each in self.outcomes]
        return {**found, 'worst': _number(self.worst), 'cases': cases}

    def cells(self) -> tuple[str, ...]:
        """Return the row of the table."""
        return (
            *(self.title, str(len(self.outcomes)), str(self.unsafe)),
            '-' if math.isnan(self.worst) else f'{self.worst:.3g}',
            *(f'{self.allowed:g}', self.unit, 'yes' if self.ok else 'NO'),
            '; '.join(self.failures),
        )


def _number(value: float) -> float | str | None:
    """Return a number for JSON, which has neither NaN nor infinity."""
    return None if math.isnan(value) else NEVER if value == math.inf else value


def table(rows: Sequence[FaultCase]) -> str:
    """Return the rows as a plain table."""
    lines = [HEAD, *(row.cells() for row in rows)]
    return '\n'.join(LAYOUT.format(*line).rstrip() for line in lines)
