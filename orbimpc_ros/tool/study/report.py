# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The report of a study: shares and times with intervals, pairs, failures; and its picture."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from scipy import stats

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.tool.study.draws import Draws
from orbimpc_ros.tool.study.flights import OURS, Row
from orbimpc_ros.tool.style import BLUE, GREEN, GREY, INK, ORANGE, RED, SKY, in_both_looks

Rows = Mapping[str, Sequence[Row]]  # by controller, flights in the same order
DEGREES = 180.0 / math.pi
MOST_NAMED = 20
# By title: the field of a row, and what it is multiplied by.
MEASURES = {
    'closest approach [m]': ('closest', 1.0),
    'distance at the end [m]': ('missed', 1.0),
    'speed at the end [m/s]': ('speed', 1.0),
    'off the plan after a tick [m]': ('tracking', 1.0),
    'largest gap': ('gap', 1.0),
    'largest projection loss': ('projection', 1.0),
    'least airspeed [m/s]': ('airspeed', 1.0),
    'largest bank [deg]': ('bank', DEGREES),
    'largest error of the attitude [deg]': ('pointing', DEGREES),
    'farthest from the setpoint [m]': ('off', 1.0),
    'height above the goal, closest [m]': ('height', 1.0),
}


def report(draws: Draws, rows: Rows) -> str:
    """Return the report in Markdown; where our controller loses comes first."""
    count = len(next(iter(rows.values())))
    lines = [f'# {draws.name}: {draws.about}', '', f'{count} flights by each controller.', '']
    others = [name for name in rows if name != OURS]
    if OURS in rows and others:
        lines += [*_losses(draws, rows, others), '']
    lines += [*_summary(draws, rows), '']
    if OURS in rows and others:
        lines += [*_pairs(draws, rows, others), '']
    lines += [*_measures(rows), '', *_failures(rows)]
    return '\n'.join(lines) + '\n'


def times_of(draws: Draws, rows: Sequence[Row]) -> Array:
    """Return the times to the catch, the limit of a flight without one, shape (M,) [s]."""
    return np.array([row['time'] if row['caught'] else draws.limit for row in rows])


def _share(rows: Sequence[Row], field: str) -> tuple[float, float, float]:
    """Return the share of flights with a field, and its interval by Wilson's score (95 %)."""
    found = stats.binomtest(sum(bool(row[field]) for row in rows), len(rows))
    low, high = found.proportion_ci(method='wilson')
    return found.statistic, low, high


def _losses(draws: Draws, rows: Rows, others: Sequence[str]) -> Iterator[str]:
    ours, time, lost = _share(rows[OURS], 'caught')[0], times_of(draws, rows[OURS]), False
    for name in others:
        share, low, _ = _share(rows[name], 'caught')
        theirs = float(times_of(draws, rows[name]).mean())
        if ours < low:
            lost = True
            yield f'- Catches less often than `{name}`: {ours:.1%} of the flights, not {share:.1%}.'
        if time.mean() > 1.02 * theirs:
            lost = True
            yield f'- Later than `{name}` in the mean: {time.mean():.2f} s, not {theirs:.2f} s.'
    if not lost:
        yield 'No other controller catches more often, or sooner by more than 2 % in the mean.'


def _summary(draws: Draws, rows: Rows) -> Iterator[str]:
    yield from _head('', 'caught', '95 %', 'touched', 'median [s]', 'mean [s]', 'proved optimal',
                     'without a plan', 'tick, p50 / longest [ms]')  # fmt: skip
    for name, flights in rows.items():
        share, low, high = _share(flights, 'caught')
        times, ticks = times_of(draws, flights), sum(row['ticks'] for row in flights)
        half = float(np.median(times))
        yield _cells(
            f'`{name}`',
            f'{share:.1%}',
            f'{low:.1%} to {high:.1%}',
            f'{_share(flights, "touched")[0]:.1%}',
            f'{half:.2f}' if share > 0.5 else 'never',
            f'{times.mean():.2f}',
            f'{sum(row["optimal"] for row in flights) / ticks:.1%}',
            f'{sum(row["unplanned"] for row in flights) / ticks:.1%}',
            f'{np.median([row["p50_ms"] for row in flights]):.1f} / '
            f'{max(row["longest_ms"] for row in flights):.0f}',
        )


