"""Pictures of a run: from its history to matplotlib figures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from orbimpc_ros.tool.history import Approach, History
from orbimpc_ros.world.rope import Rope

# Okabe and Ito's palette: distinguishable with every common colour blindness, and in grey.
INK, BLUE, SKY, ORANGE, GREEN, RED = (
    '#222222',
    '#0072B2',
    '#56B4E9',
    '#E69F00',
    '#009E73',
    '#D55E00',
)
MUTED = '#8a8a8a'
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


def save(figure: Figure, file: Path) -> None:
    """Write a figure as PNG."""
    FigureCanvasAgg(figure)
    figure.savefig(file, dpi=DOTS_PER_INCH)


def retrieval(history: History) -> Figure:
    """Return the picture of a retrieval: path and rope, their distance, the speed fraction."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 5.4), layout='constrained')
        grid = figure.add_gridspec(2, 2, width_ratios=(1.25, 1.0))
        path, distance, speed = (
            figure.add_subplot(place) for place in (grid[:, 0], grid[0, 1], grid[1, 1])
        )
        draw_path(path, history)
        draw_distance(distance, history)
        draw_speed(speed, history)
        distance.sharex(speed)
        figure.suptitle(_headline(history), x=0.01, ha='left', fontsize=12.0, fontweight='bold')
    return figure


def _headline(history: History) -> str:
    capture = history.capture
    if capture is None:
        return f'Rope not caught in {history.times[-1]:.0f} s'
    near = len(history.near_misses)
    return (
        f'Rope caught at t = {capture.time:.1f} s after {near} near miss{"" if near == 1 else "es"}'
    )


def draw_path(axes: Axes, history: History) -> None:
    """Draw the path from above, with headings, plans, the rope's swing and the near misses."""
    fans = [planned.points[:, :2] for planned in history.plans]
    axes.add_collection(LineCollection(fans, colors=SKY, linewidths=0.8, alpha=0.55, zorder=2))
    axes.plot([], [], color=SKY, label='plans')
    swing = _swing(history)
    axes.plot(swing[:, 0], swing[:, 1], color=ORANGE, lw=5.0, alpha=0.45, solid_capstyle='round',
              zorder=1, label="rope's swing")  # fmt: skip
    xy = history.positions
    axes.plot(xy[:, 0], xy[:, 1], color=INK, lw=1.3, zorder=4, label='flown path')
    axes.quiver(
        *xy[:, :2].T, *history.headings[:, :2].T,
        color=INK, angles='xy', pivot='tail', scale=26, width=0.0042, headwidth=4.5, zorder=5,
    )  # fmt: skip
    axes.plot(*xy[0, :2], 'o', mfc='white', mec=INK, ms=6, mew=1.3, zorder=6, label='start')
    _mark_near_misses(axes, history.near_misses)
    _mark_capture(axes, history)
    axes.set(xlabel='x [m]', ylabel='y [m]', title='Flight, from above', aspect='equal')
    axes.margins(0.06)
    axes.set_adjustable('datalim')
    axes.legend(loc='lower left', handlelength=1.6)


def _swing(history: History) -> np.ndarray:
    """Return points along the rope's swing, shape (K, 3) [m]."""
    values = history.values
    center, amplitude, phase = (
        np.array([*values[f'rope.{name}'], 0.0][:3]) for name in ('center', 'amplitude', 'phase')
    )
    rope = Rope(center, amplitude, values['rope.frequency'], phase)
    elapsed = np.linspace(0.0, history.times[-1] - history.times[0], 500)
    return np.array([rope.at(t) for t in elapsed])


def _mark_near_misses(axes: Axes, misses: list[Approach]) -> None:
    for number, miss in enumerate(misses, start=1):
        axes.plot(*np.array([miss.vehicle[:2], miss.rope[:2]]).T, color=RED, lw=1.0, zorder=7)
        _cross(axes, number, (miss.rope[0], miss.rope[1]), 'near miss (rope)')


def _cross(axes: Axes, number: int, at: tuple[float, float], label: str) -> None:
    """Mark a near miss with its number."""
    caption = label if number == 1 else None
    axes.plot(*at, 'x', color=RED, ms=6, mew=1.6, zorder=8, label=caption)
    axes.annotate(
        str(number),
        at,
        xytext=(5, -9),
        textcoords='offset points',
        color=RED,
        fontsize=8,
        fontweight='bold',
        zorder=9,
    )


def _mark_capture(axes: Axes, history: History) -> None:
    capture = history.capture
    if capture is None:
        return
    axes.plot(*capture.rope[:2], '*', color=GREEN, mec=INK, mew=0.6, ms=15, zorder=10,
              label=f'caught, t = {capture.time:.1f} s')  # fmt: skip


def draw_distance(axes: Axes, history: History) -> None:
    """Draw the distance to the rope, at odometry and at the closest approach of every step."""
    closest = history.approaches
    apart = np.linalg.norm(history.positions - history.ropes, axis=1)
    times = [*history.times, *(a.time for a in closest)]
    distances = [*apart, *(a.distance for a in closest)]
    order = np.argsort(times, kind='stable')
    axes.plot(np.array(times)[order], np.array(distances)[order], color=INK, lw=1.2)
    radius = history.values['capture_radius']
    axes.axhspan(axes.get_ylim()[0], radius, color=GREEN, alpha=0.18, lw=0)
    axes.axhline(radius, color=GREEN, lw=1.2, ls='--', label=f'capture radius {radius:g} m')
    for number, miss in enumerate(history.near_misses, start=1):
        _cross(axes, number, (miss.time, miss.distance), 'near miss')
    if history.capture is not None:
        axes.plot(history.capture.time, history.capture.distance, '*', color=GREEN, mec=INK,
                  mew=0.6, ms=13, zorder=6, label='caught')  # fmt: skip
    axes.set(title='Distance to the rope', ylabel='distance [m]', yscale='log')
    axes.yaxis.set_major_formatter('{x:g}')
    axes.tick_params(labelbottom=False)
    axes.legend(loc='upper right')


def draw_speed(axes: Axes, history: History) -> None:
    """Draw the commanded speed fraction and the floor below it."""
    planned = [(t, fields['speed_fraction'][1]) for t, fields in history.ticks
               if len(fields.get('speed_fraction') or ()) > 1]  # fmt: skip
    if planned:
        times, fractions = np.array(planned).T
        axes.step(times, fractions, where='post', color=BLUE, lw=1.3, label='commanded')
        axes.plot(times, fractions, '.', color=BLUE, ms=4)
    values = history.values
    if values['floor.shape'] != 'none':
        floor = values['floor.fraction']
        label = f'floor {floor:.3f} (det R > {floor**2:.2g})'
        axes.axhline(floor, color=RED, lw=1.2, ls='--', label=label)
        axes.axhspan(0.0, floor, color=RED, alpha=0.10, lw=0)
    axes.set(title='Speed fraction |R e₁|', xlabel='time [s]', ylabel='share of full speed',
             ylim=(0.0, 1.08))  # fmt: skip
    axes.legend(loc='lower right', ncols=2)
