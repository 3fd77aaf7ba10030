# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner's inputs: messages taken in or refused, and snapshots of all that is known."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Generic, TypeVar

import numpy as np

from orbimpc_ros.loop.goal.bank import Bank
from orbimpc_ros.loop.goal.forecast import forecast_named
from orbimpc_ros.loop.goal.motion import Forecast, GoalMotion, GoalObservation, GoalTrajectory
from orbimpc_ros.loop.goal.route import Route
from orbimpc_ros.loop.planner import Snapshot
from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.outcome import Reason
from orbimpc_ros.ros.clock import UNKNOWN, RosTime
from orbimpc_ros.ros.messages import (
    SECOND,
    Stamp,
    read_itinerary,
    read_odometry,
    read_sighting,
    read_wind,
)
from orbimpc_ros.ros.parameters.planner import Ageing, PlannerSettings
from orbimpc_ros.ros.planner.obstacles import (
    COMPARABLE,
    NOT_SET,
    OBSTACLES,
    PLAN,
    ObstacleTracker,
)
from orbimpc_ros.ros.transforms import TF, TF_STATIC, Transforms

T = TypeVar('T')

INCREASING = 'stamps that increase'
STREAM = 3  # goals one soon after another are a stream, which is missed when it stops
WINDOW = 10  # odometry messages; one of so many may lack its goal
READ: Mapping[str, Callable[..., tuple[Stamp, Any]]] = {
    'odom': read_odometry,
    'goal': read_sighting,
    'goal_path': read_itinerary,
    'wind': read_wind,
}
GOALS = ('goal', 'goal_path')
TRANSFORMS = (TF, TF_STATIC)
NAMED = (*READ, OBSTACLES, PLAN)  # topics whose resolved names are of use


@dataclass(frozen=True)
class Received(Generic[T]):
    """A message taken in.

    Attributes:
        stamp: the sender's.
        value: its content.
        at: when it came, on the steady clock [s].
        timed: whether its stamp can be compared with the node's clock.
        foreign: whether it was compared, and is of another clock.
        run: how many messages of its source, itself the last, came one soon after another.
        moved: the message itself, if it came in another frame.
    """

    stamp: Stamp
    value: T
    at: float
    timed: bool = False
    foreign: bool = False
    run: int = 1
    moved: Any = None

    def age(self, now: float, ros: RosTime = UNKNOWN) -> float:
        """Return how old it is [s]: by its arrival or its stamp, whichever makes it older."""
        return max(now - self.at, self.delay(ros))

    def delay(self, ros: RosTime) -> float:
        """Return how old it is by its stamp [s]; 0 where that is unknown."""
        return max(0.0, ros.since(self.stamp.nanoseconds)) if self.timed else 0.0


class Pairing:
    """Learns from stamps whether a source accompanies every odometry message.

    A source in lock-step does so from its first message on. One that merely shares the driver's
    clock, yet is slower, shares some stamps: a planner that waited for it would answer at its pace.
    """

    def __init__(self) -> None:
        self._shared: deque[bool] = deque(maxlen=WINDOW)

    def note(self, shared: bool) -> None:
        """Note whether the source shared the stamp of an odometry message, now that it is over."""
        if shared or self._shared:
            self._shared.append(shared)

    @property
    def constant(self) -> bool:
        """Return whether the source has so far accompanied every message, but for rare losses."""
        lost = self._shared.count(False)
        return bool(self._shared) and WINDOW * lost <= len(self._shared)


