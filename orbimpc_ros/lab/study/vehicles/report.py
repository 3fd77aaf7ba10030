# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The report of a study of a vehicle: shares, times and pairs; where the planner loses, first."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from orbimpc_ros.lab.study.vehicles.flights import Row
from orbimpc_ros.lab.study.vehicles.pilots import ORBITOPE
from orbimpc_ros.lab.study.vehicles.scenario import Mission
from orbimpc_ros.lab.study.vehicles.statistics import of_mean, of_ratio, sign_test, wilson
from orbimpc_ros.mpc.arrays import Array

Rows = Mapping[str, Sequence[Row]]  # by pilot, flights in the same order
WORSE = 1.02  # times the median of another: later than it


@dataclass(frozen=True)
class Standing:
    """What came of a pilot's flights.

    Attributes:
        caught: how many of ``count``.
        times: to the catch, the limit of a flight without one, shape (count,) [s].
        caught_times: with inf instead of that limit.
    """

    caught: int
    count: int
    times: Array
    caught_times: Array

    @property
    def share(self) -> float:
        """Return the share of flights with a catch."""
        return self.caught / self.count

    @property
    def median(self) -> float:
        """Return the time within which half of all flights have caught [s]; inf if they do not."""
        return float(np.quantile(self.caught_times, 0.5, method='higher'))


def score(rows: Sequence[Row], limit: float) -> Standing:
    """Return the score of flights that last a limit [s] at most."""
    caught = sum(each['caught'] for each in rows)
    times = np.array([each['time'] if each['caught'] else math.inf for each in rows])
    return Standing(caught, len(rows), np.minimum(times, limit), times)


def scores_of(scenario: Mission, rows: Rows) -> dict[str, Standing]:
    """Return the scores of all pilots."""
    return {name: score(each, scenario.limit) for name, each in rows.items()}


def report(scenario: Mission, rows: Rows) -> str:
    """Return the report as Markdown."""
    scores = scores_of(scenario, rows)
    count = len(next(iter(rows.values())))
    lines = [f'# {scenario.name}: {scenario.about}', '', f'{count} flights by each pilot.', '']
    compared = ORBITOPE in scores and bool(_rivals(scores))
    if compared:
        lines += [*_losses(scores), '', _lead(scores), '']
    lines += _table(scores, rows)
    if compared:
        lines += ['', *_pairs(scores)]
    lines += _measured(rows)
    return '\n'.join(lines) + '\n'


def _losses(scores: Mapping[str, Standing]) -> Iterator[str]:
    """Say where the planner loses: fewer catches than a rival's interval, or a later median."""
    ours, found = scores[ORBITOPE], False
    for name, theirs in _rivals(scores).items():
        if ours.share < wilson(theirs.caught, theirs.count)[0]:
            found = True
            yield f'- Loses to `{name}` in the share caught.'
        if theirs.share >= 0.5 and ours.median > WORSE * theirs.median:
            found = True
            times = f'{_told(ours.median)} against {_told(theirs.median)}'
            yield f'- Loses to `{name}` in the median time to the catch: {times} s.'
    if not found:
        yield 'Loses to nobody in the share caught, nor by more than 2 % in the median time.'


def _lead(scores: Mapping[str, Standing]) -> str:
    """Say how far the planner is ahead of the rival that is the best in the mean."""
    rivals, ours = _rivals(scores), scores[ORBITOPE]
    name = min(rivals, key=lambda each: float(rivals[each].times.mean()))
    points = 100.0 * (ours.share - rivals[name].share)
    sooner = 1.0 - ours.times.mean() / rivals[name].times.mean()
    return (
        f'Against the best rival in the mean, `{name}`: {points:+.1f} points of catches, '
        f'{sooner:+.1%} of its mean time saved.'
    )


def _told(median: float) -> str:
    return f'{median:.2f}' if math.isfinite(median) else 'never'


def _rivals(scores: Mapping[str, Standing]) -> dict[str, Standing]:
    return {name: each for name, each in scores.items() if name != ORBITOPE}


def _table(scores: Mapping[str, Standing], rows: Rows) -> Iterator[str]:
    head = (
        *('caught', '95 %', 'touched', 'median [s]', 'mean [s]', 'worst miss [m]'),
        *('without a plan', 'tick, p50 / longest [ms]'),
    )
    yield f'| | {" | ".join(head)} |'
    yield '|' + ' --- |' * (1 + len(head))
    for name, each in scores.items():
        low, high = wilson(each.caught, each.count)
        closest = max(row['closest'] for row in rows[name])
        touched = np.mean([row['touched'] for row in rows[name]])
        lost = sum(row['unplanned'] for row in rows[name]) / sum(row['ticks'] for row in rows[name])
        half = np.median([row['p50_ms'] for row in rows[name]])
        longest = max(row['longest_ms'] for row in rows[name])
        yield (
            f'| `{name}` | {each.share:.1%} | {low:.1%} to {high:.1%} | {touched:.1%} | '
            f'{_told(each.median)} | {each.times.mean():.2f} | {closest:.2f} | {lost:.1%} | '
            f'{half:.1f} / {longest:.0f} |'
        )


