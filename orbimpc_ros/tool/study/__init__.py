# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc study``: fly many random tasks of one vehicle, and report how they end."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from orbimpc_ros import __version__
from orbimpc_ros.mpc.arrays import whole
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool.arguments import add_set
from orbimpc_ros.tool.files import folder_at, new_folder

if TYPE_CHECKING:
    from orbimpc_ros.tool.study.flights import Job, Row

RUNS, MOST_RUNS, LARGEST_SEED, MOST_WORKERS = 100, 1_000_000, 2**63 - 1, 1024
FILE, WHICH = 'retrieval', 'a parameter file, a study file, or the name of one'
OUT, FLIGHTS, REPORT, PICTURE = 'out', 'flights.jsonl', 'report.md', 'caught.png'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    add = parser.add_argument
    whose = 'separated by commas; all but orbitope need a clone of the repository'
    add('file', metavar='FILE', nargs='?', default=FILE, help=f'{WHICH} (default: {FILE})')
    add('--runs', type=int, default=RUNS, metavar='N', help=f'flights (default: {RUNS})')
    add('--seed', type=int, default=0, metavar='N', help='of everything drawn (default: 0)')
    add('--controllers', default='orbitope', metavar='LIST', help=whose)
    add_set(parser, 'a parameter that is not drawn')
    add('-o', '--out', metavar='DIR', help='takes the results (default: a new one in out/)')
    add('--resume', action='store_true', help='go on with the study in DIR')
    add('--cluster', metavar='ADDRESS', help='of a Dask scheduler (default: the cores here)')
    add('--workers', type=int, metavar='N', help='processes here (default: one per core)')


def run(args: argparse.Namespace) -> int:
    """Fly what is still to be flown, then report.

    Raises:
        KeyboardInterrupt: somebody asked to stop; the results so far are kept.
    """
    from orbimpc_ros.tool.study.draws import draws_of
    from orbimpc_ros.tool.study.flights import Job, rows_of
    from orbimpc_ros.tool.study.report import draw, report

    _require_sound(args)
    draws, names = draws_of(args.file, args.set), _controllers(args.controllers)
    about = {
        'version': __version__,
        'seed': args.seed,
        'values': draws.values,
        'rules': draws.rules,
        'margin': draws.margin,
        'tuned': _tuned(names, draws.name),
    }
    folder = _folder(args, draws.name)
    flown = rows_of(folder / FLIGHTS, about, resumed=args.resume)
    jobs = [
        Job(draws.name, name, index, draws.of(args.seed, index), draws.margin)
        for index in range(args.runs)
        for name in names
        if (name, index) not in flown
    ]
    if jobs:
        _fly(flown, jobs, folder / FLIGHTS, args)
    rows = {name: [flown[name, k] for k in range(args.runs)] for name in names}
    text = report(draws, rows)
    (folder / REPORT).write_text(text)
    draw(draws, rows, folder / PICTURE)
    print(text, end='')
    return 0


def _require_sound(args: argparse.Namespace) -> None:
    whole(args.runs, '--runs', 1, MOST_RUNS)
    whole(args.seed, '--seed', 0, LARGEST_SEED)
    if args.workers is not None:
        whole(args.workers, '--workers', 1, MOST_WORKERS)
        if args.cluster is not None:
            raise BadInput('--workers', args.workers, 'only without --cluster, which has its own')
    if args.resume and args.out is None:
        raise BadInput('--resume', 'without -o DIR', 'the folder of the study to go on with')


def _folder(args: argparse.Namespace, name: str) -> Path:
    if args.out is None:
        return new_folder(OUT, name)
    folder = folder_at(Path(args.out).resolve())
    if any(folder.iterdir()) and not (folder / FLIGHTS).exists():
        raise BadInput(str(folder), 'a folder with other files', 'a new or an empty folder')
    return folder


def _controllers(given: str) -> list[str]:
    from orbimpc_ros.tool.study.flights import OURS, baselines

    names = given.split(',')
    known = [OURS] if names == [OURS] else [OURS, *baselines().BASELINES]
    if not {*names} <= {*known} or len({*names}) < len(names):
        raise BadInput('--controllers', given, f'each of {",".join(known)} at most once')
    return names


def _tuned(names: Sequence[str], study: str) -> dict[str, dict[str, float]]:
    """Return what baselines were tuned to for a study."""
    from orbimpc_ros.tool.study.flights import OURS, baselines

    return {name: baselines().tuned_of(study).get(name, {}) for name in names if name != OURS}


def _fly(
    flown: dict[tuple[str, int], Row], jobs: Sequence[Job], file: Path, args: argparse.Namespace
) -> None:
    """Fly the flights that are lacking; each is kept as soon as it is over."""
    from orbimpc_ros.tool.run.processes import interruptions
    from orbimpc_ros.tool.run.progress import ProgressLine
    from orbimpc_ros.tool.study.flights import each_flown, key_of, workers

    done = args.runs * len(args.controllers.split(',')) - len(jobs)
    total = done + len(jobs)
    progress = ProgressLine(total)
    with (
        interruptions() as received,
        workers(args.cluster, args.workers) as pool,
        file.open('a', buffering=1) as out,
    ):
        progress.show(done, f'{done} of {total} flights')
        for row in each_flown(pool, jobs, lambda: not received):
            flown[key_of(row)] = row
            out.write(json.dumps(row) + '\n')
            done += 1
            progress.show(done, f'{done} of {total} flights')
    progress.close()
    if done < total:
        print(f'kept {done} of {total} flights in {file.parent}; --resume goes on with them')
        raise KeyboardInterrupt
