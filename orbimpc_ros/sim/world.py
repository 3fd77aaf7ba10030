# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The simulated world: a swinging rope, boxes, traffic, and the flight of a vehicle among them."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from orbimpc_ros.loop.capture import closest_approach, is_headed
from orbimpc_ros.loop.traffic import centre
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.check import TOLERANCE
from orbimpc_ros.mpc.problem import Approach, Ball, Box, MovingObstacle
from orbimpc_ros.sim.vehicle import Model, Vehicle

FINISHES = ('capture', 'arrival')
ROUNDING = 1e-6  # relative tolerance of the stall speed


@dataclass(frozen=True)
class Rope:
    """A rope at g(t) = center + velocity t + amplitude * sin(2 pi f t + phase), axis by axis.

    A scalar applies to all axes. A rope with only its center given is at rest.
    """

    center: Array  # shape (n,) [m]
    amplitude: Array | float = 0.0  # shape (n,) [m]
    frequency: float = 0.0  # f [Hz]
    phase: Array | float = 0.0  # shape (n,) [rad]
    velocity: Array | float = 0.0  # shape (n,) [m/s]

    def at(self, time: float) -> Array:
        """Return g(t), shape (n,) [m]."""
        angle = 2.0 * np.pi * self.frequency * time + self.phase
        return self.center + self.velocity * time + self.amplitude * np.sin(angle)


@dataclass(frozen=True)
class Scenario:
    """A vehicle, its start and its goal.

    With finish ``capture``, a flight ends as soon as the goal is caught; with ``arrival``, it ends
    after ``max_ticks``, when it must be at the goal. Touching a box or a ball fails a flight.
    """

    model: Model
    start: Vehicle  # its time is the start time
    rope: Rope  # the goal, swinging or fixed
    capture_radius: float  # distance within which the goal counts as caught [m]
    max_ticks: int  # steps after which the flight ends
    finish: str = 'capture'
    arrival_radius: float = 0.05  # largest distance from the goal at arrival [m]
    arrival_speed: float = 0.0  # largest speed at arrival [m/s]; 0 for no limit
    obstacles: tuple[Box, ...] = ()
    traffic: tuple[MovingObstacle, ...] = ()  # balls with constant velocities from the start on
    approach: Approach = field(default_factory=Approach)  # headings that count as a capture
    rope_length: float = 0.0  # half of it above the plane of flight [m]


@dataclass(frozen=True)
class Flight:
    """A scenario after some steps.

    ``touched`` holds the indices of the boxes, followed by those of the balls, that the vehicle has
    entered so far by more than the tolerance of plans.
    """

    scenario: Scenario
    vehicle: Vehicle  # now
    ticks: int = 0  # steps flown
    miss: float = np.inf  # least distance to the goal during the last step [m]
    missed_at: float = np.nan  # time of that least distance [s]
    headed: bool = False  # whether the vehicle was in the approach cone then
    trail: tuple[Vehicle, ...] = ()  # states during the last step, to its end
    touched: frozenset[int] = frozenset()
    least_airspeed: float = math.inf  # since the start [m/s]
    stalls: int = 0  # times that it fell below the stall speed since then

    @property
    def elapsed(self) -> float:
        """Return the time since the start [s], which is the time of the rope."""
        return self.vehicle.time - self.scenario.start.time

    @property
    def goal(self) -> Array:
        """Return the current position of the goal, shape (n,) [m]."""
        if self.vehicle.goal is not None:
            return self.vehicle.goal
        return self.scenario.rope.at(self.elapsed)

    @property
    def _place(self) -> Array:
        """Return the vehicle's position and its height past the rope's ends, shape (n + 1,) [m]."""
        height = self.vehicle.height
        past = max(0.0, abs(height) - 0.5 * self.scenario.rope_length)
        return np.append(self.vehicle.position, math.copysign(past, height))

    @property
    def distance(self) -> float:
        """Return the current distance to the goal [m]."""
        return float(np.linalg.norm(self.vehicle.position - self.goal))

    @property
    def speed(self) -> float:
        """Return the current speed of the vehicle [m/s]."""
        return float(np.linalg.norm(self.vehicle.velocity))

    @property
    def stalled(self) -> bool:
        """Return True if the vehicle is slower than its stall speed."""
        return self.vehicle.airspeed < self.scenario.model.stall_speed * (1.0 - ROUNDING)

    @property
    def captured(self) -> bool:
        """Return True if the goal was caught in the last step, or has been arrived at.

        A flight that touched a box or a ball has failed.
        """
        scenario, fastest = self.scenario, self.scenario.arrival_speed or np.inf
        if self.touched:
            return False
        if scenario.finish == 'arrival':
            there = self.distance <= scenario.arrival_radius and self.speed <= fastest
            return there and self.ticks >= scenario.max_ticks
        return self.near and self.headed

    @property
    def near(self) -> bool:
        """Return True if the goal came within the capture radius in the last step.

        If an engine judges catches, return True if the goal has been caught.
        """
        judged = self.vehicle.caught
        return self.miss <= self.scenario.capture_radius if judged is None else judged

    @property
    def over(self) -> bool:
        """Return True if the goal is caught or lost, or the steps are used up."""
        return self.captured or self.vehicle.lost or self.ticks >= self.scenario.max_ticks

    def after(self, fraction: float, body_rate: Array, held: float = np.inf) -> Flight:
        """Return the flight one step later; the vehicle's model defines when the command acts.

        Args:
            fraction: commanded share of full speed or thrust.
            body_rate: commanded, shape (1,) or (3,) [rad/s].
            held: duration of the command within the step [s]; then the failsafe of the model acts.
        """
        model, trail = self.scenario.model, tuple[Vehicle, ...]()
        if held > 0.0:
            span = min(held, model.step)
            trail = model.flown(self.vehicle, span, fraction, body_rate, self.elapsed)
        if held < model.step:
            released = model.released(trail[-1] if trail else self.vehicle)
            left, elapsed = model.step - max(0.0, held), released.time - self.scenario.start.time
            safe = model.failsafe_fraction, model.failsafe_turn
            trail += model.flown(released, left, *safe, elapsed)
        return self._along(trail)

    def _along(self, trail: Sequence[Vehicle]) -> Flight:
        """Return the flight after a step along a trail, with the goal moving on."""
        miss, missed_at, headed = np.inf, np.nan, False
        before = self
        for vehicle in trail:
            now = replace(before, vehicle=vehicle)
            goals = np.append(before.goal, 0.0), np.append(now.goal, 0.0)
            near, share = closest_approach((before._place, now._place), goals)
            if near < miss and not (before.vehicle.caught or before.vehicle.lost):
                begun = before.vehicle.time
                miss, missed_at = near, begun + share * (vehicle.time - begun)
                ends = before.vehicle.attitude[:, 0], vehicle.attitude[:, 0]
                headed = is_headed(self.scenario.approach, ends, share)
            before = replace(
                now,
                touched=now.touched | before._touched(now),
                least_airspeed=min(before.least_airspeed, vehicle.airspeed),
                stalls=before.stalls + (now.stalled and not before.stalled),
            )
        return replace(
            before,
            ticks=self.ticks + 1,
            miss=miss,
            missed_at=missed_at,
            headed=headed,
            trail=tuple(trail),
        )

    def _touched(self, now: Flight) -> frozenset[int]:
        boxes, way = self.scenario.obstacles, (self.vehicle.position, now.vehicle.position)
        grazed = TOLERANCE * self.scenario.model.length_unit  # penetration allowed in plans
        balls = met(self.scenario.traffic, way, (self.elapsed, now.elapsed), grazed)
        return touched(boxes, *way, grazed) | {len(boxes) + number for number in balls}


