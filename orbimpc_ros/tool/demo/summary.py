# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A run in a few lines: what was caught or reached, how often missed, what a tick cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from orbimpc_ros.ros.parameters.spec import settings_from
from orbimpc_ros.ros.parameters.vehicle import VehicleParameters
from orbimpc_ros.sim.arena import touched_in_words
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.history import History


def text(history: History) -> str:
    """Return the summary of a run."""
    return _lines({**_job(history), **_ticks([history])})


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
    arriving = any(each.values['finish'] == 'arrival' for each in flown.values())
    rows['arrived' if arriving else 'captured'] = f'{done} of {len(flown)}'
    ticks = _ticks(list(flown.values()))
    ticks['ticks'] += f', {sum(late.values())} late'
    return _lines(rows | ticks)


def _lines(rows: Mapping[str, str]) -> str:
    return '\n'.join(f'{name:<14}{value}' for name, value in rows.items())


def _ticks(flown: Sequence[History]) -> dict[str, str]:
    fallbacks = sum(bool(tick.get('fallback')) for each in flown for tick in each.flown_ticks)
    return {
        'ticks': str(sum(len(_answers(each)) for each in flown)),
        'solve time': _solve_times(flown),
        'worst gap': _worst_gap(flown),
        'fallbacks': str(fallbacks),
    }


def _job(history: History) -> dict[str, str]:
    if history.values['finish'] == 'arrival':
        return {'arrived': _arrival(history), **_touched(history), **_airspeeds(history)}
    return {
        'captured': _capture(history),
        'near misses': _near_misses(history),
        **_touched(history),
        **_airspeeds(history),
    }


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


def _end(history: History) -> str:
    return _arrival(history) if history.values['finish'] == 'arrival' else _capture(history)


def _arrival(history: History) -> str:
    missed, speed = history.missed
    done = 'yes' if history.captured else 'no'
    when = history.times[-1] - history.times[0]
    return f'{done}, {missed:.1e} m from the goal at {speed:.1e} m/s, t = {when:.0f} s'


def _capture(history: History) -> str:
    capture = history.capture
    if capture is None:
        return 'no'
    return f't = {capture.time - history.times[0]:.2f} s, {capture.distance:.3f} m from the rope'


def _near_misses(history: History) -> str:
    misses, begun = history.near_misses, history.times[0]
    if not misses:
        return '0'
    places = [f'{m.distance:.2f} m at {m.time - begun:.1f} s' for m in misses]
    return f'{len(misses)}: ' + ', '.join(places)


def _solve_times(flown: Sequence[History]) -> str:
    times = _numbers(flown, 'solve_time_ms')
    if not times.size:
        return 'unknown'
    p50, p99 = np.percentile(times, (50, 99))
    return f'p50 {p50:.1f} ms, p99 {p99:.1f} ms, max {times.max():.1f} ms'


def _worst_gap(flown: Sequence[History]) -> str:
    gaps = _numbers(flown, 'gap')
    return f'{gaps.max():.1e}' if gaps.size else 'unknown'


def _answers(history: History) -> list[dict[str, Any]]:
    """Return the fields of the ticks that answered odometry, not of those after it has ended."""
    return [fields for time, fields in history.ticks if time <= history.times[-1]]


def _numbers(flown: Sequence[History], name: str) -> np.ndarray:
    """Return the finite values of a field, over all ticks that have it."""
    values = [fields.get(name) for history in flown for fields in _answers(history)]
    numbers = np.array([v for v in values if isinstance(v, (int, float))], dtype=float)
    return numbers[np.isfinite(numbers)]
