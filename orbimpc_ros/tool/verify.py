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
from typing import Any, NamedTuple

import numpy as np

from orbimpc_ros.loop.intercept import steps_before
from orbimpc_ros.loop.planner import Decision
from orbimpc_ros.mpc.check import TOLERANCE
from orbimpc_ros.mpc.errors import BadInput, OrbimpcError
from orbimpc_ros.mpc.outcome import Status
from orbimpc_ros.mpc.problem.case import Case, case_of
from orbimpc_ros.mpc.proof import document
from orbimpc_ros.mpc.proof.document import Document, Unproved, certificate_of, refutation, text_of
from orbimpc_ros.mpc.solve.refute import refutation_of
from orbimpc_ros.tool import bags, files, replay

LARGEST = 64 << 20  # [bytes] of a certificate's file
COST, CATCH = 'cost', 'catch'
HOLDS, FAILS, NOTHING, NONE = 'holds', 'DOES NOT HOLD', 'nothing claimed', 'no certificate'


class Refuted(OrbimpcError):
    """A claim is wrong; the message tells why."""


class Line(NamedTuple):
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


def run(path: str, problem: str | None, **of_bag: Any) -> int:
    """Verify, print a row for each bound, and return 1 if one of them does not hold."""
    of_file, counts = path.endswith('.json'), Counter[str]()
    for name, value in of_bag.items() if of_file else [('problem', problem)]:
        if value not in (None, ''):
            source = 'a bag' if of_file else 'a certificate, FILE.json'
            raise BadInput(f'--{name}', value, f'only with {source}')
    for row in [_file(Path(path), problem)] if of_file else _bag(Path(path), **of_bag):
        if not counts:  # no header above an error about the file
            print(f'{"" if of_file else "  tick  "}{"of":<7}{"claimed":<24}{"proved":<24}leaves')
        counts[row.outcome] += 1
        print(row, flush=True)
    print(', '.join(f'{count} {outcome}' for outcome, count in counts.items()))
    return 1 if counts[FAILS] else 0


def _file(path: Path, problem: str | None) -> Line:
    try:
        with files.opened(path, LARGEST) as stream:
            certificate = document.parsed(stream.read())
        row = _verified(None, certificate)
    except document.Refused as error:
        raise BadInput.stating('certificate', 'refused', str(error)) from None
    if problem and not _is_of(certificate, case_of(files.read(problem))):
        raise BadInput.stating('certificate', 'refused', f'it is not for {problem}')
    return row


def _is_of(proof: Any, case: Case) -> bool:
    """Return whether a certificate belongs to a case: problem, state and goals."""
    claim = document.statement(*case.parts)
    if 'refuted' in proof:
        proof = {**proof, 'refuted': {**proof['refuted'], 'trees': []}}
        claim = refutation(replace(case, radius=proof['refuted'].get('radius', 0.0)), ())
    unlimited: dict[str, Any] = {'limits': {}}
    return {name: (unlimited | proof).get(name) for name in unlimited | claim} == unlimited | claim


def _verified(tick: int | None, certificate: Any) -> Line:
    verdict = document.verified(certificate)
    catch = 'radius' in certificate.get('refuted', ())
    more = f', within {certificate["refuted"]["radius"]!r} m' if catch else ''
    outcome, of = HOLDS if verdict.holds else FAILS, CATCH if catch else COST
    return Line(tick, of, verdict.claimed, verdict.proved, verdict.leaves, outcome, more)


def _bag(
    path: Path, namespace: str, params: str | None, tick: int | None, out: str | None
) -> Iterator[Line]:
    if tick is None:
        for message in bags.of_vehicle(path, namespace, {'certificate'}, needed=()):
            yield _published(bytes(message.content.data))
    recording = replay.recording_of(path, namespace, params, tick=tick)
    gc.freeze()  # else each full collection scans all imported objects
    for number, each in enumerate(replay.replayed(recording)):
        if tick in (None, number):
            yield from _tick(number, each.recorded.answer, each.decision, out)


def _published(text: bytes) -> Line:
    """Verify a certificate that a planner published, without solving again."""
    try:
        return _verified(None, document.parsed(text))
    except document.Refused as error:
        return Line(None, COST, outcome=FAILS, more=f': {error}')


def _tick(number: int, then: replay.Answer, now: Decision, out: str | None) -> Iterator[Line]:
    """Certify what was claimed on a tick, by the decision of its replay."""
    bound, soonest = then.get('lower_bound'), then.get('catch_bound')
    if then.get('status') == Status.INFEASIBLE:
        yield _certified(Line(number, COST, math.inf), out, lambda: _infeasible(now))
    elif bound is not None and bound > 0.0:
        yield _certified(Line(number, COST, bound), out, lambda: _bound(then, now))
    else:
        yield Line(number, COST, bound)
    if soonest is not None and math.isfinite(soonest):
        catch = now.catch
        if catch is None or steps_before(soonest, catch.sought.problem.step):
            yield _certified(Line(number, CATCH, soonest), out, lambda: _no_catch(soonest, now))


def _infeasible(now: Decision) -> Document:
    if now.infeasible is None:
        raise Refuted(f'the replay is {now.status}')
    return refutation_of(now.infeasible)


def _bound(then: replay.Answer, now: Decision) -> Document:
    """Return a proof of the bound published on a tick, for the problem that its inputs define."""
    plan, posed, claimed = now.plan, now.case, then['lower_bound']
    if plan is None or posed is None:
        raise Refuted(f'the replay is {now.status}')
    # Each time of catch is a separate problem, and a deadline can end the search for the earliest.
    earliest, catch = then.get('earliest_catch'), now.catch
    if catch and earliest is not None and not np.isclose(catch.time, earliest, equal_nan=True):
        raise Unproved('it planned another catch, or none, at its deadline')
    if claimed > plan.objective + TOLERANCE * (plan.objective + plan.proof.cost_unit):
        raise Refuted(f'a trajectory costs {plan.objective!r}')
    return certificate_of(*posed.parts, replace(plan.proof, lower_bound=claimed))


def _no_catch(claimed: float, now: Decision) -> Document:
    """Return a proof that no trajectory catches the goal before a claimed time [s]."""
    catch = now.catch
    if catch is None:
        raise Refuted('the replay seeks no catch')
    if catch.time < claimed * (1.0 - TOLERANCE):
        raise Refuted(f'a plan catches the goal at {catch.time!r}')
    return refutation_of(catch.sought, steps_before(claimed, catch.sought.problem.step))


def _certified(row: Line, out: str | None, make: Callable[[], Document]) -> Line:
    """Return the verdict on a claim by making and verifying its certificate."""
    try:
        certificate = text_of(make())
        verdict = _verified(row.tick, document.parsed(certificate.encode()))
    except (Refuted, Unproved, document.Refused) as error:
        outcome = FAILS if isinstance(error, Refuted) else NONE
        return row._replace(outcome=outcome, more=f': {str(error).removeprefix(f"{NONE}: ")}')
    if out:
        name = f'tick_{row.tick:05d}{"_catch" * (row.of == CATCH)}.json'
        (files.folder_at(Path(out)) / name).write_text(certificate + '\n')
    if verdict.outcome == FAILS:  # not refuted: no trajectory is known to cost less
        return verdict._replace(outcome=NONE, more=f': another search proves {verdict.proved!r}')
    return verdict
