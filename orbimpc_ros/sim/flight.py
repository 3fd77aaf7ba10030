# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A flight: a scenario in progress, and the loop that a controller closes around it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from orbimpc_ros.loop.capture import closest_approach, is_headed
from orbimpc_ros.loop.goal.motion import Forecast, GoalObservation
from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.check import TOLERANCE
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.sim.contact import met, touched
from orbimpc_ros.sim.scenario import Scenario
from orbimpc_ros.sim.vehicle import Vehicle, measured

if TYPE_CHECKING:  # the simulator flies without a solver, and starts sooner for it
    from orbimpc_ros.loop.planner import Decision, Snapshot
    from orbimpc_ros.mpc.command import Command


@dataclass(frozen=True)
class Flight:
    """A scenario after some steps.

    Attributes:
        scenario: what is flown.
        vehicle: where it is now.
        ticks: steps flown.
        miss: least distance to the goal during the last step [m]; infinite before the first.
        missed_at: when that was [s].
        headed: whether it was within the cone of approach then.
        trail: the vehicle on its way through the last step, at its end last.
        touched: numbers of the boxes, and on from there of the balls in the traffic, that it has
            been in so far, farther than the tolerance of plans.
    """

    scenario: Scenario
    vehicle: Vehicle
    ticks: int = 0
    miss: float = np.inf
    missed_at: float = np.nan
    headed: bool = False
    trail: tuple[Vehicle, ...] = ()
    touched: frozenset[int] = frozenset()

    @property
    def elapsed(self) -> float:
        """Return the time since the start [s]: the rope's own time."""
        return self.vehicle.time - self.scenario.start.time

    @property
    def goal(self) -> Array:
        """Return where the goal is now, shape (n,) [m]."""
        return self.goal_of(self.vehicle)

    def goal_of(self, vehicle: Vehicle) -> Array:
        """Return where the goal is at the time of a vehicle of this flight, shape (n,) [m]."""
        if vehicle.goal is not None:
            return vehicle.goal
        return self.scenario.rope.at(vehicle.time - self.scenario.start.time)

    @property
    def _place(self) -> Array:
        """Return where the vehicle is, and how far past the rope's ends, shape (n + 1,) [m]."""
        height = self.vehicle.height
        past = max(0.0, abs(height) - 0.5 * self.scenario.rope_length)
        return np.append(self.vehicle.position, math.copysign(past, height))

    @property
    def _place_of_goal(self) -> Array:
        return np.append(self.goal, 0.0)

    @property
    def distance(self) -> float:
        """Return how far the goal is now [m]."""
        return float(np.linalg.norm(self.vehicle.position - self.goal))

    @property
    def speed(self) -> float:
        """Return how fast the vehicle is now [m/s]."""
        return float(np.linalg.norm(self.vehicle.velocity))

    @property
    def captured(self) -> bool:
        """Return whether the job is done: the goal caught by the last step, or arrived at.

        Who has touched a box, or a ball in the traffic, has not done it.
        """
        if self.touched:
            return False
        if self.scenario.finish == 'arrival':
            return self._arrived
        return self.near and self.headed

    @property
    def near(self) -> bool:
        """Return whether the goal came within the capture radius in the last step.

        Where an engine judges, it is whether the goal has been caught.
        """
        judged = self.vehicle.caught
        return self.miss <= self.scenario.capture_radius if judged is None else judged

    @property
    def _arrived(self) -> bool:
        fastest = self.scenario.arrival_speed or np.inf
        near = self.distance <= self.scenario.arrival_radius and self.speed <= fastest
        return near and self._out_of_ticks

    @property
    def _out_of_ticks(self) -> bool:
        return self.ticks >= self.scenario.max_ticks

    @property
    def over(self) -> bool:
        """Return whether the goal is caught or lost, or the steps are used up."""
        return self.captured or self.vehicle.lost or self._out_of_ticks

    def after(self, fraction: float, body_rate: Array, held: float = np.inf) -> Flight:
        """Return the flight one step later, the command taken over as the vehicle's model says.

        Args:
            fraction: commanded share of full speed or thrust.
            body_rate: commanded, shape (1,) or (3,) [rad/s].
            held: how long into the step the command is in force [s]; after that the vehicle
                does as its model has it without one: by default it stops.
        """
        step = self.scenario.model.step
        if held >= step:
            later = self._flown(step, fraction, body_rate)
        else:
            later = self._cut_short(max(0.0, held), fraction, body_rate)
        return replace(later, ticks=self.ticks + 1)

    def _cut_short(self, held: float, fraction: float, body_rate: Array) -> Flight:
        model = self.scenario.model
        obeyed = self._flown(held, fraction, body_rate) if held > 0.0 else self
        safe = replace(obeyed, vehicle=model.released(obeyed.vehicle))
        rest = safe._flown(model.step - held, model.failsafe_fraction, model.failsafe_turn)
        if held <= 0.0:
            return rest
        nearest = min((obeyed, rest), key=lambda flight: flight.miss)
        trail = obeyed.trail + rest.trail
        kept = {name: getattr(nearest, name) for name in ('miss', 'missed_at', 'headed')}
        return replace(rest, trail=trail, **kept)

    def _flown(self, span: float, fraction: float, body_rate: Array) -> Flight:
        """Return the flight after a time [s] under one command, its goal swinging on."""
        trail = self.scenario.model.flown(self.vehicle, span, fraction, body_rate, self.elapsed)
        miss, missed_at, headed = np.inf, np.nan, False
        before = self
        for vehicle in trail:
            now = replace(before, vehicle=vehicle)
            near, share = closest_approach(
                (before._place, now._place), (before._place_of_goal, now._place_of_goal)
            )
            if near < miss and not (before.vehicle.caught or before.vehicle.lost):
                begun = before.vehicle.time
                miss, missed_at = near, begun + share * (vehicle.time - begun)
                ends = before.vehicle.attitude[:, 0], vehicle.attitude[:, 0]
                headed = is_headed(self.scenario.approach, ends, share)
            before = replace(now, touched=now.touched | before._touched(now))
        return replace(before, miss=miss, missed_at=missed_at, headed=headed, trail=trail)

    def _touched(self, now: Flight) -> frozenset[int]:
        boxes, way = self.scenario.obstacles, (self.vehicle.position, now.vehicle.position)
        grazed = TOLERANCE * self.scenario.model.length_unit  # as far as plans may lead inside
        balls = met(self.scenario.traffic, way, (self.elapsed, now.elapsed), grazed)
        return touched(boxes, *way, grazed) | {len(boxes) + number for number in balls}


