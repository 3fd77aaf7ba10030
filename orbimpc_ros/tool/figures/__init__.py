"""Pictures of a run: from its history to matplotlib figures, a module for each family."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.figure import Figure

from orbimpc_ros.tool.arrivals import planned_at_start
from orbimpc_ros.tool.figures.dubins import dubins
from orbimpc_ros.tool.figures.moments import moments
from orbimpc_ros.tool.figures.retrieval import retrieval
from orbimpc_ros.tool.figures.retrieval3d import retrieval3d
from orbimpc_ros.tool.figures.spacecraft import data, spacecraft
from orbimpc_ros.tool.figures.style import BLUE, GREEN, INK, ORANGE, RED, SKY, STYLE, save
from orbimpc_ros.tool.history import History

__all__ = [
    'BLUE',
    'GREEN',
    'INK',
    'ORANGE',
    'RED',
    'SKY',
    'STYLE',
    'TRAJECTORY',
    'data',
    'dubins',
    'moments',
    'of_runs',
    'retrieval',
    'retrieval3d',
    'save',
    'spacecraft',
]

TRAJECTORY = 'trajectory.png'  # every demo has it


def of_runs(flown: Mapping[str, History]) -> dict[str, Figure]:
    """Return the paper's figures of one or more flights of a scenario, by file name.

    Args:
        flown: the flights, by name.
    """
    first = next(iter(flown.values()))
    space = first.values['dimension'] == 3
    if first.values['finish'] == 'arrival' and space:
        plan = planned_at_start(first.values)
        return {TRAJECTORY: spacecraft(first, plan), 'data.png': data(first)}
    if first.values['finish'] == 'arrival':
        return {TRAJECTORY: dubins(flown)}
    if space:
        return {TRAJECTORY: retrieval3d(first)}
    return {TRAJECTORY: retrieval(first), 'moments.png': moments(first)}
