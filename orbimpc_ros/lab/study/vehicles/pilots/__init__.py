# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Pilots: what one would fly instead, each behind the same forecast, wind and lags."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module

from orbimpc_ros.mpc.loop.controller import Controller
from orbimpc_ros.ros.parameters.planner import PlannerSettings
from orbimpc_ros.ros.planner.ticker import prepared

ORBITOPE = 'orbitope'
WAYPOINT = 'waypoint'  # an engine's own guidance
RIVALS = {
    'pursuit': ('guidance', 'PurePursuit'),
    'lead': ('guidance', 'Lead'),
    'proportional': ('guidance', 'Proportional'),
    'sampling': ('sampling', 'Sampling'),
    'linearised': ('programs', 'LinearisedPilot'),
    'nonlinear': ('programs', 'NonlinearPilot'),
}
GUIDED = {WAYPOINT: ('guidance', 'Waypoint')}  # takes an engine
PILOTS = (ORBITOPE, *RIVALS)
_made: dict[str, Controller] = {}  # the last one, by its settings


def class_of(name: str) -> type:
    """Return the class of a rival, by its name in :data:`RIVALS` or :data:`GUIDED`."""
    module, kind = (RIVALS | GUIDED)[name]
    found: type = getattr(import_module(f'{__name__}.{module}'), kind)
    return found


def pilot(name: str, settings: PlannerSettings, tuned: Mapping[str, float]) -> Controller:
    """Return a pilot, by its name in :data:`PILOTS`.

    Args:
        name: of the pilot, or of one in :data:`GUIDED`.
        settings: of the planner in whose place it flies.
        tuned: what is set of a rival's :attr:`Rival.SPACE`.
    """
    if name == ORBITOPE:
        return _ready(settings)
    made: Controller = class_of(name)(settings, tuned)
    return made


def _ready(settings: PlannerSettings) -> Controller:
    """Return a controller of the package, reset; to make one takes as long as to fly with it."""
    key = repr(settings)
    if key not in _made:
        _made.clear()
        _made[key] = prepared(settings)[1]
    _made[key].reset()
    return _made[key]
