# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The simulated world: the flight of a vehicle to its goal, among boxes and traffic."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from orbimpc_ros.loop.capture import closest_approach, is_headed
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.check import TOLERANCE
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.problem import Ball, MovingObstacle
from orbimpc_ros.sim import vehicle as vehicles
from orbimpc_ros.sim.engines import EngineFailure, Vehicle
from orbimpc_ros.sim.parameters import SimSettings
from orbimpc_ros.sim.vehicle import Plant

ROUNDING = 1e-6  # relative tolerance of the stall speed


@dataclass(frozen=True)
class Flight:
    """A flight after some steps.

    With finish ``capture``, it ends as soon as the goal is caught; with ``arrival``, after
    ``max_ticks``, when the vehicle must be at the goal. Touching a box or a ball fails it.

    ``touched`` holds the indices of the boxes, followed by those of the balls, that the vehicle has
    entered so far by more than the tolerance of plans.
    """

    settings: SimSettings
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
    def goal(self) -> Array:
        """Return the current position of the goal, shape (n,) [m]."""
        if self.vehicle.goal is not None:
            return self.vehicle.goal
        return self.settings.rope_at(self.vehicle.time)

    @property
    def _place(self) -> Array:
        """Return the vehicle's position and its height past the rope's ends, shape (n + 1,) [m]."""
        height = self.vehicle.height
        past = max(0.0, abs(height) - 0.5 * self.settings.rope_length)
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
        return self.vehicle.airspeed < self.settings.stall_speed * (1.0 - ROUNDING)

    @property
    def captured(self) -> bool:
        """Return True if the goal was caught in the last step, or has been arrived at.

        A flight that touched a box or a ball has failed.
        """
        settings, fastest = self.settings, self.settings.arrival_speed or np.inf
        if settings.finish == 'arrival':
            there = self.distance <= settings.arrival_radius and self.speed <= fastest
            return there and self.ticks >= settings.max_ticks and not self.touched
        return self.near and self.headed and not self.touched

    @property
    def near(self) -> bool:
        """Return True if the goal came within the capture radius in the last step.

        If an engine judges catches, return True if the goal has been caught.
        """
        judged = self.vehicle.caught
        return self.miss <= self.settings.capture_radius if judged is None else judged

    @property
    def over(self) -> bool:
        """Return True if the goal is caught or lost, or the steps are used up."""
        return self.captured or self.vehicle.lost or self.ticks >= self.settings.max_ticks

    def after(self, fraction: float, body_rate: Array, held: float = np.inf) -> Flight:
        """Return the flight one step later; the vehicle's model defines when the command acts.

        Args:
            fraction: commanded share of full speed or thrust.
            body_rate: commanded, shape (1,) or (3,) [rad/s].
            held: duration of the command within the step [s]; then the failsafe of the model acts.
        """
        model, engine, trail = self.settings.model, self.vehicle.engine, tuple[Vehicle, ...]()

        def flown(vehicle: Vehicle, *command: Any) -> tuple[Vehicle, ...]:
            return engine.run(*command) if engine else model.flown(vehicle, *command)

        if held > 0.0:
            trail = flown(self.vehicle, min(held, model.step), fraction, body_rate)
        if held < model.step:
            (share, turn), last = self.settings.failsafe, (self.vehicle, *trail)[-1]
            if not (engine or isinstance(model, Plant)):  # at once; at order 2 the vehicle coasts
                last = replace(last, fraction=share, body_rate=turn)
            trail += flown(last, model.step - max(0.0, held), share, turn)
        return self._along(trail)

    def _along(self, trail: tuple[Vehicle, ...]) -> Flight:
        """Return the flight after a step along a trail, with the goal moving on."""
        miss, missed_at, headed = np.inf, np.nan, False
        before, bodies = self, self.settings.bodies
        model = self.settings.model
        unit = model.step**model.translation_order * model.forward  # of lengths, as in the Problem
        grazed = TOLERANCE * unit  # penetration allowed in plans
        for vehicle in trail:
            now, times = replace(before, vehicle=vehicle), (before.vehicle.time, vehicle.time)
            goals = np.append(before.goal, 0.0), np.append(now.goal, 0.0)
            near, share = map(float, closest_approach((before._place, now._place), goals))
            if near < miss and not (before.vehicle.caught or before.vehicle.lost):
                miss, missed_at = near, times[0] + share * (times[1] - times[0])
                headings = before.vehicle.attitude[:, 0], vehicle.attitude[:, 0]
                headed = is_headed(self.settings.approach, headings, share)
            ends = before.vehicle.position, vehicle.position
            before = replace(
                now,
                touched=now.touched | touched(bodies, ends, times, grazed),
                least_airspeed=min(before.least_airspeed, vehicle.airspeed),
                stalls=before.stalls + (now.stalled and not before.stalled),
            )
        return replace(
            before, ticks=self.ticks + 1, miss=miss, missed_at=missed_at, headed=headed, trail=trail
        )


