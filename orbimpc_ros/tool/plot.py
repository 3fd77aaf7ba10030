# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc plot``: the path of a flight with headings, time series, and an animation.

Figures refer to colours by their place in the cycle, ``C0`` and so on. Style sheets in config/plots
define these colours, for print and for dark pages. The animation shows vehicle, plan and goal in
motion, next to charts of distance and speed.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import LogFormatter
from PIL import Image

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.files import folder_at
from orbimpc_ros.tool.history import History, of_bag, separations, story

INK, BLUE, SKY, ORANGE, GREEN, RED, GREY, FAINT = (f'C{place}' for place in range(8))
PATH, DATA = 'trajectory.png', 'data.png'
LOOKS = ((INK, '-'), (BLUE, '--'), (GREEN, '-.'), (ORANGE, ':'))  # styles of the lines in one chart
AXES = (('x', RED), ('y', GREEN), ('z', BLUE))  # of the body, in RViz's colours
MOST_HEADINGS, MOST_PLANS = 20, 6
ZOOM, MOST_TICKS = 0.9, 6  # of views of space
NOSE = 0.035  # length of a heading, as a share of the flight's extent
LEAST = 1e-16  # drawn instead of zero on a logarithmic axis
Flights = Mapping[str, History]  # by name
Line = tuple[Array, Array]  # times [s] and values
ANIMATION = 'animation.gif'
COARSE = 90  # dots per inch of an animation
FRAMES = 150  # at most: each takes 4 MB until all are written
PER_STEP = 5  # frames per tick, at most
FRAME, LAST = 80, 2500  # [ms] that a frame is shown, and the last one
PALETTE = 128
MOVING: dict[str, dict[str, Any]] = {
    'plan': {'color': GREEN, 'lw': 1.6, 'marker': 'o', 'ms': 3.5, 'ls': '--'},
    'flown': {'color': GREY, 'lw': 1.4},
    'vehicle': {'color': BLUE, 'lw': 3.5, 'marker': 'o', 'ms': 7.0, 'markevery': [0]},
    'goal': {'color': ORANGE, 'marker': 'o', 'ms': 9.0, 'mec': INK, 'ls': ''},
}  # styles of the animated lines


def run(
    bag: str, out: str, namespace: str, params: str | None, *, dark: bool, animated: bool
) -> int:
    """Draw a flight."""
    flight = of_bag(Path(bag), namespace, params)
    if len(flight.times) < 2:
        raise BadInput.stating(bag, 'a single odometry message', 'two or more are needed')
    folder = folder_at(Path(out))
    with look(dark):
        names = written({'': flight}, folder)
        if animated:
            write_gif(flight, folder / ANIMATION)
            names.append(ANIMATION)
    print(f'written: {", ".join(names)} in {folder}')
    return 0


# --- looks


def look(dark: bool = False) -> AbstractContextManager:
    """Return a context in which figures are drawn and written for print, or for dark pages."""
    names = ('print', 'dark') if dark else ('print',)
    return style.context([settings.config(f'plots/{name}.mplstyle') for name in names])


def in_both_looks(file: Path) -> Iterator[Path]:
    """Yield a picture's file, in the look for print, and ``name-dark.png``, in the dark look."""
    for dark in (False, True):
        with look(dark):
            yield file.with_stem(f'{file.stem}-dark') if dark else file


def paper() -> str:
    """Return the background colour of the current look."""
    return mpl.rcParams['axes.facecolor']


def halo() -> list[withStroke]:
    """Return a path effect that sets text off from its background."""
    return [withStroke(linewidth=2.5, foreground=paper())]


def written(flown: Flights, folder: Path) -> list[str]:
    """Draw the pictures of flights into a folder, and return their file names.

    They are paths and, for a single flight, time series. Call this and all functions below within a
    :func:`look`.
    """
    pictures = {PATH: paths(flown)}
    if len(flown) == 1:
        pictures[DATA] = data(*flown.values())
    for name, figure in pictures.items():
        FigureCanvasAgg(figure).print_png(folder / name)  # savefig would draw it twice
    return [*pictures]


# --- the path


def paths(flown: Flights) -> Figure:
    """Return a figure of the paths of flights, with distances and commanded shares over time."""
    figure, axes = stage(flown)
    for (name, history), kind in zip(flown.items(), itertools.cycle(LOOKS)):
        _draw_flight(axes, history, kind, _plain(name))
        if len(flown) > 2:
            start = history.positions[0, : history.values['dimension']]
            axes.text(*start, f'  {name.strip("/")}', fontsize=8.5, path_effects=halo(), zorder=9)
    handles = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    figure.legend(handles.values(), handles.keys(), loc='outside lower center', ncols=7)
    return figure


