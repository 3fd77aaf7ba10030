# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The table of a study, and the share caught over time as a picture."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy import stats

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.tool.figures import Panel, draw_panel
from orbimpc_ros.tool.study.draws import Draws
from orbimpc_ros.tool.study.flights import OURS, Row
from orbimpc_ros.tool.style import in_both_looks

Rows = Mapping[str, Sequence[Row]]  # by controller, flights in the same order
MOST_NAMED = 20
COLUMNS = (
    'controller',
    'caught (95 %)',
    'touched',
    'median [s]',
    'mean [s]',
    f'{OURS} sooner / later',
    'proved optimal',
    'without a plan',
    'tick, p50 / longest [ms]',
)


def report(draws: Draws, rows: Rows) -> str:
    """Return the report in Markdown: a row for each controller, and which flights it missed."""
    count = len(next(iter(rows.values())))
    lines = [f'# {draws.name}: {draws.about}', '', f'{count} flights by each controller.', '']
    lines += [_cells(*COLUMNS), '|' + ' --- |' * len(COLUMNS)]
    lines += [_row(draws, name, rows) for name in rows]
    return '\n'.join([*lines, '', *_missed(rows)]) + '\n'


def times_of(draws: Draws, rows: Sequence[Row]) -> Array:
    """Return the times to the catch, the limit of a flight without one, shape (M,) [s]."""
    return np.array([row['time'] if row['caught'] else draws.limit for row in rows])


def _row(draws: Draws, name: str, rows: Rows) -> str:
    flights, times = rows[name], times_of(draws, rows[name])
    ticks = max(1, sum(row['ticks'] for row in flights))
    caught = stats.binomtest(sum(bool(row['caught']) for row in flights), len(flights))
    share = caught.proportion_ci(method='wilson')
    return _cells(
        f'`{name}`',
        f'{caught.statistic:.1%} ({share.low:.1%} to {share.high:.1%})',
        f'{np.mean([bool(row["touched"]) for row in flights]):.1%}',
        f'{np.median(times):.2f}' if caught.statistic > 0.5 else 'never',
        f'{times.mean():.2f}',
        _beside_ours(draws, name, rows),
        f'{sum(row["optimal"] for row in flights) / ticks:.1%}',
        f'{sum(row["unplanned"] for row in flights) / ticks:.1%}',
        f'{np.median([row["p50_ms"] for row in flights]):.1f} / '
        f'{max(row["longest_ms"] for row in flights):.0f}',
    )


def _beside_ours(draws: Draws, name: str, rows: Rows) -> str:
    """Compare flight by flight; one without a catch lasts as long as a flight may."""
    if name == OURS or OURS not in rows:
        return ''
    apart = times_of(draws, rows[OURS]) - times_of(draws, rows[name])
    return f'{np.mean(apart < 0.0):.0%} / {np.mean(apart > 0.0):.0%}'


def _missed(rows: Rows) -> Iterator[str]:
    """Name every flight without a catch by its number, and how it missed."""
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


def _cells(*cells: str) -> str:
    return f'| {" | ".join(cells)} |'


def draw(draws: Draws, rows: Rows, file: Path) -> None:
    """Draw the share caught over time; write a PNG, and one for dark pages beside it."""
    lines = {}
    for name, flights in rows.items():
        times = sorted(row['time'] for row in flights if row['caught'])
        shares = np.array([*range(len(times) + 1), len(times)]) / len(flights)
        lines[name] = np.array([0.0, *times, draws.limit]), shares

    def drawn(_dark: bool) -> Figure:
        figure = Figure(figsize=(5.0, 3.8), layout='constrained')
        draw_panel(figure.subplots(), Panel(f'{draws.name}: share caught', '', lines, steps=True))
        return figure

    in_both_looks(drawn, file)
