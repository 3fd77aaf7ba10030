# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The rows of a study in a file: a line for each flight, so that it can be gone on with."""

from __future__ import annotations

import json
import multiprocessing
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from orbimpc_ros.lab.study.vehicles.flights import Row, row
from orbimpc_ros.lab.study.vehicles.scenario import scenario_named
from orbimpc_ros.mpc.errors import BadInput


@dataclass(frozen=True)
class Job:
    """A flight to be flown; the scenario by name and changes, since that is cheap to send."""

    scenario: str
    changes: tuple[str, ...]
    pilot: str
    seed: int
    index: int
    tuned: Mapping[str, float]

    @property
    def key(self) -> tuple[str, int, int]:
        """Return what tells the flight from others of its file."""
        return self.pilot, self.seed, self.index


def flown(job: Job) -> Row:
    """Return the row of a flight."""
    scenario = scenario_named(job.scenario, job.changes)
    return row(scenario, job.pilot, job.seed, job.index, job.tuned)


def all_flown(jobs: Sequence[Job], workers: int) -> Iterable[Row]:
    """Yield the rows of flights as they come in, from so many processes."""
    if workers == 1:
        yield from map(flown, jobs)
        return
    with multiprocessing.get_context('spawn').Pool(workers) as pool:
        yield from pool.imap_unordered(flown, jobs)


def completed(file: Path, jobs: Sequence[Job], workers: int) -> list[Row]:
    """Return the rows of flights: those that a file has, and the others, which it gets.

    Raises:
        BadInput: the file is of another study.
    """
    about = {'scenario': jobs[0].scenario, 'changes': list(jobs[0].changes)}
    kept = _kept(file, about)
    missing = [job for job in jobs if job.key not in kept]
    with file.open('a') as out:
        if not out.tell():
            print(json.dumps(about), file=out, flush=True)
        elif missing and not file.read_bytes().endswith(b'\n'):
            print(file=out)  # after a line that was cut off
        for each in all_flown(missing, workers):
            kept[_key(each)] = each
            print(json.dumps(each), file=out, flush=True)
    return [kept[job.key] for job in jobs]


def _kept(file: Path, about: dict[str, Any]) -> dict[tuple[str, int, int], Row]:
    lines = file.read_text().splitlines() if file.is_file() else []
    if lines and json.loads(lines[0]) != about:
        raise BadInput(str(file), 'flights of another study', 'a new file, or that study')
    rows = [json.loads(line) for line in lines[1:] if line.endswith('}')]  # whole lines
    return {_key(each): each for each in rows}


def _key(each: Row) -> tuple[str, int, int]:
    return each['pilot'], each['seed'], each['index']
