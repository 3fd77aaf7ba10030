"""Rows on what comes in: nothing, too late, out of order, out of range."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence

from orbimpc_ros.lab.faults import injection as onsets
from orbimpc_ros.lab.faults import stimulus as feed
from orbimpc_ros.lab.faults.fixtures import Lab
from orbimpc_ros.lab.faults.harness import Stand
from orbimpc_ros.lab.faults.injection import MIDWAY, SOLVING, START, Expected
from orbimpc_ros.lab.faults.outcome import Outcome, Trial
from orbimpc_ros.lab.faults.stimulus import HUGE, Spoiled, shifted, with_field

ODOMETRY = Expected(wait=0.3, allowed=1.0)  # odom_timeout: 1.5 steps
GOAL = Expected(wait=0.4, allowed=1.0)  # goal_timeout of the stand
HEALTH = 1.2  # [s] in which counts are told
NAN, INF = math.nan, math.inf
BEYOND = (NAN, INF, -INF, 1e300)

STAMPS = {
    'future stamps': shifted(5.0, 1e6),
    'nanosec >= 1e9': with_field('header.stamp.nanosec', 10**9, 2**32 - 1),
    'sec < 0': with_field('header.stamp.sec', -1, -(2**31)),
    'the same stamp': None,  # made anew for every case: it remembers
}
NUMBERS = {
    'position': with_field('pose.pose.position.x', *BEYOND),
    'orientation': with_field('pose.pose.orientation.w', *BEYOND),
    'quaternion not unit': feed.scaled_quaternion('odometry'),
    'velocity': with_field('twist.twist.linear.x', *BEYOND),
    'rate': with_field('twist.twist.angular.z', *BEYOND),
    'frame': with_field('header.frame_id', 'map', '', 'x' * HUGE),
    'child frame': with_field('child_frame_id', 'map', '', '\x00' * HUGE),
}
GOALS = {
    'goal position': with_field('pose.position.y', *BEYOND),
    'goal orientation': with_field('pose.orientation.x', *BEYOND),
    'goal quaternion not unit': feed.scaled_quaternion('goal'),
    'goal frame': with_field('header.frame_id', 'map', 'x' * HUGE),
    'goal stamp in the future': shifted(5.0, 1e6),
    'goal stamp sec < 0': with_field('header.stamp.sec', -1),
}


def _stamps() -> list[Spoiled]:
    found = {name: spoil or feed.repeated() for name, spoil in STAMPS.items()}
    return [Spoiled(name, odometry=spoil) for name, spoil in found.items()]


def _contents() -> list[Spoiled]:
    odometry = [Spoiled(name, odometry=spoil) for name, spoil in NUMBERS.items()]
    return odometry + [Spoiled(name, goal=spoil) for name, spoil in GOALS.items()]


def _trial(name: str, title: str, variants: Callable[[], Sequence[Spoiled]], *short: str) -> Trial:
    def run(lab: Lab, long: bool) -> Iterator[Outcome]:
        for spoiled, onset, seed in onsets.cases(long, variants(), short):
            stand = onsets.stand_for(lab, onset)
            stand.draw.seed(f'{spoiled.name} {onset} {seed}')
            expected = GOAL if spoiled.goal is not None else ODOMETRY
            yield onsets.spoiling(stand, spoiled, onset, expected)

    return Trial(name, title, 1.0, run)


def _mixed(lab: Lab, long: bool) -> Iterator[Outcome]:
    """Old messages and doubles among good ones: refused and counted, planned on all the same."""
    spoiled = Spoiled('old among new', feed.interleaved(), feed.interleaved())
    for seed in onsets.SEEDS if long else onsets.SEEDS[:1]:
        stand = onsets.stand_for(lab, MIDWAY)
        stand.draw.seed(seed)
        expected = Expected(0.0, 5.0, strict=False)
        outcome = onsets.spoiling(stand, spoiled, MIDWAY, expected)
        stand.spin(HEALTH)
        yield Outcome(outcome.case, outcome.unsafe, math.nan, _uncounted(stand))


def _uncounted(stand: Stand) -> str:
    told: dict[str, str] = {}
    for each in stand.watch.health:
        told |= each.values
    wanted = itertools.product(('odom', 'goal'), ('duplicate', 'reordered'))
    lacking = [
        f'{topic}: {what}'
        for topic, what in wanted
        if not any(topic in name and what in name for name in told)
    ]
    return f'not counted: {", ".join(lacking)}' if lacking else ''


def _garbage() -> list[Spoiled]:
    odometry = Spoiled('no odometry message', odometry=feed.garbled)
    return [odometry, Spoiled('no goal message', goal=feed.garbled)]


TRIALS = (
    _trial(
        'odometry',
        'stale odometry',
        lambda: [Spoiled('no odometry', odometry=feed.lost)],
        MIDWAY,
        SOLVING,
    ),
    _trial('goal', 'stale goal', lambda: [Spoiled('no goal', goal=feed.lost)], MIDWAY),
    _trial('stamps', 'future, repeated, malformed stamps', _stamps, MIDWAY, SOLVING),
    Trial('mixed', 'duplicates and older stamps among good ones', 1.0, _mixed),
    _trial('garbage', 'bytes that are no message', _garbage, MIDWAY),
    _trial(
        'contents', 'NaN, Inf, quaternions, frames, huge strings', _contents, START, MIDWAY, SOLVING
    ),
)
