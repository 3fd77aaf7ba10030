# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A flight in numbers over time: motion and thrust, and the cost of planning it, tick by tick."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.tool.figures.charts import story
from orbimpc_ros.tool.history import History
from orbimpc_ros.tool.style import BLUE, GREEN, INK, ORANGE, RED, headline, whole_seconds

TITLES = {
    'positions': 'Position in the world',
    'velocities': 'Velocity in the world',
    'rates': 'Rates about the body axes',
}
COMPONENTS = (('x', RED, '-'), ('y', GREEN, '--'), ('z', BLUE, '-.'))
FLOWN: dict[str, Any] = {'color': INK, 'lw': 1.4}
LEAST_GAP = 1e-16  # drawn for none, which has no place on a logarithmic axis


def _panels(history: History, rows: int = 2) -> tuple[Figure, Any]:
    """Return a figure of rows of two charts over the same time, and the charts."""
    figure = Figure(figsize=(10.0, 3.2 * rows), layout='constrained')
    panels = figure.subplots(rows, 2, sharex=True)
    for axes in panels[-1]:
        axes.set_xlabel('time [s]')
        axes.xaxis.set_major_locator(whole_seconds())
    headline(figure, story(history))
    return figure, panels


def data(history: History) -> Figure:
    """Return position, velocity, body rates, and thrust or speed over time."""
    figure, panels = _panels(history)
    draw_components(panels[0, 0], history, 'positions', 'position [m]')
    draw_components(panels[0, 1], history, 'velocities', 'velocity [m/s]')
    draw_components(panels[1, 0], history, 'rates', 'rate [rad/s]')
    draw_pushed(panels[1, 1], history)
    return figure


def solver(history: History) -> Figure:
    """Return objective, gap, solve time and nodes over time, and catches where any were sought."""
    hunted = len(series(history, 'catch_bound')[0]) > 0
    figure, panels = _panels(history, rows=3 if hunted else 2)
    draw_objective(panels[0, 0], history)
    draw_gap(panels[0, 1], history)
    draw_positive(panels[1, 0], history, 'solve_time_ms', 'Time of the whole tick', 'time [ms]')
    draw_positive(panels[1, 1], history, 'nodes', 'Relaxations solved', 'nodes')
    if hunted:
        draw_time_to_go(panels[2, 0], history)
        draw_moment(panels[2, 1], history)
    return figure


def draw_components(axes: Axes, history: History, what: str, unit: str) -> None:
    """Draw the components of a vector over time; what is commanded holds for a step."""
    vectors = getattr(history, what)
    held = what == 'rates' or (what == 'velocities' and not _thrust(history))
    times = history.times - history.times[0]
    drawstyle = 'steps-post' if held else 'default'
    for column in _columns(history, what):
        name, color, line = COMPONENTS[column]
        axes.plot(
            times, vectors[:, column], line, color=color, lw=1.4, label=name, drawstyle=drawstyle
        )
    axes.set(title=TITLES[what], ylabel=unit)
    axes.legend(ncols=3)


def _columns(history: History, what: str) -> tuple[int, ...]:
    """Return the components that can differ from zero: in the plane, turning is about z."""
    if history.values['dimension'] == 3:
        return 0, 1, 2
    return (2,) if what == 'rates' else (0, 1)


def draw_pushed(axes: Axes, history: History) -> None:
    """Draw the thrust, or at translation order 1 the speed, along the body's x axis over time."""
    times, shares = applied(history)
    what, unit, mass = 'Speed', 'm/s', 1.0
    if _thrust(history):
        what, unit, mass = 'Thrust', 'N', history.values['mass']
    full = mass * history.values['forward']
    steps(axes, times, full * shares, 'flown', FLOWN)
    axes.axhline(full, color=RED, lw=1.0, ls=':', label=f'full {what.lower()}')
    if history.values['floor.shape'] != 'none':
        least = full * history.values['floor.fraction']
        axes.axhline(least, color=RED, lw=1.2, ls='--', label='floor')
    axes.set(title=f'{what} along body x', ylabel=f'{what.lower()} [{unit}]')
    axes.set_ylim(-0.04 * full, 1.12 * full)
    axes.legend(loc='best')


