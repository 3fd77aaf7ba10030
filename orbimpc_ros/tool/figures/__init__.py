# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Pictures of a run: from its history to matplotlib figures, a module for each family."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.figure import Figure

from orbimpc_ros.tool.demo.arrivals import planned_at_start
from orbimpc_ros.tool.figures.dubins import dubins
from orbimpc_ros.tool.figures.lander import lander
from orbimpc_ros.tool.figures.multirotor import multirotor
from orbimpc_ros.tool.figures.numbers import data, solver
from orbimpc_ros.tool.figures.retrieval import retrieval
from orbimpc_ros.tool.figures.retrieval3d import retrieval3d
from orbimpc_ros.tool.figures.snapshots import moments
from orbimpc_ros.tool.figures.spacecraft import spacecraft
from orbimpc_ros.tool.history import History
from orbimpc_ros.tool.style import look, save

__all__ = [
    'TRAJECTORY',
    'data',
    'dubins',
    'lander',
    'look',
    'moments',
    'multirotor',
    'of_flight',
    'of_runs',
    'retrieval',
    'retrieval3d',
    'save',
    'solver',
    'spacecraft',
]

TRAJECTORY = 'trajectory.png'  # every demo has it


def of_runs(flown: Mapping[str, History], dark: bool = False) -> dict[str, Figure]:
    """Return the paper's figures of one or more flights of a scenario, by file name.

    Args:
        flown: the flights, by name.
        dark: for dark pages, not for print.
    """
    with look(dark):
        return _of_runs(flown)


def of_flight(history: History, dark: bool = False) -> dict[str, Figure]:
    """Return every figure there is of a flight, by file name: the paper's, and its numbers."""
    with look(dark):
        more = {'data.png': data(history), 'solver.png': solver(history)}
        return _of_runs({'': history}) | more


def _of_runs(flown: Mapping[str, History]) -> dict[str, Figure]:
    first = next(iter(flown.values()))
    space = first.values['dimension'] == 3
    if first.values['finish'] == 'arrival' and space and not first.in_time:
        return {TRAJECTORY: multirotor(first), 'data.png': data(first)}
    if first.values['finish'] == 'arrival' and space:
        draw = lander if first.values['tilt'] or first.values['glide_slope'] else spacecraft
        plan = planned_at_start(first.values)
        return {TRAJECTORY: draw(first, plan), 'data.png': data(first)}
    if first.values['finish'] == 'arrival':
        return {TRAJECTORY: dubins(flown)}
    if space:
        return {TRAJECTORY: retrieval3d(first)}
    return {TRAJECTORY: retrieval(flown), 'moments.png': moments(first)}
