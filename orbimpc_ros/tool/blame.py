"""Why a problem has no solution: the constraints without which it would have one."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

from orbimpc_ros.mpc.case import Case
from orbimpc_ros.mpc.errors import Infeasible, SolverFailure
from orbimpc_ros.mpc.problem import Floor, Problem
from orbimpc_ros.mpc.solver import Solver

PATIENCE = 2.0  # [s] for each constraint: any trajectory will do, the best is not needed


def blame(case: Case) -> str:
    """Return, in words, which constraint of an infeasible case stands in the way."""
    relaxed = dict(_relaxations(case.problem))
    guilty = [name for name, problem in relaxed.items() if _solvable(problem, case)]
    if guilty:
        return f'without {" or without ".join(guilty)} there is one'
    return f'it takes more than one of {", ".join(relaxed) or "the dynamics"} to rule them all out'


def _relaxations(problem: Problem) -> Iterator[tuple[str, Problem]]:
    """Yield the name of every constraint in force and the problem without it."""
    if problem.terminal == 'constraint':
        yield 'terminal: constraint', replace(problem, terminal='penalty')
    if problem.floor.shape != 'none':
        yield 'the floor', replace(problem, floor=Floor('none'))
    if problem.max_rate > 0.0:
        yield 'max_rate', replace(problem, max_rate=0.0)
    if problem.obstacles:
        yield 'obstacles', replace(problem, obstacles=())


def _solvable(problem: Problem, case: Case) -> bool:
    end = time.monotonic() + PATIENCE
    try:
        Solver(problem).solve(case.state, case.goals, out_of_time=lambda: time.monotonic() > end)
    except (Infeasible, SolverFailure):
        return False
    return True
