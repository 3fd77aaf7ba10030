# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner without its node: messages taken in or refused, and decisions on what they brought.

The node, replays and flights in one process share it. Times named ``now`` are of the steady clock
[s], those named ``ros`` of the node's ROS clock [ns], None while that is not known.
"""

from __future__ import annotations

import itertools
import math
import statistics
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np

from orbimpc_ros.loop.compensation import Odometry
from orbimpc_ros.loop.goal.forecast import FORECASTS
from orbimpc_ros.loop.goal.motion import GoalMotion, GoalObservation, GoalTrajectory, Route
from orbimpc_ros.loop.intercept import steps_before
from orbimpc_ros.loop.planner import Decision, Planner, Snapshot, joined
from orbimpc_ros.loop.task import Deadline
from orbimpc_ros.loop.traffic import MOST, AgentTrajectory, Bodies, Traffic, silence
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.outcome import Cause, Reason
from orbimpc_ros.mpc.proof.document import Refutation
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import SECOND, Stamp, read_obstacle, stamp_of
from orbimpc_ros.ros.parameters.planner import Ageing, PlannerSettings
from orbimpc_ros.ros.transforms import TF, TF_STATIC, Transforms

T = TypeVar('T')

INCREASING = 'stamps that increase'
STREAM = 3  # goals one soon after another are a stream, which is missed when it stops
WINDOW = 10  # odometry messages; one of so many may lack its goal
COMPARABLE = 60.0  # [s] stamps farther apart are of different clocks
UNHURRIED = 0.2  # [s] a shorter period leaves no time to wait for others
TIE = 0.02  # [s] who measures at such a distance measures at the same time
NOT_SET = (
    'set header.stamp to the time of measurement (in code get_clock().now().to_msg(), with '
    'ros2 topic pub "header: {stamp: now, frame_id: ...}")'
)
READ: Mapping[str, Callable[..., tuple[Stamp, Any]]] = {
    'odom': messages.read_odometry,
    'goal': messages.read_sighting,
    'goal_path': messages.read_itinerary,
    'wind': messages.read_wind,
}
GOALS = ('goal', 'goal_path')
OBSTACLES, PLAN = 'obstacles', 'plan'
TRANSFORMS = (TF, TF_STATIC)
NAMED = (*READ, *messages.POSE_TWIST, OBSTACLES, PLAN)  # topics whose resolved names are of use
AFRESH = Reason(Cause.AFRESH, 'starting afresh')
RESET = Reason(Cause.RESET, 'reset')
DISABLED = Reason(Cause.DISABLED, 'disabled')
INACTIVE = Reason(Cause.DISABLED, 'inactive')  # as a managed node
OF_PLANNER = (
    *('projection', 'gap_tolerance', 'response', 'disturbance', 'velocity_source', 'sideslip'),
    *('capture_radius', 'approach', 'centred', 'odom_timeout', 'goal_timeout'),
)
RECENT = 15  # decisions
LOOK = 1e-4  # [s] that a look at the deadline counts for in lock-step: some take 3e-3
LONGEST = 0.25  # [s] a deadline counts for at most there, where somebody waits for the answer


@dataclass(frozen=True)
class Received(Generic[T]):
    """A message taken in.

    Attributes:
        stamp: the sender's.
        value: its content.
        at: when it came, on the steady clock [s].
        timed: whether its stamp is of the node's clock; None where that cannot be known.
        run: how many messages of its source, itself the last, came one soon after another.
        moved: the message itself, if it came in another frame.
    """

    stamp: Stamp
    value: T
    at: float
    timed: bool | None = None
    run: int = 1
    moved: Any = None

    def age(self, now: float, ros: int | None = None) -> float:
        """Return how old it is [s]: by its arrival or its stamp, whichever makes it older."""
        return max(now - self.at, self.delay(ros))

    def delay(self, ros: int | None) -> float:
        """Return how old it is by its stamp [s]; 0 where that is unknown."""
        return max(0.0, _since(self.stamp.nanoseconds, ros)) if self.timed else 0.0


class Inputs:
    """Takes in messages, and makes snapshots of what is known.

    What stays of a message depends on stamps, never on the time of day, so that a recording gives
    the same.

    Args:
        settings: dimension, frames, timeouts and limits.
        names: of the topics as they are resolved, by their names here.
        others: topics of other vehicles' plans, as they are resolved.

    Attributes:
        lag: how far the ROS clock may trail: simulated time moves when a message says so [s].
        latest: message of each topic that has one.
        forecast: predicts the goal from its sightings.
        refused: messages refused so far, by topic and field.
        goal_counts: goals taken in so far, by topic.
        transforms: of frames to one another.
        displaced: why a goal of another frame is left where it was, in words; empty if it is not.
        bodies: on ``obstacles``.
        agents: the latest plans of other vehicles, by topic.
        traffic_stamps: of the latest message on obstacles and of each plan, by topic [ns].
        leaders: topics of the vehicles that plan before this one where stamps are shared. Planners
            that answer odometry of the same moment would each avoid what the others planned the
            moment before; by the names of their plans one comes after the other instead.
    """

    def __init__(
        self,
        settings: PlannerSettings,
        names: Mapping[str, str] | None = None,
        others: Iterable[str] = (),
    ) -> None:
        self.settings, self.others, self.lag = settings, tuple(others), 0.0
        self.names = {each: each for each in NAMED} | dict(names or {})
        self.latest: dict[str, Received[Any]] = {}
        self.forecast = FORECASTS[settings.goal_prediction]()
        self.refused, self.goal_counts = Counter[str](), Counter[str]()
        known = settings.stated_transforms, settings.transform_timeout, settings.tf
        self.transforms, self.displaced = Transforms(*known), ''
        self.bodies, self._synchronizer = Bodies(), messages.PoseTwistSynchronizer()
        self.agents: dict[str, AgentTrajectory] = {}
        self.traffic_stamps: dict[str, int] = {}
        self.leaders = tuple(name for name in self.others if name < self.names[PLAN])
        self._periods: dict[str, int] = {}  # from one plan of another vehicle to the next [ns]
        self._timed: set[str] = set()  # topics whose stamps are of the node's own clock
        # Whether each topic that may do so shared the stamp of the latest odometry, and before.
        self._shares: set[str] = set()
        paired = (*GOALS, OBSTACLES, *self.leaders)
        self._shared: dict[str, deque[bool]] = {topic: deque(maxlen=WINDOW) for topic in paired}

    def adopt(self, settings: PlannerSettings) -> None:
        """Take over new settings; another kind of forecast starts afresh from the last goal."""
        renewed = settings.goal_prediction != self.settings.goal_prediction
        self.settings = settings
        self.transforms.adopt(settings.stated_transforms, settings.transform_timeout)
        if renewed:
            self.forecast = FORECASTS[settings.goal_prediction]()
            if 'goal' in self.latest:
                self.forecast.observe(self.latest['goal'].value)

    def start_afresh(self) -> None:
        """Forget all but a goal sent by hand, as after a reset or when time jumped."""
        self._keep_goal_alone()
        for each in (self.bodies, self.agents, self.traffic_stamps, self._periods, self._timed):
            each.clear()
        self.transforms.forget()
        self._synchronizer = messages.PoseTwistSynchronizer()

    # --- messages

    def update(self, topic: str, message: Any, now: float, ros: int | None = None) -> str:
        """Take in a message; return why it was refused, or an empty string."""
        odd = ''
        try:
            if topic in messages.POSE_TWIST:
                topic, message = 'odom', self._synchronizer.take(topic, message)
            if message is None:
                return ''  # the other half is to come
            if topic in READ:
                self._take(topic, message, now, ros)
            elif topic in TRANSFORMS:
                self.transforms.hear(topic, message)
            elif topic == OBSTACLES:
                odd = self._take_obstacles(message, ros)
            else:
                self._take_plan(topic, message, ros)
        except BadInput as error:
            self.refused[f'{topic}: {error.culprit}'] += 1
            return f'{self.names.get(topic, topic)} refused: {error}'
        time = self._time
        self._shares.update(t for t, stamp in self._stamps.items() if stamp == time)
        return odd

    def _take(self, topic: str, message: Any, now: float, ros: int | None) -> None:
        """Take in odometry, a goal or a wind.

        Raises:
            BadInput: it is not acceptable.
        """
        settings, last, came = self.settings, self.latest.get(topic), message
        is_goal = topic in GOALS
        if is_goal and message.header.frame_id:
            message = self._placed(message)
        stamp, value = read(topic, message, settings)
        apart = abs(_past(stamp.nanoseconds, ros, settings.future_tolerance + self.lag))
        by_hand = is_goal and stamp.nanoseconds == 0  # typed without a stamp: of its arrival
        timeout = settings.goal_timeout if topic != 'odom' else settings.odom_timeout
        fresh = last is not None and now - last.at <= timeout
        if not by_hand:
            self._require_newer(topic, stamp.nanoseconds, fresh=fresh)
        if is_goal:
            require_attitude(value, settings)
            self._require_near(topic, stamp, value, fresh=fresh)
        timed = None  # before time starts, or without a stamp
        if not by_hand:
            # Once timed, always timed: what was held up on the way must not pass for fresh.
            if apart <= COMPARABLE:
                self._timed.add(topic)
            timed = topic in self._timed or (None if math.isnan(apart) else False)
        run = last.run + 1 if fresh and last is not None else 1
        moved = None if message is came else came
        self._keep(topic, Received(stamp, value, now, timed, run, moved))

    def _require_newer(self, topic: str, stamp: int, *, fresh: bool) -> None:
        """Refuse a stamp [ns] that is not later than that of the last message, if any is fresh."""
        last = self.latest.get(topic)
        if stamp == 0 and topic == 'odom' and topic in self._timed:
            raise BadInput.stating('unset stamp', '0', NOT_SET)
        if last is None or stamp > last.stamp.nanoseconds:
            return
        if stamp == last.stamp.nanoseconds:
            if stamp == 0:
                raise BadInput.stating('unset stamp', '0 again', NOT_SET)
            raise BadInput('duplicate stamp', stamp, INCREASING)
        # Once the last one is stale, an older stamp means that the sender's clock was set back.
        if fresh:
            raise BadInput('reordered stamp', stamp, INCREASING)

    def _require_near(self, topic: str, stamp: Stamp, value: Any, *, fresh: bool) -> None:
        """Refuse a goal that jumps; once the last is stale, the new one is believed."""
        limit, last = self.settings.goal_jump_limit, self.latest.get(topic)
        if limit == 0.0 or last is None or isinstance(value, Route):
            return
        time = stamp.nanoseconds / SECOND
        jump = float(np.linalg.norm(_place(value, time) - _place(last.value, time)))
        if jump > limit and fresh:
            raise BadInput('goal jump', f'{jump:.3g} m', f'at most goal_jump_limit, {limit:g} m')
        if jump > limit and topic == 'goal':
            self.forecast.reset()

    def _keep(self, topic: str, received: Received[Any]) -> None:
        last, first = self.latest.get(topic), self.odometry is None
        back = last is not None and received.stamp.nanoseconds <= last.stamp.nanoseconds
        if topic in GOALS:
            self.goal_counts[topic] += 1
        elif topic == 'odom':
            if not first:
                self._end_shares()
            if back:
                self._keep_goal_alone()
                first = True
        self.latest[topic] = received
        if topic == 'goal':
            # What has no stamp shows where the goal is, not how it moves. (In simulations the first
            # one has 0 for its stamp.)
            undated = last and last.stamp.nanoseconds == 0 and last.value.time > 0.0
            if back or undated:
                self.forecast.reset()
            self.forecast.observe(received.value)
        if topic == 'goal' or (topic == 'odom' and first):
            self._date_goal()
        if topic == 'odom':
            self._place_again(received.stamp.nanoseconds)

    # --- goals

    def _keep_goal_alone(self) -> None:
        """Forget odometry and goals, but for one sent by hand, which stays without its stamp.

        A stream sends the next one; if it has stopped, its last one is not to be flown to.
        """
        goal = self.latest.get('goal')
        self.latest.clear()
        self.forecast.reset()
        if goal is not None and goal.run < STREAM:
            unset = replace(goal.stamp, nanoseconds=0)
            self._see_anew(replace(goal, stamp=unset, timed=None))

    def _see_anew(self, goal: Received[GoalObservation]) -> None:
        """Take a goal for all that was ever seen of it."""
        self.latest['goal'] = goal
        self.forecast.reset()
        self.forecast.observe(goal.value)

    def _date_goal(self) -> None:
        """Take a goal without a stamp for one that is seen when the latest odometry is."""
        goal, known = self.latest.get('goal'), self.odometry
        if goal is not None and known is not None and not goal.stamp.nanoseconds:
            self._see_anew(replace(goal, value=replace(goal.value, time=known.value.time)))

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
        self.displaced = ''
        if goal is None or goal.moved is None or goal.run >= STREAM:
            return
        try:
            placed = self.transforms.moved(goal.moved, frames.world, at)
        except BadInput as error:
            self.displaced = f'the goal stays where it was: {error}'
            return
        _, value = messages.read_sighting(placed, self.settings.problem.dimension, frames)
        self._see_anew(replace(goal, value=replace(value, time=goal.value.time)))

    # --- what moves around the vehicle

    def _take_plan(self, topic: str, message: Any, ros: int | None) -> None:
        """Take in the plan of another vehicle.

        Raises:
            BadInput: it is not acceptable.
        """
        settings, placed = self.settings, self._placed(message)
        stamp, agent = messages.read_agent(placed, settings.problem.dimension, settings.frames)
        self._require_current(stamp.nanoseconds, COMPARABLE, ros)
        last = self.traffic_stamps.get(topic, stamp.nanoseconds)
        if stamp.nanoseconds < last:
            raise BadInput('reordered stamp', stamp.nanoseconds, 'stamps that do not decrease')
        if last < stamp.nanoseconds:
            self._periods[topic] = stamp.nanoseconds - last
        self.agents[topic], self.traffic_stamps[topic] = agent, stamp.nanoseconds

    def _require_current(self, stamp: int, lifetime: float, ros: int | None) -> None:
        """Refuse a stamp [ns] of the future, or older than a lifetime [s] when odometry came."""
        _past(stamp, ros, self.settings.future_tolerance + self.lag)
        limit = min(lifetime, COMPARABLE)
        if self.odometry is None or (age := (self._time - stamp) / SECOND) <= limit:
            return
        if stamp == 0:
            raise BadInput.stating('unset stamp', '0', NOT_SET)
        raise BadInput('stale stamp', f'{age:.3g} s old', f'at most {limit:g} s')

    def _take_obstacles(self, message: Any, ros: int | None) -> str:
        """Take in markers, each by itself; return in a line the first that is refused or odd."""
        odd, count = list[tuple[str, str]](), len(message.markers)  # what is to blame, and how
        if count > MOST:  # to read them all would take long
            odd.append(
                ('count', f' refused: count is {count}; allowed: {MOST}: the first are taken')
            )
        odd += filter(None, (self._take_marker(marker, ros) for marker in message.markers[:MOST]))
        self.traffic_stamps[OBSTACLES] = stamp_of(message)
        self.refused.update(f'{OBSTACLES}: {culprit}' for culprit, _ in odd)
        more = f' (the first of {len(odd)})' if len(odd) > 1 else ''
        return f'{self.names[OBSTACLES]}{odd[0][1]}{more}' if odd else ''

    def _take_marker(self, marker: Any, ros: int | None) -> tuple[str, str] | None:
        """Take in a marker; return what is to blame, and how, where it is refused or odd."""
        settings = self.settings
        try:
            seen = read_obstacle(marker, settings.problem.dimension, settings.frames, self._placed)
            if seen is None:
                self.bodies.clear()
            elif isinstance(seen, str):
                self.bodies.remove(seen)
            else:
                stamp, body = seen
                self._require_current(stamp.nanoseconds, body.lifetime, ros)
                if jump := self.bodies.see(body, settings.obstacle_speed_limit):
                    return 'jump', f': {jump}'
        except BadInput as error:
            return error.culprit, f' refused: {error}'
        return None

    def traffic(self, at: float) -> Traffic | None:
        """Return what is known at a time [s]; None where nothing was ever heard."""
        if not self.traffic_stamps:
            return None
        known = self.bodies.current(at), tuple(self.agents.values())
        return Traffic(*known, self.settings.obstacle_unseen_speed, self.settings.distance)

    def silences(self) -> list[str]:
        """Return which other vehicles are not heard, in words."""
        if self.odometry is None:
            return []
        due = self.odometry.value.time - self.settings.distance.timeout
        found = (silence(name, self.agents.get(name), due) for name in self.others)
        return [*filter(None, found)]

    # --- what belongs together

    @property
    def odometry(self) -> Received[Odometry] | None:
        """Return the latest odometry, if any."""
        return self.latest.get('odom')

    @property
    def _time(self) -> int:
        known = self.latest.get('odom')
        return -1 if known is None else known.stamp.nanoseconds

    @property
    def goal_stamps(self) -> dict[str, int]:
        """Return the stamps of the goals known, by topic [ns]."""
        latest = self.latest
        return {topic: latest[topic].stamp.nanoseconds for topic in GOALS if topic in latest}

    @property
    def _stamps(self) -> dict[str, int]:
        """Return the latest stamps of what may accompany odometry, by topic [ns]."""
        return self.goal_stamps | self.traffic_stamps

    def _end_shares(self) -> None:
        """Learn what came with the odometry that is now replaced.

        A source in lock-step shares its stamps from its first message on. One that merely shares
        the driver's clock, yet is slower, shares some: a planner that waited for it would answer at
        its pace.
        """
        for topic, shared in self._shared.items():
            if topic in self._shares or shared:
                shared.append(topic in self._shares)
        self._shares.clear()

    @property
    def companions(self) -> list[str]:
        """Return the topics that accompany every odometry message, but for rare losses."""
        return [
            topic
            for topic, shared in self._shared.items()
            if shared and WINDOW * shared.count(False) <= len(shared)
        ]

    @property
    def in_step(self) -> bool:
        """Return whether goals come with odometry, as from a simulator that waits for answers."""
        return self._time in self.goal_stamps.values() or bool(self.companions)

    @property
    def complete(self) -> bool:
        """Return whether nothing is missing, nor anyone yet to speak whom odometry waits for.

        Those are its companions, and vehicles that have measured before.
        """
        if self.missing or any(self._is_due(topic) for topic in self.others):
            return False
        stamps, time = self._stamps, self._time
        return all(topic in stamps and stamps[topic] >= time for topic in self.companions)

    def _is_due(self, topic: str) -> bool:
        """Return whether a vehicle has measured before, and its plan is on its way.

        It is known by its period. Who plans without it may choose a way that crosses its new one.
        At the same time it is the leaders who plan first.
        """
        period = self._periods.get(topic)
        if period is None or self.settings.period < UNHURRIED:
            return False
        late = (self._time - self.traffic_stamps[topic] - period) / SECOND
        if late + period / SECOND > self.settings.distance.timeout:
            return False  # it is silent
        return late > (-TIE if topic in self.leaders else TIE)

    @property
    def missing(self) -> str:
        """Return what no plan can be made without, in words; empty if nothing is missing."""
        latest, absent = self.latest, []
        if 'odom' not in latest:
            absent.append(f'odometry on {self.names["odom"]}')
        goals = [latest[topic] for topic in GOALS if topic in latest]
        if not goals:
            absent.append(f'a goal on {self.names["goal"]} or {self.names["goal_path"]}')
        elif self.settings.wants_attitude and all(g.value.attitude is None for g in goals):
            topics = f'{self.names["goal"]} or {self.names["goal_path"]}'
            absent.append(f'a goal with a yaw on {topics}')
        return ' and '.join(absent)

    @property
    def untimed(self) -> str:
        """Return which sources' stamps are of another clock than this node's, in words."""
        found = (t for t in READ if t in self.latest and self.latest[t].timed is False)
        return ', '.join(self.names[topic] for topic in found)

    # --- what decisions are made of

    @property
    def heard(self) -> dict[str, Any]:
        """Return which messages the next decision is made of, by the keys on ``tick``.

        Those are the stamps of the goals known, by topic [ns]; how many goals were taken in so far,
        for some may be lost on the way; how the forecast takes the goal to move, if it chooses; and
        the stamps of what was heard last of obstacles and of other vehicles, by topic [ns].
        """
        model = getattr(self.forecast, 'model', '')
        return {
            'goal_stamps': self.goal_stamps,
            'goal_counts': dict(self.goal_counts),
            **({'goal_model': model} if model else {}),
            'traffic_stamps': dict(self.traffic_stamps),
        }

    def snapshot(
        self, now: float, ros: int | None = None, *, stop: Reason | None = None, taking: float = 0.0
    ) -> Snapshot:
        """Return all that a decision is made of.

        Args:
            now: on the steady clock [s].
            ros: on the ROS clock.
            stop: why no plan may be followed, if none may.
            taking: how long the decision is going to take [s].
        """
        known, goal, path = self.odometry, self.latest.get('goal'), self.latest.get('goal_path')
        ages = {t: self._goal_age(t, now, ros) for t in GOALS if t in self.latest}
        motion: GoalMotion | None = None if goal is None else self.forecast
        wanted = None if goal is None else goal.value.attitude
        if path is not None:
            fresh = ages['goal_path'] <= self.settings.goal_timeout
            if fresh or goal is None:  # without any other it is its age that matters
                motion = path.value
            if fresh and path.value.attitude is not None:
                wanted = path.value.attitude
        age = min(ages.values(), default=0.0)
        if known is None:
            return Snapshot(None, motion, wanted, goal_age=age, stop=stop)
        wind = self.latest.get('wind')
        compensated = self.settings.delay_compensation and known.timed and ros
        return Snapshot(
            odometry=known.value,
            goal=motion,
            wanted=wanted,
            traffic=self.traffic(known.value.time),
            wind=None if wind is None else wind.value,
            odometry_age=known.age(now, ros),
            goal_age=age,
            latency=known.delay(ros) + taking if compensated else 0.0,
            stop=stop,
        )

    def _goal_age(self, topic: str, now: float, ros: int | None) -> float:
        """Return how old a goal is [s]; 0 for one that does not age."""
        settings, goal = self.settings, self.latest[topic]
        route = isinstance(goal.value, Route)
        by_hand = (topic == 'goal' or route) and goal.run < STREAM
        lasting = settings.goal_ageing is Ageing.STREAMED or (
            route and not settings.given_goal_timeout
        )
        if settings.goal_ageing is Ageing.NONE or (lasting and by_hand):
            return 0.0
        return goal.age(now, ros)


def _since(stamp: int, ros: int | None) -> float:
    """Return the time since a stamp [ns], negative before it [s]; NaN if it is not known."""
    return math.nan if ros is None else (ros - stamp) / SECOND


def _past(stamp: int, ros: int | None, allowed: float) -> float:
    """Return the time since a stamp [ns], which is not ahead by more than is allowed [s].

    Raises:
        BadInput: it is.
    """
    since = _since(stamp, ros)
    if -since > allowed:
        ahead_of = f"{allowed:g} s ahead of this node's clock"
        raise BadInput('future stamp', f'{-since:.3g} s ahead', f'at most {ahead_of}')
    return since


def read(topic: str, message: Any, settings: PlannerSettings) -> tuple[Stamp, Any]:
    """Return the stamp and the content of an input; a goal without a frame is of the world's.

    Raises:
        BadInput: it is not acceptable.
    """
    frames = settings.frames
    if topic in GOALS and not message.header.frame_id:
        frames = replace(frames, world='')
    return READ[topic](message, settings.problem.dimension, frames)


def require_attitude(value: GoalObservation | GoalTrajectory, settings: PlannerSettings) -> None:
    """Refuse a goal without an attitude where one is asked for.

    Raises:
        BadInput: in the plane, its x axis is vertical.
    """
    if settings.wants_attitude and value.attitude is None:
        asked = 'a body x axis with a yaw, which weights.attitude or approach.cone asks for'
        raise BadInput('pose.orientation', 'that of a vertical x axis', asked)


def others(avoid: Iterable[str], own: str, resolve: Callable[[str], str]) -> tuple[str, ...]:
    """Return the topics of other vehicles' plans, one's own left out: a fleet may share its list.

    Args:
        avoid: topics, as given.
        own: the topic of one's own plans.
        resolve: makes a topic's full name.
    """
    return tuple(name for name in dict.fromkeys(map(resolve, avoid)) if name != own)


def _place(value: GoalObservation | GoalTrajectory, time: float) -> Array:
    return value.position if isinstance(value, GoalObservation) else value.at(np.array([time]))[0]


def planner_of(settings: PlannerSettings) -> tuple[PlannerSettings, Planner]:
    """Return the settings with a planner compiled for them."""
    planner = Planner(
        settings.problem,
        shrinking=settings.horizon_mode == 'shrinking',
        safe=settings.safe_command,
        # On a dry run somebody else commands, who is not known.
        estimated=settings.estimated and not settings.dry_run,
        reserve=settings.obstacle_reserve,
        **{name: getattr(settings, name) for name in OF_PLANNER},
    )
    if settings.avoid:
        planner.expect_hazards()
    return settings, planner


class Core:
    """Decides on what messages have brought; publishing is left to others.

    Args:
        settings: of the planner.
        planner: compiled for them.
        simulated: whether time stands still while a decision is made.
        clock: that deadlines are kept by [s]; None where a solve has none, so that what it finds
            does not depend on the machine.
        counted: whether deadlines are kept by work instead while goals come with odometry.
        names: of the topics as they are resolved, by their names here.
        others: topics of other vehicles' plans, as they are resolved.

    Attributes:
        settings: of the planner.
        inputs: take in messages.
        planner: decides.
        counts: ``deadline misses``, decisions that took longer than their deadline; ``overruns``,
            that took longer than their period.
        seen: what the last decision was made of.
        outdated: why the last plan may not be followed, made in too long a time; None if it may.
    """

    def __init__(
        self,
        settings: PlannerSettings,
        planner: Planner,
        *,
        simulated: bool = True,
        clock: Callable[[], float] | None = time.perf_counter,
        counted: bool = False,
        names: Mapping[str, str] | None = None,
        others: Sequence[str] = (),
    ) -> None:
        self.settings, self.planner = settings, planner
        self.inputs = Inputs(settings, names, others)
        self.counts = Counter({'deadline misses': 0, 'overruns': 0})
        self._recent: deque[float] = deque(maxlen=RECENT)  # how long decisions took [s]
        self.seen = Snapshot()
        self.outdated: Reason | None = None
        self._simulated, self._counted = simulated, counted
        self._clock, self._unlimited = clock or time.perf_counter, clock is None
        self._deadline = Deadline(self._clock, math.inf)  # of the last decision

    @property
    def expected(self) -> float:
        """Return how long a decision usually takes [s]."""
        return statistics.median(self._recent) if self._recent else 0.0

    def install(self, settings: PlannerSettings, planner: Planner) -> None:
        """Go on with other settings and the planner made for them."""
        planner.continue_from(self.planner)
        self.settings, self.planner = settings, planner
        self.inputs.adopt(settings)

    def start_afresh(self, *, wind: bool = False) -> None:
        """Forget plan and inputs, but for a goal sent by hand; with ``wind`` that estimate, too."""
        self.planner.start_afresh(wind=wind)
        self.inputs.start_afresh()

    def unsafe(
        self, now: float, ros: int | None = None, stop: Reason | None = None
    ) -> Reason | None:
        """Return why no plan may be followed now; None if one may."""
        known = self.inputs.odometry  # a whole snapshot would forget bodies, which replays do not
        if known is None:
            return self.planner.unsafe(Snapshot(stop=stop))
        age = known.age(now, ros)
        return self.planner.unsafe(Snapshot(known.value, odometry_age=age, stop=stop))

    def decide(
        self,
        now: float,
        ros: int | None = None,
        stop: Reason | None = None,
        *,
        fresh: bool = False,
    ) -> Decision:
        """Return what to do next, how long that took, and which messages it is made of.

        Args:
            now: on the steady clock [s].
            ros: on the ROS clock.
            stop: why no plan may be followed, if none may.
            fresh: whether odometry counts as fresh, as where somebody else has judged it.
        """
        begun, taking = self._clock(), 0.0 if self._simulated else self.expected
        snapshot = self.inputs.snapshot(now, ros, stop=stop, taking=taking)
        heard = self.inputs.heard
        if fresh:
            snapshot = replace(snapshot, odometry_age=0.0)
        self.seen = snapshot
        given = math.inf if self._unlimited else self.settings.deadline
        self._deadline = Deadline(self._clock, begun + given)
        if self._counted and self.inputs.in_step:
            # A clock that goes on by the looks at it, of which a search takes one after each part:
            # what it limits is the same on every machine, however busy.
            looked = (LOOK * looks for looks in itertools.count(1)).__next__
            self._deadline = Deadline(looked, min(given, LONGEST))
        at = None if ros is None else ros / SECOND + taking
        decision = self.planner.step(snapshot, at, self._deadline)
        took = self._clock() - begun
        if decision.state is None:
            return decision
        self.outdated = None
        if snapshot.odometry_age + took > self.settings.odom_timeout:
            later = ros if ros is None or self._simulated else ros + round(took * SECOND)
            self.outdated = self.unsafe(now + took, later)
        self._recent.append(took)
        self.counts['deadline misses'] += took > self.settings.deadline
        self.counts['overruns'] += took > self.settings.period
        solving = 0.0 if decision.cause is Cause.GOAL else 1e3 * took
        return replace(decision, solve_time_ms=solving, heard=heard)

    @property
    def goal(self) -> tuple[Array, Array | None] | None:
        """Return where the goal was at the odometry last answered, and its attitude, if known.

        None unless it was fresh and nothing was missing.
        """
        motion, measured = self.seen.goal, self.seen.odometry
        lost = self.inputs.missing or self.seen.goal_age > self.settings.goal_timeout
        if lost or measured is None or motion is None or isinstance(motion, np.ndarray):
            return None
        if isinstance(motion, Route):
            return motion.place(np.array([motion.nearest(measured.position)]))[0], None
        return motion.at(np.array([measured.time]))[0], self.seen.wanted

    def proved(self, decision: Decision, *, catches: bool = False) -> Decision:
        """Return the last decision with a proof of what it states, if there is one by its deadline.

        That is that nothing is feasible or, with ``catches``, that nothing is caught before a time.
        Its command went out before, and need not wait for that.
        """
        nothing, catch = decision.infeasible, decision.catch if catches else None
        count = 0 if catch is None else steps_before(catch.bound, catch.sought.problem.step)
        if nothing is None and not count:
            return decision
        # Imported by the first decision that needs it: a tenth of a second that starts are spared.
        from orbimpc_ros.mpc.proof.document import WORD, held_in_time
        from orbimpc_ros.mpc.proof.refute import catches_refuted, refutation_of

        def made(late: Callable[[], bool]) -> Refutation:
            if nothing is not None:
                return refutation_of(nothing, late)
            assert catch is not None
            return catches_refuted(catch.sought, count, late)

        refutation = held_in_time(made, self._deadline.clock, self._deadline.end)
        reason = decision.reason
        if nothing is not None and refutation is None:
            reason = joined(reason, WORD)
        return replace(decision, refutation=refutation, reason=reason)
