"""Rows on planners that end: told to, killed, by exceptions of their own; and that come back."""

from __future__ import annotations

import math
import random
import signal
import time
from collections.abc import Iterator
from functools import partial
from typing import Any

from orbimpc_ros.lab.faults import injection as onsets
from orbimpc_ros.lab.faults import stimulus as feed
from orbimpc_ros.lab.faults.fixtures import Lab
from orbimpc_ros.lab.faults.flights import LATCH, Flying
from orbimpc_ros.lab.faults.harness import PATIENCE, RATE, STEP, Stand
from orbimpc_ros.lab.faults.injection import SLOW
from orbimpc_ros.lab.faults.outcome import Outcome, Trial
from orbimpc_ros.lab.faults.stimulus import Spoiled

FAREWELLS = 3  # safe commands at the end
LOOKED_AT = 3  # steps of a vehicle that should stand still
LEAVE = 5.0  # [s] in which a process must have ended


def _told(number: int) -> Any:
    """Return the cases of a signal: after it three safe commands, and exit code 0."""

    def run(lab: Lab, long: bool) -> Iterator[Outcome]:
        draw = random.Random(number)
        for count in range(50 if long else 1):
            slow = SLOW if (count + number) % 2 else None
            with lab.stand(slow, seed=count) as stand:
                if count % 10 != 9:  # every tenth is told to stop at the start
                    stand.until_planned()
                else:
                    stand.until_heard()
                stand.spin(draw.uniform(0.0, STEP))
                yield _ended(stand, number, f'{signal.Signals(number).name} {count + 1}')

    return run


def _ended(stand: Stand, number: int, case: str) -> Outcome:
    begin = time.monotonic()
    stand.planner.tell(number)
    stand.spin_until_gone(PATIENCE)
    code = stand.planner.wait(0.0)
    took = time.monotonic() - begin
    stand.spin(PATIENCE, lambda: _farewell(stand))
    farewell = _farewell(stand)
    failure = '' if code == 0 else f'exit code {code}'
    if not farewell:
        failure = f'{failure} no {FAREWELLS} safe commands at the end'.strip()
    return Outcome(case, stand.watch.broken(), took, failure)


def _farewell(stand: Stand) -> bool:
    """Return whether the last commands that have arrived are safe ones."""
    last = stand.watch.commands[-FAREWELLS:]
    return len(last) == FAREWELLS and all(each.safe for each in last)


def _exceptions(lab: Lab, long: bool) -> Iterator[Outcome]:
    """A controller that raises: one is survived, after five in a row the planner has to leave."""
    slipping = Spoiled('raises', odometry=feed.with_field('twist.twist.linear.y', feed.SLIP))
    for seed in onsets.SEEDS if long else onsets.SEEDS[:1]:
        with lab.stand(seed=seed, module='orbimpc_ros.lab.faults.failing') as stand:
            begin = onsets.set_in(stand, onsets.MIDWAY, partial(_spoil, stand, slipping))
            stand.spin(2.5 * STEP)
            raised = begin + 1.0 / RATE + STEP  # at the latest: the next odometry, the next tick
            safe = onsets.reaction(stand.watch.first_safe(begin), raised)
            yield onsets.recovered(stand, Outcome('raises', stand.watch.broken(), safe))
            begin = onsets.set_in(stand, onsets.MIDWAY, partial(_spoil, stand, slipping))
            stand.spin_until_gone(PATIENCE)
            code = stand.planner.wait(0.0)
            failure = '' if code == 1 else f'exit code {code} after many in a row'
            unsafe = stand.watch.broken() + stand.watch.moving_again(begin, begin + 2 * STEP)
            yield Outcome('raises again and again', unsafe, math.nan, failure)


def _spoil(stand: Stand, spoiled: Spoiled) -> None:
    stand.spoiled = spoiled


def _latched(flying: Flying, begin: float) -> bool:
    return flying.latched(begin) < math.inf


def _killed(lab: Lab, long: bool) -> Iterator[Outcome]:
    """The planner is killed or hangs in flight: the vehicle stops."""
    for number in range(20 if long else 1):
        step = 1.0 if number % 2 else 0.2
        with Flying(*lab.place(), step=step, seed=number) as flying:
            flying.until_moving()
            flying.spin(flying.draw.uniform(0.5, 1.5))
            begin = time.monotonic()
            flying.planner.tell(signal.SIGKILL)
            flying.spin(PATIENCE, partial(_latched, flying, begin))
            flying.spin_steps(LOOKED_AT)
            told = flying.latched(begin) - begin
            failure = '' if flying.still else 'the vehicle moves on'
            yield Outcome(f'killed {number + 1}', flying.watch.broken(), told, failure)


def _restarted(lab: Lab, long: bool) -> Iterator[Outcome]:
    """The planner is killed at a random moment of the retrieval, and started again."""
    for number in range(20 if long else 1):
        with Flying(*lab.place(), step=0.2, seed=number) as flying:
            flying.until_moving()
            flying.spin(flying.draw.uniform(0.0, flying.usual))
            flying.planner.tell(signal.SIGKILL)
            flying.planner.wait(LEAVE)
            flying.spin(flying.draw.uniform(0.0, 0.5))
            flying.start_planner()
            flying.until_over()
            failure = '' if flying.captured else 'not caught'
            yield Outcome(f'restarted {number + 1}', flying.watch.broken(), math.nan, failure)


TRIALS = (
    Trial('exceptions', 'exceptions in callbacks: safe, then given up', 1.0, _exceptions),
    Trial('sigint', 'SIGINT: three safe commands, exit 0', LEAVE, _told(signal.SIGINT), 's'),
    Trial('sigterm', 'SIGTERM: three safe commands, exit 0', LEAVE, _told(signal.SIGTERM), 's'),
    Trial('sigkill', 'planner killed: the vehicle is stopped', LATCH, _killed, 's'),
    Trial('restart', 'planner killed and restarted: the rope is caught', 0.0, _restarted),
)