def departure(settings: SimSettings) -> Flight:
    """Return the flight before its first step.

    Raises:
        BadInput: an engine is not installed, or cannot start from the initial state.
    """
    start = settings.start
    if settings.vehicle in vehicles.ENGINES:
        start = replace(start, wind=settings.model.blown, goal=settings.rope_at(0.0))
        conditions = settings.forward, settings.gust, settings.seed, settings.rope[0]
        try:
            engine = vehicles.class_of(settings.vehicle)(start, *conditions)
        except EngineFailure as error:
            raise BadInput('vehicle', settings.vehicle, f'a possible start ({error})') from None
        start = replace(engine.state(), engine=engine)
    else:  # at order 1, this gives it the velocity of its speed in this air
        (start,) = settings.model.flown(start, 0.0, start.fraction, start.body_rate)
    flight = Flight(settings, start, least_airspeed=start.airspeed)
    return replace(flight, stalls=int(flight.stalled))


def touched_in_words(numbers: Collection[int], boxes: int) -> str:
    """Return the names, counted from 1, of touched bodies: ``boxes`` boxes, then balls."""
    return ', '.join(
        f'box {k + 1}' if k < boxes else f'ball {k + 1 - boxes}' for k in sorted(numbers)
    )


def outcome(flight: Flight) -> str:
    """Describe how a flight has ended."""
    if flight.touched:
        return f'touched {touched_in_words(flight.touched, len(flight.settings.boxes))}'
    if flight.settings.finish == 'arrival':
        where = f'{flight.distance:.2e} m from the goal at {flight.speed:.2e} m/s'
        return f'{"" if flight.captured else "not "}arrived: {where}'
    if flight.captured:
        return f'captured at t = {flight.missed_at:.2f} s, {flight.miss:.3f} m from the goal'
    if flight.near:
        return f'not captured: {flight.miss:.3f} m from the goal, outside the cone of approach'
    struck = ': another part of the vehicle touched the goal first'
    return f'not captured{struck if flight.vehicle.lost else ""}'


def touched(
    bodies: Sequence[MovingObstacle],
    flown: tuple[Array, Array],
    times: tuple[float, float],
    grazed: float = 0.0,
) -> frozenset[int]:
    """Return the indices of the bodies that a straight path enters while they move linearly.

    It is ``flown`` between two ``times`` since the start [s]; depths up to ``grazed`` [m] do not
    count. Between both faces of a box on every axis at the same time it is inside.
    """
    indices = []
    for k, each in enumerate(bodies):
        body, (start, end) = each.body, np.array(flown) - each.moved(np.array(times))
        if isinstance(body, Ball):
            nearest, _ = closest_approach((start, end), (body.centre, body.centre))
            entered = nearest < body.radius - grazed
        else:
            low, high = body.minimum + grazed, body.maximum - grazed
            with np.errstate(divide='ignore', invalid='ignore'):  # at rest: +-inf, NaN on a face
                shares = np.array([low - start, high - start]) / (end - start)
            begin, finish = shares.min(axis=0).max(initial=0.0), shares.max(axis=0).min(initial=1.0)
            entered = (low < high).all() and begin < finish
        if entered:
            indices.append(k)
    return frozenset(indices)
