# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""One run, flown by every controller from the same sightings: a row of results for each."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from orbimpc_ros.lab.study.controllers import NONLINEAR, ORBITOPE, controller_named
from orbimpc_ros.lab.study.design import TRUTH, Run, Study, run_of
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.loop.controller import Tick
from orbimpc_ros.mpc.loop.forecast import Forecast, forecast_named
from orbimpc_ros.mpc.loop.observation import Sighting
from orbimpc_ros.mpc.loop.odometry import Odometry
from orbimpc_ros.mpc.outcome import Status
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.world.faults import View
from orbimpc_ros.world.flight import Log, Pilot, Sensor, fly
from orbimpc_ros.world.rope import TrueMotion

Row = dict[str, Any]
CHEAPER = 1e-6  # relative; costs that differ by less are the same


def flown(study: Study, numbers: Sequence[int]) -> list[Row]:
    """Return the rows of some runs of a study; what a worker is asked for."""
    return [row for number in numbers for row in _flown(study, run_of(study, number))]


def _flown(study: Study, run: Run) -> list[Row]:
    known = study.forecast == TRUTH
    forecast = Shared(TrueMotion(run.scenario.rope) if known else forecast_named(study.forecast))
    return [_row(study, run, name, forecast) for name in study.controllers]


def _row(study: Study, run: Run, name: str, forecast: Shared) -> Row:
    controller = controller_named(name, run.problem)
    controller.reset()
    forecast.reset()
    timed = Timed(controller)
    log = fly(timed, run.scenario, forecast, _sensor(run))
    row = {'run': run.number, 'controller': name, 'forecast': study.forecast, **run.drawn}
    row |= _outcome(log) | _quality(log) | _comparison(study, run.problem, name, log)
    return row | {'tick_ms': timed.spent, 'forecast_ms': forecast.spent[: len(log.ticks)]}


def _sensor(run: Run) -> Sensor:
    view = View(run.faults, run.noise_seed, run.problem.step)

    def sensor(flight):
        sighting, odometry = (sent.content for sent in view.of(flight))  # noise loses nothing
        return sighting, odometry

    return sensor


def _outcome(log: Log) -> Row:
    """Return whether, when and how nearly the rope was caught, and how much was turned for it."""
    last, caught = log.flights[-1], log.captured
    rates = [tick.command.body_rate[0] for tick in log.ticks]
    return {
        'caught': caught,
        'ticks': len(log.ticks),
        'time': last.missed_at - last.scenario.start.time if caught else None,
        'closest': float(log.misses.min()),
        'farthest': max(flight.distance for flight in log.flights),
        'turned': last.scenario.model.step * float(np.abs(rates).sum()),
    }


def _quality(log: Log) -> Row:
    """Return what was proved of the plans, and what was lost when they became rotations."""
    plans = [tick.plan for tick in log.ticks if tick.plan is not None]
    return {
        'certified': sum(tick.status == Status.OPTIMAL for tick in log.ticks),
        'fallbacks': sum(bool(tick.fallback) for tick in log.ticks),
        'projection_distance': max((float(p.projection_distance[1]) for p in plans), default=None),
        'projection_loss': max(_losses(log), default=None),
    }


def _losses(log: Log) -> list[float]:
    """Return how far from s_2 of each plan the vehicle was taken from s_1 of that plan [m].

    s_2 is the first position that a command decides; that it starts from the measured state
    instead of the true one is noise, and no loss of the projection.
    """
    found = []
    for k, tick in enumerate(log.ticks[:-1]):
        if tick.plan is not None and tick.plan.horizon > 1:
            planned = tick.plan.positions[2] - tick.plan.positions[1]
            moved = log.flights[k + 2].vehicle.position - log.flights[k + 1].vehicle.position
            found.append(float(np.linalg.norm(moved - planned)))
    return found


def _comparison(study: Study, problem: Problem, name: str, log: Log) -> Row:
    """Return how the planner's costs compare with IPOPT's on the very same problems."""
    if name != ORBITOPE or NONLINEAR not in study.controllers:
        return {'compared': 0, 'excess': None, 'cheaper': 0}
    found = excesses(problem, log.ticks)
    return {
        'compared': len(found),
        'excess': max(found, default=None),
        'cheaper': sum(excess < -CHEAPER for excess in found),
    }


def excesses(problem: Problem, ticks: Sequence[Tick]) -> list[float]:
    """Return the relative excess of plans' costs over IPOPT's, where both are legal plans."""
    rival, found = controller_named(NONLINEAR, problem, 'rival'), []
    rival.reset()
    for tick in ticks:
        if tick.plan is None or tick.state is None or tick.goals is None:
            continue
        other = rival.plan(tick.state, tick.goals)
        if not violations(problem, tick.state, tick.goals, other):
            apart = tick.plan.objective - other.objective
            found.append(apart / max(1e-9, abs(other.objective)))
    return found


class Shared:
    """A forecast made once a tick, for whoever comes first: the others get the same.

    The rope does not care who flies, so that all see the same of it.

    Attributes:
        spent: processor time that each tick's forecast took [ms].
    """

    def __init__(self, forecast: Forecast) -> None:
        self._forecast = forecast
        self._made: list[Array] = []
        self.spent: list[float] = []
        self.reset()

    def reset(self) -> None:
        """Start over with the first tick."""
        self._tick = 0

    def observe(self, sighting: Sighting) -> None:
        """Take in the sighting of a tick."""
        if self._tick == len(self._made):
            self._begin = time.thread_time()
            self._forecast.observe(sighting)

    def at(self, times: Array) -> Array:
        """Return the tick's forecast."""
        if self._tick == len(self._made):
            self._made.append(self._forecast.at(times))
            self.spent.append(1e3 * (time.thread_time() - self._begin))
        self._tick += 1
        return self._made[self._tick - 1]


class Timed:
    """A controller with a stopwatch.

    Attributes:
        spent: processor time that each tick took [ms]; what else the machine does is not in it.
    """

    def __init__(self, controller: Pilot) -> None:
        self._controller = controller
        self.problem = controller.problem
        self.spent: list[float] = []

    @property
    def remaining(self) -> int:
        """Return how many steps ahead the controller looks."""
        return self._controller.remaining

    def tick(self, odometry: Odometry, goals: Array) -> Tick:
        """Return the controller's tick."""
        begin = time.thread_time()
        tick = self._controller.tick(odometry, goals)
        self.spent.append(1e3 * (time.thread_time() - begin))
        return tick
