"""The planning problem: its weights, floor, obstacles and state, and what follows from them."""

from orbimpc_ros.mpc.problem.problem import (
    FLOOR_SHAPES,
    MAX_HORIZON,
    TERMINALS,
    Box,
    Floor,
    Problem,
    State,
    Weights,
    largest_fraction,
)

__all__ = [
    'FLOOR_SHAPES',
    'MAX_HORIZON',
    'TERMINALS',
    'Box',
    'Floor',
    'Problem',
    'State',
    'Weights',
    'largest_fraction',
]
