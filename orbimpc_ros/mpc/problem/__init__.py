"""The planning problem: its weights, floor, obstacles and state, and what follows from them."""

from orbimpc_ros.mpc.problem.floor import Floor
from orbimpc_ros.mpc.problem.obstacle import Box
from orbimpc_ros.mpc.problem.problem import MAX_HORIZON, TERMINALS, Problem, Weights
from orbimpc_ros.mpc.problem.state import State

__all__ = ['MAX_HORIZON', 'TERMINALS', 'Box', 'Floor', 'Problem', 'State', 'Weights']
