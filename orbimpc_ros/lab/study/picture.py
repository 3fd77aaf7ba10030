# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The picture of a study: catches over frequency and over time, costs, and who was sooner."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from orbimpc_ros.lab.study.controllers import CONTROLLERS, ORBITOPE
from orbimpc_ros.lab.study.design import Study
from orbimpc_ros.lab.study.score import Score, rate_over, versus
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.tool.figures import palette
from orbimpc_ros.tool.figures.style import (
    BLUE,
    FAINT,
    GREEN,
    INK,
    ORANGE,
    RED,
    halo,
    headline,
    in_both_looks,
    paper,
)

Scores = dict[str, Score]
# Colour, line and marker, which differ in grey print as well.
LOOKS = dict(
    zip(
        CONTROLLERS,
        ((BLUE, '-', 'o'), (ORANGE, '--', 's'), (RED, '-.', '^'), (GREEN, ':', 'D')),
        strict=True,
    )
)


def draw(study: Study, found: Scores, frequency: Array, file: Path) -> None:
    """Draw a study and write a PNG, and one for dark pages beside it.

    Args:
        study: what was studied.
        found: scores by controller.
        frequency: of the rope in each run, shape (runs,) [Hz].
        file: to write.
    """
    in_both_looks(lambda _dark: of_study(study, found, frequency), file)


def of_study(study: Study, found: Scores, frequency: Array) -> Figure:
    """Return the picture of a study; see :func:`draw`."""
    figure = Figure(figsize=(10.0, 6.6), layout='constrained')
    panels = figure.subplots(2, 2)
    _draw_times(panels[0, 0], found)
    _draw_rates(panels[0, 1], found, frequency)
    _draw_costs(panels[1, 0], found)
    _draw_duels(panels[1, 1], found)
    headline(figure, f'{study.runs} ropes, forecast {study.forecast}')
    return figure


def _draw_times(axes: Axes, found: Scores) -> None:
    """Draw the share of ropes caught within so many ticks."""
    last = max(score.ticks[score.caught].max(initial=1.0) for score in found.values())
    ticks = np.arange(0, last + 1)
    for name, score in found.items():
        color, line, _ = LOOKS[name]
        share = (score.ticks[:, None] <= ticks).mean(axis=0)
        axes.step(ticks, share, where='post', color=color, ls=line, lw=1.8, label=name)
    axes.set(title='Caught within so many ticks', xlabel='ticks', ylim=(-0.02, 1.04))
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    axes.legend(loc='lower right')


def _draw_rates(axes: Axes, found: Scores, frequency: Array) -> None:
    """Draw the share of ropes caught over how fast they swing."""
    lowest = 1.0
    for place, (name, score) in enumerate(found.items()):
        color, line, marker = LOOKS[name]
        middles, rates = rate_over(frequency, score.caught)
        lowest = min(lowest, rates.min())
        size = 9.0 - 1.5 * place  # equal rates stay visible under each other
        axes.plot(middles, rates, color=color, ls=line, marker=marker, ms=size, lw=1.5)
    axes.set(title='Caught, by the frequency of the swing', xlabel='frequency [Hz]')
    axes.set_ylim(min(0.9, lowest - 0.05), 1.01)
    axes.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))


def _draw_costs(axes: Axes, found: Scores) -> None:
    """Draw what a tick costs: from the median, a dot, to the 99th percentile."""
    for place, (name, score) in enumerate(reversed(found.items())):
        color, _, marker = LOOKS[name]
        half, most = np.quantile(score.tick_ms, [0.5, 0.99])
        axes.plot([half, most], [place, place], color=color, lw=2.0, solid_capstyle='butt')
        axes.plot([half], [place], color=color, marker=marker, ms=7)
        # Above its line and inside the panel, wherever on the axis the line is.
        middle = axes.get_yaxis_transform()
        text = f'{name}: {half:.2g} ms, 99 % below {most:.2g} ms'
        axes.text(0.02, place + 0.28, text, transform=middle, color=INK, fontsize=8.0,
                  path_effects=halo())  # fmt: skip
    title = 'Time per tick, excluding the forecast'
    axes.set(title=title, xlabel='processor time [ms]', xscale='log')
    axes.xaxis.set_major_formatter('{x:g}')
    axes.set_xmargin(0.1)
    axes.set_yticks([])
    axes.set_ylim(-0.4, len(found) - 0.4)
    axes.grid(visible=False, axis='y')


def _draw_duels(axes: Axes, found: Scores) -> None:
    """Draw in how many runs the planner was sooner than each baseline, as soon, later."""
    rivals = [score for name, score in found.items() if name != ORBITOPE]
    axes.set_title(f'The {ORBITOPE} planner catches the same rope ...')
    if ORBITOPE not in found or not rivals:
        axes.set_axis_off()
        return
    shares = np.array([versus(found[ORBITOPE], score) for score in rivals[::-1]])
    begin = np.zeros(len(rivals))
    words = ('sooner', 'as soon', 'later')
    # Legible in both looks: blue is dark in print alone, orange is light in both.
    colours = ((BLUE, paper()), (FAINT, INK), (ORANGE, palette.INK))
    for share, word, (color, inside) in zip(shares.T, words, colours, strict=True):
        bars = axes.barh(range(len(rivals)), share, left=begin, color=color, label=word)
        labels = [f'{each:.0%}' if each >= 0.06 else '' for each in share]
        axes.bar_label(bars, labels, label_type='center', color=inside, fontsize=8.5)
        begin = begin + share
    axes.set_yticks(range(len(rivals)), [f'than {score.name}' for score in rivals[::-1]])
    axes.set(xlim=(0.0, 1.0), ylim=(-0.6, len(rivals) - 0.1), xlabel='share of ropes')
    axes.xaxis.set_major_formatter(PercentFormatter(1.0))
    axes.grid(visible=False, axis='y')
    axes.legend(loc='upper center', ncols=3, bbox_to_anchor=(0.5, 1.0))
