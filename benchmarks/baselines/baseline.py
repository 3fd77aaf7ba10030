# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Guidance laws in the planner's place: its interface, with commands but no plans.

In traffic they sidestep: the course closest to the wanted one that stays clear of moving obstacles,
by velocity obstacles (Fiorini and Shiller 1998) for a vehicle with a limited turn rate.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from orbimpc_ros.loop.compensation import Compensator
from orbimpc_ros.loop.planner import Decision, Snapshot
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.outcome import Status
from orbimpc_ros.mpc.plan import Command
from orbimpc_ros.mpc.problem import State
from orbimpc_ros.mpc.solve.solver import Late
from orbimpc_ros.ros.parameters.planner import PlannerSettings
from orbimpc_ros.sim.world import Flight

LINED = math.radians(30.0)  # off the direction of approach: a vehicle within it is behind the goal
LOOKS, FARTHEST = 240, 12.0  # points of the forecast, and its length in horizons
NEAR = 1e-9
ASIDE = math.radians(60.0)  # angle to the line of sight up to which a small-angle law holds
COURSES, POINTS = 72, 24  # of sidesteps: courses, and points on each
SLOWER = (1.0, 0.6, 0.2)  # shares of the wanted speed; losing all of it counts as half a turn


class Sight(NamedTuple):
    """The inputs of a baseline at a tick."""

    time: float  # earliest time at which a command can act, after lags [s]
    state: State  # at that time, from which moving obstacles count their time
    # returns the goal's positions at times, shape (M,) [s], as shape (M, 2) [m]
    ahead: Callable[[Array], Array]
    wind: Array  # shape (2,) [m/s]

    @property
    def heading(self) -> float:
        """Return the vehicle's heading [rad]."""
        return math.atan2(self.state.attitude[1, 0], self.state.attitude[0, 0])


