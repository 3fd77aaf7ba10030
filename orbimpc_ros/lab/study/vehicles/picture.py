# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The picture of a study of a vehicle: the share caught over time, by pilot."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from orbimpc_ros.lab.study.vehicles.pilots import ORBITOPE
from orbimpc_ros.lab.study.vehicles.report import Standing
from orbimpc_ros.tool.figures.style import BLUE, GREEN, GREY, INK, ORANGE, RED, SKY, in_both_looks

LOOKS = {
    ORBITOPE: (BLUE, '-'),
    'pursuit': (GREEN, ':'),
    'lead': (INK, '--'),
    'proportional': (GREY, '-.'),
    'sampling': (RED, '-.'),
    'linearised': (ORANGE, '--'),
    'nonlinear': (SKY, ':'),
    'waypoint': (GREY, ':'),
}


def draw(scores: Mapping[str, Mapping[str, Standing]], file: Path) -> None:
    """Draw studies, by title and pilot, and write a PNG, and one for dark pages beside it."""
    in_both_looks(lambda _dark: of_scores(scores), file)


def of_scores(scores: Mapping[str, Mapping[str, Standing]]) -> Figure:
    """Return the picture of studies, a panel for each."""
    figure = Figure(figsize=(5.0 * len(scores), 3.8), layout='constrained')
    panels = figure.subplots(1, len(scores), squeeze=False, sharey=True)[0]
    for axes, (title, found) in zip(panels, scores.items(), strict=True):
        for name, score in found.items():
            times = np.sort(score.caught_times[np.isfinite(score.caught_times)])
            shares = np.arange(1, len(times) + 1) / score.count
            color, line = LOOKS[name]
            width = 2.2 if name == ORBITOPE else 1.4
            axes.step(times, shares, line, where='post', color=color, lw=width, label=name)
        axes.set(title=title, xlabel='time [s]', ylim=(0.0, 1.03))
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    panels[0].set_ylabel('caught')
    panels[-1].legend(loc='lower right')
    return figure