def applied(history: History) -> tuple[Array, Array]:
    """Return times [s] and the share of thrust or speed from then on, for each step flown."""
    values, begun, last = history.values, history.times[0], history.times[-1]
    if not _thrust(history):
        shares = np.linalg.norm(history.velocities, axis=1) / values['forward']
        return (history.times - begun)[:-1], shares[:-1]
    full, step = values['mass'] * values['forward'], values['step']
    found = {begun: values['start.speed_fraction']}
    # A thrust is taken over at the end of the step in which it is commanded.
    found |= {time + step: force / full for time, force in history.forces if time + step < last}
    return np.array(list(found)) - begun, np.array(list(found.values()))


def steps(axes: Axes, times: Array, values: Array, label: str, look: dict[str, Any]) -> None:
    """Draw what holds from each time for a step; ``values``, shape (K,)."""
    length = times[-1] - times[-2] if len(times) > 1 else 1.0
    axes.step(
        [*times, times[-1] + length], [*values, values[-1]], where='post', label=label, **look
    )


def tilts(headings: Array) -> Array:
    """Return the angles of unit vectors, shape (K, 3), from the vertical, shape (K,) [deg]."""
    return np.degrees(np.arccos(np.clip(headings[:, 2], -1.0, 1.0)))


def _thrust(history: History) -> bool:
    return history.values['translation_order'] == 2


def series(history: History, name: str) -> tuple[Array, Array]:
    """Return times [s] and values of a field of the ticks that have it as a finite number."""
    found = [
        (time - history.times[0], float(fields[name]))
        for time, fields in history.ticks
        if isinstance(fields.get(name), (int, float)) and np.isfinite(fields[name])
    ]
    times, values = np.reshape(found, (-1, 2)).T
    return times, values


def draw_objective(axes: Axes, history: History) -> None:
    """Draw the cost of every plan, and what no plan could have been cheaper than."""
    axes.plot(*series(history, 'objective'), 'o-', color=INK, lw=1.2, ms=3.5, label='plan')
    bound = series(history, 'lower_bound')
    axes.plot(*bound, '--', color=ORANGE, lw=2.2, label='proved lower bound')
    axes.set(title='Objective of the plan', ylabel='objective')
    axes.legend()


def draw_gap(axes: Axes, history: History) -> None:
    """Draw the relative gap, and the one from which on a plan is called optimal."""
    times, gaps = series(history, 'gap')
    axes.plot(times, np.maximum(gaps, LEAST_GAP), 'o-', color=BLUE, lw=1.0, ms=3.5, label='gap')
    tolerance = history.values['gap_tolerance']
    axes.axhline(tolerance, color=RED, lw=1.2, ls='--', label=f'optimal within {tolerance:g}')
    axes.set(title='Gap between plan and bound', ylabel='relative gap', yscale='log')
    axes.yaxis.set_major_locator(LogLocator(numticks=8))
    axes.legend()


def draw_time_to_go(axes: Axes, history: History) -> None:
    """Draw how soon each plan catches the goal, and before when none is proved to."""
    times, soonest = series(history, 'earliest_catch')
    axes.plot(times, soonest, 'o', color=GREEN, ms=4.5, label='catch of the plan')
    axes.step(*series(history, 'catch_bound'), '--', where='post', color=RED, label='none before')
    axes.set(title='Time to the catch', ylabel='time to go [s]')
    axes.set_ylim(bottom=0.0)
    axes.legend()


def draw_moment(axes: Axes, history: History) -> None:
    """Draw when each plan means to catch the goal; the line is when it was caught."""
    times, soonest = series(history, 'earliest_catch')
    axes.plot(times, times + soonest, 'o', color=GREEN, ms=4.5, label='foreseen')
    if history.capture is not None:
        caught = history.capture.time - history.times[0]
        axes.axhline(caught, color=INK, lw=1.2, ls='--', label='caught')
    axes.set(title='Moment of the catch', ylabel='time [s]')
    if axes.get_legend_handles_labels()[0]:
        axes.legend()


def draw_positive(axes: Axes, history: History, name: str, title: str, label: str) -> None:
    """Draw a field of the ticks on a logarithmic axis; ticks that fell back are crossed."""
    times, values = series(history, name)
    axes.plot(times, np.maximum(values, 1e-3), 'o-', color=BLUE, lw=1.0, ms=3.5)
    fallen = [time - history.times[0] for time, fields in history.ticks if fields.get('fallback')]
    bad = np.isin(times, fallen)
    if bad.any():
        axes.plot(times[bad], values[bad], 'x', color=RED, ms=8, mew=1.6, label='fell back')
        axes.legend()
    axes.set(title=title, ylabel=label, yscale='log')
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter('{x:g}')
    axes.yaxis.set_minor_formatter(NullFormatter())