class Baseline(ABC):
    """A controller of a planar vehicle of orders (1, 1), by a guidance law.

    Args:
        settings: of the planner that it replaces.
        tuned: numbers of :attr:`TUNABLE`; defaults for the others.

    Attributes:
        TUNABLE: defaults of the numbers that may be tuned, by name. A sidestep keeps a ``margin``
            to moving obstacles, in steps at full speed, and looks ``look`` steps ahead; to a goal
            with a cone of approach, the way leads ``behind`` it, in steps at full speed.
        problem: that the planner would solve.
    """

    TUNABLE: ClassVar[dict[str, float]] = {'behind': 10.0, 'margin': 0.2, 'look': 8.0}

    def __init__(self, settings: PlannerSettings, tuned: Mapping[str, float]) -> None:
        self.problem = settings.problem
        self._compensator = Compensator(
            settings.problem,
            settings.response,
            settings.disturbance,
            estimated=settings.estimated,
            velocity_source=settings.velocity_source,
            sideslip=settings.sideslip,
        )
        self.cone = settings.approach
        self.tuned = {**self.TUNABLE, **tuned}

    @abstractmethod
    def wanted(self, sight: Sight) -> tuple[float, float]:
        """Return the heading at the end of the step [rad], and the share of full speed."""

    def steered(self, sight: Sight) -> Command:
        """Return the command of the law, or that of a sidestep, within the vehicle's limits."""
        heading, fraction = self.wanted(self._led(sight))
        if sight.state.hazards:
            heading, fraction = self._sidestepped(sight, heading, fraction)
        rate = wrapped(heading - sight.heading) / self.problem.step
        turn = np.array([min(max(rate, -self.fastest), self.fastest)])
        rotation = sight.state.attitude @ exp(self.problem.step * turn)
        return Command(min(max(fraction, self.problem.least_speed), 1.0), turn, rotation)

    def step(
        self, snapshot: Snapshot, now: float | None = None, late: Late | None = None
    ) -> Decision:
        """Return a decision with the command; see :meth:`Planner.step`."""
        assert snapshot.odometry is not None
        assert snapshot.goal is not None
        assert not isinstance(snapshot.goal, np.ndarray)
        ahead = snapshot.goal
        start = self._compensator.start(snapshot.odometry, snapshot.latency, now)
        time, wind = start.odometry.time, self._compensator.disturbance
        hazards = () if snapshot.traffic is None else tuple(snapshot.traffic.hazards(time))
        state = State.at(**start.state, hazards=hazards)
        goals = ahead.at(time + self.problem.step * np.arange(1.0, self.problem.horizon + 1.0))
        command = self.steered(Sight(time, state, ahead.at, wind))
        return Decision(
            Status.FEASIBLE, '', state, None, command, problem=self.problem, goals=goals
        )

    def sent(self, command: Command, at: float | None = None) -> None:
        """Register a command that was sent; see :meth:`Planner.sent`."""
        self._compensator.history.add(command, at)

    def steer(self, flight: Flight) -> None:  # noqa: B027
        """Leave the engine's own guidance, if it has one, alone."""

    def expect_hazards(self) -> None:  # noqa: B027
        """Compile nothing: a baseline solves none of the package's programs."""

    @property
    def fastest(self) -> float:
        """Return the largest body rate [rad/s]."""
        return self.problem.max_rate or math.pi / self.problem.step

    def _led(self, sight: Sight) -> Sight:
        """Return a sight with an intermediate goal on the line of approach, if there is one.

        A vehicle that is not yet behind the goal is led to a point behind it; otherwise to the
        middle of the remaining line.
        """
        if not self.cone.exists:
            return sight
        axis = self.cone.axis(sight.state)
        away = sight.ahead(np.array([sight.time]))[0] - sight.state.position
        along = float(away @ axis)
        lined = along >= math.cos(LINED) * float(np.linalg.norm(away))
        behind = self.tuned['behind'] * self.problem.step * self.problem.forward
        back = (0.5 * along if lined else behind) * axis
        return sight._replace(ahead=lambda times: sight.ahead(times) - back)

    def _sidestepped(self, sight: Sight, heading: float, fraction: float) -> tuple[float, float]:
        """Return the heading [rad] and the share of full speed of a sidestep.

        It is the least detour that is clear of all, or else the one of least depth.
        """
        problem = self.problem
        times = problem.step * self.tuned['look'] * np.arange(1, POINTS + 1) / POINTS
        aside = math.pi * (2.0 * np.arange(COURSES) / COURSES - 1.0)
        shares = np.maximum(np.array(SLOWER) * fraction, problem.least_speed)
        each, speeds = (grid.ravel() for grid in np.meshgrid(aside, shares))
        points = self._flown(sight, heading + each, speeds, times).reshape(-1, 2)
        met = [body.depth(points, np.tile(times, len(each))) for body in sight.state.hazards]
        deepest = np.max(met, axis=0).reshape(-1, POINTS).max(axis=1)
        clear = deepest < -self.tuned['margin'] * problem.step * problem.forward
        detour = np.abs(each) / math.pi + (1.0 - speeds / fraction)
        best = int(np.argmin(np.where(clear, detour, np.inf) if clear.any() else deepest))
        return heading + float(each[best]), float(speeds[best])

    def _flown(self, sight: Sight, courses: Array, fractions: Array, times: Array) -> Array:
        """Return paths that turn to courses [rad] at shares of full speed, shape (M, K, 2) [m]."""
        turn = wrapped(courses - sight.heading)
        each = times[1] - times[0]
        most = self.fastest * (times - 0.5 * each)
        headings = sight.heading + np.clip(turn[:, None], -most, most)
        airspeed = self.problem.forward * fractions[:, None, None]
        velocity = airspeed * np.stack([np.cos(headings), np.sin(headings)], axis=-1) + sight.wind
        return np.asarray(sight.state.position + each * np.cumsum(velocity, axis=1))


class PurePursuit(Baseline):
    """Pure pursuit: flies along the line of sight over ground, crabbed into the wind."""

    TUNABLE = Baseline.TUNABLE | {'gain': 1.0, 'fraction': 1.0}

    def wanted(self, sight: Sight) -> tuple[float, float]:
        """Return the heading after a share of the turn to the line of sight, and the speed."""
        away = sight.ahead(np.array([sight.time]))[0] - sight.state.position
        speed = self.tuned['fraction'] * self.problem.forward
        course = crabbed(away, speed, sight.wind)
        turn = self.tuned['gain'] * wrapped(course - sight.heading)
        return sight.heading + turn, self.tuned['fraction']


