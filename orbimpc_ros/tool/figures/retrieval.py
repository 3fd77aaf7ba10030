"""A retrieval in the plane: the whole flight, its end, and what happened when."""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from matplotlib.ticker import LogLocator, NullFormatter

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.tool.figures.style import (
    BLUE,
    GREEN,
    HALO,
    INK,
    ORANGE,
    RED,
    SKY,
    STYLE,
    headline,
)
from orbimpc_ros.tool.history import History
from orbimpc_ros.world.rope import Rope


def retrieval(history: History) -> Figure:
    """Return the picture of a retrieval: the whole flight, its end, and what happened when."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 9.0), layout='constrained')
        grid = figure.add_gridspec(3, 2, height_ratios=(1.15, 1.0, 1.0), width_ratios=(1.1, 1.0))
        whole, end = figure.add_subplot(grid[0, :]), figure.add_subplot(grid[1:, 0])
        distance, speed = figure.add_subplot(grid[1, 1]), figure.add_subplot(grid[2, 1])
        draw_whole(whole, history)
        draw_end(end, history)
        draw_distance(distance, history)
        draw_speed(speed, history)
        distance.sharex(speed)
        figure.legend(*end.get_legend_handles_labels(), loc='outside lower center', ncols=7)
        headline(figure, story(history))
    return figure


def story(history: History) -> str:
    """Return in a line how a retrieval went."""
    near = len(history.near_misses)
    misses = f'{near} near miss{"" if near == 1 else "es"}'
    capture = history.capture
    if capture is None:
        return f'Rope not caught in {history.times[-1] - history.times[0]:.0f} s: {misses}'
    return f'Rope caught at t = {capture.time:.1f} s after {misses}'


def draw_whole(axes: Axes, history: History) -> None:
    """Draw the whole flight from above and frame its end."""
    _draw_swing(axes, history)
    _draw_path(axes, history, arrow=0.0022)
    _mark_capture(axes, history)
    low, high = _end_box(history)
    axes.add_patch(Rectangle(tuple(low), *(high - low), fill=False, ec=INK, lw=0.8, ls=':'))
    axes.set(xlabel='x [m]', ylabel='y [m]', title='Flight, seen from above')
    axes.set_aspect('equal', adjustable='datalim')


def draw_end(axes: Axes, history: History) -> None:
    """Draw the part of the flight around the rope, with plans and near misses."""
    fans = [planned.points[:, :2] for planned in history.plans]
    axes.add_collection(LineCollection(fans, colors=SKY, linewidths=0.7, alpha=0.6, zorder=2))
    axes.plot([], [], color=SKY, lw=0.8, label='plans')
    _draw_swing(axes, history)
    _draw_path(axes, history, arrow=0.005)
    for number, miss in enumerate(history.near_misses, start=1):
        axes.plot(*np.array([miss.vehicle[:2], miss.rope[:2]]).T, color=RED, lw=1.2, zorder=7)
        _cross(axes, number, (miss.rope[0], miss.rope[1]), 'near miss, to the rope')
    _mark_capture(axes, history)
    _draw_reach(axes, history)
    low, high = _end_box(history)
    axes.set(xlabel='x [m]', ylabel='y [m]', title='Around the rope (dotted frame above)')
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect='equal')


def _end_box(history: History) -> tuple[Array, Array]:
    """Return the corners of a square around the swing and what is flown from its vicinity on."""
    apart = np.linalg.norm(history.positions - history.ropes, axis=1)
    reach = history.values['forward'] * history.values['step']
    first = int(np.argmax(apart < 1.5 * reach)) if (apart < 1.5 * reach).any() else 0
    points = np.concatenate([history.positions[first:, :2], _swing(history)])
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    half = 0.56 * np.ptp(points, axis=0).max()
    return middle - half, middle + half


def _draw_path(axes: Axes, history: History, arrow: float) -> None:
    """Draw the path up to the capture, with an arrow along the heading at every tick."""
    points = history.positions[:, :2].copy()
    if history.capture is not None:
        points[-1] = history.capture.vehicle[:2]
    axes.plot(*points.T, color=INK, lw=1.2, zorder=4, label='flown path, headings')
    arrows: Any = {'color': INK, 'angles': 'xy', 'scale': 30, 'headwidth': 5, 'zorder': 5}
    axes.quiver(*points[:-1].T, *history.headings[:-1, :2].T, width=arrow, **arrows)
    axes.plot(*points[0], 'o', mfc='white', mec=INK, ms=6, mew=1.3, zorder=6)
    axes.annotate('start', points[0], xytext=(0, 8), textcoords='offset points', ha='center')


def _draw_swing(axes: Axes, history: History) -> None:
    swing = _swing(history)
    axes.plot(*swing.T, color=ORANGE, lw=4, alpha=0.5, solid_capstyle='round', zorder=1,
              label="rope's swing")  # fmt: skip


def _swing(history: History) -> Array:
    """Return points along the rope's swing, shape (K, 2) [m]."""
    values = history.values
    center, amplitude, phase = (
        np.array(values[f'rope.{name}'][:2]) for name in ('center', 'amplitude', 'phase')
    )
    rope = Rope(center, amplitude, values['rope.frequency'], phase)
    elapsed = np.linspace(0.0, history.times[-1] - history.times[0], 500)
    return np.array([rope.at(t) for t in elapsed])


