# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The picture: the times of all solvers, problem by problem, on a logarithmic axis."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from benchmarks.bench.results import LATE, BenchRow
from orbimpc_ros.tool.style import BLUE, INK, ORANGE, headline, in_both_looks

LEGEND = {
    BLUE: 'this package: median to 99th percentile',
    ORANGE: 'others, with the ratio of their median to ours (>: some hit the time limit)',
}


def draw(rows: Sequence[BenchRow], file: Path) -> None:
    """Draw medians as dots and the way to the 99th percentile as lines; write a PNG.

    Beside it comes another for dark pages.
    """
    timed = [row for row in rows if not math.isnan(row.p50_ms)]
    in_both_looks(lambda _dark: side_by_side(timed), file)


def side_by_side(rows: Sequence[BenchRow]) -> Figure:
    """Return the picture of rows that have times."""
    figure = Figure(figsize=(9.0, 1.4 + 0.22 * max(1, len(rows))), layout='constrained')
    axes = figure.add_subplot()
    _draw(axes, rows[::-1])
    marks = [Line2D([], [], color=colour, marker='o', ms=4.5, lw=1.2) for colour in LEGEND]
    figure.legend(marks, LEGEND.values(), loc='outside lower center', ncols=2)
    headline(figure, 'Solve times side by side')
    return figure


def _draw(axes: Axes, rows: Sequence[BenchRow]) -> None:
    for place, row in enumerate(rows):
        colour = ORANGE if row.rival else BLUE
        axes.plot([row.p50_ms, row.p99_ms], [place, place], color=colour, lw=1.2)
        axes.plot(row.p50_ms, place, 'o', color=colour, ms=4.5)
        if row.rival:
            axes.annotate(_ratio(row), (row.p99_ms, place), xytext=(6, -3), color=INK,
                          textcoords='offset points', fontsize=7.5)  # fmt: skip
    axes.set(xscale='log', xlabel='time [ms]')
    axes.set_yticks(range(len(rows)), [_name(row) for row in rows], fontsize=7.5)
    axes.set_ylim(-0.8, len(rows) - 0.2)
    left, right = axes.get_xlim()
    axes.set_xlim(left, 5.0 * right)  # room for the ratio beyond the slowest


def _ratio(row: BenchRow) -> str:
    """Return a ratio in three digits, without an exponent; a lower bound where times are capped."""
    digits = 2 - math.floor(math.log10(row.ratio_p50))
    return f'{"> " if row.capped else ""}{round(row.ratio_p50, digits):,.{max(0, digits)}f} \u00d7'


def _name(row: BenchRow) -> str:
    """Return what was timed: of a row that counts something besides, without that."""
    problem = row.problem.removesuffix(f': {LATE}')
    return f'{problem}: {row.contender}'
