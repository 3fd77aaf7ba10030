# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Rows on the vehicle: how its frames lie to one another, and the mode that it is in."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

from std_msgs.msg import Bool

from benchmarks.faults import injection, stimulus
from benchmarks.faults.harness import PATIENCE, STEP, Fixtures, Harness
from benchmarks.faults.injection import AFTER, MIDWAY, START, Expected
from benchmarks.faults.inputs import GOAL
from benchmarks.faults.outcome import FaultCase, Outcome
from benchmarks.faults.stimulus import Spoiled, shifted, with_field
from orbimpc_ros.ros.process import qos

TIMEOUT = 0.2  # [s] transform_timeout
FLIPS = 15  # of the mode
FLIP = 0.1  # [s] from one to the next
RESTLESS = 'the mode has changed'
REPORT = 2.0  # [s] in which that must be reported: it takes four flips, and diagnostics a second
DOUBT = 'see velocity_frame'
TURNED = 6.0  # [s] in which a velocity's frame must be doubted: first the vehicle has to turn
UNDERWAY = 0.1  # [s] a change of mode may take, and a command that went out before

_TRANSFORMS = (
    (Spoiled('missing', goal=with_field('header.frame_id', 'nowhere')), GOAL),
    (Spoiled('stale', transform=stimulus.lost), Expected(GOAL.wait + TIMEOUT, GOAL.allowed)),
)
_AHEAD = Spoiled('extrapolated', transform=shifted(10.0, 10.5))  # until their time has come


def _transforms(fixtures: Fixtures, long: bool) -> Iterator[Outcome]:
    """Goals in another frame, and transforms that do not lead from there: as if there were none."""
    parameters, module = {'tf': True}, 'benchmarks.faults.single_transforms'
    for seed in injection.SEEDS if long else injection.SEEDS[:1]:
        with fixtures.harness(parameters, seed=seed, module=module) as harness:
            for spoiled, expected in _TRANSFORMS:
                outcome = injection.spoiling(harness, spoiled, MIDWAY, expected)
                yield _counted(harness, outcome, spoiled)
            if long:
                outcome = injection.spoiling(harness, _AHEAD, START, GOAL)
                yield _counted(harness, outcome, _AHEAD)


def _counted(harness: Harness, outcome: Outcome, spoiled: Spoiled) -> Outcome:
    """Return the outcome, a failure if the planner does not report which transforms it lacked."""

    def reported() -> bool:
        names = [name for each in harness.monitor.health for name in each.values]
        return any(f'{spoiled.name} transform' in name for name in names)

    harness.spin(PATIENCE, reported)
    failure = '' if reported() else f'no {spoiled.name} transform counted'
    return replace(outcome, failure=failure)


def _twists(fixtures: Fixtures, long: bool) -> Iterator[Outcome]:
    """Velocities along the world's axes, as they fit the way flown: doubted, and flown with."""
    spoiled = Spoiled('of the world', odometry=stimulus.in_the_world)
    for seed in injection.SEEDS if long else injection.SEEDS[:1]:
        with fixtures.harness(seed=seed) as harness:
            begin = injection.inject(harness, MIDWAY, partial(setattr, harness, 'spoiled', spoiled))
            reported = harness.until_first(harness.monitor.first_complaint, begin, DOUBT) - begin
            outcome = Outcome(f'{spoiled.name}, {MIDWAY}', harness.monitor.broken(), reported)
            yield injection.recovered(harness, outcome)


def _modes(fixtures: Fixtures, long: bool) -> Iterator[Outcome]:
    """A mode that flips ten times a second: silent in the other one, and reported."""
    for seed in injection.SEEDS if long else injection.SEEDS[:1]:
        with fixtures.harness({'gated': True}, seed=seed) as harness:
            yield _flipped(harness)


def _flipped(harness: Harness) -> Outcome:
    mode = harness.node.create_publisher(Bool, 'engaged', qos())
    harness.until(lambda: mode.get_subscription_count() > 0, 'a planner that hears the mode')
    mode.publish(Bool(data=True))
    harness.until_planned()
    begin = time.monotonic()
    for flip in range(FLIPS):
        mode.publish(Bool(data=bool(flip % 2)))
        harness.spin(FLIP)
    reported = harness.until_first(harness.monitor.first_complaint, begin, RESTLESS) - begin
    outcome = Outcome('at 10 Hz', _spoken(harness) + harness.monitor.broken(), reported)
    mode.publish(Bool(data=True))
    return injection.recovered(harness, outcome)


def _spoken(harness: Harness) -> int:
    """Return how many commands come in a mode that takes none."""
    since = time.monotonic() + UNDERWAY
    harness.spin(UNDERWAY + AFTER * STEP)
    return sum(each.at > since for each in harness.monitor.commands)


FAULT_CASES = (
    FaultCase('transforms', 'transforms missing, stale, extrapolated', 1.0, _transforms),
    FaultCase('twist', 'velocities in the wrong frame: reported', TURNED, _twists, 's'),
    FaultCase('mode', 'a mode that flips at 10 Hz: reported, else silent', REPORT, _modes, 's'),
)
