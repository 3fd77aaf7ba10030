# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A retrieval in space: the flight, its projections, and what happened when."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from orbimpc_ros.tool.figures import space
from orbimpc_ros.tool.figures.charts import draw_over_time, story
from orbimpc_ros.tool.figures.scene import boxes, flown_path, star, swing
from orbimpc_ros.tool.history import History
from orbimpc_ros.tool.style import INK, ORANGE, SKY, headline, paper

VIEW = (24.0, -62.0)


def retrieval3d(history: History) -> Figure:
    """Return the picture of a retrieval in space."""
    figure = Figure(figsize=(10.0, 9.0), layout='constrained')
    grid = figure.add_gridspec(3, 2, height_ratios=(1.0, 1.0, 1.1), width_ratios=(1.25, 1.0))
    axes = draw_flight(figure, grid[:2, 0], history)
    distance, speed = figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
    draw_over_time(distance, speed, history)
    draw_projection(figure.add_subplot(grid[2, 0]), history, 2, 'From the side')
    draw_projection(figure.add_subplot(grid[2, 1]), history, 1, 'From above')
    figure.legend(*axes.get_legend_handles_labels(), loc='outside lower center', ncols=4)
    headline(figure, story(history))
    return figure


def draw_flight(figure: Figure, place: object, history: History) -> space.Axes3D:
    """Draw the flight in space, with the plans, the rope's swing and the body's axes."""
    path, rope = flown_path(history), swing(history)
    axes = space.add_axes(figure, place, np.concatenate([path, rope]), view=VIEW)
    space.draw_boxes(axes, boxes(history))
    for number, planned in enumerate(history.plans[:-1]):
        label = 'plans' if number == 0 else None
        axes.plot(*planned.points.T, color=SKY, lw=0.9, label=label)
    axes.plot(*rope.T, color=ORANGE, lw=3.5, alpha=0.6, label="rope's swing")
    space.draw_path(axes, path, 'flown path')
    space.draw_frames(axes, path[:-1], history.attitudes[:-1], 0.35)
    if history.capture is not None:
        space.star(axes, history.capture.rope, 'rope when caught')
    axes.set_title('Flight in space')
    return axes


def draw_projection(axes: Axes, history: History, up: int, title: str) -> None:
    """Draw the flight against x and another axis, 1 for y or 2 for z."""
    path, rope = flown_path(history), swing(history)
    for planned in history.plans[:-1]:
        axes.plot(*planned.points[:, [0, up]].T, color=SKY, lw=0.7)
    axes.plot(*rope[:, [0, up]].T, color=ORANGE, lw=3.5, alpha=0.6)
    axes.plot(*path[:, [0, up]].T, '.-', color=INK, lw=1.2, ms=4)
    axes.plot(*path[0, [0, up]], 'o', mfc=paper(), mec=INK, ms=6, mew=1.3)
    if history.capture is not None:
        x, y = map(float, history.capture.rope[[0, up]])
        star(axes, x, y, 'rope when caught')
    axes.set(xlabel='x [m]', ylabel=f'{"xyz"[up]} [m]', title=title)
    axes.set_aspect('equal', adjustable='datalim')
