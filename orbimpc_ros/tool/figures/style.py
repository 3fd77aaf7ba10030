"""One look for every picture: legible in print, told apart with every common colour blindness."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator

# Okabe and Ito's palette: told apart with every common colour blindness, and in grey.
INK, BLUE, SKY, ORANGE, GREEN, RED = (
    '#222222',
    '#0072B2',
    '#56B4E9',
    '#E69F00',
    '#009E73',
    '#D55E00',
)
STYLE: Any = {
    'font.size': 9.0,
    'axes.titlesize': 10.0,
    'axes.titlelocation': 'left',
    'axes.spines.top': False,
    'axes.spines.right': False,
    'axes.edgecolor': INK,
    'axes.grid': True,
    'axes.axisbelow': True,
    'grid.color': '#e6e6e6',
    'grid.linewidth': 0.6,
    'legend.frameon': False,
    'legend.fontsize': 8.5,
}
DOTS_PER_INCH = 200
HALO = [withStroke(linewidth=2.5, foreground='white')]


def save(figure: Figure, file: Path) -> None:
    """Write a figure as PNG."""
    FigureCanvasAgg(figure)
    figure.savefig(file, dpi=DOTS_PER_INCH)


def headline(figure: Figure, text: str) -> None:
    """Put a line above the whole figure."""
    figure.suptitle(text, x=0.01, ha='left', fontsize=12.0, fontweight='bold')


def whole_seconds() -> MaxNLocator:
    """Return ticks at whole seconds for one axis."""
    return MaxNLocator(integer=True, steps=[1, 2, 5, 10])