def stage(flown: Flights) -> tuple[Figure, Any]:
    """Return a figure with two charts and a view of obstacles and goals, and this view's axes."""
    figure = Figure(figsize=(10.0, 8.0), layout='constrained')
    first = next(iter(flown.values()))
    n = first.values['dimension']
    grid = figure.add_gridspec(2, 2, height_ratios=(2.2, 1.0))
    axes: Any = figure.add_subplot(grid[0, :], projection='3d' if n == 3 else None)
    axes.set(**{f'{axis}label': f'{axis} [m]' for axis in 'xyz'[:n]})
    _draw_boxes(axes, first)
    for history in flown.values():
        axes.plot(*history.positions.T[:n], alpha=0.0)  # for the limits of the axes
        if np.ptp(history.ropes, axis=0).any():
            axes.plot(*history.ropes.T[:n], color=ORANGE, lw=4, alpha=0.5, label="goal's way")
    axes.set_aspect('equal', adjustable='box' if n == 3 else 'datalim')
    axes.autoscale(n == 2)  # in 3D it would undo the aspect
    if n == 3:
        sides = axes.get_box_aspect()
        axes.set_box_aspect(sides, zoom=ZOOM)  # the layout does not count labels
        for axis, size in zip('xyz', sides, strict=True):  # short sides have room for few numbers
            axes.locator_params(axis, nbins=max(1, round(MOST_TICKS * size / max(sides))))
    several = len(flown) > 2 and first.values['avoid_radius']
    apart = separation(flown) if several else distance(flown)
    draw_panel(figure.add_subplot(grid[1, 0]), apart)
    draw_panel(figure.add_subplot(grid[1, 1]), shares(flown))
    figure.suptitle(story(flown), x=0.01, ha='left')
    return figure, axes


def _draw_boxes(axes: Any, history: History) -> None:
    for low, high in history.boxes:
        if len(low) == 3:
            axes.bar3d(*low, *(high - low), color=FAINT, alpha=0.35)
        else:
            how: Any = {'fc': FAINT, 'ec': GREY, 'hatch': '///', 'alpha': 0.6, 'label': 'obstacle'}
            axes.add_patch(Rectangle(tuple(low), *(high - low), **how))


def _draw_flight(axes: Any, history: History, kind: tuple[str, str], name: str) -> None:
    n, (color, line), path = history.values['dimension'], kind, history.positions
    for _, points in history.plans[:: max(1, math.ceil(len(history.plans) / MOST_PLANS))]:
        axes.plot(*points.T[:n], color=SKY, lw=0.9, label='some plans')
    label = f'flown path, {name}' if name else 'flown path'
    axes.plot(*path.T[:n], line, color=color, lw=1.3, zorder=4, label=label)
    step, reach = math.ceil(len(path) / MOST_HEADINGS), NOSE * float(np.ptp(path, axis=0).max())
    for column, (axis, shade) in enumerate(AXES if n == 3 else [('x', color)]):
        begun = path[::step]
        tips = begun + reach * history.attitudes[::step, :, column]
        ends = np.stack([begun, tips, np.full_like(tips, np.nan)], axis=1).reshape(-1, 3)
        axes.plot(*ends.T[:n], color=shade, lw=2.0, zorder=5, label=f'body {axis}')
    point: Any = {'ls': '', 'zorder': 8}
    axes.plot(*path[:1].T[:n], 'o', mfc=paper(), mec=INK, ms=6, label='start', **point)
    for number, missed in enumerate(history.at(history.near_misses)[-1][:, :n], start=1):
        axes.plot(*missed[:, None], 'x', color=RED, ms=6, label='near miss', **point)
        axes.text(*missed, f'  {number}', color=RED, path_effects=halo(), zorder=9)
    label = 'goal when caught' if history.caught else 'goal'
    axes.plot(*history.ropes[-1, :n, None], '*', color=GREEN, mec=INK, ms=14, label=label, **point)


# --- charts over time


class Panel(NamedTuple):
    """A chart over time."""

    title: str
    unit: str  # of the values; empty for none
    lines: Mapping[str, Line]  # by label; labels that begin with ``_`` have no legend
    limits: Mapping[str, float] = {}  # values of horizontal lines, by label
    steps: bool = False  # whether a value holds until the next
    log: bool = False  # whether the axis is logarithmic


