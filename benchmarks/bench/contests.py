# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The problems that are solved side by side, the contenders, and what is required of us."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from benchmarks.bench.contest import (
    CVXPY,
    GUROBI,
    GUROBI_CUT,
    IPOPT,
    QOCO,
    SCIP,
    Contest,
)
from benchmarks.bench.duel import OURS
from benchmarks.bench.instances import Instance, arrivals, boxes, circling, scattered
from benchmarks.bench.vehicles import lifted, wings
from orbimpc_ros.mpc.problem import Floor, Problem, Weights

HORIZONS, BOXES = (5, 10, 20, 50, 100), (1, 2, 4, 8, 16)
ARRIVAL: dict[str, Any] = {'horizon': 20, 'terminal': 'constraint'}
RIM, NO_FLOOR = math.sqrt(0.5), Floor('none')


def _p50(ratio: float) -> dict[str, float]:
    return {'ratio_p50': ratio}


def _planar() -> list[Contest]:
    square = Problem(floor=Floor('polygon', 4, math.sqrt(0.3)))
    contests = [
        Contest('hull', 'SE(2) N=5 hull', Problem(floor=NO_FLOOR), circling, (20, 200),
                rivals=(CVXPY, QOCO), required={CVXPY: _p50(8.0)}, closed_loop=True),
        Contest('square', 'SE(2) N=5 square floor, circling, 1e-4', square, circling, (10, 200),
                rivals=(GUROBI, SCIP), closed_loop=True,
                required={GUROBI: {'ratio_p50': 10.0, 'ratio_p99': 5.0}, SCIP: _p50(50.0)}),
    ]  # fmt: skip
    for share in (0.3, 1.0):
        problem = Problem(floor=Floor('circle', fraction=math.sqrt(share)))
        wanted = {OURS: {'worst_gap': 1e-6}, IPOPT: {'ratio_p50': 15.0, 'ratio_p99': 1.0}}
        contests.append(
            Contest(f'circle-{share}', f'SE(2) N=5 circle {share}, circling, 1e-6', problem,
                    circling, (20, 1000), 1e-6, (IPOPT,), wanted, True)
        )  # fmt: skip
    return contests


def _dubins() -> list[Contest]:
    goal = np.array([5.0, 10.0])

    def departures(problem: Problem, count: int) -> list[Instance]:
        return arrivals(problem, count, goal, 0.3)

    turning = Weights(0.0, 0.05, 1.0, 0.0)
    length = Weights(0.0, 0.0, 1.0, 0.0)
    square, circle = Floor('polygon', 4, RIM), Floor('circle', fraction=RIM)
    one_second = {OURS: {'p50_ms': 1000.0}}
    return [
        Contest('dubins', 'Dubins N=20 square r=0.05 l=1, 1e-4',
                Problem(weights=turning, floor=square, **ARRIVAL), departures, (1, 9),
                rivals=(GUROBI, GUROBI_CUT, SCIP), required={GUROBI: _p50(4.0), SCIP: _p50(10.0)}),
        Contest('dubins-length', 'Dubins N=20 square r=0 l=1, 1e-3',
                Problem(weights=length, floor=square, **ARRIVAL), departures, (1, 3), 1e-3,
                (GUROBI, GUROBI_CUT, SCIP), one_second),
        Contest('dubins-circle', 'Dubins N=20 circle, 1e-3',
                Problem(weights=turning, floor=circle, **ARRIVAL), departures, (2, 20), 1e-3),
    ]  # fmt: skip


def _space() -> list[Contest]:
    goal = np.array([5.0, 10.0, 25.0])

    def departures(problem: Problem, count: int) -> list[Instance]:
        return arrivals(problem, count, goal, 0.3)

    def around(problem: Problem, count: int) -> list[Instance]:
        return scattered(problem, count, 2.0)

    craft: dict[str, Any] = {'dimension': 3, 'rotation_order': 2, 'translation_order': 2}
    fuel = Problem(weights=Weights(0.0, 1.0, 0.1, 0.0), floor=NO_FLOOR, **craft, **ARRIVAL)
    cube = Problem(dimension=3, floor=Floor('polygon', 6, 0.5))
    return [
        Contest('spacecraft', 'spacecraft T=20 hull', fuel, departures, (3, 50),
                rivals=(CVXPY,), required={CVXPY: _p50(20.0)}),
        Contest('se3', 'SE(3) N=5 hull', Problem(dimension=3, floor=NO_FLOOR), around, (5, 100),
                rivals=(CVXPY,), required={CVXPY: _p50(2.5)}),
        Contest('se3-faces', 'SE(3) N=5 six faces 0.5, 1e-4', cube, around, (1, 10)),
    ]  # fmt: skip


def _sizes() -> list[Contest]:
    def ahead(problem: Problem, count: int) -> list[Instance]:
        return scattered(problem, count, 0.5 * problem.horizon)

    def across(problem: Problem, count: int) -> list[Instance]:
        return arrivals(problem, count, np.array([8.0, 0.0]), 0.3)

    hulls = [
        Contest('horizons', f'SE(2) hull N={n}', Problem(horizon=n, floor=NO_FLOOR), ahead,
                (4, 30))
        for n in HORIZONS
    ]  # fmt: skip
    strewn = [
        Contest('boxes', f'SE(2) N=8 among boxes: {m}',
                Problem(horizon=8, floor=NO_FLOOR, obstacles=boxes(m)), across, (1, 10),
                rivals=(GUROBI, SCIP))
        for m in BOXES
    ]  # fmt: skip
    return [*hulls, *strewn]


CONTESTS = (*_planar(), *_dubins(), *_space(), *_sizes(), *wings(), *lifted())
