"""The picture: our time against everybody's, problem by problem, on a logarithmic axis."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from orbimpc_ros.tool.measure.duel import OURS
from orbimpc_ros.tool.measure.rows import Row
from orbimpc_ros.tool.style import BLUE, INK, ORANGE, STYLE, save


def draw(rows: Sequence[Row], file: Path) -> None:
    """Draw medians as dots and the way to the 99th percentile as lines, and write a PNG."""
    timed = [row for row in rows if not math.isnan(row.p50_ms)]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.0, 1.2 + 0.22 * max(1, len(timed))), layout='constrained')
        axes = figure.add_subplot()
        _draw(axes, timed[::-1])
        figure.suptitle('Solve times side by side', x=0.01, ha='left', fontweight='bold')
        save(figure, file)


def _draw(axes: Axes, rows: Sequence[Row]) -> None:
    for place, row in enumerate(rows):
        colour = BLUE if row.contender == OURS else ORANGE
        axes.plot([row.p50_ms, row.p99_ms], [place, place], color=colour, lw=1.2)
        axes.plot(row.p50_ms, place, 'o', color=colour, ms=4.5)
        if not math.isnan(row.ratio_p50) and row.contender != OURS:
            label = f'{row.ratio_p50:.3g} x'
            axes.annotate(label, (row.p99_ms, place), xytext=(6, -3), color=INK,
                          textcoords='offset points', fontsize=7.5)  # fmt: skip
    axes.set(xscale='log', xlabel='median to 99th percentile [ms]')
    axes.set_yticks(range(len(rows)), [f'{r.problem}: {r.contender}' for r in rows], fontsize=7.5)
    axes.margins(x=0.12)
