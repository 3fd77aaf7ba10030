"""``orbimpc bench``: side by side, in one run, with the solvers that are installed."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool.contenders.contender import Contender
from orbimpc_ros.tool.measure import table
from orbimpc_ros.tool.measure.contests import CAP, CONTESTS, PACKAGES, QUICK_CAP, Contest
from orbimpc_ros.tool.measure.duel import OURS, duel
from orbimpc_ros.tool.measure.machine import machine, versions
from orbimpc_ros.tool.measure.rows import Row, growth, of_duel
from orbimpc_ros.tool.progress import Progress

WARM_UP = 3  # instances solved before the clock counts
LIVE = ('start', 'latency', 'planners')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument('--json', metavar='FILE', help='write the result there')
    parser.add_argument('--picture', metavar='FILE', help='a PNG (default: beside the JSON)')
    parser.add_argument(
        '--only', nargs='+', metavar='PROBLEM', help=f'some of: {", ".join(problems())}'
    )
    parser.add_argument('--quick', action='store_true', help='few instances, low time limits')


def problems() -> list[str]:
    """Return the short names of everything that can be measured."""
    return [*dict.fromkeys(contest.key for contest in CONTESTS), *LIVE]


def run(args: argparse.Namespace) -> int:
    """Measure, print, write, draw; 1 if somebody found a better trajectory than ours."""
    wanted, files = _wanted(args.only), _files(args)
    result: dict[str, Any] = {'machine': machine(), 'versions': versions()}
    rows = measured(wanted, args.quick)
    print(table.text(rows))
    result['rows'] = [row.as_json() for row in rows]
    if args.json:
        Path(args.json).write_text(json.dumps(result, indent=1, allow_nan=False) + '\n')
    if files is not None:
        from orbimpc_ros.tool.measure.picture import draw

        draw(rows, files)
    return int(any(row.beaten for row in rows))


def _wanted(only: list[str] | None) -> list[str]:
    for name in only or ():
        if name not in problems():
            raise BadInput('--only', name, ' | '.join(problems()))
    return only or problems()


def _files(args: argparse.Namespace) -> Path | None:
    """Return where the picture goes, after a look whether everything can be written."""
    for name in ('json', 'picture'):
        value = getattr(args, name)
        if value and not Path(value).resolve().parent.is_dir():
            raise BadInput(f'--{name}', value, 'a file in a folder that exists')
    if args.picture:
        return Path(args.picture)
    return Path(args.json).with_suffix('.png') if args.json else None


def measured(wanted: list[str], quick: bool) -> list[Row]:
    """Return the rows of the problems named in ``wanted``."""
    rows: list[Row] = []
    for contest in CONTESTS:
        if contest.key in wanted:
            rows += contested(contest, quick)
    rows += growth([row for row in rows if row.problem.startswith('SE(2) hull N=')])
    if set(LIVE) & set(wanted):
        from orbimpc_ros.tool.measure import live

        rows += live.measured(wanted, quick)
    return rows


def contested(contest: Contest, quick: bool) -> list[Row]:
    """Return the rows of one contest; who is not installed is listed as absent."""
    cap, count = QUICK_CAP if quick else CAP, contest.counts[0 if quick else 1]
    contenders, absent = _entrants(contest, cap)
    instances = contest.instances(contest.problem, count)
    progress = Progress(len(instances))
    samples = duel(
        contenders,
        instances,
        warm_up=WARM_UP,
        budget=cap,
        show=lambda done: progress.show(done, contest.title),
    )
    progress.close()
    return [*of_duel(contest.title, samples, contest.required), *absent]


def _entrants(contest: Contest, cap: float) -> tuple[dict[str, Contender], list[Row]]:
    """Return who takes part, and rows of who is not installed."""
    found = {name: _entrant(contest, name, cap) for name in (OURS, *contest.rivals)}
    absent = [
        Row(
            contest.title,
            name,
            required=contest.required.get(name),
            note=f'absent: pip install {PACKAGES[name]}',
        )
        for name, contender in found.items()
        if contender is None
    ]
    return {name: each for name, each in found.items() if each is not None}, absent


def _entrant(contest: Contest, name: str, cap: float) -> Contender | None:
    try:
        return contest.contender(name, cap)
    except ImportError:
        if name not in PACKAGES:  # one of our own: that is no absence but a defect
            raise
        return None
