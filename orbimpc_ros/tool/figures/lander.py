# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A powered descent: the path in its glide cone, thrust, tilt, and the way down from the side."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.tool.figures import space
from orbimpc_ros.tool.figures.charts import story
from orbimpc_ros.tool.figures.numbers import steps, tilts
from orbimpc_ros.tool.figures.spacecraft import FLOWN, PLANNED
from orbimpc_ros.tool.history import History
from orbimpc_ros.tool.style import (
    FAINT,
    GREEN,
    INK,
    ORANGE,
    RED,
    headline,
    whole_seconds,
)

VIEW = (14.0, -55.0)
AROUND = np.linspace(0.0, 2.0 * np.pi, 73)
RIBS = 12  # lines from the tip of the cone to its rim


def lander(history: History, plan: Plan) -> Figure:
    """Return a descent with its limits.

    Args:
        history: of the flight, with a tilt or a glide slope.
        plan: made at its start.
    """
    figure = Figure(figsize=(10.0, 7.2), layout='constrained')
    grid = figure.add_gridspec(3, 2, width_ratios=(1.2, 1.0))
    path = draw_descent(figure, grid[:, 0], history)
    thrust, tilt, side = (figure.add_subplot(grid[row, 1]) for row in range(3))
    draw_thrust(thrust, history, plan)
    draw_tilt(tilt, history, plan)
    draw_side(side, history)
    tilt.sharex(thrust)
    figure.legend(*path.get_legend_handles_labels(), loc='outside lower left', ncols=5)
    headline(figure, story(history))
    return figure


def draw_descent(figure: Figure, place: object, history: History) -> space.Axes3D:
    """Draw the path, the axis that pushes at every tick, and the cone of the glide slope."""
    path, pad = history.positions, history.ropes[-1]
    axes = space.add_axes(figure, place, np.vstack([path, pad]), view=VIEW)
    slope, height = history.values['glide_slope'], 0.4 * float(np.ptp(path[:, 2]))
    if slope:
        draw_cone(axes, pad, height / math.tan(slope), height)
    space.draw_path(axes, path, 'flown path')
    length = 0.08 * float(np.ptp(path, axis=0).max())
    for k, (begin, heading) in enumerate(zip(path, history.headings, strict=True)):
        label = 'axis that pushes' if k == 0 else None
        axes.plot(*np.array([begin, begin + length * heading]).T, color=ORANGE, lw=1.6, label=label)
    space.star(axes, pad, 'pad')
    axes.set_title('Path in space')
    return axes


def draw_cone(axes: space.Axes3D, tip: Array, radius: float, height: float) -> None:
    """Draw a cone upwards from its tip, shape (3,), by its rim and some ribs."""
    rim = tip + np.column_stack(
        [radius * np.cos(AROUND), radius * np.sin(AROUND), np.full(len(AROUND), height)]
    )
    axes.plot(*rim.T, color=GREEN, lw=1.0, label='glide slope')
    for corner in rim[:: len(rim) // RIBS]:
        axes.plot(*np.array([tip, corner]).T, color=GREEN, lw=0.5, alpha=0.7)


def draw_thrust(axes: Axes, history: History, plan: Plan) -> None:
    """Draw the share of full thrust: as planned at the start, as commanded, and the least."""
    values, begun = history.values, history.times[0]
    full = values['mass'] * values['forward']
    times = values['step'] * np.arange(plan.horizon)
    steps(axes, times, plan.speed_fraction[1:], 'planned at the start', PLANNED)
    sent = [(t - begun, force / full) for t, force in history.forces if t < history.end]
    at, shares = np.reshape(sent, (-1, 2)).T
    steps(axes, at, shares, 'commanded', FLOWN)
    if values['floor.shape'] != 'none':
        floor = values['floor.fraction']
        axes.axhline(floor, color=RED, lw=1.2, ls='--', label=f'least: {floor:.2g}')
    axes.set(title='Share of full thrust', ylabel='share', ylim=(-0.04, 1.45))
    axes.tick_params(labelbottom=False)
    axes.legend(loc='upper center', ncols=3)


def draw_tilt(axes: Axes, history: History, plan: Plan) -> None:
    """Draw the angle of the axis that pushes from the vertical, and its limit."""
    begun, step = history.times[0], history.values['step']
    planned = step * np.arange(plan.horizon + 1), tilts(plan.projected[:, :, 0])
    axes.plot(*planned, label='planned at the start', **PLANNED)
    axes.plot(history.times - begun, tilts(history.headings), label='flown', **FLOWN)
    if most := math.degrees(history.values['tilt']):
        axes.axhline(most, color=RED, lw=1.2, ls='--', label=f'most: {most:.3g}°')
    axes.set(title='Tilt from the vertical', xlabel='time [s]', ylabel='angle [°]')
    axes.set_ylim(bottom=-1.0, top=1.3 * max(axes.get_ylim()[1], most))
    axes.xaxis.set_major_locator(whole_seconds())
    axes.legend(loc='upper right', ncols=3)


def draw_side(axes: Axes, history: History) -> None:
    """Draw height over distance aside, and the glide slope below which nothing may be."""
    away = history.positions - history.ropes
    aside = np.hypot(away[:, 0], away[:, 1])
    axes.plot(aside, away[:, 2], '.-', color=INK, lw=1.3, ms=4, label='flown path')
    if slope := history.values['glide_slope']:
        edge = np.array([0.0, 1.05 * aside.max()])
        label = f'glide slope {math.degrees(slope):.3g}°'
        axes.plot(edge, math.tan(slope) * edge, color=GREEN, lw=1.3, label=label)
        axes.fill_between(edge, math.tan(slope) * edge, color=FAINT, alpha=0.35, lw=0)
    axes.plot(0.0, 0.0, '*', color=GREEN, mec=INK, mew=0.6, ms=12)
    axes.set(title='From the side', xlabel='distance aside [m]', ylabel='height [m]')
    axes.legend(loc='upper left')
