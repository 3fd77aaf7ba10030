# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Tuning of the baselines: a random search on seeds of its own, reproducible, written to a file.

python -m benchmarks.baselines.tuning STUDY [-o FILE]
"""

from __future__ import annotations

import argparse
import os
import zlib
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np
import yaml

from benchmarks.baselines import BASELINES, class_of
from benchmarks.baselines.baseline import CONE, TRAFFIC, Range
from orbimpc_ros.tool.study.draws import Draws, draws_of
from orbimpc_ros.tool.study.flights import WAYPOINT, Job, Row
from orbimpc_ros.tool.study.results import each_flown, workers

SEED = 1000  # of all flights that tune; those that count have others
CANDIDATES, FLIGHTS = 8, 4
LATE = 2.0  # limits of a flight that one without a catch counts as


def candidates(baseline: str, has: Collection[str]) -> list[dict[str, float]]:
    """Return numbers to try for a baseline: the defaults, and draws in equal ratios.

    Args:
        baseline: by name.
        has: what the study has that not all have: :data:`CONE`, :data:`TRAFFIC`.
    """
    known: Mapping[str, Range] = class_of(baseline).SPACE  # type: ignore[attr-defined]
    space = {name: each for name, each in known.items() if not each.need or each.need in has}
    rng = np.random.default_rng([SEED, zlib.crc32(baseline.encode())])
    return [
        {name: each.default for name, each in space.items()},
        *({name: _drawn(each, rng) for name, each in space.items()} for _ in range(CANDIDATES - 1)),
    ]


def _drawn(each: Range, rng: np.random.Generator) -> float:
    return float(f'{np.exp(rng.uniform(np.log(each.low), np.log(each.high))):.4g}')


def score(rows: Sequence[Row], limit: float) -> float:
    """Return the mean time to the catch [s], twice the limit of a flight where there is none."""
    return float(np.mean([row['time'] if row['caught'] else LATE * limit for row in rows]))


def best_of(baseline: str, draws: Draws, count: int) -> dict[str, float]:
    """Return the best candidate of a baseline, flown by so many processes."""
    present = {CONE: draws.values['approach.cone'], TRAFFIC: 'traffic' in draws.rules}
    tried = candidates(baseline, {name for name, there in present.items() if there})
    scores = []
    with workers(None, count) as pool:
        for each in tried:
            jobs = [
                Job(draws.name, baseline, index, draws.of(SEED, index), draws.margin, each)
                for index in range(FLIGHTS)
            ]
            scores.append(score(list(each_flown(pool, jobs, lambda: True)), draws.limit))
    return tried[int(np.argmin(scores))]


def main() -> None:
    """Tune the baselines for a study."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument('study')
    parser.add_argument('-o', '--out', default='tuned.yaml')
    args = parser.parse_args()
    draws, count = draws_of(args.study), os.cpu_count() or 1
    found = {name: best_of(name, draws, count) for name in BASELINES if name != WAYPOINT}
    Path(args.out).write_text(yaml.safe_dump(found, sort_keys=False))


if __name__ == '__main__':
    main()
