# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Contests about real vehicles: a wing, a multirotor and a lander, in problems met in flight.

A minute goes by for a solver that states a minimum speed and a turn rate as what they are, not
convex. So rivals meet a few of the ticks only, spread over the flights; all of them start cold
there, while our controller has its previous plan, as it has in flight.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.bench.contest import CVXPY, GUROBI, IPOPT, SCIP, Contest
from benchmarks.bench.duel import OURS
from benchmarks.bench.flights import landings, rotored, spread, winged
from orbimpc_ros.mpc.problem import Floor, Problem, Weights
from orbimpc_ros.mpc.problem.scaling import weighed

FULL, RATE = 15.0, 0.4363  # [m/s], [rad/s] of the wing in config/fixed_wing.yaml
ROUND, OCTAGON = Floor('circle', fraction=2.0 / 3.0), Floor('polygon', 8, 2.0 / 3.0)
EVERYBODY = (GUROBI, SCIP, IPOPT)
# Turning costs a multirotor, and fuel a lander, whose thrust then keeps to its limits.
MULTIROTOR, LANDER = Weights(1.0, 1.0, 0.0, 10.0), Weights(0.0, 0.01, 1.0, 0.0)


def _wing(
    key: str, words: str, steps: tuple[int, float], floor: Floor, rate: float, **more: Any
) -> Contest:
    """Return a contest of wings, given the steps, their length [s] and the limits."""
    horizon, step = steps
    problem = Problem(horizon=horizon, step=step, forward=FULL, floor=floor, max_rate=rate)
    known: dict[str, Any] = {'rivals': EVERYBODY, 'closed_loop': True, 'every': 20, 'gap': 1e-3}
    return Contest(key, f'wing N={horizon} {words}', weighed(problem, 'time'), winged, (4, 200),
                   **known | more)  # fmt: skip


def _times(p50: float, p99: float, **more: float) -> Mapping[str, float]:
    return {'p50_ms': p50, 'p99_ms': p99, **more}


def wings() -> list[Contest]:
    """Return the contests in the plane."""
    proved = {OURS: _times(3.0, 50.0), SCIP: {'ratio_p50': 100.0}, GUROBI: {'ratio_p50': 30.0}}
    moving = {OURS: _times(2.0, 30.0)}
    return [
        _wing('wing', 'circle 2/3, turn rate, 1e-3', (12, 0.5), ROUND, RATE, required=proved),
        _wing('wing-far', 'circle 2/3, turn rate, 1e-3', (20, 0.5), ROUND, RATE,
              required={OURS: _times(15.0, 100.0)}),
        _wing('wing-octagon', 'octagon 2/3, turn rate, 1e-4', (10, 1.0), OCTAGON, RATE, gap=1e-4,
              required={OURS: _times(5.0, 50.0, worst_gap=1e-4)}),
        _wing('wing-circle', 'circle 2/3, 1e-3', (10, 1.0), ROUND, 0.0, required=moving),
        _wing('wing-circle', 'circle 2/3, 1e-3', (20, 0.5), ROUND, 0.0, required=moving),
    ]  # fmt: skip


def lifted() -> list[Contest]:
    """Return the contests under gravity, where CVXPY solves the relaxation: a bound, no plan."""
    craft: dict[str, Any] = {'dimension': 3, 'translation_order': 2, 'forward': 20.0}
    steps: dict[str, Any] = {'horizon': 20, 'step': 0.2, 'discretisation': 'exact'}
    among = Problem(weights=MULTIROTOR, obstacles=spread(8), **craft, **steps)
    thrust = Floor('circle', fraction=0.3)
    down = Problem(horizon=30, step=0.3, weights=LANDER, terminal='constraint', floor=thrust,
                   discretisation='exact', **craft)  # fmt: skip
    return [
        Contest('multirotor', 'multirotor N=20 under gravity, 8 boxes, 1e-3',
                weighed(among, 'time'), rotored, (2, 60), 1e-3, (CVXPY,),
                {OURS: _times(5.0, 50.0)}, True, 10),
        Contest('lander', 'lander N=30, thrust 0.3, 1e-3', weighed(down, 'time'), landings,
                (2, 20), 1e-3, (CVXPY,), {OURS: _times(20.0, 20.0)}),
    ]  # fmt: skip
