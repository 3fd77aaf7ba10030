"""The spacecraft, the paper's figures: path and frames, determinant and thrust, and its data."""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.tool.figures import space
from orbimpc_ros.tool.figures.style import (
    BLUE,
    GREEN,
    INK,
    ORANGE,
    RED,
    STYLE,
    headline,
    whole_seconds,
)
from orbimpc_ros.tool.history import History

VIEW = (18.0, -70.0)
PLANNED: dict[str, Any] = {'color': ORANGE, 'lw': 3.5, 'alpha': 0.6}
FLOWN: dict[str, Any] = {'color': BLUE, 'lw': 1.4}
TITLES = {
    'positions': 'Position in the world',
    'velocities': 'Velocity in the world',
    'rates': 'Rates about the body axes',
}
COMPONENTS = (('x', RED, '-'), ('y', GREEN, '--'), ('z', BLUE, '-.'))


def spacecraft(history: History, plan: Plan) -> Figure:
    """Return a manoeuvre in space with its determinant and its thrust.

    Args:
        history: of the flight.
        plan: made at its start, with the relaxed rotations R_k.
    """
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 6.6), layout='constrained')
        grid = figure.add_gridspec(2, 2, width_ratios=(1.15, 1.0))
        axes = draw_manoeuvre(figure, grid[:, 0], history)
        determinant, thrust = figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
        draw_determinant(determinant, history, plan)
        draw_fraction(thrust, history, plan)
        determinant.sharex(thrust)
        figure.legend(*axes.get_legend_handles_labels(), loc='outside lower left', ncols=6)
        thrust.xaxis.set_major_locator(whole_seconds())
        headline(figure, _story(history))
    return figure


def data(history: History) -> Figure:
    """Return position, velocity, body rates and thrust over time."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 6.4), layout='constrained')
        panels = figure.subplots(2, 2, sharex=True)
        draw_components(panels[0, 0], history, 'positions', 'position [m]')
        draw_components(panels[0, 1], history, 'velocities', 'velocity [m/s]')
        draw_components(panels[1, 0], history, 'rates', 'rate [rad/s]')
        draw_thrust(panels[1, 1], history)
        for axes in panels[1]:
            axes.set_xlabel('time [s]')
            axes.xaxis.set_major_locator(whole_seconds())
        headline(figure, _story(history))
    return figure


def _story(history: History) -> str:
    missed, speed = history.missed
    done = 'Spacecraft arrives' if history.captured else 'Spacecraft does not arrive'
    return f'{done}: {missed:.1e} m from the goal at {speed:.1e} m/s'


def draw_manoeuvre(figure: Figure, place: object, history: History) -> space.Axes3D:
    """Draw the path in space, the body's axes at every second, and the thrust."""
    path, reach = history.positions, 0.06 * float(np.ptp(history.positions, axis=0).max())
    axes = space.add_axes(figure, place, path, view=VIEW)
    space.draw_path(axes, path, 'flown path')
    space.draw_frames(axes, path, history.attitudes, reach)
    space.star(axes, history.ropes[-1], 'goal')
    axes.set_title('Path in space, body axes at every tick')
    return axes


def draw_determinant(axes: Axes, history: History, plan: Plan) -> None:
    """Draw det R_k: of the plan, and as flown, where R = sigma Q and so det R = sigma^3."""
    times = history.values['step'] * np.arange(plan.horizon)
    _steps(axes, times, np.linalg.det(plan.rotations[:-1]), 'relaxed plan at the start', PLANNED)
    applied, shares = _applied(history)
    _steps(axes, applied, shares**3, r'flown: $R = \sigma Q$, $\det R = \sigma^3$', FLOWN)
    axes.set(title='Determinant det R', ylabel='det R', ylim=(-0.04, 1.04))
    axes.tick_params(labelbottom=False)
    axes.legend(loc='upper left')


def draw_fraction(axes: Axes, history: History, plan: Plan) -> None:
    """Draw the share of full thrust: as planned at the start, and as flown."""
    times = history.values['step'] * np.arange(plan.horizon)
    _steps(axes, times, plan.speed_fraction[:-1], 'planned at the start', PLANNED)
    _steps(axes, *_applied(history), 'flown, re-planned at every tick', FLOWN)
    title = r'Share of full thrust, $\sigma = |R e_1|$'
    axes.set(title=title, xlabel='time [s]', ylabel='share', ylim=(-0.04, 1.04))
    axes.legend(loc='upper left')


def _steps(axes: Axes, times: Array, values: Array, label: str, look: dict[str, Any]) -> None:
    """Draw what holds from each time for a step; ``values``, shape (K,)."""
    length = times[1] - times[0]
    axes.step(
        [*times, times[-1] + length], [*values, values[-1]], where='post', label=label, **look
    )


def _applied(history: History) -> tuple[Array, Array]:
    """Return times [s] and the share of thrust applied from then on, for each step flown."""
    full = history.values['mass'] * history.values['forward']
    step, last = history.values['step'], history.times[-1]
    shares = {history.times[0]: history.values['start.speed_fraction']}
    # A thrust is taken over at the end of the step in which it is commanded.
    shares |= {time + step: force / full for time, force in history.forces if time + step < last}
    return np.array(list(shares)) - history.times[0], np.array(list(shares.values()))


def draw_components(axes: Axes, history: History, what: str, unit: str) -> None:
    """Draw the components of a vector over time; a rate holds for a step."""
    vectors = getattr(history, what)
    drawstyle = 'steps-post' if what == 'rates' else 'default'
    times = history.times - history.times[0]
    for column, (name, color, line) in enumerate(COMPONENTS):
        axes.plot(
            times, vectors[:, column], line, color=color, lw=1.4, label=name, drawstyle=drawstyle
        )
    axes.set(title=TITLES[what], ylabel=unit)
    axes.legend(ncols=3)


def draw_thrust(axes: Axes, history: History) -> None:
    """Draw the thrust along the body's x axis over time."""
    times, shares = _applied(history)
    full = history.values['mass'] * history.values['forward']
    _steps(axes, times, full * shares, 'flown', {'color': INK, 'lw': 1.4})
    axes.axhline(full, color=RED, lw=1.0, ls=':', label='full thrust')
    axes.set(title='Thrust along body x', ylabel='thrust [N]', ylim=(-0.04 * full, 1.12 * full))
    axes.legend(loc='center left')