@dataclass
class Inputs:
    """Takes in messages, and makes snapshots of what is known.

    Times named ``now`` are of the steady clock [s], those named ``ros`` of the node's ROS clock.

    Attributes:
        settings: dimension, frames, timeouts and limits.
        names: of the topics as they are resolved, by their names here.
        others: topics of other vehicles' plans, as they are resolved.
        latest: message of each topic that has one.
        forecast: predicts the goal from its sightings.
        refused: messages refused so far, by topic and field.
        goal_counts: goals taken in so far, by topic.
        pairings: whether each topic that may do so accompanies the odometry.
        timed: topics whose stamps have been seen to be of the node's own clock.
        obstacles: what moves around the vehicle.
        transforms: of frames to one another.
        displaced: why a goal of another frame is left where it was, in words; empty if it is not.
    """

    settings: PlannerSettings
    names: Mapping[str, str] = field(default_factory=dict)
    others: tuple[str, ...] = ()
    latest: dict[str, Received[Any]] = field(default_factory=dict)
    forecast: Forecast = field(init=False)
    refused: Counter[str] = field(default_factory=Counter)
    goal_counts: Counter[str] = field(default_factory=Counter)
    pairings: dict[str, Pairing] = field(init=False)
    timed: set[str] = field(default_factory=set)
    obstacles: ObstacleTracker = field(init=False)
    transforms: Transforms = field(init=False)
    displaced: str = ''

    def __post_init__(self) -> None:
        self.names = {each: each for each in NAMED} | dict(self.names)
        self.forecast = forecast_named(self.settings.goal_prediction)
        known = self.settings.tree
        self.transforms = Transforms(known.stated, known.timeout, known.heard)
        around = self.names, self.others, self.refused, self._placed
        self.obstacles = ObstacleTracker(self.settings, *around)
        paired = (*GOALS, OBSTACLES, *self.obstacles.leaders)
        self.pairings = {topic: Pairing() for topic in paired}
        self._paired: set[str] = set()  # topics that share the stamp of the latest odometry

    def adopt(self, settings: PlannerSettings) -> None:
        """Take over new settings; another kind of forecast starts afresh from the last goal."""
        renewed = settings.goal_prediction != self.settings.goal_prediction
        self.transforms.adopt(settings.tree.stated, settings.tree.timeout, settings.tree.heard)
        self.settings = self.obstacles.settings = settings
        if renewed:
            self.forecast = forecast_named(settings.goal_prediction)
            if 'goal' in self.latest:
                self.forecast.observe(self.latest['goal'].value)

    def forget(self) -> None:
        """Forget every input and whose clock is whose."""
        self.start_afresh()
        self.latest.clear()
        self.forecast.reset()

    def start_afresh(self) -> None:
        """Forget all but a goal sent by hand, as after a reset or when time jumped."""
        self._keep_goal_alone()
        self.obstacles.forget()
        self.transforms.forget()
        self.timed.clear()

    def _keep_goal_alone(self) -> None:
        """Forget odometry and goals, but for one sent by hand, which stays without its stamp.

        A stream sends the next one; if it has stopped, its last one is not to be flown to.
        """
        goal = self.latest.get('goal')
        self.latest.clear()
        self.forecast.reset()
        if goal is not None and goal.run < STREAM:
            unset = replace(goal.stamp, nanoseconds=0)
            self._see_anew(replace(goal, stamp=unset, timed=False, foreign=False))

    def _see_anew(self, goal: Received[GoalObservation]) -> None:
        """Take a goal for all that was ever seen of it."""
        self.latest['goal'] = goal
        self.forecast.reset()
        self.forecast.observe(goal.value)

    def _date_goal(self) -> None:
        """Take a goal without a stamp for one that is seen when the latest odometry is."""
        goal, known = self.latest.get('goal'), self.odometry
        if goal is None or known is None or goal.stamp.nanoseconds:
            return
        self._see_anew(replace(goal, value=replace(goal.value, time=known.value.time)))

    @property
    def odometry(self) -> Received[Odometry] | None:
        """Return the latest odometry, if any."""
        return self.latest.get('odom')

    def update(self, topic: str, message: Any, now: float, ros: RosTime = UNKNOWN) -> str:
        """Take in a message; return why it was refused, or an empty string."""
        if topic in TRANSFORMS:
            return self._hear(topic, message)
        if topic not in READ:
            measured = UNKNOWN if self.odometry is None else RosTime(self._time)
            refusal = self.obstacles.take(topic, message, ros, measured)
            self._note_pairs()
            return refusal
        settings, last, came = self.settings, self.latest.get(topic), message
        try:
            if topic in GOALS and message.header.frame_id:
                message = self._placed(message)
            stamp, value = read(topic, message, settings)
            since = ros.require_past(stamp.nanoseconds, settings.future_tolerance)
            self._require_newer(topic, stamp, last, now)
            if topic in GOALS:
                require_attitude(value, settings)
                self._require_near(topic, stamp, value, now)
        except BadInput as error:
            self.refused[f'{topic}: {error.culprit}'] += 1
            return f'{self.names[topic]} refused: {error}'
        # Once timed, always timed: what was held up on the way must not pass for fresh.
        apart, unset = abs(since), _is_unset(topic, stamp)
        if apart <= COMPARABLE and not unset:
            self.timed.add(topic)
        timed = topic in self.timed and not unset
        foreign = apart > COMPARABLE and not (timed or unset)  # neither before time starts
        moved = None if message is came else came
        run = self._run(topic, now)
        self._keep(topic, Received(stamp, value, now, timed, foreign, run, moved))
        return ''

    def _hear(self, topic: str, message: Any) -> str:
        try:
            self.transforms.hear(topic, message)
        except BadInput as error:
            self.refused[f'{topic}: {error.culprit}'] += 1
            return f'{topic} refused: {error}'
        return ''

    def _placed(self, message: Any) -> Any:
        """Return a message as of the world's frame: itself, or what can be read of it elsewhere.

        Raises:
            BadInput: it is of another frame, and no transform leads from there.
        """
        world = self.settings.frames.world
        if not world or message.header.frame_id == world:
            return message
        return self.transforms.moved(message, world)

    def _place_again(self, at: int) -> None:
        """Move a goal that holds, and stands in another frame, to where that is at a stamp [ns].

        Localisation corrects how ``map`` lies in ``odom``, by metres where it closes a loop.
        """
        goal, frames = self.latest.get('goal'), self.settings.frames
        if goal is None or goal.moved is None or goal.run >= STREAM:
            self.displaced = ''
            return
        try:
            placed = self.transforms.moved(goal.moved, frames.world, at)
        except BadInput as error:
            self.displaced = f'the goal stays where it was: {error}'
            return
        _, value = read_sighting(placed, self.settings.problem.dimension, frames)
        self._see_anew(replace(goal, value=replace(value, time=goal.value.time)))
        self.displaced = ''

    def _keep(self, topic: str, received: Received[Any]) -> None:
        if topic in GOALS:
            self.goal_counts[topic] += 1
        elif topic == 'odom':
            self._end_pairs()
        last, goal = self.latest.get(topic), self.latest.get('goal')
        back = last is not None and received.stamp.nanoseconds <= last.stamp.nanoseconds
        if topic == 'odom' and back:
            self._keep_goal_alone()
        first = self.odometry is None
        self.latest[topic] = received
        self._note_pairs()
        if topic == 'goal':
            # What has no stamp shows where the goal is, not how it moves.
            if back or (goal is not None and _is_undated(goal)):
                self.forecast.reset()
            self.forecast.observe(received.value)
            self._date_goal()
        elif topic == 'odom':
            if first:
                self._date_goal()
            self._place_again(received.stamp.nanoseconds)

    def _run(self, topic: str, now: float) -> int:
        last = self.latest.get(topic)
        follows = last is not None and now - last.at <= self._timeout(topic)
        return last.run + 1 if last is not None and follows else 1

    def _require_newer(
        self, topic: str, stamp: Stamp, last: Received[Any] | None, now: float
    ) -> None:
        if topic == 'odom' and topic in self.timed and stamp.nanoseconds == 0:
            raise BadInput.stating('unset stamp', '0', NOT_SET)
        if last is None or stamp.nanoseconds > last.stamp.nanoseconds or _is_unset(topic, stamp):
            return
        if stamp.nanoseconds == last.stamp.nanoseconds:
            if stamp.nanoseconds == 0:
                raise BadInput.stating('unset stamp', '0 again', NOT_SET)
            raise BadInput('duplicate stamp', stamp.nanoseconds, INCREASING)
        # Once the last one is stale, an older stamp means that the sender's clock was set back.
        if now - last.at <= self._timeout(topic):
            raise BadInput('reordered stamp', stamp.nanoseconds, INCREASING)

    def _require_near(
        self,
        topic: str,
        stamp: Stamp,
        value: GoalObservation | GoalTrajectory,
        now: float,
    ) -> None:
        limit, last = self.settings.goal_jump_limit, self.latest.get(topic)
        if limit == 0.0 or last is None or isinstance(value, Route):
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

    @property
    def goal_model(self) -> str:
        """Return how the forecast takes the goal to move, if it chooses; otherwise nothing."""
        return self.forecast.model if isinstance(self.forecast, Bank) else ''

    def _timeout(self, topic: str) -> float:
        return self.settings.odom_timeout if topic == 'odom' else self.settings.goal_timeout

    def _goal_sources(self) -> dict[str, Received[Any]]:
        return {topic: self.latest[topic] for topic in GOALS if topic in self.latest}

    def _note_pairs(self) -> None:
        self._paired |= {t for t, stamp in self._stamps.items() if stamp == self._time}

    def _end_pairs(self) -> None:
        """Learn what came with the odometry that is now replaced."""
        if self.odometry is not None:
            for topic, pairing in self.pairings.items():
                pairing.note(topic in self._paired)
        self._paired.clear()

    @property
    def companions(self) -> list[str]:
        """Return the topics that accompany every odometry message."""
        return [topic for topic, pairing in self.pairings.items() if pairing.constant]

    @property
    def in_step(self) -> bool:
        """Return whether goals come with odometry, as from a simulator that waits for answers."""
        return self._time in self.goal_stamps.values() or bool(self.companions)

    def _spoken(self, topic: str) -> bool:
        stamp = self._stamps.get(topic)
        return stamp is not None and stamp >= self._time

    @property
    def _time(self) -> int:
        return -1 if self.odometry is None else self.odometry.stamp.nanoseconds

    @property
    def complete(self) -> bool:
        """Return whether nothing is missing, nor anyone yet to speak whom odometry waits for.

        Those are its companions, and vehicles that have measured before.
        """
        due = any(self.obstacles.is_due(topic, self._time) for topic in self.others)
        return not self.missing and not due and all(map(self._spoken, self.companions))

    @property
    def missing(self) -> str:
        """Return what no plan can be made without, in words; empty if nothing is missing."""
        absent = []
        if self.odometry is None:
            absent.append(f'odometry on {self.names["odom"]}')
        sources = self._goal_sources().values()
        topics = f'{self.names["goal"]} or {self.names["goal_path"]}'
        if not sources:
            absent.append(f'a goal on {topics}')
        elif self.settings.wants_attitude and not any(_turned(each) for each in sources):
            absent.append(f'a goal with a yaw on {topics}')
        return ' and '.join(absent)

    @property
    def goal_stamps(self) -> dict[str, int]:
        """Return the stamps of the goals known, by topic [ns]."""
        return {topic: each.stamp.nanoseconds for topic, each in self._goal_sources().items()}

    @property
    def _stamps(self) -> dict[str, int]:
        """Return the latest stamps of what may accompany odometry, by topic [ns]."""
        return self.goal_stamps | self.obstacles.stamps

    @property
    def untimed(self) -> str:
        """Return which sources' stamps are of another clock than this node's, in words."""
        untimed = [t for t in READ if t in self.latest and self.latest[t].foreign]
        return ', '.join(self.names[topic] for topic in untimed)

    @property
    def heard(self) -> dict[str, Any]:
        """Return which messages the next decision is made of, as a report has it."""
        return {
            'goal_stamps': self.goal_stamps,
            'goal_counts': dict(self.goal_counts),
            'goal_model': self.goal_model,
            'traffic_stamps': dict(self.obstacles.stamps),
        }

    def snapshot(
        self, now: float, ros: RosTime = UNKNOWN, *, stop: Reason | None = None, taking: float = 0.0
    ) -> Snapshot:
        """Return all that a decision is made of.

        Args:
            now: on the steady clock [s].
            ros: on the ROS clock.
            stop: why no plan may be followed, if none may.
            taking: how long the decision is going to take [s].
        """
        known, goal, path = self.odometry, self.latest.get('goal'), self._fresh_path(now, ros)
        motion: GoalMotion | None = self.forecast if path is None and goal is not None else path
        if motion is None and 'goal_path' in self.latest:
            motion = self.latest['goal_path'].value  # stale: its age is what matters
        wanted = None if goal is None else goal.value.attitude
        if path is not None and path.attitude is not None:
            wanted = path.attitude
        wind = self.latest.get('wind')
        ages = (self._goal_age(*each, now, ros) for each in self._goal_sources().items())
        snapshot = Snapshot(None, motion, wanted, goal_age=min(ages, default=0.0), stop=stop)
        if known is None:
            return snapshot
        compensated = self.settings.delay_compensation and known.timed and ros.nanoseconds
        return replace(
            snapshot,
            odometry=known.value,
            wind=None if wind is None else wind.value,
            traffic=self.obstacles.traffic(known.value.time) if self.obstacles.stamps else None,
            odometry_age=known.age(now, ros),
            latency=known.delay(ros) + taking if compensated else 0.0,
        )

    def goal_at(self, now: float, ros: RosTime = UNKNOWN) -> tuple[Array, Array | None] | None:
        """Return where the goal is at the latest odometry's time, and its attitude, if known.

        None unless it is fresh and nothing is missing.
        """
        snapshot = self.snapshot(now, ros)
        motion, measured = snapshot.goal, snapshot.odometry
        lost = self.missing or snapshot.goal_age > self.settings.goal_timeout
        if lost or measured is None or motion is None or isinstance(motion, np.ndarray):
            return None
        if isinstance(motion, Route):
            return motion.place(np.array([motion.nearest(measured.position)]))[0], None
        return motion.at(np.array([measured.time]))[0], snapshot.wanted

    def _goal_age(self, topic: str, received: Received[Any], now: float, ros: RosTime) -> float:
        """Return how old a goal is [s]; 0 for one that does not age."""
        ageing = self.settings.goal_ageing
        route = isinstance(received.value, Route)
        by_hand = (topic == 'goal' or route) and received.run < STREAM
        lasting = ageing is Ageing.STREAMED or (route and not self.settings.given_goal_timeout)
        if ageing is Ageing.NONE or (lasting and by_hand):
            return 0.0
        return received.age(now, ros)

    def _fresh_path(self, now: float, ros: RosTime) -> GoalTrajectory | None:
        path = self.latest.get('goal_path')
        if path is None or self._goal_age('goal_path', path, now, ros) > self.settings.goal_timeout:
            return None
        return path.value


