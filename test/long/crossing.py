# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Crossings in simulated time: each planner a process of its own, the vehicles and the clock here.

    python test/long/crossing.py --runs 10 --vehicles 8 --first-seed 1000 --out FOLDER
    python test/long/crossing.py --runs 100 --aboard
    python test/long/crossing.py --runs 100 --aboard --phases --delay 0.1

All plan at the same moments, one after the other, or with ``--phases`` each at a moment of its own,
which is drawn. With ``--aboard`` the planners are in this process, too: the same path from messages
to messages without DDS, deadlines kept by processor time, so that a busy machine changes little;
plans of others are heard ``--delay`` after the odometry that they start from.

Prints a line for each run and one for all: how close any two vehicles ever came, at any time, how
far from its goal the last one ended, what fell back, how long ticks took. One folder takes the logs
of processes. Exit code 1 if two ever came closer than asked for.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

sys.path.insert(0, str(Path(__file__).parents[1]))
import crossings
from harness import Observer

from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import SECOND
from orbimpc_ros.ros.process import qos
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.run.discovery import claimed
from orbimpc_ros.tool.run.processes import Process

DEPTH = 10
AGAIN = 1.0  # [s]
WAITING = 'odom_timeout=60.0'  # simulated time stands while planners wait for each other
ANSWERS = {'cmd_vel': TwistStamped, 'tick': DiagnosticArray}


class Ashore:
    """Planners in processes, asked all at once."""

    def __init__(self, observer: Observer, values: Mapping[str, settings.Values]) -> None:
        node, self._until = observer.node, observer.until
        self._time = node.create_publisher(Clock, '/clock', qos(DEPTH))
        self._odometry, self._goal = (
            {name: node.create_publisher(kind, f'{name}/{topic}', qos(DEPTH)) for name in values}
            for kind, topic in ((Odometry, 'odom'), (PoseStamped, 'goal'))
        )
        self._resets = [node.create_client(Trigger, f'{name}/planner/reset') for name in values]
        self._heard: dict[str, dict[str, Any]] = {}
        for name in values:
            for topic, kind in ANSWERS.items():
                node.create_subscription(kind, f'{name}/{topic}', self._hears(name, topic), DEPTH)

    def _hears(self, name: str, topic: str) -> Any:
        def hear(message: Any) -> None:
            stamp = message.header.stamp
            if stamp.sec * SECOND + stamp.nanosec == self._at:
                self._heard[name][topic] = message

        return hear

    def meet(self) -> None:
        """Wait until every planner is there."""
        self._at = -1
        ends = [*self._odometry.values(), *self._goal.values()]
        self._until(lambda: all(each.get_subscription_count() for each in ends))
        self._until(lambda: all(each.service_is_ready() for each in self._resets))

    def reset(self) -> None:
        """Have every planner forget the crossing before."""
        answers = [each.call_async(Trigger.Request()) for each in self._resets]
        self._until(lambda: all(each.done() for each in answers))

    def answers(self, asked: Mapping[str, tuple[Any, Any]], at: int) -> dict[str, dict[str, Any]]:
        self._heard, self._at, again = {name: {} for name in asked}, at, 0.0

        def complete() -> bool:
            nonlocal again
            if time.monotonic() > again:
                again = time.monotonic() + AGAIN
                self._ask(asked, at)
            return all(len(each) == len(ANSWERS) for each in self._heard.values())

        self._until(complete)
        return self._heard

    def _ask(self, asked: Mapping[str, tuple[Any, Any]], at: int) -> None:
        self._time.publish(Clock(clock=messages.time_message(at)))
        for name, (odometry, goal) in asked.items():
            if len(self._heard[name]) < len(ANSWERS):
                self._goal[name].publish(goal)
                self._odometry[name].publish(odometry)


def main() -> int:
    """Fly crossings and print what came of them."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('--runs', type=int, default=10)
    parser.add_argument('--vehicles', type=int, default=8)
    parser.add_argument('--first-seed', type=int, default=1000)
    parser.add_argument('--aboard', action='store_true')
    parser.add_argument('--phases', action='store_true')
    parser.add_argument('--delay', type=float, default=0.0)
    parser.add_argument('--out', type=Path, default=Path('crossings'))
    parser.add_argument('--set', action='append', default=[])
    args = parser.parse_args()
    args.set.insert(0, WAITING)
    values = crossings.setup(args.vehicles, args.first_seed, args.set)
    if args.aboard:
        return fly(crossings.Aboard(values, time.thread_time, args.delay), args)
    with ashore(values, args.out) as crew:
        return fly(crew, args)


@contextmanager
def ashore(values: Mapping[str, settings.Values], out: Path) -> Iterator[Ashore]:
    """Run a process for each planner, its log in a folder, and end them."""
    out.mkdir(parents=True, exist_ok=True)
    domain = next(filter(claimed, range(1, 100)))
    parameters = out / 'parameters.yaml'
    parameters.write_text(settings.text(next(iter(values.values())) | {'use_sim_time': True}))
    planners = [
        Process('orbimpc_ros.ros.planner', parameters, out / f'{name.strip("/")}.log', domain, name)
        for name in values
    ]
    try:
        with closing(Observer(domain)) as observer:
            crew = Ashore(observer, values)
            crew.meet()
            yield crew
    finally:
        for each in planners:
            each.stop()


def fly(crew: crossings.Crew, args: argparse.Namespace) -> int:
    """Fly all runs, one after the other by the same planners; 0 if all kept their distance."""
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
        f'{late} with a vehicle that did not arrive; '
        f'p50 {p50:.1f} ms, p99 {p99:.1f} ms'
    )
    return int(min(least) < radius)


if __name__ == '__main__':
    sys.exit(main())
