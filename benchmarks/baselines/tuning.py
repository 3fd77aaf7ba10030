# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Tuning of the baselines: a random search on seeds of its own, reproducible, written to a file.

python -m benchmarks.baselines.tuning STUDY [-o FILE]
"""

from __future__ import annotations

import argparse
import os
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml

from benchmarks.baselines import BASELINES
from orbimpc_ros.tool.study.draws import Draws, draws_of
from orbimpc_ros.tool.study.flights import WAYPOINT, Job, Row, each_flown, workers

SEED = 1000  # of all flights that tune; those that count have others
CANDIDATES, FLIGHTS = 8, 4
LATE = 2.0  # a flight without a catch counts as so many times its limit


def candidates(baseline: str) -> list[dict[str, float]]:
    """Return numbers to try for a baseline: the defaults, and draws in equal ratios."""
    space = BASELINES[baseline].SPACE
    rng = np.random.default_rng([SEED, zlib.crc32(baseline.encode())])
    drawn = [
        {k: float(f'{np.exp(rng.uniform(*np.log(each[1:]))):.4g}') for k, each in space.items()}
        for _ in range(CANDIDATES - 1)
    ]
    return [{name: each.default for name, each in space.items()}, *drawn]


def score(rows: Sequence[Row], limit: float) -> float:
    """Return the mean time to the catch [s], twice the limit of a flight where there is none."""
    return float(np.mean([row['time'] if row['caught'] else LATE * limit for row in rows]))


def best_of(baseline: str, draws: Draws, count: int) -> dict[str, float]:
    """Return the best candidate of a baseline, flown by so many processes."""
    tried, scores = candidates(baseline), []
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
    Path(args.out).write_text(yaml.safe_dump({args.study: found}, sort_keys=False))


if __name__ == '__main__':
    main()
