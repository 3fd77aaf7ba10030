# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Convex model predictive control over rotations, as ROS 2 nodes and as a library.

What is named here is the library's interface (docs/library.md); it needs no ROS. Each name is
imported when it is first used: NumPy and solvers take a while.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from orbimpc_ros.loop.compensation import Odometry
    from orbimpc_ros.loop.planner import Decision, Planner, Snapshot
    from orbimpc_ros.mpc.errors import BadInput, Infeasible, OrbimpcError, SolverFailure
    from orbimpc_ros.mpc.outcome import Fallback, Status
    from orbimpc_ros.mpc.plan import Command, Plan, Proof
    from orbimpc_ros.mpc.problem import (
        Approach,
        Ball,
        Box,
        Floor,
        MovingObstacle,
        Problem,
        State,
        Weights,
    )
    from orbimpc_ros.mpc.solve.solver import Solver

__version__ = '0.1.0'

# Where the names are, in the order in which these modules import each other.
_HOMES = (
    *('mpc.errors', 'mpc.outcome', 'mpc.problem', 'mpc.plan', 'mpc.solve.solver'),
    *('loop.compensation', 'loop.planner'),
)

__all__ = [
    'Approach',
    'BadInput',
    'Ball',
    'Box',
    'Command',
    'Decision',
    'Fallback',
    'Floor',
    'Infeasible',
    'MovingObstacle',
    'Odometry',
    'OrbimpcError',
    'Plan',
    'Planner',
    'Problem',
    'Proof',
    'Snapshot',
    'Solver',
    'SolverFailure',
    'State',
    'Status',
    'Weights',
    '__version__',
]


def __getattr__(name: str) -> Any:
    """Return a name of the interface."""
    for home in _HOMES if name in __all__ else ():
        module = import_module(f'orbimpc_ros.{home}')
        if hasattr(module, name):
            return getattr(module, name)
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
