# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Two pictures of any flight: its path with headings, and its numbers over time."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.sim.parameters import sim_settings
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.history import History
from orbimpc_ros.tool.style import (
    BLUE,
    FAINT,
    GREEN,
    GREY,
    INK,
    ORANGE,
    RED,
    SKY,
    halo,
    headline,
    look,
    paper,
    whole_seconds,
)
from orbimpc_ros.tool.summary import length

PATH, DATA = 'trajectory.png', 'data.png'
COMPONENTS = (('x', RED, '-'), ('y', GREEN, '--'), ('z', BLUE, '-.'))  # RViz's colours
FLIGHTS = ((INK, '-'), (BLUE, '--'))  # of one or two flights side by side
FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
WIDE = 2.5  # as a ratio of sides
CLOSE = 2.5  # a path so many times larger than what is around its end gets a second view
MOST_ARROWS = 30
VIEW = (24.0, -62.0)  # elevation and azimuth [deg]
LEAST_GAP = 1e-16  # drawn for none, which has no place on a logarithmic axis


def of_runs(flown: Mapping[str, History], dark: bool = False) -> dict[str, Figure]:
    """Return the pictures of flights, by file name: their paths and, of a single one, its numbers.

    Args:
        flown: the flights, by name.
        dark: for dark pages, not for print.
    """
    with look(dark):
        found = {PATH: paths(flown)}
        return found if len(flown) > 1 else found | {DATA: data(*flown.values())}


# --- a flight in words


def story(flown: Mapping[str, History]) -> str:
    """Return how flights ended: a line for each, or for a fleet."""
    if len(flown) > len(FLIGHTS):
        times = [each.end - each.times[0] for each in flown.values() if each.captured]
        arrive = any(each.arrives for each in flown.values())
        done = 'vehicles arrived' if arrive else 'ropes caught'
        last = f', the last at t = {max(times):.1f} s' if len(times) == len(flown) else ''
        return f'{len(times)} of {len(flown)} {done}{last}'
    return '\n'.join(
        f'{name}: {_end(each)}' if name else _end(each) for name, each in flown.items()
    )


def _end(history: History) -> str:
    after = f't = {history.end - history.times[0]:.1f} s'
    if history.arrives:
        missed, speed = history.missed
        at = f' at {length(speed)}/s' if history.values['translation_order'] == 2 else ''
        verb = 'Arrives' if history.captured else 'Does not arrive'
        return f'{verb}: {length(missed)} from the goal{at}, {after}'
    near = len(history.near_misses)
    misses = f'{near} near miss{"" if near == 1 else "es"}'
    if history.capture is None:
        return f'Goal not caught by {after}: {misses}'
    verb = 'intercepted' if history.values['objective'] == 'intercept' else 'caught'
    return f'Goal {verb} at {after} {f"after {misses}" if near else "on the first pass"}'


# --- paths


def paths(flown: Mapping[str, History]) -> Figure:
    """Return the paths of flights with the ways their distances and speeds went.

    Args:
        flown: the flights, by name: one, two to compare, or those of a fleet.
    """
    first = next(iter(flown.values()))
    draw = _in_space if first.values['dimension'] == 3 else _in_plane
    figure = Figure(figsize=(10.0, 8.0), layout='constrained')
    charts, legend = draw(figure, flown)
    if len(flown) > 2 and first.values['avoid_radius']:
        draw_separations(charts[0], flown)
    else:
        draw_distances(charts[0], flown)
    draw_shares(charts[1], flown)
    for axes in charts:
        axes.set_xlabel('time [s]')
    handles = dict(zip(*legend.get_legend_handles_labels()[::-1], strict=True))
    figure.legend(handles.values(), handles.keys(), loc='outside lower center', ncols=6)
    headline(figure, story(flown))
    return figure


