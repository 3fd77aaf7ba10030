"""Convex model predictive control over rotations, as ROS 2 nodes and as a library.

What is named here is the library's interface; it needs no ROS. Each name is imported when it is
first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from orbimpc_ros.mpc.errors import BadInput, Infeasible, OrbimpcError, SolverFailure
    from orbimpc_ros.mpc.loop.controller import Controller
    from orbimpc_ros.mpc.plan import Plan
    from orbimpc_ros.mpc.problem import Box, Floor, Problem, State, Weights
    from orbimpc_ros.mpc.solve.solver import Solver

__all__ = [
    'BadInput',
    'Box',
    'Controller',
    'Floor',
    'Infeasible',
    'OrbimpcError',
    'Plan',
    'Problem',
    'SolverFailure',
    'Solver',
    'State',
    'Weights',
    '__version__',
]

__version__ = '0.1.0'

_HOMES = {
    'loop.controller': ('Controller',),
    'errors': ('BadInput', 'Infeasible', 'OrbimpcError', 'SolverFailure'),
    'plan': ('Plan',),
    'problem': ('Box', 'Floor', 'Problem', 'State', 'Weights'),
    'solve.solver': ('Solver',),
}


def __getattr__(name: str) -> Any:
    """Return a name of the interface, imported now: NumPy and solvers take a while."""
    for home, names in _HOMES.items():
        if name in names:
            return getattr(import_module(f'orbimpc_ros.mpc.{home}'), name)
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
