# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Flights in a few lines: what was caught or reached, what was touched, what a tick cost."""

from __future__ import annotations

import itertools
import math
import textwrap
from collections import defaultdict
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from orbimpc_ros.ros.parameters.spec import settings_from
from orbimpc_ros.ros.parameters.vehicle import VehicleParameters
from orbimpc_ros.sim.simulation import touched_in_words
from orbimpc_ros.tool import bags, settings
from orbimpc_ros.tool.history import History

WIDTH, NAMES = 80, 14  # characters


def text(history: History) -> str:
    """Return the summary of a run."""
    rows = {'arrived' if history.arrives else 'captured': _end(history)}
    if not history.arrives:
        rows['near misses'] = _near_misses(history)
    return lines(rows | _touched(history) | _airspeeds(history) | _ticks([history]))


def of_fleet(flown: Mapping[str, History], late: Mapping[str, int]) -> str:
    """Return the summary of a fleet's flights, a line for each and some for all.

    Args:
        flown: the flights, by namespace.
        late: the steps of each that began without a command for them.
    """
    rows = {
        name.strip('/'): f'{_end(each)}; {len(_answers(each))} ticks, {late[name]} late'
        for name, each in flown.items()
    }
    done = sum(each.captured for each in flown.values())
    arrive = any(each.arrives for each in flown.values())
    rows['arrived' if arrive else 'captured'] = f'{done} of {len(flown)}'
    ticks = _ticks(list(flown.values()))
    ticks['ticks'] += f', {sum(late.values())} late'
    return lines(rows | ticks)


def late(path: Path) -> dict[str, int]:
    """Return how many odometry messages were not answered before the next one, by namespace.

    What comes before a vehicle's first command does not count.

    Args:
        path: of the bag.
    """
    asked: defaultdict[str, dict[int, int]] = defaultdict(dict)  # when sent, by stamp [ns]
    answered: defaultdict[str, dict[int, int]] = defaultdict(dict)
    for message in bags.raw(path):
        namespace, _, topic = message.topic.rpartition('/')
        if topic == 'odom':
            asked[namespace][message.stamp] = message.sent
        elif topic == 'cmd_vel':
            answered[namespace].setdefault(message.stamp, message.sent)
    return {name: _late(each, answered[name]) for name, each in asked.items()}


def _late(asked: Mapping[int, int], answered: Mapping[int, int]) -> int:
    begun = min(answered, default=math.inf)
    flown = [stamp for stamp in sorted(asked) if stamp >= begun]
    return sum(
        answered.get(stamp, math.inf) > asked[after] for stamp, after in itertools.pairwise(flown)
    )


def lines(rows: Mapping[str, str]) -> str:
    """Return rows of a name and a value each, within the width of a page."""
    wrap = partial(textwrap.fill, width=WIDTH, subsequent_indent=' ' * NAMES)
    return '\n'.join(wrap(f'{name:<{NAMES}}{value}') for name, value in rows.items())


def _end(history: History) -> str:
    capture, begun = history.capture, history.times[0]
    if history.arrives:
        missed, speed = history.missed
        done, when = 'yes' if history.captured else 'no', history.times[-1] - begun
        return f'{done}, {length(missed)} from the goal at {length(speed)}/s, t = {when:.0f} s'
    if capture is None:
        return 'no'
    return f't = {capture.time - begun:.2f} s, {length(capture.distance)} from the rope'


def length(metres: float) -> str:
    """Return a length as people write it."""
    if metres < 1e-3:
        return 'less than 1 mm'
    return f'{metres:.2f} m' if metres >= 0.1 else f'{1e3 * metres:.0f} mm'


def _near_misses(history: History) -> str:
    misses, begun = history.near_misses, history.times[0]
    places = ', '.join(f'{m.distance:.2f} m at {m.time - begun:.1f} s' for m in misses)
    return f'{len(misses)}: {places}' if misses else '0'


def _touched(history: History) -> dict[str, str]:
    """Return what a vehicle in continuous time has touched, if there is anything to touch."""
    found, values = history.truth.get('touched'), settings.of_sim(history.values)
    if not (values['obstacles'] or values['traffic']) or not isinstance(found, list):
        return {}
    boxes = len(settings_from(VehicleParameters, values).boxes())
    return {'touched': touched_in_words(found, boxes) or f'no {"box" if boxes else "ball"}'}


def _airspeeds(history: History) -> dict[str, str]:
    """Return how slow a vehicle in continuous time became, if it has a stall speed."""
    least, stalls = (history.truth.get(name) for name in ('least_airspeed', 'stalls'))
    if not isinstance(least, (int, float)) or not history.values['stall_speed']:
        return {}
    return {'airspeed': f'at least {least:.2f} m/s, {stalls} stalls'}


def _ticks(flown: Sequence[History]) -> dict[str, str]:
    times, gaps = _numbers(flown, 'solve_time_ms'), _numbers(flown, 'gap')
    spent = 'unknown'
    if times.size:
        p50, p99 = np.percentile(times, (50, 99))
        spent = f'p50 {p50:.1f} ms, p99 {p99:.1f} ms, max {times.max():.1f} ms'
    fallbacks = sum(bool(tick.get('fallback')) for each in flown for tick in each.flown_ticks)
    return {
        'ticks': str(sum(len(_answers(each)) for each in flown)),
        'solve time': spent,
        'worst gap': f'{gaps.max():.1e}' if gaps.size else 'unknown',
        'fallbacks': str(fallbacks),
    }


def _answers(history: History) -> list[dict[str, Any]]:
    """Return the fields of the ticks that answered odometry, not of those after it has ended."""
    return [fields for time, fields in history.ticks if time <= history.times[-1]]


def _numbers(flown: Sequence[History], name: str) -> np.ndarray:
    """Return the finite values of a field, over all ticks that have it."""
    values = [fields.get(name) for history in flown for fields in _answers(history)]
    numbers = np.array([v for v in values if isinstance(v, (int, float))], dtype=float)
    return numbers[np.isfinite(numbers)]