def _in_plane(figure: Figure, flown: Mapping[str, History]) -> tuple[list[Axes], Axes]:
    """Draw paths from above; return the places of two charts, and the axes with the legend."""
    seen = np.concatenate([_seen(each)[:, :2] for each in flown.values()])
    width, height = np.ptp(seen, axis=0)
    first = next(iter(flown.values()))
    middle, half = window(first)
    large = max(width, height) > CLOSE * 2.0 * half
    close = large and len(flown) <= 2 and not first.arrives
    rows = [['path', 'distance'], ['path', 'share']]
    if width > WIDE * height:
        left = 'close' if close else 'distance'
        rows = [['path', 'path'], [left, 'distance'], [left, 'share']]
        rows = rows if close else [['path', 'path'], ['distance', 'share']]
    elif close:
        rows = [['path', 'close'], ['distance', 'share']]
    found = figure.subplot_mosaic(rows)  # type: ignore[arg-type]
    draw_view(found['path'], flown, (0, 1), 'Seen from above')
    if close:
        draw_view(found['close'], flown, (0, 1), 'Around the end', (middle, half))
        frame: Any = {'fill': False, 'ec': INK, 'lw': 0.8, 'ls': ':'}
        found['path'].add_patch(Rectangle(tuple(middle[:2] - half), 2 * half, 2 * half, **frame))
    return [found['distance'], found['share']], found['close' if close else 'path']


def _in_space(figure: Figure, flown: Mapping[str, History]) -> tuple[list[Axes], Axes]:
    """Draw paths in space, from above and from the side; return as in the plane."""
    first = next(iter(flown.values()))
    middle, half = window(first)
    seen = np.concatenate([_seen(each) for each in flown.values()])
    close = not first.arrives and float(np.ptp(seen, axis=0).max()) > CLOSE * 2.0 * half
    figure.set_size_inches(10.0, 9.5)
    grid = figure.add_gridspec(3, 2, width_ratios=(1.25, 1.0), height_ratios=(1.0, 1.0, 0.9))
    axes = draw_space(figure, grid[:2, 0], flown, seen)
    for row, (across, title) in enumerate((((0, 1), 'above'), ((0, 2), 'the side'))):
        where = ', around the end' if close else ''
        view = figure.add_subplot(grid[row, 1])
        around = (middle, half) if close else None
        draw_view(view, flown, across, f'From {title}{where}', around)
    charts = [figure.add_subplot(grid[2, column]) for column in range(2)]
    return charts, axes


def window(history: History) -> tuple[Array, float]:
    """Return the middle, shape (3,), and half the side of what is around a flight's end [m].

    It reaches over a step of flight, near misses and some radii of a catch.
    """
    middle = history.ropes[-1] if history.capture is None else history.capture.rope
    misses = [float(np.linalg.norm(miss.vehicle - middle)) for miss in history.near_misses]
    step = float(np.linalg.norm(np.diff(history.positions[-3:], axis=0), axis=1).max(initial=0.0))
    return middle, 1.2 * max(*misses, 3.0 * history.radius, 1.5 * step, 0.01)


def flown_path(history: History) -> Array:
    """Return the positions up to the capture, shape (M, 3) [m]."""
    points = history.positions.copy()
    if history.capture is not None:
        points[-1] = history.capture.vehicle
    return points


def swing(history: History) -> Array:
    """Return points along the goal's way, shape (K, 3) [m].

    Where it was sighted elsewhere than the parameters say, these are the sightings: a bag may have
    been recorded by others, without parameters.
    """
    rope = sim_settings(settings.of_sim(history.values)).scenario.rope
    elapsed = history.times - history.times[0]
    spare = (0, 3 - len(rope.center))
    known, fine = (
        np.array([np.pad(rope.at(t), spare) for t in at])
        for at in (elapsed, np.linspace(0.0, elapsed[-1], 500))
    )
    return fine if np.allclose(known, history.ropes, atol=0.05) else history.ropes


def boxes(history: History) -> list[Array]:
    """Return the lower and the upper corner of every obstacle, shape (2, n) each [m]."""
    values = settings.of_sim(history.values)
    return list(np.reshape(values['obstacles'], (-1, 2, values['dimension'])))


def _seen(history: History) -> Array:
    corners = [np.pad(box, ((0, 0), (0, 3 - box.shape[1]))) for box in boxes(history)]
    return np.concatenate([history.positions, swing(history), *corners])


