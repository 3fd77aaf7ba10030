"""Pictures in space: axes to scale, bodies as frames, shadows on the ground."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.tool.figures.style import BLUE, GREEN, INK, RED

Axes3D = Any  # mpl_toolkits has no types
AXES = (('x', RED), ('y', GREEN), ('z', BLUE))  # of the body, as in RViz
SHADOW = '#b5b5b5'


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
    margin = 0.06 * float((high - low).max())
    low, high = low - margin, high + margin
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=0.95)
    axes.set(xlabel='x [m]', ylabel='y [m]', zlabel='z [m]')
    axes.view_init(elev=view[0], azim=view[1])
    for each in (axes.xaxis, axes.yaxis, axes.zaxis):
        each.pane.set_facecolor('white')
        each.pane.set_edgecolor('#cccccc')
        each.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    return axes


def draw_path(axes: Axes3D, points: Array, label: str) -> None:
    """Draw a path, shape (K, 3), its shadow on the ground, and where it begins."""
    ground = axes.get_zlim()[0]
    axes.plot(*points[:, :2].T, ground, color=SHADOW, lw=1.0, label='shadow on the ground')
    axes.plot(*points.T, '.-', color=INK, lw=1.3, ms=4, label=label)
    axes.plot(*points[0], 'o', mfc='white', mec=INK, ms=6, mew=1.3)
    axes.text(*points[0], 'start  ', ha='right', va='top')


def draw_frames(axes: Axes3D, positions: Array, attitudes: Array, length: float) -> None:
    """Draw the body's axes, ``length`` [m] long, at positions (K, 3) with attitudes (K, 3, 3)."""
    for column, (name, color) in enumerate(AXES):
        ends = np.stack([positions, positions + length * attitudes[:, :, column]], axis=1)
        for k, (begin, end) in enumerate(ends):
            label = f'body {name}' if k == 0 else None
            axes.plot(*np.array([begin, end]).T, color=color, lw=1.6, label=label)


def drop(axes: Axes3D, point: Array) -> None:
    """Draw a line from a point, shape (3,), down to the ground."""
    ground = axes.get_zlim()[0]
    axes.plot([point[0]] * 2, [point[1]] * 2, [ground, point[2]], color=SHADOW, lw=0.8, ls=':')


def star(axes: Axes3D, point: Array, label: str) -> None:
    """Mark what the flight was about, shape (3,) [m]."""
    drop(axes, point)
    axes.plot(*point, '*', color=GREEN, mec=INK, mew=0.6, ms=14, label=label, ls='', zorder=10)