class Lead(Baseline):
    """Lead pursuit: straight to the earliest point of interception in the wind.

    ``turn`` is the share of the time for the first turn that counts as lost.
    """

    TUNABLE = Baseline.TUNABLE | {'gain': 1.0, 'fraction': 1.0, 'turn': 0.3}

    def wanted(self, sight: Sight) -> tuple[float, float]:
        """Return the heading after a share of the turn to the interception, and the speed."""
        course, fraction = self._meeting(sight)
        return sight.heading + self.tuned['gain'] * wrapped(course - sight.heading), fraction

    def _meeting(self, sight: Sight) -> tuple[float, float]:
        """Return the heading to the interception [rad], and the share of full speed for it."""
        problem, fraction = self.problem, self.tuned['fraction']
        longest = FARTHEST * problem.horizon * problem.step
        times = np.linspace(0.0, longest, LOOKS + 1)[1:]
        away = sight.ahead(sight.time + times) - sight.state.position - np.outer(times, sight.wind)
        distance, angle = np.linalg.norm(away, axis=1), np.arctan2(away[:, 1], away[:, 0])
        turn = np.abs(wrapped(angle - sight.heading))
        left = times - self.tuned['turn'] * turn / self.fastest
        met = distance <= np.maximum(left, 0.0) * fraction * problem.forward
        first = int(np.argmax(met)) if met.any() else LOOKS - 1
        needed = distance[first] / (max(left[first], NEAR) * problem.forward)
        return float(angle[first]), min(fraction, float(needed)) if met.any() else fraction


class Waypoint(Baseline):
    """Full speed; the guidance of an engine steers to the goal's present position."""

    def wanted(self, sight: Sight) -> tuple[float, float]:
        """Return the present heading, and full speed."""
        return sight.heading, 1.0

    def steer(self, flight: Flight) -> None:
        """Have the engine's own guidance fly to the present position of the goal.

        Raises:
            BadInput: the vehicle has no engine with its own guidance.
        """
        steer_to = getattr(flight.vehicle.engine, 'steer_to', None)
        if steer_to is None:
            raise BadInput('--controllers', 'waypoint', 'an engine with its own guidance')
        steer_to(flight.goal)


class Proportional(Baseline):
    """Proportional navigation: turns in proportion to the rate of the line of sight.

    Far off the line of sight it first turns to the line.
    """

    TUNABLE = Baseline.TUNABLE | {'constant': 3.0, 'fraction': 1.0}

    def wanted(self, sight: Sight) -> tuple[float, float]:
        """Return the heading after a step at the rate of the law, and the speed."""
        step = self.problem.step
        now, soon = sight.ahead(sight.time + np.array([0.0, step]))
        away, fraction = now - sight.state.position, self.tuned['fraction']
        off = wrapped(math.atan2(away[1], away[0]) - sight.heading)
        if abs(off) > ASIDE:
            return sight.heading + off, fraction
        axis = sight.state.attitude[:, 0]
        closing = (soon - now) / step - fraction * self.problem.forward * axis - sight.wind
        turned = (away[0] * closing[1] - away[1] * closing[0]) / max(float(away @ away), NEAR)
        most = step * self.fastest  # larger turns would wrap to the other side
        turn = min(max(step * self.tuned['constant'] * turned, -most), most)
        return sight.heading + turn, fraction


def crabbed(way: Array, speed: float, wind: Array) -> float:
    """Return the heading to fly a direction over ground, as far as the wind allows [rad].

    Args:
        way: direction over ground, of any length, shape (2,).
        speed: through the air [m/s].
        wind: shape (2,) [m/s].
    """
    course = math.atan2(way[1], way[0])
    across = -math.sin(course) * wind[0] + math.cos(course) * wind[1]
    return course - math.asin(min(max(across / speed, -1.0), 1.0))


def wrapped(angle: Any) -> Any:
    """Return an angle, or each of an array, in [-pi, pi) [rad]."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