class _Plain(LogFormatter):
    """Labels of a logarithmic axis, as people write numbers."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return f'{x:g}' if super().__call__(x, pos) else ''


def draw_panel(axes: Axes, panel: Panel) -> None:
    """Draw a chart."""
    kind: Any = {'drawstyle': 'steps-post', 'marker': '.', 'ms': 4} if panel.steps else {}
    for (label, (times, values)), (color, line) in zip(panel.lines.items(), itertools.cycle(LOOKS)):
        shown = np.maximum(values, LEAST) if panel.log else values
        axes.plot(times, shown, line, color=color, lw=1.2, label=label, **kind)
    for meaning, value in panel.limits.items():
        axes.axhline(value, color=RED, lw=1.2, ls='--')
        place: Any = {'xycoords': axes.get_yaxis_transform(), 'textcoords': 'offset points'}
        how: Any = {'va': 'bottom', 'fontsize': 8.0, 'path_effects': halo(), 'color': RED}
        axes.annotate(meaning, (0.01, value), xytext=(0, 2), **place, **how)
    unit = f' [{panel.unit}]' if panel.unit else ''
    axes.set(title=f'{panel.title}{unit}', xlabel='time [s]')
    if panel.log:
        axes.set_yscale('log')
        axes.yaxis.set_major_formatter(_Plain())
        axes.yaxis.set_minor_formatter(_Plain())
    if len(axes.get_legend_handles_labels()[0]) > 1:
        axes.legend(loc='best', ncols=2)


def distance(flown: Flights) -> Panel:
    """Return the chart of distances to the goal, at odometry and at closest approaches."""
    lines = {}
    for name, each in flown.items():
        times, distances, _, _ = each.at(each.steps)
        lines[_label(name, flown)] = times - each.times[0], np.maximum(distances, 0.1 * each.radius)
    radius = next(iter(flown.values())).radius
    return Panel('Distance to the goal', 'm', lines, {f'within {radius:g} m': radius}, log=True)


def separation(flown: Flights) -> Panel:
    """Return the chart of the least distance between two vehicles since the previous odometry."""
    times, distances = separations(flown)
    least = np.min([*distances.values()], axis=0)
    radius = next(iter(flown.values())).values['avoid_radius']
    line = times[1:] - times[0], np.where(np.isfinite(least), least, np.nan)
    return Panel('Closest pair', 'm', {'_': line}, {f'{radius:g} m required': radius})


def shares(flown: Flights) -> Panel:
    """Return the chart of commanded shares of full speed or thrust, |R e1|, and of the floor."""
    lines, first = {}, next(iter(flown.values())).values
    for name, each in flown.items():
        points = [
            (time - each.times[0], fields['speed_fraction'][1])
            for time, fields in each.ticks
            if len(fields.get('speed_fraction') or ()) > 1 and time <= each.times[-1]
        ]
        lines[_label(name, flown)] = tuple(np.reshape(points, (-1, 2)).T)
    quantity = 'thrust' if first['translation_order'] == 2 else 'speed'
    floors = {k: v for each in flown.values() for k, v in _floor(each.values).items()}
    return Panel(f'Share of full {quantity}, |R e₁|', '', lines, floors, steps=True)


def _floor(values: settings.Values, full: float = 1.0) -> dict[str, float]:
    return {} if values['floor.shape'] == 'none' else {'floor': full * values['floor.fraction']}


def _label(name: str, flown: Flights) -> str:
    return _plain(name) if len(flown) == 2 else f'_{name}'


def _plain(name: str) -> str:
    """Return a flight's name for a legend; empty for a namespace, which marks the path's start."""
    return '' if name.startswith('/') else name.replace('_', ' ')


def data(history: History) -> Figure:
    """Return a figure of motion, solve times and proved bounds over time."""
    panels = [*motion(history), *planning(history)]
    rows = math.ceil(len(panels) / 2)
    figure = Figure(figsize=(10.0, 2.2 * rows), layout='constrained')
    places = list(figure.subplots(rows, 2, sharex=True).flat)
    for axes, panel in zip(places, panels, strict=False):
        draw_panel(axes, panel)
    for axes in places[len(panels) :]:
        axes.remove()
    figure.suptitle(story({'': history}), x=0.01, ha='left')
    return figure


def motion(history: History) -> list[Panel]:
    """Return the charts of a vehicle's motion."""
    values, times = history.values, history.times - history.times[0]
    n, full = values['dimension'], values['forward']

    def along(vectors: Array, first: int = 0, count: int = n) -> dict[str, Line]:
        return {'xyz'[k]: (times, vectors[:, k]) for k in range(first, count)}

    moved = along(history.velocities)
    moved['speed'] = times, np.linalg.norm(history.velocities, axis=1)
    limited = values['translation_order'] == 1
    limits = {'full speed': full} | _floor(values, full) if limited else {}
    panels = [
        Panel('Position', 'm', along(history.positions)),
        Panel('Velocity', 'm/s', moved, limits),
        Panel('Body rates', 'rad/s', along(history.rates, 0 if n == 3 else 2, 3)),
    ]
    if values['gravity']:
        angles = np.degrees(np.arccos(np.clip(history.attitudes[:, 2, 0], -1.0, 1.0)))
        limits = {'largest': math.degrees(values['tilt'])} if values['tilt'] else {}
        panels.append(Panel('Tilt from the vertical', 'deg', {'_': (times, angles)}, limits))
    return panels