def _pairs(scores: Mapping[str, Standing]) -> Iterator[str]:
    """Compare the planner with each rival flight by flight; one without a catch lasts the limit."""
    ours = scores[ORBITOPE].times
    head = (
        *('the planner against', 'sooner', 'later', 'p, sign test', 'mean difference [s]', '95 %'),
        *('median / theirs, 95 %', 'mean / theirs, 95 %'),
    )
    yield f'| {" | ".join(head)} |'
    yield '|' + ' --- |' * len(head)
    for name, each in _rivals(scores).items():
        apart = ours - each.times
        low, high = of_mean(apart)
        halves, means = (of_ratio(of, ours, each.times) for of in (np.median, np.mean))
        yield (
            f'| `{name}` | {np.mean(apart < 0.0):.0%} | {np.mean(apart > 0.0):.0%} | '
            f'{sign_test(apart):.1g} | {apart.mean():+.2f} | {low:+.2f} to {high:+.2f} | '
            f'{halves[0]:.3f} to {halves[1]:.3f} | {means[0]:.3f} to {means[1]:.3f} |'
        )


# By heading of a column: what of a flight, and by how much it is multiplied. First of an arrival,
# then of a catch by a vehicle in an engine.
ARRIVAL = {
    'distance at the end [m]': ('missed', 1.0),
    'speed at the end [m/s]': ('speed', 1.0),
    'largest error of the attitude [deg]': ('pointing', 180.0 / math.pi),
    'off the plan after a tick [m]': ('tracking', 1.0),
}
CATCH = {
    'miss [m]': ('closest', 1.0),
    'height above the middle [m]': ('height', 1.0),
    'distance to the middle [m]': ('apart', 1.0),
    'speed past the goal [m/s]': ('closing', 1.0),
    'least airspeed [m/s]': ('airspeed', 1.0),
    'largest bank [deg]': ('bank', 180.0 / math.pi),
    'farthest from the setpoint [m]': ('astray', 1.0),
    'off the plan after a tick [m]': ('tracking', 1.0),
}


def _measured(rows: Rows) -> Iterator[str]:
    """Give distributions, and name the failures, of an arrival or a vehicle in an engine."""
    known = set.intersection(*(set(each) for found in rows.values() for each in found))
    arrival = 'missed' in known
    if arrival or 'bank' in known:
        measures = ARRIVAL if arrival else CATCH
        every = [row for found in rows.values() for row in found]
        shown = {
            title: (field, scale)
            for title, (field, scale) in measures.items()
            if field in known and any(row[field] for row in every)
        }
        yield ''
        yield from _distributions(rows, shown)
        yield ''
        yield from _failures(rows, _arrived if arrival else _passed)


def _distributions(rows: Rows, measures: Mapping[str, tuple[str, float]]) -> Iterator[str]:
    """Give the range, the median and the 5 and 95 % quantiles of measures."""
    yield f'| least, 5 %, half, 95 %, most | {" | ".join(f"`{name}`" for name in rows)} |'
    yield '|' + ' --- |' * (1 + len(rows))
    for title, (field, scale) in measures.items():
        words = []
        for found in rows.values():
            values = [scale * each[field] for each in found if each[field] is not None]
            levels = np.quantile(values, [0.0, 0.05, 0.5, 0.95, 1.0]) if values else ()
            words.append(', '.join(f'{level:.3g}' for level in levels) or 'none')
        yield f'| {title} | {" | ".join(words)} |'


def _failures(rows: Rows, told: Callable[[Row], str]) -> Iterator[str]:
    """Name every flight without a catch: its number, and how it missed."""
    for name, found in rows.items():
        lost = [each for each in found if not each['caught']]
        words = [f'{each["index"]} ({each.get("failed") or told(each)})' for each in lost]
        yield f'- `{name}` missed {len(words)}: {", ".join(words) or "none"}.'


def _arrived(row: Row) -> str:
    return f'{row["missed"]:.3g} m at {row["speed"]:.2g} m/s'


def _passed(row: Row) -> str:
    return f'{row["closest"]:.1f} m{"" if row["headed"] else ", headed away"}'