def read(topic: str, message: Any, settings: PlannerSettings) -> tuple[Stamp, Any]:
    """Return the stamp and the content of an input; a goal without a frame is of the world's.

    Raises:
        BadInput: it is not acceptable.
    """
    frames = settings.frames
    if topic in GOALS and not message.header.frame_id:
        frames = replace(frames, world='')
    return READ[topic](message, settings.problem.dimension, frames)


def _is_unset(topic: str, stamp: Stamp) -> bool:
    """Return whether it is a goal as typed by hand, without a stamp: it holds from its arrival."""
    return topic in GOALS and stamp.nanoseconds == 0


def _is_undated(goal: Received[GoalObservation]) -> bool:
    """Return whether a goal came without a stamp; in simulations the first one has 0 for its."""
    return goal.stamp.nanoseconds == 0 and goal.value.time > 0.0


def require_attitude(value: GoalObservation | GoalTrajectory, settings: PlannerSettings) -> None:
    """Refuse a goal without an attitude where one is asked for.

    Raises:
        BadInput: in the plane, its x axis is vertical.
    """
    if settings.wants_attitude and value.attitude is None:
        asked = 'a body x axis with a yaw, which weights.attitude or approach.cone asks for'
        raise BadInput('pose.orientation', 'that of a vertical x axis', asked)


def _turned(received: Received[Any]) -> bool:
    return received.value.attitude is not None


def _place(value: GoalObservation | GoalTrajectory, time: float) -> Array:
    return value.position if isinstance(value, GoalObservation) else value.at(np.array([time]))[0]