def draw_view(
    axes: Axes,
    flown: Mapping[str, History],
    across: tuple[int, int],
    title: str,
    around: tuple[Array, float] | None = None,
) -> None:
    """Draw paths against two axes of the world.

    Args:
        axes: to draw on.
        flown: the flights, by name.
        across: numbers of the axes, 0 for x.
        title: of the view.
        around: middle, shape (3,), and half the side [m] of what to show; all by default.
    """
    pick = list(across)
    first = next(iter(flown.values()))
    draw_boxes(axes, first, pick)
    for number, (name, history) in enumerate(flown.items()):
        _draw_flight(axes, history, pick, FLIGHTS[number % 2 if len(flown) == 2 else 0], name)
        if len(flown) > 2:
            _draw_name(axes, name.strip('/'), history)
    if around is not None:
        middle, half = around[0][pick], around[1]
        axes.set(xlim=(middle[0] - half, middle[0] + half))
        axes.set(ylim=(middle[1] - half, middle[1] + half))
        _draw_misses(axes, first, pick)
    axes.set(xlabel=f'{"xyz"[across[0]]} [m]', ylabel=f'{"xyz"[across[1]]} [m]', title=title)
    axes.set_aspect('equal', adjustable='datalim' if around is None else 'box')


def _draw_flight(
    axes: Axes, history: History, pick: list[int], kind: tuple[str, str], name: str
) -> None:
    color, line = kind
    path, step = flown_path(history), max(1, len(history.times) // MOST_ARROWS)
    for planned in history.plans[:: step if history.plans else 1]:
        axes.plot(*planned.points[:, pick].T, color=SKY, lw=0.7, alpha=0.7, label='plans')
    goal = swing(history)[:, pick]
    if np.ptp(goal, axis=0).any():
        axes.plot(*goal.T, color=ORANGE, lw=4, alpha=0.5, zorder=1, label="goal's way")
    label = f'flown path, {name}' if name and not name.startswith('/') else 'flown path, headings'
    axes.plot(*path[:, pick].T, line, color=color, lw=1.3, zorder=4, label=label)
    arrows: Any = {'angles': 'xy', 'units': 'inches', 'scale': 6.0, 'width': 0.018, 'zorder': 5}
    headings = history.headings[:-1:step][:, pick]
    axes.quiver(*path[:-1:step][:, pick].T, *headings.T, color=color, **arrows)
    axes.plot(*path[0, pick], 'o', mfc=paper(), mec=INK, ms=6, mew=1.3, zorder=6, label='start')
    if slope := history.values['glide_slope']:
        _draw_slope(axes, history, pick, slope)
    if history.capture is not None or history.arrives:
        label = 'goal' if history.capture is None else 'goal when caught'
        _star(axes, window(history)[0][pick], label)


def _draw_slope(axes: Axes, history: History, pick: list[int], slope: float) -> None:
    """Draw the glide slope, above which the path must be, where the view is from the side."""
    if pick[1] != 2:
        return
    tip, reach = history.ropes[-1], float(np.ptp(history.positions[:, pick[0]]))
    x, z = tip[pick[0]], tip[2]
    edge = np.array([[x - reach, z + reach * math.tan(slope)], [x, z]])
    mirrored = edge[:1] * [-1.0, 1.0] + [2.0 * x, 0.0]
    axes.plot(*np.vstack([edge, mirrored]).T, color=GREEN, lw=1.3, ls='--', label='glide slope')


def _draw_misses(axes: Axes, history: History, pick: list[int]) -> None:
    """Mark near misses with their numbers, and the circle within which the goal is caught."""
    for number, miss in enumerate(history.near_misses, start=1):
        ends = np.array([miss.vehicle, miss.rope])[:, pick]
        axes.plot(*ends.T, color=RED, lw=1.2, zorder=7)
        _cross(axes, number, ends[1])
    at = window(history)[0]
    reach: Any = {'fill': False, 'ec': GREEN, 'ls': '--', 'lw': 1.2, 'zorder': 7}
    circle = Circle(tuple(at[pick]), history.radius, label=f'within {history.radius:g} m', **reach)
    axes.add_patch(circle)


def _cross(axes: Axes, number: int, at: Array) -> None:
    axes.plot(*at, 'x', color=RED, ms=6, mew=1.6, zorder=8, ls='', label='near miss')
    beside: Any = {'xytext': (0, -12), 'textcoords': 'offset points', 'ha': 'center'}
    how: Any = {'color': RED, 'fontweight': 'bold', 'path_effects': halo(), 'zorder': 9}
    axes.annotate(str(number), tuple(at), **beside, **how)


def _star(axes: Any, at: Sequence[float] | Array, label: str) -> None:
    axes.plot(*at, '*', color=GREEN, mec=INK, mew=0.6, ms=14, zorder=10, ls='', label=label)


def draw_boxes(axes: Axes, history: History, pick: list[int]) -> None:
    """Draw obstacles against two axes; in space each with its extent along the third one."""
    kind: Any = {'fc': FAINT, 'ec': GREY, 'hatch': '///', 'alpha': 0.6, 'zorder': 1}
    for low, high in boxes(history):
        corner, size = low[pick], (high - low)[pick]
        axes.add_patch(Rectangle(tuple(corner), *size, label='obstacle', **kind))
        if len(low) == 3:
            (third,) = {0, 1, 2} - set(pick)
            text = f'{"xyz"[third]} {low[third]:g} to {high[third]:g}'
            middle = corner + 0.5 * size
            how: Any = {'ha': 'center', 'va': 'center', 'fontsize': 7.0, 'path_effects': halo()}
            axes.text(middle[0], middle[1], text, clip_on=True, zorder=2, **how)


def _draw_name(axes: Axes, name: str, history: History) -> None:
    """Write a vehicle's name beyond its goal, as seen from where it started."""
    way = swing(history)[:, :2]
    middle, begin = 0.5 * (way.min(axis=0) + way.max(axis=0)), history.positions[0, :2]
    ahead = (middle - begin) / max(1e-9, float(np.linalg.norm(middle - begin)))
    place = middle + (float(np.ptp(way, axis=0).max()) + 0.6) * ahead
    side = 'center' if abs(ahead[0]) < 0.3 else 'left' if ahead[0] > 0 else 'right'
    how: Any = {'ha': side, 'va': 'center', 'fontsize': 8.5, 'path_effects': halo()}
    axes.text(place[0], place[1], name, zorder=9, **how)
    axes.update_datalim([place, place + 2.0 * ahead])  # texts have none


def add_axes(figure: Figure, place: Any, points: Array) -> Any:
    """Return 3-D axes to scale around points, shape (K, 3) [m]."""
    axes: Any = figure.add_subplot(place, projection='3d')
    low, high = points.min(axis=0), points.max(axis=0)
    margin = max(0.01, 0.06 * float((high - low).max()))  # also of what stands still
    low, high = low - margin, high + margin
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=0.9)
    axes.set(xlabel='x [m]', ylabel='y [m]', zlabel='z [m]')
    axes.view_init(elev=VIEW[0], azim=VIEW[1])
    for each in (axes.xaxis, axes.yaxis, axes.zaxis):
        each.pane.set_facecolor(paper())
        each.pane.set_edgecolor(FAINT)
        each.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    return axes


