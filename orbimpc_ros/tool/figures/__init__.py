"""Pictures of a run: from its history to matplotlib figures, a module for each family."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.figure import Figure

from orbimpc_ros.tool.figures.retrieval import retrieval
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
    'of_scenario',
    'retrieval',
    'save',
]


def of_scenario(scenario: str, flown: Mapping[str, History]) -> dict[str, Figure]:
    """Return the paper's figures of a scenario, by file name.

    Args:
        scenario: its name.
        flown: its flights, by name.
    """
    first = next(iter(flown.values()))
    return {'trajectory.png': retrieval(first)}
