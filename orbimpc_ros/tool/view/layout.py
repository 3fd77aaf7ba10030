# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The layout of the page: the world, the set of thrusts, the tick in words, and charts."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import rerun.blueprint as rrb

from orbimpc_ros.mpc.arrays import Array

TIMELINE = 'ros_time'
WORLD, THRUST, TICK, CHARTS = 'world', 'thrust', 'tick', 'charts'
SHOWN = {
    'Distance to the goal [m]': ('distance',),
    'Share of full speed |R e₁|, floor': ('speed', 'floor'),
    'Gap to the proved bound, log₁₀': ('gap',),
    'Solve time [ms]': ('solve_time_ms',),
    'Earliest catch, and its bound [s]': ('earliest_catch', 'catch_bound'),
}  # lines of each chart, below CHARTS
OPENING = math.radians(27.0)  # half the viewer's vertical field of view
NEAR = 2.0  # [m]: look at no less
SLANT = np.array([0.45, -0.85, 0.5])  # where space is looked at from


class Eye(NamedTuple):
    """From where to look, at what, and which way is up; shape (3,) each [m]."""

    position: Array
    target: Array
    up: Array


def eye(dimension: int, points: Array) -> Eye:
    """Return a view of points, shape (K, 3) [m]: the plane from above, space aslant."""
    low, high = points.min(axis=0), points.max(axis=0)
    target, reach = 0.5 * (low + high), 0.5 * max(NEAR, float(np.linalg.norm(high - low)))
    away = 1.15 * reach / math.tan(OPENING)
    if dimension == 2:
        return Eye(target + np.array([0.0, 0.0, away]), target, np.array([0.0, 1.0, 0.0]))
    return Eye(target + away * SLANT / np.linalg.norm(SLANT), target, np.array([0.0, 0.0, 1.0]))


def blueprint(dimension: int, world: Eye, *, intercepting: bool) -> rrb.Blueprint:
    """Return the page's layout, with a chart of catches where any are looked for."""
    low = dimension == 2
    axes = 'the (a, b) disk' if low else 'the unit ball'
    corners = np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 0.0]])
    charts = [
        rrb.TimeSeriesView(name=title, contents=[f'/{CHARTS}/{name}' for name in lines])
        for title, lines in SHOWN.items()
    ]
    disk = eye(dimension, 0.75 * corners)
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                _space(WORLD, 'Vehicle, plan, rope', world, grid=True),
                rrb.Horizontal(charts[0], charts[1]),
                row_shares=[9, 3],
            ),
            rrb.Vertical(
                _space(THRUST, f'R e₁ of the plan in {axes}: hull, floor', disk, grid=False),
                rrb.TextDocumentView(origin=TICK, name='Tick'),
                rrb.Horizontal(*charts[2 : 5 if intercepting else 4]),
                row_shares=[9, 9, 6],
            ),
            column_shares=[3, 2],
        ),
        rrb.TimePanel(timeline=TIMELINE, state='collapsed'),
        collapse_panels=True,
    )


def _space(origin: str, name: str, seen: Eye, grid: bool) -> rrb.Spatial3DView:
    controls = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=seen.position,
        look_target=seen.target,
        eye_up=seen.up,
    )
    return rrb.Spatial3DView(
        origin=origin,
        name=name,
        eye_controls=controls,
        line_grid=rrb.LineGrid3D(visible=grid),
    )
