# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A retrieval in the plane: the whole flight, its end, and what happened when."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from orbimpc_ros.tool.figures.charts import draw_other_distance, draw_over_time, story
from orbimpc_ros.tool.figures.scene import (
    cross,
    draw_obstacles,
    draw_path,
    draw_reach,
    draw_swing,
    end_box,
    mark_capture,
)
from orbimpc_ros.tool.history import History
from orbimpc_ros.tool.style import (
    BLUE,
    INK,
    RED,
    SKY,
    headline,
)


def retrieval(flown: Mapping[str, History]) -> Figure:
    """Return the picture of a retrieval: the whole flight, its end, and what happened when.

    Args:
        flown: the flight, and perhaps another one of the same rope to be shown beside it.
    """
    first, *others = flown.values()
    figure = Figure(figsize=(10.0, 9.0), layout='constrained')
    grid = figure.add_gridspec(3, 2, height_ratios=(1.15, 1.0, 1.0), width_ratios=(1.1, 1.0))
    if others:
        draw_whole(figure.add_subplot(grid[0, 0]), first, 'Towards the rope where it was last seen')
        draw_beside(figure.add_subplot(grid[0, 1]), others[0])
    else:
        draw_whole(figure.add_subplot(grid[0, :]), first)
    end, distance, speed = map(figure.add_subplot, (grid[1:, 0], grid[1, 1], grid[2, 1]))
    draw_end(end, first)
    draw_over_time(distance, speed, first)
    if others:
        draw_other_distance(distance, others[0])
    figure.legend(*end.get_legend_handles_labels(), loc='outside lower center', ncols=7)
    headline(figure, '. '.join(map(story, flown.values())))
    return figure


def draw_whole(axes: Axes, history: History, title: str = 'Flight, seen from above') -> None:
    """Draw the whole flight from above and frame its end."""
    draw_obstacles(axes, history)
    draw_swing(axes, history)
    draw_path(axes, history, arrow=0.0022)
    mark_capture(axes, history)
    low, high = end_box(history)
    axes.add_patch(Rectangle(tuple(low), *(high - low), fill=False, ec=INK, lw=0.8, ls=':'))
    axes.set(xlabel='x [m]', ylabel='y [m]', title=title)
    axes.set_aspect('equal', adjustable='datalim')


def draw_beside(axes: Axes, history: History) -> None:
    """Draw the whole of the flight that intercepts the rope."""
    draw_swing(axes, history)
    draw_path(axes, history, arrow=0.0044, color=BLUE)
    mark_capture(axes, history)
    axes.set(xlabel='x [m]', title='The same rope, intercepted')
    axes.set_aspect('equal', adjustable='datalim')


def draw_end(axes: Axes, history: History) -> None:
    """Draw the part of the flight around the rope, with plans and near misses."""
    fans = [planned.points[:, :2] for planned in history.plans]
    axes.add_collection(LineCollection(fans, colors=SKY, linewidths=0.7, alpha=0.6, zorder=2))
    axes.plot([], [], color=SKY, lw=0.8, label='plans')
    draw_obstacles(axes, history)
    draw_swing(axes, history)
    draw_path(axes, history, arrow=0.005)
    for number, miss in enumerate(history.near_misses, start=1):
        axes.plot(*np.array([miss.vehicle[:2], miss.rope[:2]]).T, color=RED, lw=1.2, zorder=7)
        cross(axes, number, (miss.rope[0], miss.rope[1]), 'near miss, to the rope')
    mark_capture(axes, history)
    draw_reach(axes, history)
    low, high = end_box(history)
    axes.set(xlabel='x [m]', ylabel='y [m]', title='Around the rope (dotted frame above)')
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect='equal')
