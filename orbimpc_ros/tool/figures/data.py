"""A flight in numbers over time: position, velocity, body rates, and thrust or speed."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.tool.figures.captions import story
from orbimpc_ros.tool.figures.style import BLUE, GREEN, INK, RED, headline, whole_seconds
from orbimpc_ros.tool.io.history import History

TITLES = {
    'positions': 'Position in the world',
    'velocities': 'Velocity in the world',
    'rates': 'Rates about the body axes',
}
COMPONENTS = (('x', RED, '-'), ('y', GREEN, '--'), ('z', BLUE, '-.'))
FLOWN: dict[str, Any] = {'color': INK, 'lw': 1.4}


def data(history: History) -> Figure:
    """Return position, velocity, body rates, and thrust or speed over time."""
    figure = Figure(figsize=(10.0, 6.4), layout='constrained')
    panels = figure.subplots(2, 2, sharex=True)
    draw_components(panels[0, 0], history, 'positions', 'position [m]')
    draw_components(panels[0, 1], history, 'velocities', 'velocity [m/s]')
    draw_components(panels[1, 0], history, 'rates', 'rate [rad/s]')
    draw_pushed(panels[1, 1], history)
    for axes in panels[1]:
        axes.set_xlabel('time [s]')
        axes.xaxis.set_major_locator(whole_seconds())
    headline(figure, story(history))
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


def _thrust(history: History) -> bool:
    return history.values['translation_order'] == 2