def _cross(axes: Axes, number: int, at: tuple[float, float], label: str) -> None:
    """Mark a near miss with its number."""
    caption = label if number == 1 else None
    axes.plot(*at, 'x', color=RED, ms=6, mew=1.6, zorder=8, label=caption)
    axes.annotate(
        str(number),
        at,
        xytext=(0, -12),
        textcoords='offset points',
        ha='center',
        color=RED,
        fontweight='bold',
        path_effects=HALO,
        zorder=9,
    )


def _mark_capture(axes: Axes, history: History) -> None:
    if history.capture is not None:
        x, y, _ = history.capture.rope
        _star(axes, x, y, 'rope when caught')


def _draw_reach(axes: Axes, history: History) -> None:
    """Draw the circle within which the rope was caught, and the vehicle in it."""
    capture = history.capture
    if capture is None:
        return
    radius = history.values['capture_radius']
    reach = Circle(
        (capture.rope[0], capture.rope[1]), radius, fill=False, ec=GREEN, ls='--', lw=1.2
    )
    axes.add_patch(reach)
    axes.plot(*np.array([capture.vehicle[:2], capture.rope[:2]]).T, color=GREEN, lw=1.6, zorder=9)
    axes.plot([], [], color=GREEN, ls='--', lw=1.2, label='capture radius')


def _star(axes: Axes, x: float, y: float, label: str) -> None:
    axes.plot(x, y, '*', color=GREEN, mec=INK, mew=0.6, ms=14, zorder=10, label=label)


def draw_distance(axes: Axes, history: History) -> None:
    """Draw the distance to the rope, at odometry and at the closest approach of every step."""
    moments = [(moment.time, moment.distance) for moment in history.moments]
    axes.plot(*np.array(moments).T, color=INK, lw=1.2)
    radius = history.values['capture_radius']
    axes.axhline(radius, color=GREEN, lw=1.2, ls='--', label=f'capture radius {radius:g} m')
    for number, miss in enumerate(history.near_misses, start=1):
        _cross(axes, number, (miss.time, miss.distance), 'near miss')
    if history.capture is not None:
        _star(axes, history.capture.time, history.capture.distance, 'caught')
    axes.set(title='Distance to the rope', ylabel='distance [m]', yscale='log')
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter('{x:g}')
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.tick_params(labelbottom=False)
    axes.legend(loc='upper right')


def draw_speed(axes: Axes, history: History) -> None:
    """Draw the commanded speed fraction and the floor below it."""
    planned = [
        (time, fields['speed_fraction'][1])
        for time, fields in history.ticks
        if len(fields.get('speed_fraction') or ()) > 1 and time <= history.end
    ]
    if planned:
        axes.step(*np.array(planned).T, where='post', color=BLUE, lw=1.3, label='commanded')
    values = history.values
    if values['floor.shape'] != 'none':
        floor = values['floor.fraction']
        label = f'floor {floor:.3f} (det R > {floor**2:.2g})'
        axes.axhline(floor, color=RED, lw=1.2, ls='--', label=label)
        axes.axhspan(0.0, floor, color=RED, alpha=0.10, lw=0)
    axes.set(title='Speed fraction |R e₁|', xlabel='time [s]', ylabel='share of full speed')
    axes.set_ylim(0.0, 1.08)
    axes.legend(loc='lower right', ncols=2)