def planning(history: History) -> list[Panel]:
    """Return the charts of plan costs, proved bounds, gaps, solve times and nodes."""
    line = history.series
    tolerance = history.values['gap_tolerance']
    below = {f'optimal below {tolerance:g}': tolerance}
    fallen = replace(history, ticks=tuple(t for t in history.ticks if t[1].get('fallback')))
    spent = {'planned': line('solve_time_ms'), 'fell back': fallen.series('solve_time_ms')}
    costs = {'plan': line('objective'), 'proved bound': line('lower_bound')}
    panels = [
        Panel('Objective', '', costs, steps=True),
        Panel('Gap of plan and bound', '', {'_': line('gap')}, below, steps=True, log=True),
        Panel('Time of each tick', 'ms', spent, steps=True, log=True),
        Panel('Relaxations solved', '', {'_': line('nodes')}, steps=True),
    ]
    catches = {'catch of the plan': line('earliest_catch'), 'none before': line('catch_bound')}
    if len(catches['none before'][0]):
        panels.append(Panel('Time to the catch', 's', catches, steps=True))
    return panels


# --- animation


def instants(history: History) -> Iterator[dict[str, Array]]:
    """Yield the points of each animated line, shape (K, 3) [m], interpolated between odometry."""
    path = history.positions
    reach = NOSE * float(np.ptp(path, axis=0).max())
    end = len(path) - 1
    steps = np.linspace(0.0, end, min(FRAMES, PER_STEP * end) + 1)
    for step, now, goal in zip(steps, *history.at(steps)[2:], strict=True):
        k = int(step)
        plans = [points for time, points in history.plans if time <= history.times[k]]
        yield {
            'plan': plans[-1] if plans else np.zeros((0, 3)),
            'flown': np.vstack([path[: k + 1], now]),
            'vehicle': np.array([now, now + reach * history.attitudes[k, :, 0]]),
            'goal': goal[None],
        }


def write_gif(history: History, file: Path) -> None:
    """Write a flight as an endlessly repeating animation; redraw only the animated lines."""
    figure, axes = stage({'': history})
    figure.set_dpi(COARSE)
    canvas, n, shown = FigureCanvasAgg(figure), history.values['dimension'], []
    lines = {
        name: axes.plot(*[[]] * n, label=name, animated=True, zorder=5, **kind)[0]
        for name, kind in MOVING.items()
    }
    axes.legend(handles=lines.values(), loc='upper left')
    canvas.draw()
    background: Any = canvas.copy_from_bbox(figure.bbox)
    for instant in instants(history):
        canvas.restore_region(background)
        for name, points in instant.items():
            (lines[name].set_data_3d if n == 3 else lines[name].set_data)(*points.T[:n])
            axes.draw_artist(lines[name])
        shown.append(Image.fromarray(np.array(canvas.buffer_rgba())[:, :, :3]))
    # One palette for all frames: colours must not flicker.
    palette = shown[len(shown) // 2].quantize(PALETTE, Image.Quantize.MAXCOVERAGE)
    images = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in shown]
    images[0].save(
        file,
        save_all=True,
        append_images=images[1:],
        duration=[FRAME] * (len(images) - 1) + [LAST],
        loop=0,
    )
