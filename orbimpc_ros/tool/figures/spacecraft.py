# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The spacecraft, the paper's figure: path and frames, determinant and thrust."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.tool.figures import space
from orbimpc_ros.tool.figures.charts import story
from orbimpc_ros.tool.figures.numbers import applied, steps
from orbimpc_ros.tool.figures.scene import boxes
from orbimpc_ros.tool.history import History
from orbimpc_ros.tool.style import (
    BLUE,
    ORANGE,
    headline,
    whole_seconds,
)

VIEW = (18.0, -70.0)
PLANNED: dict[str, Any] = {'color': ORANGE, 'lw': 3.5, 'alpha': 0.6}
FLOWN: dict[str, Any] = {'color': BLUE, 'lw': 1.4}


def spacecraft(history: History, plan: Plan) -> Figure:
    """Return a manoeuvre in space with its determinant and its thrust.

    Args:
        history: of the flight.
        plan: made at its start, with the relaxed rotations R_k.
    """
    figure = Figure(figsize=(10.0, 6.6), layout='constrained')
    grid = figure.add_gridspec(2, 2, width_ratios=(1.15, 1.0))
    axes = draw_manoeuvre(figure, grid[:, 0], history)
    determinant, thrust = figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
    draw_determinant(determinant, history, plan)
    draw_fraction(thrust, history, plan)
    determinant.sharex(thrust)
    figure.legend(*axes.get_legend_handles_labels(), loc='outside lower left', ncols=6)
    thrust.xaxis.set_major_locator(whole_seconds())
    headline(figure, story(history))
    return figure


def draw_manoeuvre(figure: Figure, place: object, history: History) -> space.Axes3D:
    """Draw the path in space, the body's axes at every second, and the thrust."""
    path, reach = history.positions, 0.06 * float(np.ptp(history.positions, axis=0).max())
    axes = space.add_axes(figure, place, path, view=VIEW)
    space.draw_boxes(axes, boxes(history))
    space.draw_path(axes, path, 'flown path')
    space.draw_frames(axes, path, history.attitudes, reach)
    space.star(axes, history.ropes[-1], 'goal')
    axes.set_title('Path in space, body axes at every tick')
    return axes


def draw_determinant(axes: Axes, history: History, plan: Plan) -> None:
    """Draw det R_k: of the plan, and as flown, where R = sigma Q and so det R = sigma^3."""
    times = history.values['step'] * np.arange(plan.horizon)
    steps(axes, times, np.linalg.det(plan.rotations[:-1]), 'relaxed plan at the start', PLANNED)
    times, shares = applied(history)
    steps(axes, times, shares**3, r'flown: $R = \sigma Q$, $\det R = \sigma^3$', FLOWN)
    axes.set(title='Determinant det R', ylabel='det R', ylim=(-0.04, 1.04))
    axes.tick_params(labelbottom=False)
    axes.legend(loc='upper left')


def draw_fraction(axes: Axes, history: History, plan: Plan) -> None:
    """Draw the share of full thrust: as planned at the start, and as flown."""
    times = history.values['step'] * np.arange(plan.horizon)
    steps(axes, times, plan.speed_fraction[:-1], 'planned at the start', PLANNED)
    steps(axes, *applied(history), 'flown, re-planned at every tick', FLOWN)
    title = r'Share of full thrust, $\sigma = |R e_1|$'
    axes.set(title=title, xlabel='time [s]', ylabel='share', ylim=(-0.04, 1.04))
    axes.legend(loc='upper left')
