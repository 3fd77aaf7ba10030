# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""What one would fly instead: controllers behind the same forecast, wind estimate and lags."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path

from benchmarks.baselines.baseline import Baseline
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.parameters.planner import PlannerSettings
from orbimpc_ros.tool.files import read

BASELINES = {
    'pursuit': ('guidance', 'PurePursuit'),
    'lead': ('guidance', 'Lead'),
    'proportional': ('guidance', 'Proportional'),
    'sampling': ('sampling', 'Sampling'),
    'linearised': ('programs', 'LinearisedBaseline'),
    'nonlinear': ('programs', 'NonlinearBaseline'),
    'waypoint': ('guidance', 'Waypoint'),  # of an engine that has guidance of its own
}
TUNED = Path(__file__).with_name('tuned')
# Studies whose baselines were tuned on another one, as far as they have no file of their own.
LIKE = {
    'fixed_wing_cone': 'fixed_wing',
    'fixed_wing_near': 'fixed_wing',
    'gates': 'crossing',
    'retrieval_constant': 'retrieval',
    'retrieval_small': 'retrieval',
}
Tuned = dict[str, dict[str, float]]


def class_of(name: str) -> type:
    """Return the class of a baseline, by its name in :data:`BASELINES`."""
    module, kind = BASELINES[name]
    found: type = getattr(import_module(f'{__name__}.{module}'), kind)
    return found


def baseline_named(
    name: str, settings: PlannerSettings, study: str, tuned: Mapping[str, float] | None = None
) -> Baseline:
    """Return a baseline.

    Args:
        name: in :data:`BASELINES`.
        settings: of the planner in whose place it flies.
        study: whose tuning it has.
        tuned: what is set of its :attr:`Baseline.SPACE` instead.

    Raises:
        BadInput: all baselines are planar.
    """
    if settings.problem.dimension != 2:
        raise BadInput('--controllers', name, 'orbitope where dimension is 3')
    given = tuned_of(study).get(name, {}) if tuned is None else tuned
    made: Baseline = class_of(name)(settings, given)
    return made


def tuned_of(study: str) -> Tuned:
    """Return what was found for a study, by baseline."""
    files = [TUNED / f'{name}.yaml' for name in (LIKE.get(study, study), study)]
    known: Tuned = {}
    for file in files:
        known |= read(str(file)) if file.is_file() else {}
    return known
