# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Tasks of flight among discs and spheres, after the published examples of TinySDP (2605.13748).

    python test/long/obstacle_tasks.py
    python test/long/obstacle_tasks.py --task sweeping --starts 200 --seed 7

A point with the dynamics p+ = p + v + u/2, v+ = v + u starts at rest, to be at the origin within
0.15 and slower than 0.05. The thrust is held through a step of 1, so the point flies a parabola,
and is judged along it, at 200 instants of every step, against bodies where their formula has them
then. The planner knows their tracks, by chords of a quarter of a step. Exit code 1 if a flight
touches anything.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.mpc.plan import Plan, shifted
from orbimpc_ros.mpc.problem import Ball, MovingObstacle, Problem, State, Weights
from orbimpc_ros.mpc.solve.solver import Solver

NEAR, SLOW = 0.15, 0.05
THRUST = 0.3  # of the 3 per axis that are allowed: who is fast swings wide
MARGIN = 0.01  # on every radius: tracks are chords of curves
KNOTS = 4  # of a track in a step
FINE = 200
DEADLINE = 0.035  # [s] of a solve


@dataclass(frozen=True)
class Body:
    """A ball: its radius, and where its centre is at times, shape (M,), as shape (M, n)."""

    radius: float
    at: Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Task:
    """Where to fly from: shape (n,) each, with the shortest path; among what; in how many steps."""

    starts: list[tuple[list[float], float]]
    bodies: list[Body]
    steps: int
    spread: tuple[float, ...]


@dataclass(frozen=True)
class Flight:
    """What became of a flight: steps, path, whether it arrived, least clearance, solve times."""

    steps: int
    path: float
    arrived: bool
    clearance: float
    times: list[float]


class Budget:
    """Says when a time of computing is used up, whatever else the machine is busy with."""

    def __init__(self, seconds: float) -> None:
        self._end, self._polls, self._over = time.process_time() + seconds, 0, False

    def __call__(self) -> bool:
        self._polls += 1
        if self._polls % 4 == 0:  # to look at that clock takes long on some machines
            self._over = self._over or time.process_time() > self._end
        return self._over


def still(centre: list[float], radius: float) -> Body:
    return Body(radius, lambda t: np.tile(centre, (len(t), 1)))


def sweeper(centre: list[float], radius: float, phases: tuple[float, float, float]) -> Body:
    """A body of the sweeping gate: it drifts, and swings a little."""

    def at(t: np.ndarray) -> np.ndarray:
        a, b, c = phases
        swing = [0.03 * np.sin(0.3 * t + a), 0.05 * np.cos(0.3 * t + b), 0.04 * np.sin(0.4 * t + c)]
        return np.array(centre) + np.outer(t, [0.03, -0.16, 0.0]) + np.array(swing).T

    return Body(radius, at)


def riser(t: np.ndarray) -> np.ndarray:
    """The body of the rising gate that moves."""
    height = 0.35 + 0.75 * np.sin(0.48 * t - 1.1)
    return np.column_stack([np.full(len(t), -1.35), np.zeros(len(t)), height])


U = [(2.5, 0.0), *((x, y) for x in (2.5, 3.8, 5.0) for y in (1.2, -1.2))]
GATE = ([-4.5, 0.0, 1.0], float(np.linalg.norm([4.5, 0.0, 1.0])))
TASKS = {
    'u': Task(
        [([5.0, 0.05], 8.446), ([6.0, 1.0], 7.259), ([6.0, -1.0], 7.259), ([6.0, 0.05], 8.171),
         ([4.0, 3.0], 5.028), ([4.0, -3.0], 5.028)],
        [still([x, y], 0.8) for x, y in U], 60, (0.0, 0.0)),
    'sweeping': Task([GATE], [
        still([-3.3, 0.0, 0.2], 0.65), sweeper([-1.8, 1.3, 0.35], 0.56, (0.2, 0.4, 0.5)),
        sweeper([-1.35, 1.55, 0.95], 0.55, (0.8, 0.7, 1.0))], 28, (0.5, 0.5, 0.3)),
    'rising': Task([GATE], [
        still([-2.9, 0.9, 0.15], 0.6), still([-2.4, -0.9, 0.15], 0.6), Body(0.55, riser)],
        26, (0.5, 0.5, 0.3)),
}  # fmt: skip


def planned_for(dimension: int) -> Problem:
    """The one setting for every task of a dimension.

    What the thrust costs keeps it from alternating from step to step: the square of its changes in
    the plane, its size in space, where that spares the search all but the thrust axis.
    """
    effort = {'input': 0.5} if dimension == 2 else {'input': 0.0, 'length': 1.0}
    weights = Weights(position=1.0, terminal=0.0, **effort)
    return Problem(
        dimension=dimension, translation_order=2, horizon=14, step=1.0, forward=THRUST,
        discretisation='held', weights=weights, arrival_weight=20.0,
    )  # fmt: skip


