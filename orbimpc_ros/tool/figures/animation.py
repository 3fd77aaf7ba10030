# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A flight that moves: vehicle, plan and rope beside distance and speed, frame by frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.tool.figures import space
from orbimpc_ros.tool.figures.charts import draw_distance, draw_speed, story
from orbimpc_ros.tool.figures.scene import boxes, draw_obstacles, flown_path, mark_start, swing
from orbimpc_ros.tool.history import History, Planned
from orbimpc_ros.tool.style import BLUE, GREEN, GREY, INK, ORANGE, headline, look

SIZE, DOTS_PER_INCH = (9.0, 5.4), 100
WIDE = 2.0  # as a ratio of sides
FRAMES = 150  # at most, or one a tick
PER_STEP = 5  # frames, at most
VIEW = (24.0, -62.0)
NOSE = 0.05  # length of the vehicle, as a share of what is seen


class Instant(NamedTuple):
    """What is seen at a time.

    Attributes:
        time: since the start [s].
        way: flown so far, shape (K, 3) [m].
        nose: of the vehicle, shape (3,).
        rope: shape (3,) [m].
        plan: being followed, shape (N + 1, 3) [m]; (0, 3) if there is none.
    """

    time: float
    way: Array
    nose: Array
    rope: Array
    plan: Array


def animation(history: History, dark: bool = False) -> Iterator[Array]:
    """Yield the frames of a flight, shape (height, width, 3), as bytes of red, green and blue."""
    with look(dark):
        stage = Stage(history)
    for instant in instants(history):
        with look(dark):  # left before whoever takes the frame goes on
            frame = stage.show(instant)
        yield frame


def instants(history: History) -> Iterator[Instant]:
    """Yield what is seen from the start to the end; between odometry all moves straight."""
    path, ropes, times = flown_path(history), _ropes(history), history.times.copy()
    times[-1] = history.end
    steps = len(times) - 1
    per_step = int(np.clip(FRAMES // max(1, steps), 1, PER_STEP))
    for moment in np.linspace(0.0, steps, steps * per_step + 1):
        k = min(int(moment), steps - 1)
        share = moment - k
        now, rope = (a[k] + share * (a[k + 1] - a[k]) for a in (path, ropes))
        time = times[k] + share * (times[k + 1] - times[k])
        way = np.concatenate([path[: k + 1], [now]])
        plan = _followed(history.plans, times[k])
        yield Instant(time - times[0], way, history.headings[k], rope, plan)


def _ropes(history: History) -> Array:
    """Return where the rope is at the times of odometry, the last one where it was caught."""
    ropes = history.ropes.copy()
    if history.capture is not None:
        ropes[-1] = history.capture.rope
    return ropes


def _followed(plans: Sequence[Planned], time: float) -> Array:
    """Return the points of the last plan made by a time."""
    made = [planned.points for planned in plans if planned.time <= time]
    return made[-1] if made else np.zeros((0, 3))


class Stage:
    """A figure whose background is drawn once; frames only redraw what moves."""

    def __init__(self, history: History) -> None:
        self._space = history.values['dimension'] == 3
        figure = Figure(figsize=SIZE, dpi=DOTS_PER_INCH, layout='constrained')
        self._canvas = FigureCanvasAgg(figure)
        place, *charts = _places(figure, _seen(history))
        upper, lower = (figure.add_subplot(each) for each in charts)
        draw_distance(upper, history)
        draw_speed(lower, history)
        lower.sharex(upper)
        upper.tick_params(labelbottom=True)
        self._reach = NOSE * float(np.ptp(_seen(history), axis=0).max())
        draw = self._draw_space if self._space else self._draw_plane
        axes = draw(figure, place, history)
        goal = 'goal' if history.values['finish'] == 'arrival' else 'rope'
        self._moving = _moving(axes, self._space, goal)
        self._cursors = [_cursor(each) for each in (upper, lower)]
        headline(figure, story(history))
        self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(figure.bbox)

    def _draw_plane(self, figure: Figure, place: Any, history: History) -> Axes:
        axes = figure.add_subplot(place)
        draw_obstacles(axes, history)
        axes.plot(*swing(history)[:, :2].T, color=ORANGE, lw=4, alpha=0.4)
        mark_start(axes, history.positions[0, :2])
        axes.update_datalim(_seen(history)[:, :2])
        axes.autoscale_view()
        axes.set(xlabel='x [m]', ylabel='y [m]')
        axes.set_aspect('equal', adjustable='datalim')
        return axes

    def _draw_space(self, figure: Figure, place: Any, history: History) -> space.Axes3D:
        axes = space.add_axes(figure, place, _seen(history), view=VIEW)
        space.draw_boxes(axes, boxes(history))
        axes.plot(*swing(history).T, color=ORANGE, lw=3.5, alpha=0.5)
        return axes

    def show(self, instant: Instant) -> Array:
        """Return a frame."""
        nose = instant.way[-1] + self._reach * instant.nose
        shapes: tuple[Any, ...] = (
            instant.plan,
            instant.way,
            [instant.way[-1], nose],
            [instant.rope],
        )
        for line, points in zip(self._moving, shapes, strict=True):
            self._place(line, np.reshape(points, (-1, 3)))
        self._canvas.restore_region(self._background)
        for cursor in self._cursors:
            cursor.set_xdata([instant.time] * 2)
        for each in (*self._moving, *self._cursors):
            each.axes.draw_artist(each)
        return np.array(self._canvas.buffer_rgba())[:, :, :3]

    def _place(self, line: Any, points: Array) -> None:
        if self._space:
            line.set_data_3d(*points.T)
        else:
            line.set_data(*points[:, :2].T)


def _places(figure: Figure, points: Array) -> tuple[SubplotSpec, SubplotSpec, SubplotSpec]:
    """Return where scene and charts go: beside each other, or below where the scene is wide."""
    width, height, depth = np.ptp(points, axis=0)
    if width > WIDE * max(height, depth):
        grid = figure.add_gridspec(2, 2, height_ratios=(1.1, 1.0))
        return grid[0, :], grid[1, 0], grid[1, 1]
    grid = figure.add_gridspec(2, 2, width_ratios=(1.5, 1.0))
    return grid[:, 0], grid[0, 1], grid[1, 1]


def _seen(history: History) -> Array:
    """Return points that must be in sight, shape (K, 3) [m]."""
    return np.concatenate([history.positions, swing(history)])


def _moving(axes: Any, in_space: bool, goal: str) -> list[Artist]:
    """Return the lines that move: plan, way, vehicle and goal, and name them in a legend."""
    nowhere: Any = [[]] * (3 if in_space else 2)
    looks: tuple[tuple[str, dict[str, Any]], ...] = (
        ('plan', {'color': GREEN, 'lw': 1.6, 'marker': 'o', 'ms': 3.5, 'ls': '--'}),
        ('flown', {'color': GREY, 'lw': 1.4}),
        ('vehicle', {'color': BLUE, 'lw': 3.5, 'marker': 'o', 'ms': 7.0, 'markevery': [0]}),
        (goal, {'color': ORANGE, 'marker': 'o', 'ms': 9.0, 'mec': INK, 'ls': ''}),
    )
    lines = [
        axes.plot(*nowhere, label=name, animated=True, zorder=5, **kind)[0] for name, kind in looks
    ]
    axes.legend(loc='upper left')
    return lines


def _cursor(axes: Axes) -> Any:
    return axes.axvline(0.0, color=INK, lw=1.0, animated=True)
