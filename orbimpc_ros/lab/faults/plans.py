"""Rows on plans that cannot be made: no way out, no time, a goal that leaps."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from orbimpc_ros.lab.faults import injection as onsets
from orbimpc_ros.lab.faults.fixtures import Lab
from orbimpc_ros.lab.faults.harness import STEP, Stand
from orbimpc_ros.lab.faults.injection import AFTER, SLOW
from orbimpc_ros.lab.faults.outcome import Outcome, Trial
from orbimpc_ros.lab.faults.stimulus import Spoiled
from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.mpc.outcome import Fallback

WALLED_IN = [-50.0, -50.0, 50.0, 50.0]  # everywhere is inside of this box
ELSEWHERE = [10.0, 10.0, 11.0, 11.0]  # a box off the circle
LADDER = 2.0  # ticks that a shifted plan may stand in, and none more
HALF = 0.5  # of a step is what a solve may take
BUSY = 0.25  # of a step on top: a machine that is busy with other things


def set_live(stand: Stand, **values: Any) -> None:
    """Set parameters of a running planner; dots in names are written as two underscores.

    Raises:
        OrbimpcError: they are refused.
    """
    request = SetParameters.Request(
        parameters=[
            Parameter(name.replace('__', '.'), value=value).to_parameter_msg()
            for name, value in values.items()
        ]
    )
    results = stand.call(SetParameters, '/planner/set_parameters', request).results
    refusals = [result.reason for result in results if not result.successful]
    if refusals:
        raise OrbimpcError(f'refused: {refusals}')


def _repeat(long: bool) -> list[tuple[str, int]]:
    if not long:
        return [(onsets.MIDWAY, 1)]
    return [(onset, seed) for onset in (onsets.MIDWAY, onsets.SOLVING) for seed in onsets.SEEDS]


def _infeasible(lab: Lab, long: bool) -> Iterator[Outcome]:
    """A box grows around the vehicle: no plan is left, the fallback ladder has to end."""
    for onset, seed in _repeat(long):
        stand = onsets.stand_for(lab, onset)
        stand.draw.seed(seed)
        begin = onsets.set_in(stand, onset, partial(set_live, stand, obstacles=WALLED_IN))
        stand.spin((LADDER + 1 + AFTER) * STEP)
        ladder = begin + LADDER * STEP
        again = stand.watch.moving_again(ladder, ladder + STEP)
        unsafe = stand.watch.broken(begin) + again
        reaction = onsets.reaction(stand.watch.first_safe(begin), begin)
        told = any(tick.at >= begin and Fallback.SAFE_COMMAND in tick.values['fallback']
                   for tick in stand.watch.ticks)  # fmt: skip
        failure = '' if told else 'no reason on tick'
        set_live(stand, obstacles=ELSEWHERE)
        outcome = Outcome(f'walled in, {onset}', unsafe, reaction, failure)
        yield onsets.recovered(stand, outcome)


def _no_time(lab: Lab, long: bool) -> Iterator[Outcome]:
    """Searches that cannot end: every tick has its command all the same."""
    for deadline in (0.001, 0.02, 0.05, 0.1) if long else (0.001, 0.1):
        stand = lab.shared('slow', SLOW)
        set_live(stand, deadline=0.0)
        stand.until_planned()
        set_live(stand, deadline=deadline)
        begin = time.monotonic()
        stand.spin(10 * STEP)
        yield Outcome(f'deadline {deadline:g} s', stand.watch.broken(begin), _late(stand, begin))
    set_live(stand, deadline=0.0)


def _late(stand: Stand, since: float) -> float:
    """Return the longest solve, or what the longest gap between ticks had too much, in ticks."""
    ticks = [tick for tick in stand.watch.ticks if tick.at >= since]
    if len(ticks) < 2:
        return math.inf
    gap = max(later.at - tick.at for tick, later in itertools.pairwise(ticks))
    slowest = 1e-3 * max(float(tick.values['solve_time_ms']) for tick in ticks)
    return max(slowest / STEP, gap / STEP - 1.0)


def _leaping(distance: float) -> Callable[..., list[Any]]:
    """Return what moves a goal by ``distance`` [m] in a random direction."""

    def spoil(message: Any, draw: Any) -> list[Any]:
        angle = draw.uniform(0.0, 2.0 * math.pi)
        message.pose.position.x += distance * math.cos(angle)
        message.pose.position.y += distance * math.sin(angle)
        return [message]

    return spoil


def _leaps(lab: Lab, long: bool) -> Iterator[Outcome]:
    """A goal that is somewhere else at every sighting: refused or clamped, and told."""
    for distance in (30.0, 1e3, 1e6) if long else (1e6,):
        for onset, seed in _repeat(long):
            stand = onsets.stand_for(lab, onset)
            stand.draw.seed(f'{distance} {seed}')
            spoiled = Spoiled(f'goal leaps {distance:g} m', goal=_leaping(distance))
            begin = onsets.set_in(stand, onset, partial(setattr, stand, 'spoiled', spoiled))
            stand.spin_until_complaint(begin, 'goal')
            told = stand.watch.first_complaint(begin, 'goal')
            reaction = max(0.0, told - begin) / STEP
            outcome = Outcome(f'{spoiled.name}, {onset}', stand.watch.broken(begin), reaction)
            yield onsets.recovered(stand, outcome)


TRIALS = (
    Trial('leaps', 'goal teleports, out of reach: refused and told', 1.2 / STEP, _leaps),
    Trial('infeasible', 'no plan: shifted plan, then safe', LADDER + 1.0, _infeasible),
    Trial('deadline', 'no time to search: longest solve, or time missed', HALF + BUSY, _no_time),
)
