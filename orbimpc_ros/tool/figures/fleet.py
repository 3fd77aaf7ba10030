# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A fleet from above: every flight and goal; beside it the approaches, or who came how close."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from orbimpc_ros.tool.figures.scene import draw_headings, draw_swing, flown_path, star
from orbimpc_ros.tool.history import History
from orbimpc_ros.tool.style import GREEN, INK, ORANGE, RED, halo, headline

EVERY = 5  # ticks from one arrow to the next
POINTS = 600  # in time
BESIDE = 0.6  # [m] from the swing to the name


def fleet(flown: Mapping[str, History]) -> Figure:
    """Return the picture of a fleet's flights, by namespace."""
    figure = Figure(figsize=(10.0, 6.2), layout='constrained')
    above, distance = figure.subplots(1, 2, width_ratios=(1.4, 1.0))
    crossing = _arrives(flown)
    for name, history in flown.items():
        draw_member(above, name, history)
        if not crossing:
            draw_distance(distance, history)
    if crossing:
        draw_pairs(distance, flown)
    above.set(xlabel='x [m]', ylabel='y [m]', title='Flights, seen from above')
    above.margins(0.12)  # for the names
    above.set_aspect('equal', adjustable='datalim')
    if not crossing:
        distance.set(ylabel='distance to the own rope [m]', yscale='log', title='Approach')
    distance.set_xlabel('time [s]')
    handles = dict(zip(*above.get_legend_handles_labels()[::-1], strict=True))
    figure.legend(handles.values(), handles.keys(), loc='outside lower center', ncols=4)
    headline(figure, story(flown))
    return figure


def story(flown: Mapping[str, History]) -> str:
    """Return in a line how a fleet has done."""
    if _arrives(flown):
        return f'{sum(each.captured for each in flown.values())} of {len(flown)} vehicles arrived'
    ends = [each.end - each.times[0] for each in flown.values() if each.capture is not None]
    if len(ends) < len(flown):
        return f'{len(ends)} of {len(flown)} ropes caught'
    return f'{len(ends)} of {len(flown)} ropes caught, the last at t = {max(ends):.1f} s'


def _arrives(flown: Mapping[str, History]) -> bool:
    return any(each.values['finish'] == 'arrival' for each in flown.values())


def draw_pairs(axes: Axes, flown: Mapping[str, History]) -> None:
    """Draw the distance of each pair of vehicles, and what was asked for; red where it is less."""
    radius = next(iter(flown.values())).values['avoid_radius']
    for one, other in itertools.combinations(flown.values(), 2):
        begin, end = max(one.times[0], other.times[0]), min(one.times[-1], other.times[-1])
        times = np.linspace(begin, end, POINTS)
        ways = [
            np.stack([np.interp(times, each.times, along) for along in each.positions.T])
            for each in (one, other)
        ]
        apart = np.linalg.norm(ways[0] - ways[1], axis=0)
        color = RED if apart.min() < radius else INK
        axes.plot(times - begin, apart, color=color, lw=0.9, alpha=0.8)
    if radius:
        axes.axhline(radius, color=RED, ls='--', lw=1.2, label=f'{radius:g} m asked for')
    axes.margins(y=0.15)  # for the legend
    axes.set(ylabel='distance of two vehicles [m]', title='Separation')
    axes.set_ylim(bottom=0.0)
    axes.legend(loc='upper right')


def draw_member(axes: Axes, name: str, history: History) -> None:
    """Draw one flight from above."""
    if history.values['finish'] == 'arrival':
        x, y, *_ = history.values['rope.center']
        axes.plot(x, y, 'o', color=ORANGE, ms=9, alpha=0.6, label='goals', zorder=2)
    else:
        draw_swing(axes, history)
    path = flown_path(history)[:, :2]
    axes.plot(*path.T, color=INK, lw=1.2, zorder=4, label='flown paths, headings')
    draw_headings(axes, path[:-1:EVERY], history.headings[:-1:EVERY, :2], width=0.003)
    _draw_name(axes, name.strip('/'), path, history)
    if history.capture is not None:
        x, y, _ = map(float, history.capture.rope)
        star(axes, x, y, 'rope when caught')


def _draw_name(axes: Axes, name: str, path: np.ndarray, history: History) -> None:
    """Write a vehicle's name beyond the swing of its rope, as seen from where it started."""
    middle = np.array(history.values['rope.center'][:2])
    reach = np.linalg.norm(history.values['rope.amplitude'][:2]) + BESIDE
    x, y = (middle - path[0]) / np.linalg.norm(middle - path[0])
    place = middle + reach * np.array([x, y])
    side = 'center' if abs(x) < 0.3 else 'left' if x > 0 else 'right'
    axes.text(
        float(place[0]),
        float(place[1]),
        name,
        ha=side,
        va='center',
        zorder=9,
        fontsize=8.5,
        path_effects=halo(),
    )
    axes.update_datalim([place, place + np.sign(x) * np.array([BESIDE, 0.0])])  # texts have none


def draw_distance(axes: Axes, history: History) -> None:
    """Draw the distance to the rope over time, down to the capture."""
    moments, begun = history.moments, history.times[0]
    times = [moment.time - begun for moment in moments]
    distances = [moment.distance for moment in moments]
    color = INK if history.capture is not None else RED
    axes.plot(times, distances, color=color, lw=0.9, alpha=0.8)
    if history.capture is not None:
        axes.plot(times[-1], distances[-1], '*', color=GREEN, mec=INK, mew=0.6, ms=11, zorder=5)
