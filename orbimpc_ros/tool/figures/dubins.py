# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The Dubins car, the paper's two figures: paths, and determinants, with and without a floor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.tool.figures.scene import draw_headings, draw_obstacles, mark_start, star
from orbimpc_ros.tool.history import History
from orbimpc_ros.tool.style import BLUE, RED, headline, whole_seconds

COLORS = (BLUE, RED)
LINES = ('-', '--')


def dubins(flown: Mapping[str, History]) -> Figure:
    """Return paths and determinants of one or two flights, by name."""
    figure = Figure(figsize=(10.0, 6.2), layout='constrained')
    paths, determinants = figure.subplots(1, 2, width_ratios=(1.0, 1.25))
    for number, history in enumerate(flown.values()):
        draw_path(paths, history, number)
        draw_determinant(determinants, history, number)
    _finish_paths(paths, list(flown.values()))
    _finish_determinants(determinants, list(flown.values()))
    figure.legend(*paths.get_legend_handles_labels(), loc='outside lower center', ncols=4)
    headline(figure, _story(list(flown.values())))
    return figure


def named(history: History) -> str:
    """Return the name of a flight among others: its minimum speed."""
    shape, fraction = history.values['floor.shape'], history.values['floor.fraction']
    if shape == 'none':
        return 'no minimum speed'
    faces = {4: 'a square', 6: 'a hexagon'}
    count = history.values['floor.faces']
    by = 'a circle' if shape == 'circle' else faces.get(count, f'{count} faces')
    return f'det R ≥ {fraction**2:.2g} by {by}'


def determinant(history: History) -> Array:
    """Return det R, the square of the share of full speed, as flown from each time on, shape (M,).

    In the plane det R = |R e1|^2.
    """
    speeds = np.linalg.norm(history.velocities, axis=1)
    return (speeds / history.values['forward']) ** 2


def draw_path(axes: Axes, history: History, number: int) -> None:
    """Draw a path with an arrow along the heading at every tick."""
    color, points = COLORS[number], history.positions[:, :2]
    axes.plot(*points.T, LINES[number], color=color, lw=1.3, label=named(history))
    axes.plot(*points.T, '.', color=color, ms=4)
    draw_headings(axes, points, history.headings[:, :2], color=color)


def draw_determinant(axes: Axes, history: History, number: int) -> None:
    """Draw the determinant over time; R_k moves the car from t_k to t_{k+1}."""
    times = history.times - history.times[0]
    color = COLORS[number]
    axes.step(times, determinant(history), LINES[number], where='post', color=color, lw=1.5)
    axes.plot(times, determinant(history), '.', color=color, ms=4)


def _finish_paths(axes: Axes, flown: list[History]) -> None:
    draw_obstacles(axes, flown[0])
    mark_start(axes, flown[0].positions[0, :2])
    x, y = flown[0].ropes[-1, :2]
    star(axes, x, y, f'goal at t = {flown[0].times[-1] - flown[0].times[0]:.0f} s')
    axes.set(xlabel='x [m]', ylabel='y [m]', title='Paths from above, headings at every tick')
    axes.set_aspect('equal', adjustable='datalim')


def _finish_determinants(axes: Axes, flown: list[History]) -> None:
    for history in flown:
        if history.values['floor.shape'] != 'none':
            floor = history.values['floor.fraction'] ** 2
            axes.axhspan(0.0, floor, color=RED, alpha=0.10, lw=0)
            axes.axhline(floor, color=RED, lw=1.0, ls=':')
            where: Any = {'ha': 'right', 'va': 'top', 'transform': axes.get_yaxis_transform()}
            axes.text(0.99, floor - 0.02, f'minimum {floor:.2g}', color=RED, **where)
    axes.set(xlabel='time [s]', ylabel='det R', title='Determinant det R = (share of full speed)²')
    axes.set_ylim(0.0, 1.05)
    axes.xaxis.set_major_locator(whole_seconds())


def _story(flown: list[History]) -> str:
    missed = max(history.missed[0] for history in flown)
    done = 'arrives' if all(history.captured for history in flown) else 'does not arrive'
    end = flown[0].times[-1] - flown[0].times[0]
    return f'Dubins car {done} at t = {end:.0f} s: {missed:.1e} m from the goal or less'
