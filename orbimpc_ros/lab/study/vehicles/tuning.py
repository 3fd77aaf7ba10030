# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Tuning of the rivals: a random search on seeds of its own, reproducible, written to a file."""

from __future__ import annotations

import zlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import yaml

from orbimpc_ros.lab.study.vehicles.flights import Row
from orbimpc_ros.lab.study.vehicles.pilots import RIVALS, class_of
from orbimpc_ros.lab.study.vehicles.pilots.rival import Range
from orbimpc_ros.lab.study.vehicles.results import Job, all_flown
from orbimpc_ros.lab.study.vehicles.scenario import FOLDER, Mission
from orbimpc_ros.tool.io import document

SEED = 1000  # of all flights that tune; those that count have others
CANDIDATES, FLIGHTS = 8, 4
LATE = 2.0  # limits of a flight that one without a catch counts as
Tuned = dict[str, dict[str, float]]


def tuned_of(name: str) -> Tuned:
    """Return what was found for a scenario, or the one that it is like, by rival."""
    file = FOLDER / 'tuned' / f'{name}.yaml'
    base = document.read(str(FOLDER / f'{name}.yaml')).get('like')
    known = tuned_of(base) if base else {}
    return known | document.read(str(file)) if file.is_file() else known


def candidates(rival: str, has: Collection[str]) -> list[dict[str, float]]:
    """Return numbers to try for a rival: the defaults, and draws in equal ratios.

    Args:
        rival: by name.
        has: what there is in the scenario that not all have.
    """
    known: Mapping[str, Range] = class_of(rival).SPACE  # type: ignore[attr-defined]
    space = {name: each for name, each in known.items() if not each.need or each.need in has}
    rng = np.random.default_rng([SEED, zlib.crc32(rival.encode())])
    return [
        {name: each.default for name, each in space.items()},
        *({name: _drawn(each, rng) for name, each in space.items()} for _ in range(CANDIDATES - 1)),
    ]


def _drawn(each: Range, rng: np.random.Generator) -> float:
    return float(f'{np.exp(rng.uniform(np.log(each.low), np.log(each.high))):.4g}')


def searched(
    scenario: Mission, changes: Sequence[str], workers: int, rivals: Iterable[str] = RIVALS
) -> Iterator[tuple[str, dict[str, float], float]]:
    """Yield for every rival the best of its candidates, with its score [s]."""
    for rival in rivals:
        tried = candidates(rival, scenario.has)
        jobs = [
            Job(scenario.name, tuple(changes), rival, SEED, index, each)
            for each in tried
            for index in range(FLIGHTS)
        ]
        rows = {id(job.tuned): [] for job in jobs}  # type: dict[int, list[Row]]
        for job, row in zip(jobs, _in_order(jobs, workers), strict=True):
            rows[id(job.tuned)].append(row)
        scores = [score(rows[id(each)], scenario.limit) for each in tried]
        best = int(np.argmin(scores))
        yield rival, tried[best], scores[best]


def _in_order(jobs: Sequence[Job], workers: int) -> list[Row]:
    """Return the rows of jobs in their order, candidates with the same flights apart."""
    rows: list[Row] = []
    for start in range(0, len(jobs), FLIGHTS):
        part = {row['index']: row for row in all_flown(jobs[start : start + FLIGHTS], workers)}
        rows += [part[index] for index in range(FLIGHTS)]
    return rows


def score(rows: Sequence[Row], limit: float) -> float:
    """Return the mean time to the catch [s], twice the limit of a flight where there is none."""
    return float(np.mean([row['time'] if row['caught'] else LATE * limit for row in rows]))


def written(found: Tuned, file: Path) -> None:
    """Write what was found, for :func:`tuned_of`."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(yaml.safe_dump(found, sort_keys=False))
