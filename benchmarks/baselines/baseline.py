# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The base class of the baselines: the planner's interface, with commands but no plans."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from orbimpc_ros.loop.compensation import Compensator
from orbimpc_ros.loop.planner import Decision, Snapshot
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.outcome import Status
from orbimpc_ros.mpc.plan import Command
from orbimpc_ros.mpc.problem import MovingObstacle, State
from orbimpc_ros.mpc.solve.solver import Late
from orbimpc_ros.ros.parameters.planner import PlannerSettings
from orbimpc_ros.sim.world import Flight

BEHIND: Mapping[str, float] = {'behind': 10.0}  # default with a cone of approach
LINED = math.radians(30.0)  # off the direction of approach: a vehicle within it is behind the goal


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
    """A controller of a planar vehicle of orders (1, 1).

    Args:
        settings: of the planner that it replaces.
        tuned: numbers of :attr:`TUNABLE`; defaults for the others.

    Attributes:
        TUNABLE: defaults of the numbers that may be tuned, by name.
        problem: that the planner would solve.
    """

    TUNABLE: ClassVar[dict[str, float]] = {}

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
    def steered(self, sight: Sight) -> tuple[float, float]:
        """Return the share of full speed and the body rate [rad/s], before limits."""

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
        sight = Sight(time, state, ahead.at, wind)
        command = self._limited(state, *self.steered(self._led(sight)))
        return Decision(
            Status.FEASIBLE, '', state, None, command, problem=self.problem, goals=goals
        )

    def sent(self, command: Command, at: float | None = None) -> None:
        """Register a command that was sent; see :meth:`Planner.sent`."""
        self._compensator.history.add(command, at)

    def _led(self, sight: Sight) -> Sight:
        """Return a sight with an intermediate goal on the line of approach, if there is one.

        A vehicle that is not yet behind the goal is led to a point behind it, at a distance of
        ``behind`` steps at full speed; otherwise to the middle of the remaining line.
        """
        if not self.cone.exists or 'behind' not in self.tuned:
            return sight
        axis = self.cone.axis(sight.state)
        away = sight.ahead(np.array([sight.time]))[0] - sight.state.position
        along = float(away @ axis)
        lined = along >= math.cos(LINED) * float(np.linalg.norm(away))
        behind = self.tuned['behind'] * self.problem.step * self.problem.forward
        back = (0.5 * along if lined else behind) * axis
        return sight._replace(ahead=lambda times: sight.ahead(times) - back)

    def steer(self, flight: Flight) -> None:  # noqa: B027
        """Leave the engine's own guidance, if it has one, alone."""

    def expect_hazards(self) -> None:  # noqa: B027
        """Compile nothing: a baseline solves none of the package's programs."""

    @property
    def fastest(self) -> float:
        """Return the largest body rate [rad/s]."""
        return self.problem.max_rate or math.pi / self.problem.step

    def _limited(self, state: State, fraction: float, rate: float) -> Command:
        least = self.problem.least_speed
        turn = np.array([min(max(rate, -self.fastest), self.fastest)])
        rotation = state.attitude @ exp(self.problem.step * turn)
        return Command(min(max(fraction, least), 1.0), turn, rotation)


def depths(hazards: Sequence[MovingObstacle], paths: Array, times: Array) -> Array:
    """Return the depths of points of paths inside of moving obstacles [m]; negative outside.

    Args:
        hazards: at least one.
        paths: shape (M, K, 2) [m].
        times: of their points, shape (K,) [s], in the hazards' own time.

    Returns:
        Shape (M, K).
    """
    points = [(paths - each.moved(times)).reshape(-1, 2) for each in hazards]
    found = [each.body.depth(p) for each, p in zip(hazards, points, strict=True)]
    return np.asarray(np.max(found, axis=0).reshape(paths.shape[:2]))


def wrapped(angle: Any) -> Any:
    """Return an angle, or each of an array, in [-pi, pi) [rad]."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
