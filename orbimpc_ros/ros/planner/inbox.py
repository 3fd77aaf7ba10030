"""The planner's inputs: the latest of each, its age, and what was refused."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.loop.forecast import Forecast, Itinerary, Sighting, forecast_named
from orbimpc_ros.mpc.loop.odometry import Odometry
from orbimpc_ros.ros.arrival import COMPARABLE, UNKNOWN, Arrival, RosTime
from orbimpc_ros.ros.messages import (
    SECOND,
    Stamp,
    read_itinerary,
    read_odometry,
    read_sighting,
)
from orbimpc_ros.ros.parameters.planner import Ageing, PlannerSettings
from orbimpc_ros.ros.planner.pairing import Pairing

INCREASING = 'stamps that increase'
NOT_SET = (
    'header.stamp set to the time of measurement (in code get_clock().now().to_msg(), with '
    'ros2 topic pub "header: auto")'
)
STREAM = 3  # goals one soon after another are a stream, which is missed when it stops
TOPICS = ('odom', 'goal', 'goal_path')


@dataclass
class Inbox:
    """The planner's inputs.

    Times named ``now`` are of the steady clock [s], those named ``ros`` of the node's ROS clock.

    Attributes:
        settings: dimension, frames, timeouts and limits.
        names: of the topics as they are resolved, by their names here.
        odometry: the latest, if any.
        goal: the latest, if any.
        path: the latest forecast from outside, if any.
        forecast: predicts the goal from its sightings.
        refused: messages refused so far, by topic and field.
        goal_counts: goals taken in so far, by topic.
        pairings: whether each topic of the goal accompanies the odometry.
        timed: topics whose stamps have been seen to be of the node's own clock.
    """

    settings: PlannerSettings
    names: Mapping[str, str] = field(default_factory=lambda: {each: each for each in TOPICS})
    odometry: Arrival[Odometry] | None = None
    goal: Arrival[Sighting] | None = None
    path: Arrival[Itinerary] | None = None
    forecast: Forecast = field(init=False)
    refused: Counter[str] = field(default_factory=Counter)
    goal_counts: Counter[str] = field(default_factory=Counter)
    pairings: dict[str, Pairing] = field(init=False)
    timed: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.forecast = forecast_named(self.settings.goal_prediction)
        self.pairings = {topic: Pairing() for topic in TOPICS[1:]}
        self._paired: set[str] = set()  # topics that share the stamp of the latest odometry

    def adopt(self, settings: PlannerSettings) -> None:
        """Take over new settings; another kind of forecast starts afresh from the last goal."""
        renewed = settings.goal_prediction != self.settings.goal_prediction
        self.settings = settings
        if renewed:
            self.forecast = forecast_named(settings.goal_prediction)
            if self.goal is not None:
                self.forecast.observe(self.goal.value)

    def forget(self) -> None:
        """Forget every input and whose clock is whose, as after a reset or when time jumped."""
        self._drop_all()
        self.timed.clear()

    def _drop_all(self) -> None:
        self.odometry = self.goal = self.path = None
        self.forecast.reset()

    def take_odometry(self, message: Any, now: float, ros: RosTime = UNKNOWN) -> str:
        """Take in an odometry message; return why it was refused, or an empty string."""
        return self._take('odom', message, now, ros)

    def take_goal(self, message: Any, now: float, ros: RosTime = UNKNOWN) -> str:
        """Take in a goal; return why it was refused, or an empty string."""
        refusal = self._take('goal', message, now, ros)
        if not refusal and self.goal is not None:
            self.forecast.observe(self.goal.value)
        return refusal

    def take_path(self, message: Any, now: float, ros: RosTime = UNKNOWN) -> str:
        """Take in a goal's path; return why it was refused, or an empty string."""
        return self._take('goal_path', message, now, ros)

    def _take(self, topic: str, message: Any, now: float, ros: RosTime) -> str:
        read = {'odom': read_odometry, 'goal': read_sighting, 'goal_path': read_itinerary}[topic]
        attribute = {'odom': 'odometry', 'goal': 'goal', 'goal_path': 'path'}[topic]
        settings, last = self.settings, getattr(self, attribute)
        value: Any
        try:
            stamp, value = read(message, settings.problem.dimension, settings.frames)
            self._require_past(stamp, ros)
            self._require_newer(topic, stamp, last, now)
            if topic != 'odom':
                self._require_near(topic, stamp, value, last, now)
        except BadInput as error:
            self.refused[f'{topic}: {error.culprit}'] += 1
            return f'{self.names[topic]} refused: {error}'
        # Once timed, always timed: what was held up on the way must not pass for fresh.
        if abs(ros.since(stamp.nanoseconds)) <= COMPARABLE:
            self.timed.add(topic)
        if topic == 'odom':
            self._end_pairs()
        else:
            self.goal_counts[topic] += 1
        run = self._run(topic, last, now)
        setattr(self, attribute, Arrival(stamp, value, now, topic in self.timed, run))
        self._note_pairs()
        return ''

    def _run(self, topic: str, last: Arrival[Any] | None, now: float) -> int:
        follows = last is not None and now - last.at <= self._timeout(topic)
        return last.run + 1 if last is not None and follows else 1

    def _require_past(self, stamp: Stamp, ros: RosTime) -> None:
        ahead, allowed = -ros.since(stamp.nanoseconds), self.settings.future_tolerance + ros.lag
        if ahead > allowed:
            ahead_of = f"{allowed:g} s ahead of this node's clock"
            raise BadInput('future stamp', f'{ahead:.3g} s ahead', f'at most {ahead_of}')

    def _require_newer(
        self, topic: str, stamp: Stamp, last: Arrival[Any] | None, now: float
    ) -> None:
        if last is None or stamp.nanoseconds > last.stamp.nanoseconds:
            return
        if stamp.nanoseconds == last.stamp.nanoseconds:
            if stamp.nanoseconds == 0:
                raise BadInput('unset stamp', '0 again', NOT_SET)
            raise BadInput('duplicate stamp', stamp.nanoseconds, INCREASING)
        # Once the last one is stale, an older stamp means that the sender's clock was set back.
        if now - last.at <= self._timeout(topic):
            raise BadInput('reordered stamp', stamp.nanoseconds, INCREASING)
        self._drop_all()

    def _require_near(
        self,
        topic: str,
        stamp: Stamp,
        value: Sighting | Itinerary,
        last: Arrival[Any] | None,
        now: float,
    ) -> None:
        limit = self.settings.goal_jump_limit
        if limit == 0.0 or last is None:
            return
        time = stamp.nanoseconds / SECOND
        jump = float(np.linalg.norm(_place(value, time) - _place(last.value, time)))
        if jump <= limit:
            return
        # Once the last one is stale, the goal is believed to be where it is said to be.
        if now - last.at <= self._timeout(topic):
            raise BadInput('goal jump', f'{jump:.3g} m', f'at most goal_jump_limit, {limit:g} m')
        if topic == 'goal':
            self.forecast.reset()

    def _timeout(self, topic: str) -> float:
        return self.settings.odom_timeout if topic == 'odom' else self.settings.goal_timeout

    def _goal_sources(self) -> dict[str, Arrival[Any]]:
        sources = {'goal': self.goal, 'goal_path': self.path}
        return {topic: arrival for topic, arrival in sources.items() if arrival is not None}

    def _note_pairs(self) -> None:
        for topic, arrival in self._goal_sources().items():
            if arrival.stamp.nanoseconds == self._time:
                self._paired.add(topic)

    def _end_pairs(self) -> None:
        """Learn which goals came with the odometry that is now replaced."""
        if self.odometry is not None:
            for topic, pairing in self.pairings.items():
                pairing.note(topic in self._paired)
        self._paired.clear()

    @property
    def companions(self) -> list[str]:
        """Return the topics of the goal that accompany every odometry message."""
        return [topic for topic, pairing in self.pairings.items() if pairing.constant]

    def _spoken(self, topic: str) -> bool:
        arrival = self._goal_sources().get(topic)
        return arrival is not None and arrival.stamp.nanoseconds >= self._time

    @property
    def _time(self) -> int:
        return -1 if self.odometry is None else self.odometry.stamp.nanoseconds

    @property
    def complete(self) -> bool:
        """Return whether nothing is missing, nor any companion of odometry yet to speak."""
        return not self.missing and all(map(self._spoken, self.companions))

    @property
    def missing(self) -> str:
        """Return what no plan can be made without, in words; empty if nothing is missing."""
        absent = []
        if self.odometry is None:
            absent.append(f'odometry on {self.names["odom"]}')
        if not self._goal_sources():
            absent.append(f'a goal on {self.names["goal"]} or {self.names["goal_path"]}')
        return ' and '.join(absent)

    @property
    def goal_stamps(self) -> dict[str, int]:
        """Return the stamps of the goals known, by topic [ns]."""
        return {topic: each.stamp.nanoseconds for topic, each in self._goal_sources().items()}

    @property
    def untimed(self) -> str:
        """Return which sources' stamps are of another clock than this node's, in words."""
        heard = {'odom': self.odometry, **self._goal_sources()}
        untimed = (t for t, each in heard.items() if each is not None and not each.timed)
        return ', '.join(self.names[topic] for topic in untimed)

    def stale_odometry(self, now: float, ros: RosTime = UNKNOWN) -> str:
        """Return that odometry is too old to plan with, in words; empty if it is not."""
        age = 0.0 if self.odometry is None else self.odometry.age(now, ros)
        return f'odometry is {age:.2f} s old' if age > self.settings.odom_timeout else ''

    def stale_goal(self, now: float, ros: RosTime = UNKNOWN) -> str:
        """Return that every source of the goal is too old, in words; empty if one is not."""
        ages = (self._goal_age(*each, now, ros) for each in self._goal_sources().items())
        age = min(ages, default=0.0)
        return f'the goal is {age:.2f} s old' if age > self.settings.goal_timeout else ''

    def _goal_age(self, topic: str, arrival: Arrival[Any], now: float, ros: RosTime) -> float:
        """Return how old a goal is [s]; 0 for one that does not age."""
        ageing = self.settings.goal_ageing
        by_hand = topic == 'goal' and arrival.run < STREAM
        if ageing is Ageing.NONE or (ageing is Ageing.STREAMED and by_hand):
            return 0.0
        return arrival.age(now, ros)

    def targets(
        self, steps: int, now: float, ros: RosTime = UNKNOWN, start: float | None = None
    ) -> Array:
        """Return the goals at the ends of the next ``steps`` steps, shape (steps, n) [m].

        A forecast from outside is used while it is fresh; otherwise one's own. The first step
        begins at ``start`` [s], by default when odometry was measured.
        """
        assert self.odometry is not None
        start = self.odometry.value.time if start is None else start
        times = start + self.settings.problem.step * np.arange(1, steps + 1)
        path = self.path
        if path is None or self._goal_age('goal_path', path, now, ros) > self.settings.goal_timeout:
            return self.forecast.at(times)
        return path.value.at(times)


def _place(value: Sighting | Itinerary, time: float) -> Array:
    return value.position if isinstance(value, Sighting) else value.at(np.array([time]))[0]
