# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Chases by a Dubins vehicle, put to the planner: constant airspeed, steps instead of time."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from dubins import Chase, earliest
from problems import floor
from stepping import Motion, Stepped

from orbimpc_ros.loop.intercept import AIM, Interception, InterceptQuery, Target
from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.loop.task import Solvers, Task
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.solve.request import Enough
from orbimpc_ros.mpc.solve.solver import Solver

NEAR = 0.1  # radius of a catch, a share of what is flown in a step


class Reference(NamedTuple):
    """A chase, and when it ends at the earliest; the same with a given heading at the end."""

    chase: Chase
    time: float
    word: str
    heading: float
    headed_time: float
    headed_word: str


class Attempt(NamedTuple):
    """How near a plan came, in radii of a catch, and whether it is proved that none is a catch."""

    miss: float
    never: bool


def references():
    """The chases whose earliest ends others have computed."""
    file = Path(__file__).with_name('reference') / 'interception.json'
    return [_reference(case) for case in json.loads(file.read_text())['cases']]


def _reference(case):
    start, target = case['start'], case['target']
    chase = Chase(
        np.array(start['position']),
        start['heading'],
        case['airspeed'],
        case['turn_radius'],
        np.array(target['position']),
        np.array(target['velocity']),
        np.array(case['wind']),
    )
    free, given = case['free'], case['prescribed']
    headed = given['heading'], given['time'], given['word'][:3]
    return Reference(chase, free['time'], free['word'], *headed)


def drawn(rng, shortest, longest):
    """A chase at random that ends between two times [s]."""
    while True:
        speed = rng.uniform(0.8, 1.4)
        chase = Chase(
            rng.uniform(-1.0, 1.0, 2),
            rng.uniform(-math.pi, math.pi),
            speed,
            rng.uniform(0.5, 1.5),
            rng.uniform(-5.0, 5.0, 2),
            _within(rng, 0.6 * speed),
            _within(rng, 0.3 * speed),
        )
        if shortest < earliest(chase)[0] < longest:
            return chase


def _within(rng, most):
    angle, length = rng.uniform(-math.pi, math.pi), rng.uniform(0.0, most)
    return length * np.array([math.cos(angle), math.sin(angle)])


def problem(chase, step, horizon):
    """The problem of a vehicle that flies a chase in steps [s]."""
    return Problem(
        horizon=horizon,
        step=step,
        forward=chase.airspeed,
        floor=floor('circle', 1.0),
        max_rate=chase.rate,
        discretisation='exact',
    )


def radius(chase, step):
    """Within what a goal counts as caught [m]: next to nothing."""
    return NEAR * step * chase.airspeed


def goals(chase, step, count):
    return chase.goal + np.multiply.outer(step * np.arange(1, count + 1), chase.course)


def catch(chase, step, horizon, approach=None, *, between=False):
    """The catch of a controller's first tick, at ends of steps or ``between`` them."""
    controller = Stepped(
        problem(chase, step, horizon),
        capture_radius=radius(chase, step),
        approach=approach,
        disturbance=chase.wind,
        velocity_source='air',
    )
    along, still = np.array([chase.airspeed, 0.0]), np.zeros(1)
    odometry = Odometry(0.0, chase.position, exp(np.array([chase.heading])), along, still)
    ahead = (lambda times: chase.goal + np.outer(times, chase.course)) if between else None
    return controller.tick(odometry, goals(chase, step, horizon), None, ahead).catch


def tried(chase, step, end, out_of_time=None):
    """The attempt to catch a goal at the end of so many steps, and not at another."""
    near, target = radius(chase, step), Target(end)
    posed = problem(chase, step, end)
    interception = Interception(posed, near, Solvers(posed))
    places = goals(chase, step, end)
    plan = _solver(interception, target, near).solve(_start(chase), places, None, out_of_time)
    miss = np.linalg.norm(plan.positions[-1] - places[-1])
    return Attempt(float(miss / near), plan.lower_bound > interception.enough(end).bound)


def soonest(chase, step, horizon, deadline):
    """The catch of :func:`catch`, between ends of steps, by searches that stop once they know.

    A controller looks on for the best way to a catch, and keeps all its searches' trees: gigabytes.

    Args:
        chase: what is flown.
        step: its length [s].
        horizon: steps within which a catch is looked for.
        deadline: returns what tells one search that its time is up; called for each of them.
    """
    near, posed = radius(chase, step), problem(chase, step, horizon)
    places, knots = goals(chase, step, horizon), np.arange(1.0, horizon + 1.0)
    task = Task(posed, _start(chase), places, knots)
    motion = Motion(lambda times: chase.goal + np.outer(times, chase.course))
    interception = Interception(posed, near, _SolversOfCatches(posed, near, deadline))
    return interception.earliest(InterceptQuery(task, motion, 0.0))[2]


class _SolversOfCatches(Solvers):
    """Solvers whose searches stop at the first catch, or once none is proved to be."""

    def __init__(self, problem, near, deadline):
        super().__init__(problem)
        self._near, self._deadline = near, deadline

    def new(self, problem, enough=None):
        stop = enough and Enough((AIM * self._near) ** 2, enough.bound)
        return _DeadlinedSolver(problem, self._deadline, stop)


class _DeadlinedSolver(Solver):
    """A solver with a deadline of its own for each of its searches."""

    def __init__(self, problem, deadline, enough):
        super().__init__(problem, enough=enough)
        self._deadline = deadline

    def solve(self, state, goals, guess=None, _out_of_time=None):
        return super().solve(state, goals, guess, self._deadline())


def _start(chase):
    start = State.at(chase.position, exp(np.array([chase.heading])))
    return replace(start, disturbance=chase.wind)


def _solver(interception, target, near):
    """The search for a catch at an end, which stops at the first, or once none is proved to be."""
    enough = Enough((AIM * near) ** 2, interception.enough(target.end).bound)
    return Solver(interception.problem(target), enough=enough)
