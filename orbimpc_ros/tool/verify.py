# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc verify``: certificates gone through in exact arithmetic, of a file or in a bag.

A certificate states its problem, so that it is verified as it is, without a planner. A bag has
those that the planner published (``publish_certificate``): of the bounds of its ticks, that nothing
is feasible, and that nothing catches the goal before a time.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.problem.case import Case, case_of
from orbimpc_ros.mpc.problem.sought import Sought
from orbimpc_ros.mpc.proof import document, reading
from orbimpc_ros.mpc.proof.document import Refutation
from orbimpc_ros.tool import files
from orbimpc_ros.tool.arguments import add_namespace

HOLDS, FAILS = 'holds', 'DOES NOT HOLD'


class Row(NamedTuple):
    """What became of a certificate.

    Attributes:
        of: what is bounded: a cost, which is infinite where nothing is feasible, or a time [s].
        claimed: the bound that it states.
        proved: the bound that it proves.
        leaves: of its trees.
        outcome: whether it holds.
        words: more about that.
    """

    of: str = 'cost'
    claimed: float = math.nan
    proved: float = math.nan
    leaves: int = 0
    outcome: str = FAILS
    words: str = ''

    def __str__(self) -> str:
        bounds = ''.join(f'{each!r:<24}' for each in (self.claimed, self.proved))
        return f'{self.of:<7}{bounds}{self.leaves:>6}  {self.outcome}{self.words}'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument('path', metavar='CERTIFICATE.json|BAG', help='of `orbimpc solve`; a flight')
    parser.add_argument(
        '--problem', metavar='FILE', help='that the certificate is to be of, as given to solve'
    )
    add_namespace(parser)
    parser.add_argument('--out', metavar='DIR', help='write the certificates of a bag there')


def run(args: argparse.Namespace) -> int:
    """Verify, print a row for each certificate, and return 1 if one of them does not hold."""
    path = Path(args.path)
    rows = iter([_file(path, args)]) if path.suffix == '.json' else _bag(path, args)
    counts: Counter[str] = Counter()
    for row in rows:
        if not counts:  # after what may be wrong with a file
            print(f'{"of":<7}{"claimed":<24}{"proved":<24}leaves')
        counts[row.outcome] += 1
        print(row, flush=True)
    print(', '.join(f'{count} {outcome}' for outcome, count in counts.items()))
    return 1 if counts[FAILS] else 0


def _file(path: Path, args: argparse.Namespace) -> Row:
    try:
        known = reading.read(path)
        row = _verified(known)
    except reading.Refused as error:
        raise BadInput.stating('certificate', 'refused', str(error)) from None
    if args.problem and not _is_of(known, case_of(files.read(args.problem))):
        raise BadInput.stating('certificate', 'refused', f'it is not of {args.problem}')
    return row


def _is_of(known: Any, case: Case) -> bool:
    """Return whether a certificate is of a problem, a state and goals."""
    made = document.statement(*case)
    if 'refuted' in known:
        known = {**known, 'refuted': {**known['refuted'], 'trees': []}}
        made = Refutation(Sought(*case, radius=known['refuted'].get('radius', 0.0)), ()).document()
    unlimited: dict[str, Any] = {'limits': {}}
    return {name: (unlimited | known).get(name) for name in unlimited | made} == unlimited | made


def _verified(known: Any) -> Row:
    verdict = document.verified(known)
    radius = known.get('refuted', {}).get('radius')
    of, words = ('cost', '') if radius is None else ('catch', f', within {radius!r} m')
    outcome = HOLDS if verdict.holds else FAILS
    return Row(of, verdict.claimed, verdict.proved, verdict.leaves, outcome, words)


def _bag(path: Path, args: argparse.Namespace) -> Iterator[Row]:
    """Yield what becomes of each certificate in a bag."""
    from orbimpc_ros.tool import bags

    number = 0
    for each in bags.read(path, {'certificate'}):
        if each.topic == f'{args.namespace}/certificate':
            text = bytes(each.content.data)
            if args.out:
                file = files.folder_at(Path(args.out)) / f'certificate_{number:05d}.json'
                file.write_bytes(text + b'\n')
            number += 1
            try:
                yield _verified(reading.parsed(text))
            except reading.Refused as error:
                yield Row(words=f': {error}')
    if not number:
        hint = 'set publish_certificate for the planner'
        raise BadInput.stating(str(path), 'without certificates', hint)
