# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Pictures in space: axes to scale, bodies as frames, shadows on the ground."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.tool.style import BLUE, FAINT, GREEN, GREY, INK, RED, paper

Axes3D = Any  # mpl_toolkits has no types
FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
AXES = (('x', RED, '-'), ('y', GREEN, (0, (2.5, 1.0))), ('z', BLUE, (0, (1.0, 0.8))))
# of the body, in RViz's colours; told apart by their dashes where there are no colours


def add_axes(figure: Figure, place: Any, points: Array, *, view: tuple[float, float]) -> Axes3D:
    """Return 3-D axes to scale around points, shape (K, 3) [m].

    Args:
        figure: gets the axes.
        place: in its grid.
        points: that must be seen.
        view: elevation and azimuth [deg].
    """
    axes: Axes3D = figure.add_subplot(place, projection='3d')
    low, high = points.min(axis=0), points.max(axis=0)
    margin = max(0.01, 0.06 * float((high - low).max()))  # also of what stands still
    low, high = low - margin, high + margin
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=0.9)
    axes.set(xlabel='x [m]', ylabel='y [m]', zlabel='z [m]')
    axes.view_init(elev=view[0], azim=view[1])
    for each in (axes.xaxis, axes.yaxis, axes.zaxis):
        each.pane.set_facecolor(paper())
        each.pane.set_edgecolor(FAINT)
        each.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    return axes


def draw_path(axes: Axes3D, points: Array, label: str) -> None:
    """Draw a path, shape (K, 3), its shadow on the ground, and where it begins."""
    ground = axes.get_zlim()[0]
    axes.plot(*points[:, :2].T, ground, color=FAINT, lw=1.0, label='shadow on the ground')
    axes.plot(*points.T, '.-', color=INK, lw=1.3, ms=4, label=label)
    axes.plot(*points[0], 'o', mfc=paper(), mec=INK, ms=6, mew=1.3)
    axes.text(*points[0], 'start  ', ha='right', va='top')


def draw_frames(axes: Axes3D, positions: Array, attitudes: Array, length: float) -> None:
    """Draw the body's axes, ``length`` [m] long, at positions (K, 3) with attitudes (K, 3, 3)."""
    for column, (name, color, line) in enumerate(AXES):
        ends = np.stack([positions, positions + length * attitudes[:, :, column]], axis=1)
        for k, (begin, end) in enumerate(ends):
            label = f'body {name}' if k == 0 else None
            axes.plot(*np.array([begin, end]).T, ls=line, color=color, lw=1.8, label=label)


def draw_boxes(axes: Axes3D, corners: list[Array]) -> None:
    """Draw boxes by their lower and upper corners, shape (2, 3) each [m]."""
    for number, box in enumerate(corners):
        points = np.array(list(itertools.product(*box.T)))  # eight, in binary order
        faces = [points[list(face)] for face in FACES]
        solid = Poly3DCollection(faces, facecolor=FAINT, edgecolor=GREY, alpha=0.35, lw=0.8)
        solid.set_label('obstacle' if number == 0 else '')
        axes.add_collection3d(solid)


def drop(axes: Axes3D, point: Array) -> None:
    """Draw a line from a point, shape (3,), down to the ground."""
    ground = axes.get_zlim()[0]
    axes.plot([point[0]] * 2, [point[1]] * 2, [ground, point[2]], color=FAINT, lw=0.8, ls=':')


def star(axes: Axes3D, point: Array, label: str) -> None:
    """Mark what the flight was about, shape (3,) [m]."""
    drop(axes, point)
    axes.plot(*point, '*', color=GREEN, mec=INK, mew=0.6, ms=14, label=label, ls='', zorder=10)