def _pairs(draws: Draws, rows: Rows, others: Sequence[str]) -> Iterator[str]:
    """Compare flight by flight; one without a catch lasts as long as a flight may."""
    yield from _head('ours against', 'sooner', 'later', 'p, sign test', 'mean difference [s]',
                     '95 %')  # fmt: skip
    ours = times_of(draws, rows[OURS])
    for name in others:
        apart = ours - times_of(draws, rows[name])
        less, more = int((apart < 0.0).sum()), int((apart > 0.0).sum())
        chance = stats.binomtest(less, less + more).pvalue if less + more else 1.0
        low, high = _interval(apart)
        yield _cells(
            f'`{name}`',
            f'{less / len(apart):.0%}',
            f'{more / len(apart):.0%}',
            f'{chance:.1g}',
            f'{apart.mean():+.2f}',
            f'{low:+.2f} to {high:+.2f}',
        )


def _interval(values: Array) -> tuple[float, float]:
    """Return the interval of a mean by bootstrap (95 %)."""
    if np.ptp(values) == 0.0:
        return float(values[0]), float(values[0])
    drawn = stats.bootstrap(
        (values,), np.mean, n_resamples=2000, method='percentile', random_state=0
    )
    return float(drawn.confidence_interval.low), float(drawn.confidence_interval.high)


def _measures(rows: Rows) -> Iterator[str]:
    yield from _head('least, 5 %, half, 95 %, most', *(f'`{name}`' for name in rows))
    for title, (field, scale) in MEASURES.items():
        found = [
            [r[field] for r in flights if r.get(field) is not None] for flights in rows.values()
        ]
        if any(found):
            levels = [
                np.quantile(each, [0.0, 0.05, 0.5, 0.95, 1.0]) if each else () for each in found
            ]
            yield _cells(title, *(', '.join(f'{scale * x:.3g}' for x in each) for each in levels))


def _failures(rows: Rows) -> Iterator[str]:
    """Name every flight without a catch by its number, and say how it missed."""
    for name, flights in rows.items():
        lost = [f'{row["index"]} ({_how(row)})' for row in flights if not row['caught']]
        named = [*lost[:MOST_NAMED], *(['...'] if lost[MOST_NAMED:] else [])]
        yield f'- `{name}` missed {len(lost)}{": " if lost else ""}{", ".join(named)}.'


def _how(row: Row) -> str:
    if row['failed'] or row['touched']:
        return str(row['failed']) or 'collision'
    if 'missed' in row:
        return f'{row["missed"]:.3g} m at {row["speed"]:.2g} m/s'
    return f'{row["closest"]:.3g} m'


def _head(*cells: str) -> Iterator[str]:
    yield _cells(*cells)
    yield '|' + ' --- |' * len(cells)


def _cells(*cells: str) -> str:
    return f'| {" | ".join(cells)} |'


def draw(draws: Draws, rows: Rows, file: Path) -> None:
    """Draw the share caught over time; write a PNG, and one for dark pages beside it."""
    in_both_looks(lambda _dark: _figure(draws, rows), file)


def _figure(draws: Draws, rows: Rows) -> Figure:
    figure = Figure(figsize=(5.0, 3.8), layout='constrained')
    axes = figure.subplots()
    colours = [BLUE, INK, ORANGE, GREEN, RED, SKY, GREY]
    for place, (name, flights) in enumerate(rows.items()):
        times = np.sort([row['time'] for row in flights if row['caught']])
        ends = np.concatenate([[0.0], times, [draws.limit]])
        shares = np.append(np.arange(len(times) + 1), len(times)) / len(flights)
        width, line = (2.2, '-') if name == OURS else (1.4, ('--', ':', '-.')[place % 3])
        color = colours[place % len(colours)]
        axes.step(ends, shares, line, where='post', color=color, lw=width, label=name)
    axes.set(title=draws.name, xlabel='time [s]', ylabel='caught', ylim=(0.0, 1.03))
    axes.set_xlim(0.0, max([row['time'] or 0.0 for each in rows.values() for row in each] + [1.0]))
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    axes.legend(loc='lower right')
    return figure
