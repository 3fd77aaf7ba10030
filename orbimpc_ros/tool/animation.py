# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A flight in motion: vehicle, plan and goal beside distance and speed, frame by frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.tool import figures
from orbimpc_ros.tool.files import write_whole
from orbimpc_ros.tool.history import History
from orbimpc_ros.tool.style import BLUE, GREEN, GREY, INK, MAKER, ORANGE, headline, look

SIZE, DOTS_PER_INCH = (9.0, 5.4), 100
FRAMES = 150  # at most, or one a tick
PER_STEP = 5  # frames, at most
NOSE = 0.05  # length of the vehicle, as a share of what is seen
FRAME, LAST = 80, 2500  # [ms] that frames are shown
COLORS = 128


class Instant(NamedTuple):
    """What is seen at a time.

    Attributes:
        time: since the start [s].
        way: flown so far, shape (K, 3) [m].
        nose: of the vehicle, shape (3,).
        goal: shape (3,) [m].
        plan: being followed, shape (N + 1, 3) [m]; (0, 3) if there is none.
    """

    time: float
    way: Array
    nose: Array
    goal: Array
    plan: Array


def instants(history: History) -> Iterator[Instant]:
    """Yield what is seen from the start to the end; between odometry all moves straight."""
    path, goals, times = figures.flown_path(history), history.ropes.copy(), history.times.copy()
    times[-1] = history.end
    if history.capture is not None:
        goals[-1] = history.capture.rope
    steps = len(times) - 1
    per_step = int(np.clip(FRAMES // max(1, steps), 1, PER_STEP))
    for moment in np.linspace(0.0, steps, steps * per_step + 1):
        k = min(int(moment), steps - 1)
        now, goal, time = (a[k] + (moment - k) * (a[k + 1] - a[k]) for a in (path, goals, times))
        way = np.concatenate([path[: k + 1], [now]])
        made = [planned.points for planned in history.plans if planned.time <= times[k]]
        plan = made[-1] if made else np.zeros((0, 3))
        yield Instant(time - times[0], way, history.headings[k], goal, plan)


def frames(history: History, dark: bool = False) -> Iterator[Array]:
    """Yield the frames of a flight, shape (height, width, 3), as bytes of red, green and blue."""
    with look(dark):
        stage = Stage(history)
    for instant in instants(history):
        with look(dark):  # left before whoever takes the frame goes on
            frame = stage.show(instant)
        yield frame


class Stage:
    """A figure whose background is drawn once; frames only redraw what moves."""

    def __init__(self, history: History) -> None:
        self._space = history.values['dimension'] == 3
        figure = Figure(figsize=SIZE, dpi=DOTS_PER_INCH, layout='constrained')
        self._canvas = FigureCanvasAgg(figure)
        seen = np.concatenate([history.positions, figures.swing(history)])
        width, height = np.ptp(seen[:, :2], axis=0)
        wide = not self._space and width > figures.WIDE * height
        grid = figure.add_gridspec(2, 2, width_ratios=(1.0 if wide else 1.4, 1.0))
        scene = grid[0, :] if wide else grid[:, 0]
        charts = (grid[1, 0] if wide else grid[0, 1]), grid[1, 1]
        axes = self._scene(figure, scene, history, seen)
        upper, lower = (figure.add_subplot(place) for place in charts)
        figures.draw_distances(upper, {'': history})
        figures.draw_shares(lower, {'': history})
        lower.sharex(upper)
        lower.set_xlabel('time [s]')
        self._reach = NOSE * float(np.ptp(seen, axis=0).max())
        self._moving = _movers(axes, self._space)
        self._cursors = [
            each.axvline(0.0, color=INK, lw=1.0, animated=True) for each in (upper, lower)
        ]
        headline(figure, figures.story({'': history}))
        self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(figure.bbox)

    def _scene(self, figure: Figure, place: Any, history: History, seen: Array) -> Any:
        """Return axes with all that stands still."""
        if self._space:
            axes = figures.add_axes(figure, place, seen)
            figures.draw_solids(axes, figures.boxes(history))
            axes.plot(*figures.swing(history).T, color=ORANGE, lw=3.5, alpha=0.5)
            return axes
        axes = figure.add_subplot(place)
        figures.draw_boxes(axes, history, [0, 1])
        axes.plot(*figures.swing(history)[:, :2].T, color=ORANGE, lw=4, alpha=0.4)
        axes.update_datalim(seen[:, :2])
        axes.autoscale_view()
        axes.set(xlabel='x [m]', ylabel='y [m]')
        axes.set_aspect('equal', adjustable='datalim')
        return axes

    def show(self, instant: Instant) -> Array:
        """Return a frame."""
        nose = instant.way[-1] + self._reach * instant.nose
        shapes = (instant.plan, instant.way, np.array([instant.way[-1], nose]), instant.goal[None])
        for line, points in zip(self._moving, shapes, strict=True):
            if self._space:
                line.set_data_3d(*points.T)
            else:
                line.set_data(*points[:, :2].T)
        self._canvas.restore_region(self._background)
        for cursor in self._cursors:
            cursor.set_xdata([instant.time] * 2)
        for each in (*self._moving, *self._cursors):
            each.axes.draw_artist(each)
        return np.array(self._canvas.buffer_rgba())[:, :, :3]


def _movers(axes: Any, in_space: bool) -> list[Any]:
    """Return the lines that move: plan, way, vehicle and goal, and name them in a legend."""
    nowhere: Any = [[]] * (3 if in_space else 2)
    looks: tuple[tuple[str, dict[str, Any]], ...] = (
        ('plan', {'color': GREEN, 'lw': 1.6, 'marker': 'o', 'ms': 3.5, 'ls': '--'}),
        ('flown', {'color': GREY, 'lw': 1.4}),
        ('vehicle', {'color': BLUE, 'lw': 3.5, 'marker': 'o', 'ms': 7.0, 'markevery': [0]}),
        ('goal', {'color': ORANGE, 'marker': 'o', 'ms': 9.0, 'mec': INK, 'ls': ''}),
    )
    lines = [
        axes.plot(*nowhere, label=name, animated=True, zorder=5, **kind)[0] for name, kind in looks
    ]
    figures.legend_above(axes)
    return lines


def write_gif(shown: Sequence[Array], file: Path) -> None:
    """Write frames, shape (height, width, 3), as an animation that repeats for ever."""
    # One palette for all frames: colours must not flicker.
    palette = Image.new('P', (1, 1))
    some = np.concatenate([shown[0], shown[len(shown) // 2], shown[-1]])
    palette.putpalette(frequent(some, COLORS).astype(np.uint8).tobytes())
    images = [
        Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE)
        for frame in shown
    ]
    how: Any = {
        'format': 'GIF',
        'save_all': True,
        'append_images': images[1:],
        'duration': [FRAME] * (len(images) - 1) + [LAST],
        'loop': 0,
        'comment': MAKER.encode(),
    }
    write_whole(file, lambda new: images[0].save(new, **how))


def frequent(picture: Array, count: int) -> Array:
    """Return the most frequent colours, shape (count or less, 3), of a picture, shape (m, n, 3).

    In a drawing these are its very colours; those that are mixed at edges are few of a kind.
    """
    # As one number each: to sort rows of three takes ten times as long.
    packed = picture.reshape(-1, 3).astype(np.int64) @ np.array([1 << 16, 1 << 8, 1])
    found, counts = np.unique(packed, return_counts=True)
    chosen = found[np.argsort(counts)[::-1][:count]]
    return np.stack(np.unravel_index(chosen, (256, 256, 256)), axis=1)
