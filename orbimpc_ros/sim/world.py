# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The simulated world: a swinging rope, boxes, traffic, and a flight among them, step by step."""

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
ROUNDING = 1e-6  # of the stall speed


@dataclass(frozen=True)
class Rope:
    """A rope at g(t) = center + velocity t + amplitude * sin(2 pi f t + phase), axis by axis.

    What is one number is that along all axes: a rope of which only the center is told stays there.
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

    A flight to a ``capture`` ends as soon as the goal is caught; one to an ``arrival`` ends after
    ``max_ticks`` and has to be at the goal then. It fails if it touches a box or a ball.
    """

    model: Model
    start: Vehicle  # its time is the start's
    rope: Rope  # the goal, swinging or fixed
    capture_radius: float  # the goal counts as caught within it [m]
    max_ticks: int  # steps after which the flight ends
    finish: str = 'capture'
    arrival_radius: float = 0.05  # how far from the goal a vehicle that has arrived may be [m]
    arrival_speed: float = 0.0  # and how fast [m/s]; 0 for any speed
    obstacles: tuple[Box, ...] = ()
    traffic: tuple[MovingObstacle, ...] = ()  # balls, each moving evenly from the start on
    approach: Approach = field(default_factory=Approach)  # headings that count at a capture
    rope_length: float = 0.0  # the rope hangs so far, half of it above the plane of flight [m]


@dataclass(frozen=True)
class Flight:
    """A scenario after some steps.

    It has ``touched`` the boxes, and on from their count the balls, that it has been in so far,
    farther than the tolerance of plans.
    """

    scenario: Scenario
    vehicle: Vehicle  # now
    ticks: int = 0  # steps flown
    miss: float = np.inf  # least distance to the goal during the last step [m]
    missed_at: float = np.nan  # when that was [s]
    headed: bool = False  # whether it was within the cone of approach then
    trail: tuple[Vehicle, ...] = ()  # the vehicle on its way through the last step, to its end
    touched: frozenset[int] = frozenset()
    least_airspeed: float = math.inf  # since the start [m/s]
    stalls: int = 0  # how often it fell below the stall speed since then

    @property
    def elapsed(self) -> float:
        """Return the time since the start [s]: the rope's own time."""
        return self.vehicle.time - self.scenario.start.time

    @property
    def goal(self) -> Array:
        """Return where the goal is now, shape (n,) [m]."""
        if self.vehicle.goal is not None:
            return self.vehicle.goal
        return self.scenario.rope.at(self.elapsed)

    @property
    def _place(self) -> Array:
        """Return where the vehicle is, and how far past the rope's ends, shape (n + 1,) [m]."""
        height = self.vehicle.height
        past = max(0.0, abs(height) - 0.5 * self.scenario.rope_length)
        return np.append(self.vehicle.position, math.copysign(past, height))

    @property
    def distance(self) -> float:
        """Return how far the goal is now [m]."""
        return float(np.linalg.norm(self.vehicle.position - self.goal))

    @property
    def speed(self) -> float:
        """Return how fast the vehicle is now [m/s]."""
        return float(np.linalg.norm(self.vehicle.velocity))

    @property
    def stalled(self) -> bool:
        """Return whether the vehicle is slower than its stall speed."""
        return self.vehicle.airspeed < self.scenario.model.stall_speed * (1.0 - ROUNDING)

    @property
    def captured(self) -> bool:
        """Return whether the goal was caught by the last step, or arrived at.

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
        """Return whether the goal came within the capture radius in the last step.

        Where an engine decides that, it is whether the goal has been caught.
        """
        judged = self.vehicle.caught
        return self.miss <= self.scenario.capture_radius if judged is None else judged

    @property
    def over(self) -> bool:
        """Return whether the goal is caught or lost, or the steps are used up."""
        return self.captured or self.vehicle.lost or self.ticks >= self.scenario.max_ticks

    def after(self, fraction: float, body_rate: Array, held: float = np.inf) -> Flight:
        """Return the flight one step later, the command taken over as the vehicle's model does.

        Args:
            fraction: commanded share of full speed or thrust.
            body_rate: commanded, shape (1,) or (3,) [rad/s].
            held: how long into the step the command is in force [s]; after that the model's
                failsafe is.
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
        """Return the flight after a step along a trail, its goal swinging on."""
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
        grazed = TOLERANCE * self.scenario.model.length_unit  # as far as plans may lead inside
        balls = met(self.scenario.traffic, way, (self.elapsed, now.elapsed), grazed)
        return touched(boxes, *way, grazed) | {len(boxes) + number for number in balls}


def departure(scenario: Scenario, time: float | None = None) -> Flight:
    """Return the flight before its first step; ``time`` [s] moves the start on the clock."""
    start = scenario.model.begun(scenario.start)
    if time is not None:
        start = replace(start, time=time)
    flight = Flight(replace(scenario, start=start), start, least_airspeed=start.airspeed)
    return replace(flight, stalls=int(flight.stalled))


def touched_in_words(numbers: Collection[int], boxes: int) -> str:
    """Return the names of touched boxes and balls, counted from 1, of which so many are boxes."""
    return ', '.join(
        f'box {k + 1}' if k < boxes else f'ball {k + 1 - boxes}' for k in sorted(numbers)
    )


def outcome(flight: Flight) -> str:
    """Return in words how a flight has ended."""
    done = '' if flight.captured else 'not '
    if flight.touched:
        return f'touched {touched_in_words(flight.touched, len(flight.scenario.obstacles))}'
    if flight.scenario.finish == 'arrival':
        where = f'{flight.distance:.2e} m from the goal at {flight.speed:.2e} m/s'
        return f'{done}arrived: {where}'
    if not flight.captured and flight.near:
        return f'not captured: {flight.miss:.3f} m from the goal, outside the cone of approach'
    if flight.vehicle.lost:
        return 'not captured: something else of the vehicle touched the goal first'
    if not flight.captured:
        return 'not captured'
    when = flight.missed_at - flight.scenario.start.time
    return f'captured at t = {when:.2f} s, {flight.miss:.3f} m from the goal'


def touched(boxes: Sequence[Box], start: Array, end: Array, grazed: float = 0.0) -> frozenset[int]:
    """Return the numbers of the boxes that a straight path is in, deeper than ``grazed`` [m]."""
    return frozenset(k for k, box in enumerate(boxes) if _crosses(box, start, end, grazed))


def met(
    traffic: Sequence[MovingObstacle],
    flown: tuple[Array, Array],
    times: tuple[float, float],
    grazed: float = 0.0,
) -> frozenset[int]:
    """Return the numbers of the balls that a straight path meets while they move evenly.

    It is ``flown`` between two ``times`` since the start [s]; a ``grazed`` depth does not count.
    """
    found = set()
    for number, each in enumerate(traffic):
        begin, end = centre(each.body) + each.moved(np.array(times))
        nearest, _ = closest_approach(flown, (begin, end))
        if isinstance(each.body, Ball) and nearest < each.body.radius - grazed:
            found.add(number)
    return frozenset(found)


def _crosses(box: Box, start: Array, end: Array, grazed: float) -> bool:
    """Return whether a path is between both faces of every axis at the same time."""
    way, low, high = end - start, box.minimum + grazed, box.maximum - grazed
    moves = way != 0.0
    if not ((low < start) & (start < high))[~moves].all() or (low >= high).any():
        return False
    shares = np.array([low - start, high - start])[:, moves] / way[moves]
    begin, finish = shares.min(axis=0).max(initial=0.0), shares.max(axis=0).min(initial=1.0)
    return bool(begin < finish or not moves.any())
