"""The base of the rivals: a controller whose commands come from elsewhere than from a plan."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import ClassVar, NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.command import Command
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.loop.controller import Controller, Tick
from orbimpc_ros.mpc.loop.odometry import Odometry
from orbimpc_ros.mpc.outcome import Status
from orbimpc_ros.mpc.problem import State
from orbimpc_ros.ros.parameters.planner import PlannerSettings


class Range(NamedTuple):
    """What a number may be tuned to: its default, and the ends of its range, in equal ratios."""

    default: float
    low: float
    high: float


class Sight(NamedTuple):
    """What a pilot knows at a tick.

    Attributes:
        time: from when on it can act, its lags being over [s].
        state: then.
        goals: g_1..g_N at the ends of the steps, shape (N, 2) [m].
        ahead: returns where the goal will be at times, shape (M,) [s], as shape (M, 2) [m].
        wind: shape (2,) [m/s].
    """

    time: float
    state: State
    goals: Array
    ahead: Callable[[Array], Array]
    wind: Array

    @property
    def heading(self) -> float:
        """Return where the vehicle points [rad]."""
        return math.atan2(self.state.attitude[1, 0], self.state.attitude[0, 0])


class Rival(Controller, ABC):
    """Flies a planar vehicle of orders (1, 1).

    Args:
        settings: of the planner in whose place it flies.
        tuned: numbers of :attr:`SPACE`; defaults for the others.

    Attributes:
        SPACE: what may be tuned, by name.
    """

    SPACE: ClassVar[Mapping[str, Range]] = {}

    def __init__(self, settings: PlannerSettings, tuned: Mapping[str, float]) -> None:
        super().__init__(
            settings.problem,
            safe=settings.safe_command,
            response=settings.response,
            disturbance=settings.disturbance,
            velocity_source=settings.velocity_source,
        )
        self.radius = settings.capture_radius
        self.tuned = {name: each.default for name, each in self.SPACE.items()} | dict(tuned)

    @abstractmethod
    def steered(self, sight: Sight) -> tuple[float, float]:
        """Return the share of full speed and the body rate [rad/s], still to be limited."""

    def tick(
        self,
        odometry: Odometry,
        goals: Array,
        out_of_time: Callable[[], bool] | None = None,
        ahead: Callable[[Array], Array] | None = None,
        wanted: Array | None = None,
    ) -> Tick:
        """Return the command that it steers; see :meth:`Controller.tick`."""
        assert ahead is not None
        state = self._state(odometry)
        self._begin(odometry)
        wind = np.zeros(2) if self.disturbance is None else self.disturbance
        command = self._limited(
            state, *self.steered(Sight(odometry.time, state, goals, ahead, wind))
        )
        known = self.problem, np.array(goals)
        return self._finish(
            Tick(Status.FEASIBLE, '', state, None, command, problem=known[0], goals=known[1])
        )

    @property
    def fastest(self) -> float:
        """Return the largest body rate [rad/s]."""
        return self.problem.max_rate or math.pi / self.problem.step

    def turning(self, angle: float) -> float:
        """Return the rate that turns by an angle within a step, as far as the limit allows."""
        rate = wrapped(angle) / self.problem.step
        return min(max(rate, -self.fastest), self.fastest)

    def _limited(self, state: State, fraction: float, rate: float) -> Command:
        least = self.problem.floor.clearance(2)
        turn = np.array([min(max(rate, -self.fastest), self.fastest)])
        rotation = state.attitude @ exp(self.problem.step * turn)
        return Command(min(max(fraction, least), 1.0), turn, rotation)


def wrapped(angle: float) -> float:
    """Return an angle in [-pi, pi) [rad]."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