def departure(scenario: Scenario, time: float | None = None) -> Flight:
    """Return the flight before its first step; ``time`` [s] sets its clock at the start."""
    start = scenario.model.begun(scenario.start)
    if time is not None:
        start = replace(start, time=time)
    flight = Flight(replace(scenario, start=start), start, least_airspeed=start.airspeed)
    return replace(flight, stalls=int(flight.stalled))


def touched_in_words(numbers: Collection[int], boxes: int) -> str:
    """Return the names, counted from 1, of touched bodies: ``boxes`` boxes, then balls."""
    return ', '.join(
        f'box {k + 1}' if k < boxes else f'ball {k + 1 - boxes}' for k in sorted(numbers)
    )


def outcome(flight: Flight) -> str:
    """Describe how a flight has ended."""
    done = '' if flight.captured else 'not '
    if flight.touched:
        return f'touched {touched_in_words(flight.touched, len(flight.scenario.obstacles))}'
    if flight.scenario.finish == 'arrival':
        where = f'{flight.distance:.2e} m from the goal at {flight.speed:.2e} m/s'
        return f'{done}arrived: {where}'
    if not flight.captured and flight.near:
        return f'not captured: {flight.miss:.3f} m from the goal, outside the cone of approach'
    if flight.vehicle.lost:
        return 'not captured: another part of the vehicle touched the goal first'
    if not flight.captured:
        return 'not captured'
    when = flight.missed_at - flight.scenario.start.time
    return f'captured at t = {when:.2f} s, {flight.miss:.3f} m from the goal'


def touched(boxes: Sequence[Box], start: Array, end: Array, grazed: float = 0.0) -> frozenset[int]:
    """Return the indices of the boxes that a straight path enters by more than ``grazed`` [m]."""
    return frozenset(k for k, box in enumerate(boxes) if _crosses(box, start, end, grazed))


def met(
    traffic: Sequence[MovingObstacle],
    flown: tuple[Array, Array],
    times: tuple[float, float],
    grazed: float = 0.0,
) -> frozenset[int]:
    """Return the indices of the balls that a straight path enters while they move linearly.

    It is ``flown`` between two ``times`` since the start [s]; depths up to ``grazed`` do not count.
    """
    found = set()
    for number, each in enumerate(traffic):
        begin, end = centre(each.body) + each.moved(np.array(times))
        nearest, _ = closest_approach(flown, (begin, end))
        if isinstance(each.body, Ball) and nearest < each.body.radius - grazed:
            found.add(number)
    return frozenset(found)


def _crosses(box: Box, start: Array, end: Array, grazed: float) -> bool:
    """Return True if a path is between both faces of every axis at the same time."""
    way, low, high = end - start, box.minimum + grazed, box.maximum - grazed
    moves = way != 0.0
    if not ((low < start) & (start < high))[~moves].all() or (low >= high).any():
        return False
    shares = np.array([low - start, high - start])[:, moves] / way[moves]
    begin, finish = shares.min(axis=0).max(initial=0.0), shares.max(axis=0).min(initial=1.0)
    return bool(begin < finish or not moves.any())
