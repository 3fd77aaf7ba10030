# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Crossings in simulated time, each planner from messages to messages, without DDS.

    python test/long/crossing.py --runs 100 --vehicles 8 --first-seed 1000
    python test/long/crossing.py --runs 100 --phases --delay 0.1

All plan at the same moments, one after the other, or with ``--phases`` each at a moment of its own,
which is drawn. Deadlines are kept by processor time, so that a busy machine changes little; plans
of others are heard ``--delay`` after the odometry that they start from.

Prints a line for each run and one for all: how close any two vehicles ever came, at any time, how
far from its goal the last one ended, what fell back, how long ticks took. Exit code 1 if two ever
came closer than asked for.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
import crossings


def main() -> int:
    """Fly crossings and print what came of them."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--runs', type=int, default=10)
    parser.add_argument('--vehicles', type=int, default=8)
    parser.add_argument('--first-seed', type=int, default=1000)
    parser.add_argument('--phases', action='store_true')
    parser.add_argument('--delay', type=float, default=0.0)
    parser.add_argument('--set', action='append', default=[])
    args = parser.parse_args()
    values = crossings.setup(args.vehicles, args.first_seed, args.set)
    crew = crossings.Aboard(values, time.thread_time, args.delay)
    begin, least, late, times = 0.0, [], 0, []
    for seed in range(args.first_seed, args.first_seed + args.runs):
        values = crossings.setup(args.vehicles, seed, args.set)
        phases = crossings.phases(values, seed) if args.phases else None
        outcome = crossings.fly(values, crew, begin, phases)
        begin = max(stamps[-1] for stamps, _ in outcome.tracks) + 0.5
        crew.reset()
        least.append(outcome.apart)
        late += max(outcome.distances) > next(iter(values.values()))['arrival_radius']
        times += outcome.solve_times
        row = {
            'seed': seed,
            'apart': outcome.apart,
            'farthest': max(outcome.distances),
            'ticks': len(outcome.statuses),
            'fallbacks': Counter(map(str, outcome.fallbacks)),
            'reasons': Counter(outcome.reasons).most_common(3),
            'statuses': Counter(map(str, outcome.statuses)),
            'p50_p99_ms': np.percentile(outcome.solve_times, (50, 99)).round(1).tolist(),
        }
        print(json.dumps(row), flush=True)
    radius = next(iter(values.values()))['avoid_radius']
    p50, p99 = np.percentile(times, (50, 99))
    closer = sum(each < radius for each in least)
    print(
        f'{len(least)} runs, {closer} closer than {radius:g} m, at least {min(least):.4f} m; '
        f'{late} with a vehicle that did not arrive; p50 {p50:.1f} ms, p99 {p99:.1f} ms'
    )
    return int(min(least) < radius)


if __name__ == '__main__':
    sys.exit(main())
