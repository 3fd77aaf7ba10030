# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Nine moments of a retrieval, as in the paper: the vehicle, its plan and the rope."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.tool.figures.charts import story
from orbimpc_ros.tool.figures.scene import (
    arrival_tick,
    draw_headings,
    draw_obstacles,
    draw_swing,
    end_box,
)
from orbimpc_ros.tool.history import Encounter, History
from orbimpc_ros.tool.style import BLUE, GREEN, GREY, INK, ORANGE, RED, headline

PANELS = 9


def moments(history: History) -> Figure:
    """Return nine moments of a retrieval, from above, each with the plan made then."""
    figure = Figure(figsize=(9.0, 9.8), layout='constrained')
    panels = figure.subplots(3, 3, sharex=True, sharey=True)
    chosen = chosen_ticks(history)
    for axes, tick in zip(panels.flat, chosen, strict=False):
        draw_moment(axes, history, tick)
    for axes in panels.flat[len(chosen) :]:
        axes.set_axis_off()
    low, high = _box(history, chosen)
    panels[0, 0].set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    for axes in panels[-1]:
        axes.set_xlabel('x [m]')
    for axes in panels[:, 0]:
        axes.set_ylabel('y [m]')
    figure.legend(*_legend(panels.flat), loc='outside lower center', ncols=7)
    headline(figure, story(history))
    return figure


def _box(history: History, chosen: list[int]) -> tuple[Array, Array]:
    """Return corners around what is flown at the end and around the plans of the moments."""
    low, high = end_box(history)
    planned = {each.time: each.points[:, :2] for each in history.plans}
    shown = [planned[time] for time in history.times[chosen] if time in planned]
    points = np.concatenate([[low, high], *shown])
    beside = 0.03 * (high - low)
    return np.minimum(low, points.min(axis=0) - beside), np.maximum(
        high, points.max(axis=0) + beside
    )


def chosen_ticks(history: History) -> list[int]:
    """Return up to nine ticks: those that led to near misses and the end, others in between."""
    last = max(0, len(history.times) - 2)
    first = max(0, min(arrival_tick(history), last - PANELS + 1))
    wanted = {_tick_before(history, miss.time) for miss in history.near_misses} | {first, last}
    chosen = sorted(wanted)[-PANELS:]
    while len(chosen) < min(PANELS, last - first + 1):
        gaps = np.diff(chosen)
        widest = int(np.argmax(gaps))
        chosen.insert(widest + 1, chosen[widest] + int(gaps[widest]) // 2)
    return chosen


def _tick_before(history: History, time: float) -> int:
    return max(0, int(np.searchsorted(history.times, time, side='left')) - 1)


def draw_moment(axes: Axes, history: History, tick: int) -> None:
    """Draw a tick: the way so far, the plan, the rope, and how the step went."""
    axes.set_aspect('equal')
    draw_obstacles(axes, history)
    draw_swing(axes, history)
    way = history.positions[: tick + 1, :2]
    axes.plot(*way.T, color=GREY, lw=1.0, zorder=2, label='flown so far')
    _draw_plan(axes, history, tick)
    heading = history.headings[tick : tick + 1, :2]
    draw_headings(axes, way[-1:], heading, width=0.014, scale=12, pivot='mid')
    axes.plot([], [], '>', color=INK, ms=8, label='vehicle')  # an arrow's own entry is a bare bar
    axes.plot(*history.ropes[tick, :2], 'o', color=ORANGE, mec=INK, mew=0.6, ms=7, zorder=6,
              label='rope')  # fmt: skip
    axes.set_title(
        f't = {history.times[tick] - history.times[0]:.0f} s{_outcome(axes, history, tick)}'
    )


def _draw_plan(axes: Axes, history: History, tick: int) -> None:
    for planned in history.plans:
        if planned.time == history.times[tick]:
            axes.plot(*planned.points[:, :2].T, 'o-', color=BLUE, ms=2.5, lw=1.2, zorder=4,
                      label='plan')  # fmt: skip


def _outcome(axes: Axes, history: History, tick: int) -> str:
    """Mark what came of a step and return it in words."""
    begun, ended = history.times[tick : tick + 2]
    capture = history.capture
    if capture is not None and begun < capture.time <= ended:
        _mark(axes, capture, GREEN, '*', 'caught')
        radius = history.capture_radius
        axes.add_patch(Circle(tuple(capture.rope[:2]), radius, fill=False, ec=GREEN, ls='--'))
        return f': caught at {capture.time - history.times[0]:.1f} s'
    for miss in history.near_misses:
        if begun < miss.time <= ended:
            _mark(axes, miss, RED, 'x', 'near miss')
            return f': missed by {miss.distance:.2f} m'
    return ''


def _mark(axes: Axes, approach: Encounter, color: str, marker: str, label: str) -> None:
    ends = np.array([approach.vehicle[:2], approach.rope[:2]])
    axes.plot(*ends.T, color=color, lw=1.4, zorder=7)
    axes.plot(*ends[1], marker, color=color, ms=12 if marker == '*' else 7, mew=1.5, zorder=8,
              ls='', label=label)  # fmt: skip


def _legend(panels: np.flatiter) -> tuple[list, list]:
    """Return the legend of all panels, each name once."""
    found: dict[str, Any] = {}
    for axes in panels:
        handles, labels = axes.get_legend_handles_labels()
        found |= dict(zip(labels, handles, strict=True))
    return list(found.values()), list(found)
