# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A flight as seen from above: its path, the rope, and marks for what happened."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Rectangle

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.sim.parameters import sim_settings
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.history import History
from orbimpc_ros.tool.style import FAINT, GREEN, GREY, INK, ORANGE, RED, halo, paper


def flown_path(history: History) -> Array:
    """Return the positions up to the capture, shape (M, 3) [m]."""
    points = history.positions.copy()
    if history.capture is not None:
        points[-1] = history.capture.vehicle
    return points


def swing(history: History) -> Array:
    """Return points along the rope's swing, shape (K, 3) [m].

    Where it was sighted elsewhere than the parameters say, these are the sightings: a bag may have
    been recorded by others, without parameters.
    """
    rope = sim_settings(settings.of_sim(history.values)).scenario.rope
    elapsed = history.times - history.times[0]
    fine = np.linspace(0.0, elapsed[-1], 500)
    known = [np.pad([rope.at(t) for t in at], _to_space(rope.center)) for at in (elapsed, fine)]
    return known[1] if np.allclose(known[0], history.ropes, atol=0.05) else history.ropes


def _to_space(point: Array) -> tuple[tuple[int, int], tuple[int, int]]:
    return (0, 0), (0, 3 - len(point))


def boxes(history: History, *, planned: bool = False) -> list[Array]:
    """Return the lower and the upper corner of every obstacle, shape (2, n) each [m].

    Args:
        history: of the flight.
        planned: whether those of the planner are asked for, not the simulator's.
    """
    values = history.values if planned else settings.of_sim(history.values)
    return list(np.reshape(values['obstacles'], (-1, 2, values['dimension'])))


def draw_obstacles(axes: Axes, history: History) -> None:
    """Draw the obstacles as seen from above, hatched."""
    for number, (low, high) in enumerate(boxes(history)):
        draw_box(axes, low[:2], high[:2], 'obstacle' if number == 0 else None)


def draw_box(axes: Axes, low: Array, high: Array, label: str | None = None) -> None:
    """Draw a rectangle, hatched, given its lower and its upper corner, shape (2,) each [m]."""
    look: Any = {'fc': FAINT, 'ec': GREY, 'hatch': '///', 'alpha': 0.6, 'zorder': 1}
    axes.add_patch(Rectangle((low[0], low[1]), *(high - low), label=label, **look))


def arrival_tick(history: History) -> int:
    """Return the first tick in the rope's vicinity, one and a half steps away; 0 if none is."""
    apart = np.linalg.norm(history.positions - history.ropes, axis=1)
    near = apart < 1.5 * history.values['forward'] * history.values['step']
    return int(np.argmax(near))


def end_box(history: History) -> tuple[Array, Array]:
    """Return the corners of a square around the swing and what is flown from its vicinity on."""
    points = np.concatenate([history.positions[arrival_tick(history) :, :2], swing(history)[:, :2]])
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    half = 0.56 * np.ptp(points, axis=0).max()
    return middle - half, middle + half


def draw_path(axes: Axes, history: History, arrow: float, color: str = INK) -> None:
    """Draw the path up to the capture, with an arrow along the heading at every tick."""
    points = flown_path(history)[:, :2]
    axes.plot(*points.T, color=color, lw=1.2, zorder=4, label='flown path, headings')
    draw_headings(axes, points[:-1], history.headings[:-1, :2], color=color, width=arrow)
    mark_start(axes, points[0])


def draw_headings(
    axes: Axes,
    points: Array,
    headings: Array,
    *,
    color: str = INK,
    width: float = 0.005,
    **look: Any,
) -> None:
    """Draw an arrow at each point, shape (K, 2), along its heading, shape (K, 2)."""
    arrows: Any = {'angles': 'xy', 'scale': 30, 'headwidth': 5, 'zorder': 5} | look
    axes.quiver(*points.T, *headings.T, color=color, width=width, **arrows)


def mark_start(axes: Axes, at: Array) -> None:
    """Mark where a flight begins, shape (2,) [m]."""
    x, y = map(float, at)
    axes.plot(x, y, 'o', mfc=paper(), mec=INK, ms=6, mew=1.3, zorder=6)
    axes.annotate('start', (x, y), xytext=(0, 8), textcoords='offset points', ha='center')


def draw_swing(axes: Axes, history: History) -> None:
    """Draw the curve on which the rope swings."""
    curve = swing(history)[:, :2]
    axes.plot(*curve.T, color=ORANGE, lw=4, alpha=0.5, solid_capstyle='round', zorder=1,
              label="rope's swing")  # fmt: skip


def cross(axes: Axes, number: int, at: tuple[float, float], label: str) -> None:
    """Mark a near miss with its number."""
    caption = label if number == 1 else None
    axes.plot(*at, 'x', color=RED, ms=6, mew=1.6, zorder=8, label=caption)
    axes.annotate(
        str(number),
        at,
        xytext=(0, -12),
        textcoords='offset points',
        ha='center',
        color=RED,
        fontweight='bold',
        path_effects=halo(),
        zorder=9,
    )


def mark_capture(axes: Axes, history: History) -> None:
    """Mark where the rope was when it was caught, if it was."""
    if history.capture is not None:
        x, y, _ = history.capture.rope
        star(axes, x, y, 'rope when caught')


def draw_reach(axes: Axes, history: History) -> None:
    """Draw the circle within which the rope was caught, and the vehicle in it."""
    capture = history.capture
    if capture is None:
        return
    radius = history.capture_radius
    reach = Circle(
        (capture.rope[0], capture.rope[1]), radius, fill=False, ec=GREEN, ls='--', lw=1.2
    )
    axes.add_patch(reach)
    axes.plot(*np.array([capture.vehicle[:2], capture.rope[:2]]).T, color=GREEN, lw=1.6, zorder=9)
    axes.plot([], [], color=GREEN, ls='--', lw=1.2, label='capture radius')


def star(axes: Axes, x: float, y: float, label: str) -> None:
    """Mark the moment or the place that the flight was about."""
    axes.plot(x, y, '*', color=GREEN, mec=INK, mew=0.6, ms=14, zorder=10, label=label)
