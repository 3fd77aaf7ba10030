# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc study --scenario``: fly, tune, report."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from orbimpc_ros.lab.study.vehicles.picture import draw
from orbimpc_ros.lab.study.vehicles.pilots import ORBITOPE, PILOTS, WAYPOINT
from orbimpc_ros.lab.study.vehicles.report import report, scores_of
from orbimpc_ros.lab.study.vehicles.results import Job, completed
from orbimpc_ros.lab.study.vehicles.scenario import Mission, scenario_named
from orbimpc_ros.lab.study.vehicles.tuning import searched, tuned_of, written
from orbimpc_ros.mpc.arrays import whole
from orbimpc_ros.mpc.errors import BadInput

MOST_RUNS, LARGEST_SEED, MOST_WORKERS = 1_000_000, 999, 1024  # tuning has the seeds above
FLIGHTS, REPORT, PICTURE, TUNED = 'flights.jsonl', 'report.md', 'caught.png', 'tuned.yaml'


def run(args: argparse.Namespace, runs: int, folder: Path) -> int:
    """Fly a scenario by every pilot and report, or tune; what a file has is not flown again.

    Args:
        args: of the command line.
        runs: flights by each pilot, unless it says how many.
        folder: takes the results.
    """
    scenario = scenario_named(args.scenario, args.set)
    workers = whole(args.workers or len(os.sched_getaffinity(0)), '--workers', 1, MOST_WORKERS)
    if args.forecast or args.scheduler:
        name = '--forecast' if args.forecast else '--scheduler'
        raise BadInput(name, args.forecast or args.scheduler, 'only without --scenario')
    folder.mkdir(parents=True, exist_ok=True)
    if args.tune:
        rivals = [name for name in _pilots(args.controllers, scenario) if name != ORBITOPE]
        found = {}
        for name, best, _ in searched(scenario, args.set, workers, rivals):
            found[name] = best
            written(found, folder / TUNED)
        print(folder / TUNED)
        return 0
    seed = whole(args.seed or 0, '--seed', 0, LARGEST_SEED)
    count = whole(args.runs or runs, '--runs', 1, MOST_RUNS)
    tuned, changes = tuned_of(args.scenario), tuple(args.set)
    rows = {}
    for name in _pilots(args.controllers, scenario):
        jobs = [
            Job(args.scenario, changes, name, seed, index, tuned.get(name, {}))
            for index in range(count)
        ]
        rows[name] = completed(folder / FLIGHTS, jobs, workers)
    text = report(scenario, rows)
    (folder / REPORT).write_text(text)
    draw({scenario.name: scores_of(scenario, rows)}, folder / PICTURE)
    print(text, end='')
    return 0


def _pilots(given: str | None, scenario: Mission) -> list[str]:
    """Return the names of the pilots that are to fly; all rivals are planar."""
    known = (*PILOTS, WAYPOINT) if scenario.values['dimension'] == 2 else (ORBITOPE,)
    names = given.split(',') if given else [name for name in PILOTS if name in known]
    for name in names:
        if name not in known or names.count(name) > 1:
            raise BadInput('--controllers', given, f'each of {",".join(known)} at most once')
    return names
