"""The cost of planning, tick by tick: objective, proved bound, gap, time, relaxations."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.tool.figures.captions import story
from orbimpc_ros.tool.figures.style import BLUE, INK, ORANGE, RED, headline, whole_seconds
from orbimpc_ros.tool.io.history import History

LEAST_GAP = 1e-16  # drawn for none, which has no place on a logarithmic axis


def solver(history: History) -> Figure:
    """Return objective, gap, solve time and nodes over time."""
    figure = Figure(figsize=(10.0, 6.4), layout='constrained')
    panels = figure.subplots(2, 2, sharex=True)
    draw_objective(panels[0, 0], history)
    draw_gap(panels[0, 1], history)
    draw_positive(panels[1, 0], history, 'solve_time_ms', 'Time of the whole tick', 'time [ms]')
    draw_positive(panels[1, 1], history, 'nodes', 'Relaxations solved', 'nodes')
    for axes in panels[1]:
        axes.set_xlabel('time [s]')
        axes.xaxis.set_major_locator(whole_seconds())
    headline(figure, story(history))
    return figure


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
