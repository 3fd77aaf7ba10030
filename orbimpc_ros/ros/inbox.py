"""What the planner has been told: the latest of each input, its age, and what was refused."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.forecast import Forecast, Itinerary, Sighting, forecast_named
from orbimpc_ros.mpc.odometry import Odometry
from orbimpc_ros.ros.messages import (
    Stamp,
    read_itinerary,
    read_odometry,
    read_sighting,
)
from orbimpc_ros.ros.planner_parameters import PlannerSettings

T = TypeVar('T')


@dataclass(frozen=True)
class Arrival(Generic[T]):
    """A message taken in.

    Attributes:
        stamp: the sender's.
        value: what it said.
        at: when it came, on the steady clock [s].
    """

    stamp: Stamp
    value: T
    at: float


@dataclass
class Inbox:
    """The planner's inputs. Times named ``now`` are of the steady clock [s].

    Attributes:
        settings: dimension, frames and timeouts.
        odometry: the latest, if any.
        goal: the latest, if any.
        path: the latest forecast from outside, if any.
        forecast: predicts the goal from its sightings.
        refused: messages refused so far, by topic and field.
        synchronised: topics whose stamps have been seen to equal the odometry's.
    """

    settings: PlannerSettings
    odometry: Arrival[Odometry] | None = None
    goal: Arrival[Sighting] | None = None
    path: Arrival[Itinerary] | None = None
    forecast: Forecast = field(init=False)
    refused: Counter[str] = field(default_factory=Counter)
    synchronised: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.forecast = forecast_named(self.settings.goal_prediction)

    def adopt(self, settings: PlannerSettings) -> None:
        """Take over new settings; another kind of forecast starts afresh from the last goal."""
        renewed = settings.goal_prediction != self.settings.goal_prediction
        self.settings = settings
        if renewed:
            self.forecast = forecast_named(settings.goal_prediction)
            if self.goal is not None:
                self.forecast.observe(self.goal.value)

    def forget(self) -> None:
        """Forget every input, as after a reset or when the clock went back."""
        self.odometry = self.goal = self.path = None
        self.forecast.reset()

    def take_odometry(self, message: Any, now: float) -> str:
        """Take in an odometry message; return why it was refused, or an empty string."""
        return self._take('odom', message, now)

    def take_goal(self, message: Any, now: float) -> str:
        """Take in a goal; return why it was refused, or an empty string."""
        refusal = self._take('goal', message, now)
        if not refusal and self.goal is not None:
            self.forecast.observe(self.goal.value)
        return refusal

    def take_path(self, message: Any, now: float) -> str:
        """Take in a goal's path; return why it was refused, or an empty string."""
        return self._take('goal_path', message, now)

    def _take(self, topic: str, message: Any, now: float) -> str:
        read = {'odom': read_odometry, 'goal': read_sighting, 'goal_path': read_itinerary}[topic]
        attribute = {'odom': 'odometry', 'goal': 'goal', 'goal_path': 'path'}[topic]
        settings = self.settings
        try:
            stamp, value = read(message, settings.problem.dimension, settings.frames)
            self._require_newer(topic, stamp, getattr(self, attribute), now)
        except BadInput as error:
            self.refused[f'{topic}: {error.culprit}'] += 1
            return f'{topic} refused: {error}'
        setattr(self, attribute, Arrival(stamp, value, now))
        self._note_synchronised()
        return ''

    def _require_newer(
        self, topic: str, stamp: Stamp, last: Arrival[Any] | None, now: float
    ) -> None:
        if last is None or stamp.nanoseconds > last.stamp.nanoseconds:
            return
        if stamp.nanoseconds == last.stamp.nanoseconds:
            raise BadInput('duplicate stamp', stamp.nanoseconds, 'stamps that increase')
        # Once the last one is stale, an older stamp means that the sender's clock was set back.
        if now - last.at <= self._timeout(topic):
            raise BadInput('reordered stamp', stamp.nanoseconds, 'stamps that increase')
        self.forget()

    def _timeout(self, topic: str) -> float:
        return self.settings.odom_timeout if topic == 'odom' else self.settings.goal_timeout

    def _goal_sources(self) -> dict[str, Arrival[Any]]:
        sources = {'goal': self.goal, 'goal_path': self.path}
        return {topic: arrival for topic, arrival in sources.items() if arrival is not None}

    def _note_synchronised(self) -> None:
        for topic, arrival in self._goal_sources().items():
            if self.odometry is not None and arrival.stamp.nanoseconds == self._time:
                self.synchronised.add(topic)

    @property
    def _time(self) -> int:
        return -1 if self.odometry is None else self.odometry.stamp.nanoseconds

    @property
    def complete(self) -> bool:
        """Return whether nothing is missing, nor any synchronised source yet to speak."""
        sources = self._goal_sources()
        return not self.missing and all(
            topic in sources and sources[topic].stamp.nanoseconds >= self._time
            for topic in self.synchronised
        )

    @property
    def missing(self) -> str:
        """Return what no plan can be made without, in words; empty if nothing is missing."""
        absent = []
        if self.odometry is None:
            absent.append('odometry on odom')
        if not self._goal_sources():
            absent.append('a goal on goal or goal_path')
        return ' and '.join(absent)

    def stale(self, now: float) -> str:
        """Return which input is too old to plan with, in words; empty if none is."""
        if self.odometry is not None and now - self.odometry.at > self.settings.odom_timeout:
            return f'odometry is {now - self.odometry.at:.2f} s old'
        ages = [now - arrival.at for arrival in self._goal_sources().values()]
        if ages and min(ages) > self.settings.goal_timeout:
            return f'the goal is {min(ages):.2f} s old'
        return ''

    def targets(self, steps: int, now: float) -> Array:
        """Return the goals at the ends of the next ``steps`` steps, shape (steps, n) [m].

        A forecast from outside is used while it is fresh; otherwise one's own.
        """
        assert self.odometry is not None
        ahead = self.settings.problem.step * np.arange(1, steps + 1)
        times = self.odometry.value.time + ahead
        if self.path is not None and now - self.path.at <= self.settings.goal_timeout:
            return self.path.value.at(times)
        return self.forecast.at(times)