def draw_space(figure: Figure, place: Any, flown: Mapping[str, History], seen: Array) -> Any:
    """Draw paths in space with the body's axes and their shadows on the ground."""
    axes = add_axes(figure, place, seen)
    ground, reach = axes.get_zlim()[0], 0.06 * float(np.ptp(seen, axis=0).max())
    draw_solids(axes, boxes(next(iter(flown.values()))))
    for history in flown.values():
        path, step = flown_path(history), max(1, len(history.times) // MOST_ARROWS)
        for planned in history.plans[::step]:
            axes.plot(*planned.points.T, color=SKY, lw=0.7, alpha=0.7, label='plans')
        if np.ptp(swing(history), axis=0).any():
            axes.plot(*swing(history).T, color=ORANGE, lw=3.5, alpha=0.6, label="goal's way")
        axes.plot(*path[:, :2].T, ground, color=FAINT, lw=1.0, label='shadow')
        axes.plot(*path.T, color=INK, lw=1.3, label='flown path')
        for column, (name, color, _) in enumerate(COMPONENTS):
            tips = path[::step] + reach * history.attitudes[::step, :, column]
            for ends in zip(path[::step], tips, strict=True):
                axes.plot(*np.array(ends).T, color=color, lw=1.2, label=f'body {name}')
        axes.plot(*path[0], 'o', mfc=paper(), mec=INK, ms=6, mew=1.3, ls='', label='start')
        if history.capture is not None or history.arrives:
            _star(
                axes, history.ropes[-1] if history.capture is None else history.capture.rope, 'goal'
            )
    axes.set_title('In space, body axes')
    return axes


def draw_solids(axes: Any, corners: list[Array]) -> None:
    """Draw boxes in space by their lower and upper corners, shape (2, 3) each [m]."""
    for box in corners:
        points = np.array(list(itertools.product(*box.T)))  # eight, in binary order
        faces = [points[list(face)] for face in FACES]
        solid = Poly3DCollection(faces, facecolor=FAINT, edgecolor=GREY, alpha=0.35, lw=0.8)
        axes.add_collection3d(solid)


# --- charts over time


def legend_above(axes: Axes) -> None:
    """Put a chart's legend above it, beside the title, where it hides no curve."""
    handles = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    if handles:
        place: Any = {'loc': 'lower right', 'bbox_to_anchor': (1.0, 1.0), 'borderaxespad': 0.1}
        axes.legend(handles.values(), handles.keys(), ncols=4, handlelength=1.6, **place)


def draw_limit(axes: Axes, value: float, text: str, color: str = RED, side: str = 'top') -> None:
    """Draw a horizontal limit with its meaning written on it."""
    axes.axhline(value, color=color, lw=1.2, ls='--')
    place: Any = {'xycoords': axes.get_yaxis_transform(), 'textcoords': 'offset points'}
    how: Any = {'ha': 'left', 'va': side, 'fontsize': 8.0, 'path_effects': halo(), 'color': color}
    shift = (0, 2 if side == 'bottom' else -2)
    axes.annotate(text, (0.01, value), xytext=shift, **place, **how)


def draw_distances(axes: Axes, flown: Mapping[str, History]) -> None:
    """Draw distances to the goal, at odometry and at the closest approach of every step."""
    first = next(iter(flown.values()))
    for number, (name, history) in enumerate(flown.items()):
        begun, (color, line) = history.times[0], FLIGHTS[number if len(flown) == 2 else 0]
        times, distances = np.array([(m.time - begun, m.distance) for m in history.moments]).T
        shown = np.maximum(distances, 0.2 * history.radius)  # arrivals have no place on the axis
        label = name if len(flown) == 2 else '_'
        axes.plot(times, shown, line, color=color, lw=1.2, label=label)
        if history.captured:
            _star(axes, (history.end - begun, shown[-1]), 'arrived' if first.arrives else 'caught')
    if len(flown) == 1:
        for number, miss in enumerate(first.near_misses, start=1):
            _cross(axes, number, np.array([miss.time - first.times[0], miss.distance]))
    draw_limit(axes, first.radius, f'{first.radius:g} m', GREEN)
    axes.set(title='Distance to the goal', ylabel='distance [m]', yscale='log')
    _plain_log(axes)
    legend_above(axes)


def _plain_log(axes: Axes) -> None:
    """Write the numbers of a logarithmic axis without powers."""
    low, high = axes.get_ylim()
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 1e3 * low else (1.0,)))
    axes.yaxis.set_major_formatter('{x:g}')
    axes.yaxis.set_minor_formatter(NullFormatter())


