# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Flights among sixteen discs that move, N = 12: how long ticks take, and what they come to.

    python test/long/discs.py
    python test/long/discs.py --flights 40 --seed 7

Discs drift at up to half of what the vehicle flies at, and reappear on the other side of an arena
that it crosses. The vehicle obeys its plans; it is judged at 50 instants of every step. Times are
CPU times. Exit code 1 if a flight touches anything.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from obstacle_tasks import DEADLINE, Budget, planned

from orbimpc_ros.mpc.model.motion import controls
from orbimpc_ros.mpc.problem import Ball, Floor, MovingObstacle, Problem, State
from orbimpc_ros.mpc.solve.solver import Solver

COUNT, STEPS, TICKS = 16, 12, 30
WIDE, HIGH = 12.0, 8.0  # of the arena
RADII, SPEED = (0.3, 0.7), 0.5
APART = 1.5  # from the vehicle's first place
FINE = 50
KINDS = {
    'order 1': {},
    'order 2': {'translation_order': 2, 'discretisation': 'exact'},
    'floor and turn rate': {'floor': Floor('circle'), 'max_rate': 1.2},
}


def problem_of(kind: str) -> Problem:
    return Problem(horizon=STEPS, step=0.5, forward=1.0, **KINDS[kind])


def discs(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres, radii and velocities; none near the start or the goal when the flight begins."""
    centres, ends = [], np.array([[0.0, 0.0], [WIDE, 0.0]])
    while len(centres) < COUNT:
        centre = rng.uniform([0.0, -0.5 * HIGH], [WIDE, 0.5 * HIGH])
        if np.linalg.norm(ends - centre, axis=1).min() > APART:
            centres.append(centre)
    angles = rng.uniform(0.0, 2.0 * np.pi, COUNT)
    speeds = rng.uniform(0.0, SPEED, COUNT)[:, None]
    ways = speeds * np.column_stack([np.cos(angles), np.sin(angles)])
    return np.array(centres), rng.uniform(*RADII, COUNT), ways


def fly(solver: Solver, rng: np.random.Generator) -> tuple[list[float], list[str], float, float]:
    """Solve times, what became of ticks, the least clearance, the distance left."""
    problem = solver.problem
    centres, radii, ways = discs(rng)
    state = State.at(np.zeros(2), 0.6 * np.eye(2), attitude=np.eye(2))
    goals, plan = np.tile([WIDE, 0.0], (STEPS, 1)), None
    times, became, clearance = [], [], np.inf
    shares = np.linspace(0.0, 1.0, FINE + 1)[:, None]
    for _ in range(TICKS):
        hazards = tuple(map(MovingObstacle.drifting, map(Ball, centres, radii), ways))
        state = State.at(state.position, state.rotation, attitude=state.attitude,
                         velocity=state.velocity, hazards=hazards)  # fmt: skip
        begun = time.process_time()
        plan = planned(solver, state, goals, plan, Budget(DEADLINE))
        times.append(time.process_time() - begun)
        became.append('none' if plan is None else plan.status)
        if plan is None:
            break
        flown = plan.positions, plan.velocities
        points = controls(problem.translation.degree, problem.step, *flown)[0]
        degree = len(points) - 1
        basis = [_binomial(degree, i) * shares**i * (1 - shares) ** (degree - i)
                 for i in range(degree + 1)]  # fmt: skip
        way = sum(b * p for b, p in zip(basis, points, strict=True))
        moved = centres + problem.step * shares[:, :, None] * ways
        away = np.linalg.norm(way[:, None] - moved, axis=2) - radii
        clearance = min(clearance, float(away.min()))
        centres = centres + problem.step * ways
        attitude = plan.projected[1]
        state = State.at(plan.positions[1], plan.rotations[1], attitude=attitude,
                         velocity=plan.velocities[1])  # fmt: skip
    return times, became, clearance, float(np.linalg.norm(state.position - goals[-1]))


def _binomial(n: int, k: int) -> int:
    return [[1], [1, 1], [1, 2, 1], [1, 3, 3, 1]][n][k]


def main() -> int:
    """Fly all kinds of vehicles."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('--flights', type=int, default=20)
    parser.add_argument('--seed', type=int, default=1)
    asked = parser.parse_args()
    well = True
    for kind in KINDS:
        solver = Solver(problem_of(kind), gap_tolerance=1e-2)
        fly(solver, np.random.default_rng(0))  # which compiles
        flown = [fly(solver, np.random.default_rng([asked.seed, i])) for i in range(asked.flights)]
        times = 1e3 * np.concatenate([each[0] for each in flown])
        became = np.concatenate([each[1] for each in flown])
        p50, p99 = np.percentile(times, [50, 99])
        clearance = min(each[2] for each in flown)
        left = np.array([each[3] for each in flown])
        well &= clearance >= -1e-6
        print(f'{kind}: {len(times)} ticks, p50 {p50:.1f} ms, p99 {p99:.1f} ms, at most '
              f'{times.max():.1f} ms; {np.mean(became == "optimal"):.0%} proved, '
              f'{np.sum(became == "none")} without a plan; least clearance {clearance:.4f}, '
              f'within 1 m of the goal {np.mean(left < 1.0):.0%}')  # fmt: skip
    return 0 if well else 1


if __name__ == '__main__':
    sys.exit(main())