def departure(scenario: Scenario, time: float | None = None) -> Flight:
    """Return the flight before its first step; ``time`` [s] moves the start on the clock."""
    start = scenario.model.begun(scenario.start)
    if time is not None:
        start = replace(start, time=time)
    return Flight(replace(scenario, start=start), start)


@dataclass(frozen=True)
class Log:
    """What a whole flight came to.

    Attributes:
        flights: its states, one more than ticks.
        ticks: what the controller made of each but the last.
    """

    flights: tuple[Flight, ...]
    ticks: tuple[Decision, ...]

    @property
    def captured(self) -> bool:
        """Return whether the goal was caught."""
        return self.flights[-1].captured

    @property
    def misses(self) -> Array:
        """Return the least distance to the goal during each step, shape (ticks,) [m]."""
        return np.array([flight.miss for flight in self.flights[1:]])


class Pilot(Protocol):
    """What flies a vehicle: the planner of this package, or another to compare it with.

    Attributes:
        problem: gives the step.
    """

    problem: Problem

    @property
    def remaining(self) -> int:
        """Return how many steps ahead it looks."""

    def step(self, snapshot: Snapshot) -> Decision:
        """Return what to do next, given goals g_1..g_N, shape (``remaining``, n) [m]."""

    def sent(self, command: Command) -> None:
        """Take note of a command that was sent."""


Sensor = Callable[[Flight], tuple[GoalObservation, Odometry]]


def perfect_sensor(flight: Flight) -> tuple[GoalObservation, Odometry]:
    """Return what is seen of a flight without noise: its goal and its vehicle."""
    source = flight.scenario.model.velocity_source
    return GoalObservation(flight.vehicle.time, flight.goal), measured(flight.vehicle, source)


def fly(
    pilot: Pilot, scenario: Scenario, forecast: Forecast, sensor: Sensor = perfect_sensor
) -> Log:
    """Close the loop of controller and vehicle until the goal is caught or the steps run out.

    The simulator and the planner do the same over DDS; this is the loop without ROS.
    """
    flights, ticks = [departure(scenario)], []
    while not flights[-1].over:
        tick = planned(pilot, flights[-1], forecast, sensor)
        command = tick.command
        ticks.append(tick)
        flights.append(flights[-1].after(command.speed_fraction, command.body_rate))
    return Log(tuple(flights), tuple(ticks))


def planned(
    pilot: Pilot, flight: Flight, forecast: Forecast, sensor: Sensor = perfect_sensor
) -> Decision:
    """Return a pilot's decision on what is seen of a flight just now."""
    sighting, odometry = sensor(flight)
    forecast.observe(sighting)
    ahead = pilot.problem.step * np.arange(1, pilot.remaining + 1)
    from orbimpc_ros.loop.planner import Snapshot

    decision = pilot.step(Snapshot(odometry, forecast.at(sighting.time + ahead)))
    pilot.sent(decision.command)
    return decision
