# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Baseline controllers with the same forecast, wind estimate and lag compensation."""

from __future__ import annotations

from pathlib import Path

from benchmarks.baselines.baseline import Baseline, Lead, Proportional, PurePursuit, Waypoint
from orbimpc_ros.install import shared
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.parameters.planner import PlannerSettings
from orbimpc_ros.tool.files import read

BASELINES: dict[str, type[Baseline]] = {
    'pursuit': PurePursuit,
    'lead': Lead,
    'proportional': Proportional,
    'waypoint': Waypoint,  # for an engine with its own guidance
}
TUNED = Path(__file__).with_name('tuned.yaml')


def baseline_named(name: str, settings: PlannerSettings, study: str) -> Baseline:
    """Return a baseline.

    Args:
        name: in :data:`BASELINES`.
        settings: of the planner that it replaces.
        study: whose tuning to use.

    Raises:
        BadInput: all baselines are planar.
    """
    if settings.problem.dimension != 2:
        raise BadInput('--controllers', name, 'orbitope where dimension is 3')
    return BASELINES[name](settings, tuned_of(study).get(name, {}))


def tuned_of(study: str) -> dict[str, dict[str, float]]:
    """Return the tuned numbers of a study, or of the one that it is based on, by baseline."""
    known, file = read(str(TUNED)), shared(f'config/studies/{study}.yaml')
    base = study if file is None else Path(read(str(file))['config']).stem
    return {**known.get(base, {}), **known.get(study, {})}
