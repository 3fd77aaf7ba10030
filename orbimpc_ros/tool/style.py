# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Looks for every picture: one for print, legible in grey, and one for dark pages.

Figures are drawn in colours by place in the cycle, ``C0`` and so on; a look has the colour of each.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.rcsetup import cycler

INK, BLUE, SKY, ORANGE, GREEN, RED, GREY, FAINT = (f'C{place}' for place in range(8))
# Okabe and Ito's, distinct with every common colour blindness.
PRINT = ('#222222', '#0072B2', '#56B4E9', '#E69F00', '#009E73', '#D55E00', '#8C8C8C', '#B5B5B5')
DARK = ('#E6EDF3', '#58A6FF', '#9CCBF5', '#F0B33C', '#2FBF94', '#FF8A4C', '#9AA4AE', '#4A535D')
PAGE = '#0D1117'  # dark
DOTS_PER_INCH = 200


def _style(colors: tuple[str, ...], page: str, grid: str) -> Any:
    """Return matplotlib's settings for a look: colours by place, the page's, the grid's."""
    inked = ('text.color', 'axes.edgecolor', 'axes.labelcolor', 'xtick.color', 'ytick.color')
    return {
        **dict.fromkeys(inked, colors[0]),
        'font.size': 9.0,
        'figure.facecolor': page,
        'axes.facecolor': page,
        'axes.prop_cycle': cycler(color=colors),
        'axes.titlesize': 10.0,
        'axes.titlelocation': 'left',
        'axes.spines.top': False,
        'axes.spines.right': False,
        'axes.grid': True,
        'axes.axisbelow': True,
        'grid.color': grid,
        'legend.facecolor': page,
        'legend.edgecolor': 'none',
        'legend.fontsize': 8.5,
    }


STYLE = _style(PRINT, 'white', '#E6E6E6')
DARK_STYLE = _style(DARK, PAGE, '#21262D')


def look(dark: bool = False) -> AbstractContextManager:
    """Return a context in which figures are drawn for print, or for dark pages."""
    return mpl.rc_context(DARK_STYLE if dark else STYLE)


def save(figure: Figure, file: Path, dark: bool = False) -> None:
    """Write a figure as PNG, in the look in which it was drawn."""
    FigureCanvasAgg(figure)
    with look(dark):  # some ticks are only made now
        figure.savefig(file, dpi=DOTS_PER_INCH)


def in_both_looks(draw: Callable[[bool], Figure], file: Path) -> None:
    """Write a picture for print, and beside it, ``name-dark.png``, one for dark pages.

    Args:
        draw: makes the figure in the look that is set; its argument is whether that is dark.
        file: for print.
    """
    for dark in (False, True):
        with look(dark):
            figure = draw(dark)
        save(figure, file.with_stem(f'{file.stem}-dark') if dark else file, dark)


def rgb(color: str) -> tuple[int, int, int]:
    """Return red, green and blue, 0 to 255, of a colour of the cycle in print."""
    red, green, blue = bytes.fromhex(PRINT[int(color[1:])][1:])
    return red, green, blue


def paper() -> str:
    """Return the colour behind what is drawn now."""
    return mpl.rcParams['axes.facecolor']


def halo() -> list[withStroke]:
    """Return an effect that sets text off from what is behind it."""
    return [withStroke(linewidth=2.5, foreground=paper())]


def headline(figure: Figure, text: str) -> None:
    """Put a line above the whole figure."""
    figure.suptitle(text, x=0.01, ha='left', fontsize=12.0, fontweight='bold')