def draw_separations(axes: Axes, flown: Mapping[str, History]) -> None:
    """Draw the distance of each pair of vehicles, red where it is less than asked for."""
    radius = next(iter(flown.values())).values['avoid_radius']
    for one, other in itertools.combinations(flown.values(), 2):
        begin, end = max(one.times[0], other.times[0]), min(one.times[-1], other.times[-1])
        times = np.linspace(begin, end, 600)
        ways = [
            np.stack([np.interp(times, each.times, along) for along in each.positions.T])
            for each in (one, other)
        ]
        apart = np.linalg.norm(ways[0] - ways[1], axis=0)
        color = RED if apart.min() < radius else INK
        axes.plot(times - begin, apart, color=color, lw=0.9, alpha=0.8)
    draw_limit(axes, radius, f'{radius:g} m required')
    axes.set(title='Separation of each pair', ylabel='distance [m]')
    axes.set_ylim(bottom=0.0)


def draw_shares(axes: Axes, flown: Mapping[str, History]) -> None:
    """Draw the commanded shares of full speed or thrust, |R e1|, and the floor below them."""
    first = next(iter(flown.values()))
    for number, (name, history) in enumerate(flown.items()):
        color, line = FLIGHTS[number if len(flown) == 2 else 0]
        planned = [
            (time - history.times[0], fields['speed_fraction'][1])
            for time, fields in history.ticks
            if len(fields.get('speed_fraction') or ()) > 1 and time <= history.end
        ]
        if planned:
            planned.append((history.end - history.times[0], planned[-1][1]))  # holds to the end
            label, lines = (name if len(flown) == 2 else '_'), np.array(planned).T
            axes.step(*lines, line, where='post', color=color, lw=1.3, label=label)
    floored = [each.values for each in flown.values() if each.values['floor.shape'] != 'none']
    if floored:
        floor = floored[0]['floor.fraction']
        axes.axhspan(0.0, floor, color=RED, alpha=0.10, lw=0)
        draw_limit(
            axes, floor, f'floor {floor:.3g}, det R {floor ** first.values["dimension"]:.2g}'
        )
    what = 'thrust' if first.values['translation_order'] == 2 else 'speed'
    axes.set(title=f'Share of full {what}, |R e₁|', ylabel='share', ylim=(0.0, 1.08))
    legend_above(axes)


