# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A multirotor among boxes: the flight in space, from above and from the side, thrust and tilt."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.tool.figures import space
from orbimpc_ros.tool.figures.charts import story
from orbimpc_ros.tool.figures.numbers import applied, steps, tilts
from orbimpc_ros.tool.figures.scene import boxes, draw_box, star
from orbimpc_ros.tool.history import History
from orbimpc_ros.tool.style import BLUE, GREY, INK, ORANGE, SKY, headline

VIEW = (28.0, -66.0)
SHARE = 0.08  # of the flight's extent: the length of full thrust


def multirotor(history: History) -> Figure:
    """Return the picture of a flight to a point among boxes."""
    figure = Figure(figsize=(10.0, 8.0), layout='constrained')
    grid = figure.add_gridspec(2, 2, height_ratios=(1.15, 1.0), width_ratios=(1.2, 1.0))
    axes = draw_flight(figure, grid[0, 0], history)
    draw_view(figure.add_subplot(grid[0, 1]), history, 1, 'From above')
    draw_view(figure.add_subplot(grid[1, 0]), history, 2, 'From the side')
    draw_thrust(figure.add_subplot(grid[1, 1]), history)
    figure.legend(*axes.get_legend_handles_labels(), loc='outside lower center', ncols=6)
    headline(figure, story(history))
    return figure


def thrusts(history: History) -> Array:
    """Return the thrust from each tick on as arrows, shape (K, 2, 3) [m]."""
    _, shares = applied(history)
    count = min(len(shares), len(history.positions))
    begin = history.positions[:count]
    length = SHARE * float(np.ptp(history.positions, axis=0).max())
    return np.stack(
        [begin, begin + length * shares[:count, None] * history.headings[:count]], axis=1
    )


def draw_flight(figure: Figure, place: object, history: History) -> space.Axes3D:
    """Draw the flight in space, with the boxes, the plans and the thrust."""
    path, corners = history.positions, boxes(history)
    axes = space.add_axes(figure, place, np.concatenate([path, *corners]), view=VIEW)
    space.draw_boxes(axes, corners)
    for number, planned in enumerate(history.plans[::4]):
        label = 'plans' if number == 0 else None
        axes.plot(*planned.points.T, color=SKY, lw=0.9, label=label)
    space.draw_path(axes, path, 'flown path')
    for number, arrow in enumerate(thrusts(history)):
        label = 'thrust' if number == 0 else None
        axes.plot(*arrow.T, color=BLUE, lw=1.4, label=label)
    space.star(axes, history.ropes[-1], 'goal')
    axes.set_title('Flight in space')
    return axes


def draw_view(axes: Axes, history: History, up: int, title: str) -> None:
    """Draw the flight against x and another axis, 1 for y or 2 for z.

    The boxes as they are for the planner stand around those that there are.
    """
    for low, high in boxes(history):
        draw_box(axes, low[[0, up]], high[[0, up]])
    for low, high in boxes(history, planned=True):
        look: Any = {'fill': False, 'ec': GREY, 'ls': ':', 'lw': 0.9}
        axes.add_patch(Rectangle(low[[0, up]], *(high - low)[[0, up]], **look))
    axes.plot(*history.positions[:, [0, up]].T, '.-', color=INK, lw=1.2, ms=4, zorder=4)
    for arrow in thrusts(history):
        axes.plot(*arrow[:, [0, up]].T, color=BLUE, lw=1.2, zorder=3)
    goal = history.ropes[-1]
    star(axes, float(goal[0]), float(goal[up]), 'goal')
    axes.set(xlabel='x [m]', ylabel=f'{"xyz"[up]} [m]', title=title)
    axes.set_aspect('equal', adjustable='datalim')


def draw_thrust(axes: Axes, history: History) -> None:
    """Draw the share of full thrust, and how far its axis is from the vertical."""
    times, shares = applied(history)
    steps(axes, times, shares, 'share of full thrust', {'color': BLUE, 'lw': 1.4})
    hover = history.values['gravity'] / history.values['forward']
    axes.axhline(hover, color=GREY, lw=1.0, ls='--', label='weight')
    axes.set(title='Thrust and tilt', xlabel='time [s]', ylabel='share', ylim=(-0.04, 1.3))
    right = axes.twinx()
    right.plot(
        history.times - history.times[0],
        tilts(history.headings),
        color=ORANGE,
        lw=1.4,
        label='tilt',
    )
    right.set(ylabel='tilt [deg]', ylim=(-180.0 * 0.04, 180.0 * 1.3))
    right.grid(visible=False)
    handles, labels = axes.get_legend_handles_labels()
    axes.legend([*handles, *right.lines], [*labels, 'tilt'], loc='upper right', ncols=3)
