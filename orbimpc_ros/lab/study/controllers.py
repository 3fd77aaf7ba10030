# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The controllers that fly: the planner of this package and the baselines, by name."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from importlib import import_module
from typing import Any

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.problem import Problem

ORBITOPE, NONLINEAR = 'orbitope', 'nonlinear'
CONTROLLERS = {
    ORBITOPE: ('orbimpc_ros.mpc.loop.controller', 'Controller'),
    'linearised': ('orbimpc_ros.lab.study.baselines.linearised', 'Linearised'),
    NONLINEAR: ('orbimpc_ros.lab.study.baselines.nonlinear', 'Nonlinear'),
    'pursuit': ('orbimpc_ros.lab.study.baselines.pursuit', 'Pursuit'),
}
NEEDED = ('distributed', 'pyarrow')
KEPT = 8  # controllers ready for another run of the same problem


@lru_cache(maxsize=KEPT)
def controller_named(name: str, problem: Problem, purpose: str = '') -> Any:
    """Return a controller for a problem, the same one each time; it remembers its last flight.

    Args:
        name: in :data:`CONTROLLERS`.
        problem: what it solves.
        purpose: separates controllers that must not share a memory.
    """
    module, kind = CONTROLLERS[name]
    return getattr(import_module(module), kind)(problem)


def require_installed(controllers: Sequence[str]) -> None:
    """Raise BadInput, saying what to install, unless a study with these controllers can run."""
    needed = (*NEEDED, 'casadi') if NONLINEAR in controllers else NEEDED
    missing = [module for module in needed if not _imports(module)]
    if missing:
        problem = f'{", ".join(missing)} {"is" if len(missing) == 1 else "are"} missing'
        raise BadInput.stating('orbimpc study', problem, "pip install 'orbimpc_ros[study]'")


def _imports(module: str) -> bool:
    try:
        import_module(module)
    except ImportError:  # not there, or not for the NumPy that is
        return False
    return True
