# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Flights in a few lines: captures, arrivals, collisions, and the time of ticks."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

import numpy as np

from orbimpc_ros.sim.world import touched_in_words
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.history import History

WIDTH, NAMES = 80, 14  # characters


def text(history: History) -> str:
    """Return the summary of a run."""
    rows = {_job(history): _end(history)}
    if not history.arrives:
        begun, misses = history.times[0], history.near_misses
        places = ', '.join(f'{m.distance:.2f} m at {m.time - begun:.1f} s' for m in misses)
        rows['near misses'] = f'{len(misses)}: {places}' if misses else '0'
    return lines(rows | _contacts(history) | _ticks([history]))


def of_fleet(flown: Mapping[str, History]) -> str:
    """Return the summary of a fleet's flights by namespace, a line for each and some for all."""
    rows = {
        name.strip('/'): f'{_end(each)}; {len(each.ticks)} ticks' for name, each in flown.items()
    }
    done = sum(each.captured for each in flown.values())
    rows[_job(next(iter(flown.values())))] = f'{done} of {len(flown)}'
    return lines(rows | _ticks(list(flown.values())))


def story(flown: Mapping[str, History]) -> str:
    """Return how flights ended, for a headline: a line for each, or for a fleet."""
    job = _job(next(iter(flown.values()))).capitalize()
    if len(flown) > 2:
        return f'{job}: {sum(each.captured for each in flown.values())} of {len(flown)}'
    return '\n'.join(
        f'{name.replace("_", " ").capitalize()}: {_end(each, _job(each))}'
        if name
        else f'{job}: {_end(each)}'
        for name, each in flown.items()
    )


def lines(rows: Mapping[str, str]) -> str:
    """Return rows of a name and a value each, within the width of a page."""
    return '\n'.join(
        textwrap.fill(f'{name:<{NAMES}}{value}', WIDTH, subsequent_indent=' ' * NAMES)
        for name, value in rows.items()
    )


def _job(history: History) -> str:
    return 'arrived' if history.arrives else 'captured'


def _end(history: History, yes: str = 'yes') -> str:
    capture, begun = history.capture, history.times[0]
    if history.arrives:
        missed, speed = map(_length, history.missed)
        done, when = yes if history.captured else _not(yes), history.times[-1] - begun
        return f'{done}, {missed} from the goal at {speed}/s, t = {when:.0f} s'
    if capture is None:
        return _not(yes)
    return f't = {capture.time - begun:.2f} s, {_length(capture.distance)} from the rope'


def _not(yes: str) -> str:
    return 'no' if yes == 'yes' else f'not {yes}'


def _length(metres: float) -> str:
    """Return a length in a unit that suits it."""
    if metres < 1e-3:
        return 'less than 1 mm'
    return f'{metres:.2f} m' if metres >= 0.1 else f'{1e3 * metres:.0f} mm'


def _contacts(history: History) -> dict[str, str]:
    """Return collisions and stalls of a vehicle in continuous time that may have them."""
    rows, truth, values = {}, history.truth, settings.of_sim(history.values)
    touched = truth.get('touched')
    if (values['obstacles'] or values['traffic']) and isinstance(touched, list):
        boxes = len(history.boxes)
        rows['touched'] = touched_in_words(touched, boxes) or f'no {"box" if boxes else "ball"}'
    least = truth.get('least_airspeed')
    if values['stall_speed'] and isinstance(least, (int, float)):
        rows['airspeed'] = f'at least {least:.2f} m/s, {truth.get("stalls")} stalls'
    return rows


def _ticks(flown: Sequence[History]) -> dict[str, str]:
    times, gaps = (
        np.concatenate([each.series(name)[1] for each in flown])
        for name in ('solve_time_ms', 'gap')
    )
    spent = 'unknown'
    if times.size:
        p50, p99 = np.percentile(times, (50, 99))
        spent = f'p50 {p50:.1f} ms, p99 {p99:.1f} ms, max {times.max():.1f} ms'
    # The last command is not flown.
    commanded = [tick for each in flown for time, tick in each.ticks if time < each.times[-1]]
    return {
        'ticks': str(sum(len(each.ticks) for each in flown)),
        'solve time': spent,
        'worst gap': f'{gaps.max():.1e}' if gaps.size else 'unknown',
        'fallbacks': str(sum(bool(tick.get('fallback')) for tick in commanded)),
    }
