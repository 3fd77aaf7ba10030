# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc verify``: lower bounds proved again, in exact arithmetic.

A file's certificate is verified as it is. A bag's ticks are solved again, for the problem that each
of them was about; that the bound which was published then holds is certified now.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from orbimpc_ros.mpc.check import TOLERANCE
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.problem.case import Case, case_of
from orbimpc_ros.mpc.proof import verifier
from orbimpc_ros.mpc.proof.certificate import Certificate, statement
from orbimpc_ros.mpc.proof.prove import Unproved, certificate_for
from orbimpc_ros.tool.io import bag, document
from orbimpc_ros.tool.io.files import write_whole

if TYPE_CHECKING:
    from orbimpc_ros.tool.replay.resolving import ReplayedTick

HOLDS, FAILS, NOTHING, NONE = 'holds', 'DOES NOT HOLD', 'nothing claimed', 'no certificate'


class TickVerdict(NamedTuple):
    """What became of a tick's bound.

    Attributes:
        tick: its number, None of a file.
        claimed: the bound that was published; None if none was.
        proved: the bound that holds; None without a certificate.
        leaves: of the certificate.
        outcome: in a word or two.
        words: why there is no certificate, or none can be, if that is so.
    """

    tick: int | None
    claimed: float | None = None
    proved: float | None = None
    leaves: int = 0
    outcome: str = NOTHING
    words: str = ''

    def __str__(self) -> str:
        name = '' if self.tick is None else f'{self.tick:>6}  '
        claimed, proved = (f'{_shown(each):<24}' for each in (self.claimed, self.proved))
        return f'{name}{claimed}{proved}{self.leaves:>6}  {self.words or self.outcome}'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument('path', metavar='CERTIFICATE.json|BAG', help='of `orbimpc solve`; a flight')
    parser.add_argument(
        '--problem', metavar='FILE', help='that the certificate is to be of, as given to solve'
    )
    parser.add_argument('--tick', type=int, metavar='K', help='of a bag: this tick alone')
    parser.add_argument('--namespace', default='', metavar='NS', help='of the vehicle')
    parser.add_argument('--params', metavar='FILE', help='of a bag that has no notes of its own')
    parser.add_argument('--out', metavar='DIR', help="write the ticks' certificates there")


def run(args: argparse.Namespace) -> int:
    """Verify, print a row for each bound, and return 1 if one of them does not hold."""
    path = Path(args.path)
    print(f'{"" if path.suffix == ".json" else "  tick  "}{"claimed":<24}{"proved":<24}leaves')
    found = []
    for row in [_file(path, args)] if path.suffix == '.json' else _bag(path, args):
        found.append(row)
        print(row, flush=True)
    counts = Counter(row.outcome for row in found)
    print(', '.join(f'{count} {outcome}' for outcome, count in counts.items()))
    return 1 if counts[FAILS] else 0


def _file(path: Path, args: argparse.Namespace) -> TickVerdict:
    try:
        known = verifier.read(path)
        row = _verified(None, known)
    except verifier.Refused as error:
        raise BadInput.stating('certificate', 'refused', str(error)) from None
    if args.problem:
        case = case_of(document.read(args.problem))
        if not _is_of(known, case):
            raise BadInput.stating('certificate', 'refused', f'it is not of {args.problem}')
    return row


def _is_of(known: Any, case: Case) -> bool:
    """Return whether a certificate is of a problem, a state and goals."""
    unlimited: dict[str, Any] = {'limits': {}}
    stated = unlimited | statement(*case)
    return {name: (unlimited | known).get(name) for name in stated} == stated


def _verified(tick: int | None, known: Any) -> TickVerdict:
    verdict = verifier.verified(known)
    outcome = HOLDS if verdict.holds else FAILS
    return TickVerdict(tick, verdict.claimed, verdict.proved, verdict.leaves, outcome)


def _bag(path: Path, args: argparse.Namespace) -> Iterator[TickVerdict]:
    from orbimpc_ros.tool.replay.report import ticks_of  # needs ROS, which a file does not

    recorded = _recorded(path, args.namespace)
    for number, each in enumerate(ticks_of(path, args.params, args.namespace)):
        if args.tick in (None, number):
            yield _tick(number, each, recorded, args)


def _recorded(path: Path, namespace: str) -> dict[float, Any]:
    """Return the certificates that a planner published, by the bounds that they claim."""
    found = {}
    for each in bag.read(path, {'certificate'}):
        if each.topic != f'{namespace}/certificate':
            continue
        try:
            known = verifier.parsed(bytes(each.content.data))
            found[float(known['lower_bound'])] = known
        except (verifier.Refused, KeyError, TypeError, ValueError) as error:
            raise BadInput.stating(str(path), 'certificate refused', str(error)) from None
    return found


def _tick(
    number: int, each: ReplayedTick, recorded: dict[float, Any], args: argparse.Namespace
) -> TickVerdict:
    """Certify what was published on a tick, of the problem that its inputs pose."""
    claimed, tick = each.recorded.answer.lower_bound, each.tick
    if claimed is None or claimed <= 0.0 or tick.plan is None or not tick.plan.lower_bound > 0.0:
        return TickVerdict(number, claimed)
    assert tick.problem is not None
    assert tick.state is not None
    assert tick.goals is not None
    posed, cost = Case(tick.problem, tick.state, tick.goals), tick.plan.objective
    if claimed > cost + TOLERANCE * (cost + tick.plan.proof.cost_unit):
        words = f'{FAILS}: a trajectory costs {cost!r}'
        return TickVerdict(number, claimed, outcome=FAILS, words=words)
    known = recorded.get(claimed)
    if known is not None and _is_of(known, posed):
        return _verified(number, known)
    try:
        made = certificate_for(*posed, tick.plan, claimed)
    except Unproved as error:
        return TickVerdict(number, claimed, outcome=NONE, words=str(error))
    if args.out:
        _write(Path(args.out), number, made)
    return _verified(number, verifier.parsed(made.text().encode()))


def _write(folder: Path, number: int, made: Certificate) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    text = made.text() + '\n'
    write_whole(folder / f'tick_{number:05d}.json', lambda file: file.write_text(text))


def _shown(value: float | None) -> str:
    return '' if value is None else repr(value)
