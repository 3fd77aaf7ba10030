# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc study``: many flights from a seed, everyone's controllers side by side."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orbimpc_ros.mpc.errors import BadInput

if TYPE_CHECKING:
    from orbimpc_ros.lab.study.design import Study
    from orbimpc_ros.lab.study.store import Store

RUNS, SEED, FORECAST, OUT = 1000, 0, 'harmonic', 'out'
PARTS, LARGEST_PART = 100, 50  # about so many parts, of so many runs at most


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    add = parser.add_argument
    add('--runs', type=int, metavar='N', help=f'draws (default: {RUNS})')
    add('--seed', type=int, metavar='N', help=f'of all draws (default: {SEED})')
    add('--controllers', metavar='LIST', help='separated by commas (default: all of them)')
    kinds = 'harmonic, hold, velocity, auto, truth'
    add('--forecast', metavar='KIND', help=f'{kinds} (default: {FORECAST})')
    add(
        '--set',
        action='append',
        default=[],
        metavar='NAME=VALUE',
        help='a number, or [low, high] for every run to draw from; may be repeated',
    )
    vehicles = 'such as fixed_wing, retrieval, crossing: a vehicle in continuous time instead'
    add('--scenario', metavar='NAME', help=vehicles)
    engines = 'cessna, rope or servicer: as --scenario, of a vehicle in an engine that is not ours'
    add('--engine', dest='scenario', metavar='NAME', help=engines)
    add('--tune', action='store_true', help='with --scenario: look for the best settings of rivals')
    add('-o', '--out', metavar='DIR', help='takes the results (default: a new one in out/)')
    add('--resume', action='store_true', help='go on with the study in DIR')
    add('--scheduler', metavar='ADDRESS', help='of a Dask cluster (default: the cores here)')
    add('--workers', type=int, metavar='N', help='processes here (default: one a core)')


def run(args: argparse.Namespace) -> int:
    """Fly what is still to be flown, then report; 1 if IPOPT found a cheaper plan than ours."""
    from orbimpc_ros.lab.study.controllers import require_installed

    if args.scenario is not None:
        return _run_scenario(args)
    if args.tune:
        raise BadInput('--tune', 'without --scenario', 'the scenario to tune for')
    given = _given(args)
    require_installed(given.get('controllers', ()))
    store = _store(args, given)
    require_installed(store.study.controllers)
    _fly(store, args)
    if not store.complete:
        store.join()
    from orbimpc_ros.lab.study.report import report

    return int(report(store))


def _run_scenario(args: argparse.Namespace) -> int:
    from orbimpc_ros.lab.study.vehicles.command import run
    from orbimpc_ros.tool.demo import new_folder

    if args.resume and args.out is None:
        raise BadInput('--resume', 'without -o DIR', 'the folder of the study to go on with')
    folder = new_folder(OUT, args.scenario) if args.out is None else Path(args.out).resolve()
    return run(args, RUNS, folder)


def _given(args: argparse.Namespace) -> dict[str, Any]:
    """Return the fields of a study that the command line gives, and the settings it changes."""
    from orbimpc_ros.lab.study.settings import resolved

    values = resolved(args.set)
    names = [change.partition('=')[0] for change in args.set]
    controllers = tuple(args.controllers.split(',')) if args.controllers else None
    fields = {
        'runs': args.runs,
        'seed': args.seed,
        'controllers': controllers,
        'forecast': args.forecast,
        'settings': {name: values[name] for name in names} or None,
    }
    return {name: value for name, value in fields.items() if value is not None}


def _store(args: argparse.Namespace, given: dict[str, Any]) -> Store:
    """Return the folder of results: a new one, or the one to go on with."""
    from orbimpc_ros.lab.study.store import Store, require_agreement
    from orbimpc_ros.tool.demo import new_folder

    if args.resume:
        if args.out is None:
            raise BadInput('--resume', 'without -o DIR', 'the folder of the study to go on with')
        folder = Path(args.out).resolve()
        store = Store.resumed(folder)
        require_agreement(store.study, given, folder)
        return store
    study = _study(given)
    folder = new_folder(OUT, 'study') if args.out is None else Path(args.out).resolve()
    return Store.created(folder, study)


def _study(given: dict[str, Any]) -> Study:
    from orbimpc_ros.lab.study.controllers import CONTROLLERS
    from orbimpc_ros.lab.study.design import Study
    from orbimpc_ros.lab.study.settings import resolved

    defaults = {'runs': RUNS, 'seed': SEED, 'controllers': tuple(CONTROLLERS), 'forecast': FORECAST}
    return Study(**{**defaults, **given, 'settings': {**resolved(), **given.get('settings', {})}})


def _fly(store: Store, args: argparse.Namespace) -> None:
    """Fly the runs that are missing and keep each part as it comes.

    Raises:
        KeyboardInterrupt: somebody asked to stop; what was flown is kept.
    """
    from orbimpc_ros.lab.study.cluster import client_of
    from orbimpc_ros.tool.run.processes import Interruptions

    missing = store.missing()
    if not missing:
        return
    print(f'results in {store.folder}')
    with Interruptions() as interruptions, client_of(args.scheduler, args.workers) as client:
        store.begin()
        done = _kept(store, client, missing, lambda: not interruptions.requested)
    if done < store.study.runs:
        again = f'orbimpc study --resume -o {store.folder}'
        print(f'kept {done} of {store.study.runs} runs; to go on: {again}')
        raise KeyboardInterrupt


def _kept(store: Store, client: Any, missing: Sequence[int], going: Callable[[], bool]) -> int:
    """Return how many runs are done after keeping what comes in."""
    from orbimpc_ros.lab.study.cluster import each_flown
    from orbimpc_ros.tool.run.progress import ProgressLine

    runs = store.study.runs
    done, progress = runs - len(missing), ProgressLine(runs)
    size = min(max(1, runs // PARTS), LARGEST_PART)
    chunks = [missing[i : i + size] for i in range(0, len(missing), size)]
    progress.show(done, f'{done} of {runs} runs')
    for rows in each_flown(client, store.study, chunks, going):
        store.add(rows)
        done += len(rows) // len(store.study.controllers)
        progress.show(done, f'{done} of {runs} runs')
    progress.close()
    return done
