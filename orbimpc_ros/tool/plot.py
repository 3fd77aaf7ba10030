# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc plot``: the path of a bag's flight, its numbers over time, and an animation.

In the animation vehicle, plan and goal move beside charts of distance and speed.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool import figures, history
from orbimpc_ros.tool.figures import BLUE, GREEN, GREY, INK, ORANGE, look
from orbimpc_ros.tool.files import folder_at, shown
from orbimpc_ros.tool.history import History

ANIMATION = 'animation.gif'
DOTS_PER_INCH = 90
FRAMES = 150  # at most, or one a tick
PER_STEP = 5  # frames, at most
FRAME, LAST = 80, 2500  # [ms] that frames are shown
COLORS = 128
LOOKS: dict[str, dict[str, Any]] = {
    'plan': {'color': GREEN, 'lw': 1.6, 'marker': 'o', 'ms': 3.5, 'ls': '--'},
    'flown': {'color': GREY, 'lw': 1.4},
    'vehicle': {'color': BLUE, 'lw': 3.5, 'marker': 'o', 'ms': 7.0, 'markevery': [0]},
    'goal': {'color': ORANGE, 'marker': 'o', 'ms': 9.0, 'mec': INK, 'ls': ''},
}  # of what moves


def run(bag: str, out: str, namespace: str, *, dark: bool, animated: bool) -> int:
    """Draw a flight."""
    flight = history.of_bag(Path(bag), namespace)
    if len(flight.times) < 2:
        raise BadInput.stating(bag, 'a single odometry message', 'two or more are needed')
    folder = folder_at(Path(out).resolve())
    names = figures.written({'': flight}, folder, dark)
    if animated:
        write_gif(flight, folder / ANIMATION, dark)
        names.append(ANIMATION)
    print(f'written: {", ".join(names)} in {shown(folder)}')
    return 0


def instants(history: History) -> Iterator[dict[str, Array]]:
    """Yield the points of what moves, shape (K, 3) each [m]; between odometry it moves straight."""
    path, goals = history.way, history.ropes.copy()
    if history.capture is not None:
        goals[-1] = history.capture.rope
    reach = figures.NOSE * float(np.ptp(path, axis=0).max())
    steps = len(path) - 1
    per_step = int(np.clip(FRAMES // max(1, steps), 1, PER_STEP))
    for moment in np.linspace(0.0, steps, steps * per_step + 1):
        k = min(int(moment), steps - 1)
        now, goal = (a[k] + (moment - k) * (a[k + 1] - a[k]) for a in (path, goals))
        made = [planned.points for planned in history.plans if planned.time <= history.times[k]]
        yield {
            'plan': made[-1] if made else np.zeros((0, 3)),
            'flown': np.vstack([path[: k + 1], now]),
            'vehicle': np.array([now, now + reach * history.attitudes[k, :, 0]]),
            'goal': goal[None],
        }


def write_gif(history: History, file: Path, dark: bool = False) -> None:
    """Write a flight as an animation that repeats for ever."""
    with look(dark):
        shown = [Image.fromarray(frame) for frame in _frames(history)]
    # One palette for all frames: colours must not flicker.
    palette = shown[len(shown) // 2].quantize(COLORS, Image.Quantize.MAXCOVERAGE)
    images = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in shown]
    images[0].save(
        file,
        save_all=True,
        append_images=images[1:],
        duration=[FRAME] * (len(images) - 1) + [LAST],
        loop=0,
    )


def _frames(history: History) -> Iterator[Array]:
    """Yield pictures, shape (height, width, 3), of which only what moves is drawn each time."""
    figure, axes = figures.stage({'': history})
    figure.set_dpi(DOTS_PER_INCH)
    canvas, n = FigureCanvasAgg(figure), history.values['dimension']
    lines = {
        name: axes.plot(*[[]] * n, label=name, animated=True, zorder=5, **kind)[0]
        for name, kind in LOOKS.items()
    }
    axes.legend(handles=lines.values(), loc='upper left')
    canvas.draw()
    background: Any = canvas.copy_from_bbox(figure.bbox)
    for instant in instants(history):
        canvas.restore_region(background)
        for name, points in instant.items():
            (lines[name].set_data_3d if n == 3 else lines[name].set_data)(*points.T[:n])
            axes.draw_artist(lines[name])
        yield np.array(canvas.buffer_rgba())[:, :, :3]
