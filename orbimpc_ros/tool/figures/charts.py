# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Distances and speeds over time, and a flight in one line for the head of its pictures."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter

from orbimpc_ros.tool.figures.scene import cross, star
from orbimpc_ros.tool.history import History
from orbimpc_ros.tool.style import BLUE, GREEN, INK, RED


def draw_over_time(distance: Axes, speed: Axes, history: History) -> None:
    """Draw distance above speed, over the same time."""
    draw_distance(distance, history)
    draw_speed(speed, history)
    distance.sharex(speed)
    span = history.end - history.times[0]
    speed.set_xlim(-0.04 * span, 1.04 * span)


def draw_distance(axes: Axes, history: History) -> None:
    """Draw the distance to the goal, at odometry and at the closest approach of every step."""
    begun = history.times[0]
    _plot_distance(axes, history, color=INK)
    radius, done, goal = _aim(history)
    axes.axhline(radius, color=GREEN, lw=1.2, ls='--', label=f'{done} radius {radius:g} m')
    for number, miss in enumerate(history.near_misses, start=1):
        cross(axes, number, (miss.time - begun, miss.distance), 'near miss')
    if history.capture is not None:
        star(axes, history.capture.time - begun, history.capture.distance, 'caught')
    axes.set(title=f'Distance to the {goal}', ylabel='distance [m]', yscale='log')
    # An arrival on the spot has no place on a logarithmic axis.
    axes.set_ylim(bottom=max(axes.get_ylim()[0], 0.2 * radius))
    low, high = axes.get_ylim()
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 1e3 * low else (1.0,)))
    axes.yaxis.set_major_formatter('{x:g}')
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.tick_params(labelbottom=False)
    axes.legend(loc='upper right')


def draw_other_distance(axes: Axes, history: History) -> None:
    """Add the distance to the goal of another flight to that of the first."""
    limits = axes.get_ylim()
    _plot_distance(axes, history, color=BLUE, label='intercepted')
    if history.capture is not None:
        caught = max(history.capture.distance, 1.1 * limits[0])  # or it would be out of sight
        star(axes, history.capture.time - history.times[0], caught, '_nolegend_')
    axes.set_ylim(limits)
    axes.legend(loc='upper right')


def _plot_distance(axes: Axes, history: History, **look: Any) -> None:
    moments = [(moment.time - history.times[0], moment.distance) for moment in history.moments]
    axes.plot(*np.array(moments).T, lw=1.2, **look)


def _aim(history: History) -> tuple[float, str, str]:
    """Return how near is near enough [m], what that is called, and what the goal is."""
    if history.values['finish'] == 'arrival':
        return history.values['arrival_radius'], 'arrival', 'goal'
    return history.capture_radius, 'capture', 'rope'


def draw_speed(axes: Axes, history: History) -> None:
    """Draw the commanded speed fraction and the floor below it."""
    planned = [
        (time - history.times[0], fields['speed_fraction'][1])
        for time, fields in history.ticks
        if len(fields.get('speed_fraction') or ()) > 1 and time <= history.end
    ]
    if planned:
        planned.append((history.end - history.times[0], planned[-1][1]))  # holds to the end
        axes.step(*np.array(planned).T, where='post', color=BLUE, lw=1.3, label='commanded')
    values = history.values
    if values['floor.shape'] != 'none':
        floor = values['floor.fraction']
        det = f' (det R > {floor**2:.2g})' if values['dimension'] == 2 else ''
        label = f'floor {floor:.3f}{det}'
        axes.axhline(floor, color=RED, lw=1.2, ls='--', label=label)
        axes.axhspan(0.0, floor, color=RED, alpha=0.10, lw=0)
    what = 'thrust' if values['translation_order'] == 2 else 'speed'
    title = f'{what.capitalize()} fraction |R e₁|'
    axes.set(title=title, xlabel='time [s]', ylabel=f'share of full {what}')
    axes.set_ylim(0.0, 1.08)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc='lower right', ncols=2)


def story(history: History) -> str:
    """Return how a flight went: a capture, or an arrival."""
    return _arrival(history) if history.values['finish'] == 'arrival' else _retrieval(history)


def _retrieval(history: History) -> str:
    near = len(history.near_misses)
    misses = f'{near} near miss{"" if near == 1 else "es"}'
    capture = history.capture
    if capture is None:
        return f'Rope not caught in {history.times[-1] - history.times[0]:.0f} s: {misses}'
    how = f'after {misses}' if near else 'on the first pass'
    verb = 'intercepted' if history.values['objective'] == 'intercept' else 'caught'
    return f'Rope {verb} at t = {capture.time - history.times[0]:.1f} s {how}'


def _arrival(history: History) -> str:
    missed, speed = history.missed
    values = history.values
    vehicle = 'Spacecraft' if values['dimension'] == 3 else 'Dubins car'
    if values['gravity']:
        vehicle = 'Lander' if values['glide_slope'] or values['tilt'] else 'Multirotor'
    at = f' at {speed:.1e} m/s' if values['translation_order'] == 2 else ''
    done = 'arrives' if history.captured else 'does not arrive'
    return f'{vehicle} {done}: {missed:.1e} m from the goal{at}'