# --- numbers over time


def data(history: History) -> Figure:
    """Return motion, thrust or speed, and what planning took and proved, over time."""
    draws = [draw_positions, draw_velocities, draw_rates, draw_pushed]
    draws += [draw_tilt] if history.values['gravity'] else []
    draws += [draw_objective, draw_gap, draw_solve_time]
    draws += [draw_catches] if len(series(history, 'catch_bound')[0]) else []
    draws += [draw_nodes] if len(draws) % 2 else []
    figure = Figure(figsize=(10.0, 1.35 * len(draws)), layout='constrained')
    panels = figure.subplots(len(draws) // 2, 2, sharex=True)
    for axes, draw in zip(panels.flat, draws, strict=True):
        draw(axes, history)
        legend_above(axes)
    for axes in panels[-1]:
        axes.set_xlabel('time [s]')
        axes.xaxis.set_major_locator(whole_seconds())
    headline(figure, story({'': history}))
    return figure


def draw_positions(axes: Axes, history: History) -> None:
    """Draw the position in the world."""
    _draw_components(axes, history, history.positions)
    axes.set(title='Position', ylabel='position [m]')


def draw_velocities(axes: Axes, history: History) -> None:
    """Draw the velocity in the world."""
    _draw_components(axes, history, history.velocities)
    axes.set(title='Velocity', ylabel='velocity [m/s]')


def draw_rates(axes: Axes, history: History) -> None:
    """Draw the rates about the body's axes; in the plane, turning is about z."""
    shown = history.rates
    if history.values['dimension'] == 2:
        axes.step(history.times - history.times[0], shown[:, 2], color=BLUE, where='post')
    else:
        _draw_components(axes, history, shown)
    axes.set(title='Body rates', ylabel='rate [rad/s]')


def _draw_components(axes: Axes, history: History, vectors: Array) -> None:
    times = history.times - history.times[0]
    for column, (name, color, line) in enumerate(COMPONENTS[: history.values['dimension']]):
        axes.plot(times, vectors[:, column], line, color=color, lw=1.4, label=name)


def draw_pushed(axes: Axes, history: History) -> None:
    """Draw the thrust, or at translation order 1 the speed, with its largest and least."""
    times, shares = applied(history)
    thrust = history.values['translation_order'] == 2
    what, unit = ('thrust', 'N') if thrust else ('speed', 'm/s')
    full = history.values['forward'] * (history.values['mass'] if thrust else 1.0)
    axes.step(times, full * shares, where='post', color=INK, lw=1.4)
    draw_limit(axes, full, f'full {what}', side='bottom')
    if history.values['floor.shape'] != 'none':
        draw_limit(axes, full * history.values['floor.fraction'], 'floor')
    axes.set(title=what.capitalize(), ylabel=f'{what} [{unit}]')
    axes.set_ylim(-0.04 * full, 1.2 * full)


def applied(history: History) -> tuple[Array, Array]:
    """Return times [s] and the share of thrust or speed from then on, for each step flown."""
    values, begun, last = history.values, history.times[0], history.times[-1]
    if values['translation_order'] == 1:
        shares = np.linalg.norm(history.velocities, axis=1) / values['forward']
        return history.times - begun, shares
    full, step = values['mass'] * values['forward'], values['step']
    found = {begun: values['start.speed_fraction']}
    # A thrust is taken over at the end of the step in which it is commanded.
    found |= {time + step: force / full for time, force in history.forces if time + step <= last}
    return np.array(list(found)) - begun, np.array(list(found.values()))


def draw_tilt(axes: Axes, history: History) -> None:
    """Draw the angle of the axis that pushes from the vertical, and its limit."""
    angles = np.degrees(np.arccos(np.clip(history.headings[:, 2], -1.0, 1.0)))
    axes.plot(history.times - history.times[0], angles, color=INK, lw=1.4)
    if history.values['tilt']:
        draw_limit(axes, math.degrees(history.values['tilt']), 'largest')
    axes.set(title='Tilt from the vertical', ylabel='angle [deg]')


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
    """Draw the cost of every plan, and the proved bound below it."""
    axes.plot(*series(history, 'objective'), color=INK, lw=1.2, label='plan')
    axes.plot(*series(history, 'lower_bound'), '--', color=ORANGE, lw=2.0, label='proved bound')
    axes.set(title='Objective', ylabel='objective')


def draw_gap(axes: Axes, history: History) -> None:
    """Draw the relative gap, and the one up to which a plan is called optimal."""
    times, gaps = series(history, 'gap')
    axes.plot(times, np.maximum(gaps, LEAST_GAP), '.-', color=BLUE, lw=0.8, ms=4)
    tolerance = history.values['gap_tolerance']
    draw_limit(axes, tolerance, f'optimal below {tolerance:g}')
    axes.set(title='Gap of plan and bound', ylabel='relative gap', yscale='log')
    axes.yaxis.set_major_locator(LogLocator(numticks=6))


def draw_solve_time(axes: Axes, history: History) -> None:
    """Draw the time of each tick; those that fell back are crossed."""
    times, values = series(history, 'solve_time_ms')
    axes.plot(times, np.maximum(values, 1e-3), '.-', color=BLUE, lw=0.8, ms=4)
    fallen = [time - history.times[0] for time, fields in history.ticks if fields.get('fallback')]
    bad = np.isin(times, fallen)
    if bad.any():
        axes.plot(
            times[bad], np.maximum(values[bad], 1e-3), 'x', color=RED, ls='', label='fell back'
        )
    axes.set(title='Time of the whole tick', ylabel='time [ms]', yscale='log')
    _plain_log(axes)


def draw_nodes(axes: Axes, history: History) -> None:
    """Draw how many relaxations each tick solved."""
    axes.plot(*series(history, 'nodes'), '.-', color=BLUE, lw=0.8, ms=4)
    axes.set(title='Relaxations solved', ylabel='nodes')


def draw_catches(axes: Axes, history: History) -> None:
    """Draw how soon each plan catches the goal, and before when none is proved to."""
    axes.plot(*series(history, 'earliest_catch'), 'o', color=GREEN, ms=4, label='catch of the plan')
    axes.step(*series(history, 'catch_bound'), '--', where='post', color=RED, label='none before')
    axes.set(title='Time to the catch', ylabel='time to go [s]')
    axes.set_ylim(bottom=0.0)
