# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc verify``: verification of lower bounds in exact arithmetic.

The certificates in a file or a bag are verified directly. A bag's ticks are also solved again, each
for its own problem, and certificates are made for the bounds that were published. So are they for
claims that a problem is infeasible, or that no trajectory catches the goal before a given time.
"""

from __future__ import annotations

import gc
import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from orbimpc_ros.loop.intercept import steps_before
from orbimpc_ros.mpc.check import TOLERANCE
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.outcome import Status
from orbimpc_ros.mpc.problem.case import Case, Sought, case_of
from orbimpc_ros.mpc.proof import document
from orbimpc_ros.mpc.proof.document import Document, Unproved, certificate_of, refutation, text_of
from orbimpc_ros.mpc.solve.refute import refutation_of
from orbimpc_ros.tool import bags, files
from orbimpc_ros.tool.files import folder_at

if TYPE_CHECKING:
    from orbimpc_ros.tool.recording import ReplayedTick

LARGEST = 64 << 20  # [bytes] of a certificate's file
COST, CATCH = 'cost', 'catch'
HOLDS, FAILS, NOTHING, NONE = 'holds', 'DOES NOT HOLD', 'nothing claimed', 'no certificate'


class TickVerdict(NamedTuple):
    """The verdict on a bound."""

    tick: int | None  # its number; None for a published certificate
    of: str  # bounded quantity: a cost, infinite if infeasible, or a time to the catch [s]
    claimed: float | None = None  # published bound, if any
    proved: float | None = None  # bound that the certificate proves, if any
    leaves: int = 0  # of the certificate
    outcome: str = NOTHING  # verdict in a word or two
    more: str = ''  # what is written after it, such as a reason

    def __str__(self) -> str:
        name = '' if self.tick is None else f'{self.tick:>6}  '
        shown = ('' if each is None else repr(each) for each in (self.claimed, self.proved))
        claimed, proved = (f'{each:<24}' for each in shown)
        return f'{name}{self.of:<7}{claimed}{proved}{self.leaves:>6}  {self.outcome}{self.more}'

    def because(self, outcome: str, why: str) -> TickVerdict:
        """Return the verdict with another outcome, and its reason."""
        return self._replace(outcome=outcome, more=f': {why}')


def run(
    path: str,
    problem: str | None,
    tick: int | None,
    namespace: str,
    params: str | None,
    out: str | None,
) -> int:
    """Verify, print a row for each bound, and return 1 if one of them does not hold."""
    of_file = path.endswith('.json')
    first, found = '' if of_file else '  tick  ', list[TickVerdict]()
    bag = Path(path), namespace, params, tick, out
    for row in [_file(Path(path), problem)] if of_file else _bag(*bag):
        if not found:  # no header above an error about the file
            print(f'{first}{"of":<7}{"claimed":<24}{"proved":<24}leaves')
        found.append(row)
        print(row, flush=True)
    counts = Counter(row.outcome for row in found)
    print(', '.join(f'{count} {outcome}' for outcome, count in counts.items()))
    return 1 if counts[FAILS] else 0


def _file(path: Path, problem: str | None) -> TickVerdict:
    try:
        with files.opened(path, LARGEST) as stream:
            known = document.parsed(stream.read())
        row = _verified(None, known)
    except document.Refused as error:
        raise BadInput.stating('certificate', 'refused', str(error)) from None
    if problem and not _is_of(known, case_of(files.read(problem))):
        raise BadInput.stating('certificate', 'refused', f'it is not for {problem}')
    return row


def _is_of(known: Any, case: Case) -> bool:
    """Return whether a certificate belongs to a case: problem, state and goals."""
    made = document.statement(*case)
    if 'refuted' in known:
        known = {**known, 'refuted': {**known['refuted'], 'trees': []}}
        made = refutation(Sought(*case, radius=known['refuted'].get('radius', 0.0)), ())
    unlimited: dict[str, Any] = {'limits': {}}
    return {name: (unlimited | known).get(name) for name in unlimited | made} == unlimited | made


def _verified(tick: int | None, known: Any) -> TickVerdict:
    verdict = document.verified(known)
    catch = 'radius' in known.get('refuted', ())
    more = f', within {known["refuted"]["radius"]!r} m' if catch else ''
    outcome, of = HOLDS if verdict.holds else FAILS, CATCH if catch else COST
    return TickVerdict(tick, of, verdict.claimed, verdict.proved, verdict.leaves, outcome, more)


def _bag(
    path: Path, namespace: str, params: str | None, tick: int | None, out: str | None
) -> Iterator[TickVerdict]:
    from orbimpc_ros.tool import recording  # needs ROS, unlike a certificate file

    if tick is None:
        for each in bags.of_vehicle(path, namespace, {'certificate'}, needed=()):
            yield _published(bytes(each.content.data))
    known = recording.recording_of(path, namespace, params, tick=tick)
    gc.freeze()  # else each full collection scans all imported objects
    for number, answer in enumerate(recording.replayed(known)):
        if tick in (None, number):
            yield _tick(number, answer, out)
            yield from _catch(number, answer, out)


def _published(text: bytes) -> TickVerdict:
    """Verify a certificate that a planner published, without solving again."""
    try:
        return _verified(None, document.parsed(text))
    except document.Refused as error:
        return TickVerdict(None, COST).because(FAILS, str(error))


def _tick(number: int, each: ReplayedTick, out: str | None) -> TickVerdict:
    """Certify the bound published on a tick, for the problem that its inputs define."""
    then, tick, plan = each.recorded.answer, each.decision, each.decision.plan
    claimed = then.get('lower_bound')
    if then.get('status') == Status.INFEASIBLE:
        row, sought = TickVerdict(number, COST, math.inf), tick.infeasible
        if sought is None:
            return row.because(FAILS, f'the replay is {tick.status}')
        return _certified(row, out, lambda: refutation_of(sought))
    row = TickVerdict(number, COST, claimed)
    if claimed is None or not claimed > 0.0:
        return row
    if plan is None:
        return row.because(FAILS, f'the replay is {tick.status}')
    # Each time of catch is a separate problem, and a deadline can end the search for the earliest.
    earliest, catch = then.get('earliest_catch'), tick.catch
    if catch and earliest is not None and not np.isclose(catch.time, earliest, equal_nan=True):
        return row.because(NONE, 'it planned another catch, or none, at its deadline')
    if claimed > plan.objective + TOLERANCE * (plan.objective + plan.proof.cost_unit):
        return row.because(FAILS, f'a trajectory costs {plan.objective!r}')
    posed, proof = tick.case, replace(plan.proof, lower_bound=claimed)
    assert posed is not None
    return _certified(row, out, lambda: certificate_of(*posed, proof))


def _catch(number: int, each: ReplayedTick, out: str | None) -> Iterator[TickVerdict]:
    """Certify the time before which a tick claims that no trajectory catches the goal."""
    claimed, catch = each.recorded.answer.get('catch_bound'), each.decision.catch
    if claimed is None or not math.isfinite(claimed):
        return
    row = TickVerdict(number, CATCH, claimed)
    if catch is None:
        yield row.because(FAILS, 'the replay seeks no catch')
        return
    sought = catch.sought
    count = steps_before(claimed, sought.problem.step)
    if catch.time < claimed * (1.0 - TOLERANCE):
        yield row.because(FAILS, f'a plan catches the goal at {catch.time!r}')
    elif count:
        yield _certified(row, out, lambda: refutation_of(sought, count))


def _certified(row: TickVerdict, out: str | None, make: Callable[[], Document]) -> TickVerdict:
    """Return the verdict on a claim by making and verifying its certificate."""
    try:
        made = text_of(make())
        found = _verified(row.tick, document.parsed(made.encode()))
    except Unproved as error:
        return row.because(NONE, str(error).removeprefix(f'{NONE}: '))
    except document.Refused as error:
        return row.because(NONE, f'refused: {error}')
    if out:
        name = f'tick_{row.tick:05d}{"_catch" * (row.of == CATCH)}.json'
        (folder_at(Path(out)) / name).write_text(made + '\n')
    if found.outcome == FAILS:  # not refuted: no trajectory is known to cost less
        return found.because(NONE, f'another search proves {found.proved!r}')
    return found