def seen(bodies: list[Body], now: float, horizon: int) -> tuple[MovingObstacle, ...]:
    """The tracks of bodies from now on."""
    times = np.arange(horizon * KNOTS + 1) / KNOTS
    found = []
    for body in bodies:
        track = body.at(now + times)
        found.append(MovingObstacle(Ball(track[0], body.radius + MARGIN), times, track - track[0]))
    return tuple(found)


def fly(task: Task, start: np.ndarray, solver: Solver) -> Flight:
    """Fly from a start until the goal, the last step, or no plan."""
    problem, n = solver.problem, len(start)
    place, velocity, heading = start.copy(), np.zeros(n), np.zeros((n, n))
    goals, plan = np.zeros((problem.horizon, n)), None
    path, clearance, times = 0.0, np.inf, []
    for k in range(task.steps):
        if np.linalg.norm(place) <= NEAR and np.linalg.norm(velocity) < SLOW:
            return Flight(k, path, True, clearance, times)
        hazards = seen(task.bodies, float(k), problem.horizon)
        state = State.at(place, heading, velocity=velocity, attitude=np.eye(n), hazards=hazards)
        begun = time.process_time()
        plan = planned(solver, state, goals, plan, Budget(DEADLINE))
        times.append(time.process_time() - begun)
        if plan is None:
            u = -np.clip(velocity, -problem.forward, problem.forward)  # brake
        else:
            u = problem.forward * plan.rotations[1, :, 0]
        heading = heading if plan is None else plan.rotations[1]
        moments = np.linspace(0.0, 1.0, FINE + 1)[:, None]
        flown = place + moments * velocity + 0.5 * moments**2 * u
        path += float(np.linalg.norm(np.diff(flown, axis=0), axis=1).sum())
        for body in task.bodies:
            away = flown - body.at(k + moments[:, 0])
            clearance = min(clearance, float(np.linalg.norm(away, axis=1).min()) - body.radius)
        place, velocity = place + velocity + 0.5 * u, velocity + u
    return Flight(task.steps, path, False, clearance, times)


def planned(
    solver: Solver, state: State, goals: np.ndarray, before: Plan | None, budget: Budget
) -> Plan | None:
    """The plan of a tick, from the one before; None if there is none."""
    guess = None
    if before is not None:
        guess = shifted(solver.problem, state, goals, before, projection='thrust_aligned')
    try:
        return solver.solve(state, goals, guess, budget)
    except OrbimpcError:
        return guess


def starts_of(task: Task, count: int, seed: int) -> Iterator[tuple[np.ndarray, float]]:
    """The published starts, then random ones around the first of them."""
    for start, shortest in task.starts:
        yield np.array(start), shortest
    rng = np.random.default_rng(seed)
    while count:
        start = np.array(task.starts[0][0]) + rng.uniform(-1.0, 1.0, len(task.spread)) * task.spread
        away = [np.linalg.norm(start - b.at(np.zeros(1))[0]) - b.radius for b in task.bodies]
        if min(away) > 0.1 and any(task.spread):
            yield start, float(np.linalg.norm(start))
        count -= 1


def report(name: str, task: Task, count: int, seed: int) -> bool:
    """Fly a task from all its starts, and print what became of it; return whether all is well."""
    solver = Solver(planned_for(len(task.spread)), gap_tolerance=1e-2)
    first = np.array(task.starts[0][0])
    fly(task, first, solver)  # which compiles
    flights, ratios = [], []
    for start, shortest in starts_of(task, count, seed):
        flight = fly(task, start, solver)
        flights.append(flight)
        ratios.append(flight.path / shortest)
        if len(flights) <= len(task.starts):
            print(f'  {start.tolist()}: {"arrived" if flight.arrived else "NOT ARRIVED"} in '
                  f'{flight.steps} steps, path {ratios[-1]:.2f} x, clearance '
                  f'{flight.clearance:.3f}')  # fmt: skip
    arrived = [each.arrived and each.clearance >= 0.0 for each in flights]
    solves = 1e3 * np.concatenate([each.times for each in flights])
    p50, p99 = np.percentile(solves, [50, 99])
    good = [ratio for ratio, each in zip(ratios, arrived, strict=True) if each] or [np.inf]
    print(f'{name}: {sum(arrived)} of {len(flights)} arrived untouched; '
          f'path at most {max(good):.2f} x, median {np.median(good):.2f} x; '
          f'solve p50 {p50:.1f} ms, p99 {p99:.1f} ms')  # fmt: skip
    return all(each.clearance >= 0.0 for each in flights)


def main() -> int:
    """Fly the tasks asked for."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('--task', choices=tuple(TASKS), help='one of them; all by default')
    parser.add_argument('--starts', type=int, default=50, help='random starts besides')
    parser.add_argument('--seed', type=int, default=1)
    asked = parser.parse_args()
    well = True
    for name in [asked.task] if asked.task else TASKS:
        well &= report(name, TASKS[name], asked.starts, asked.seed)
    return 0 if well else 1


if __name__ == '__main__':
    sys.exit(main())
