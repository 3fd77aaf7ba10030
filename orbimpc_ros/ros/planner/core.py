# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner without its node: takes in or rejects messages, and decides on their content.

The node, replays and flights in one process share it. Times named ``now`` are on the steady clock
[s], those named ``ros`` on the node's ROS clock [ns], None while that is unknown.
"""

from __future__ import annotations

import itertools
import math
import statistics
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from visualization_msgs.msg import Marker

from orbimpc_ros.loop.capture import Events
from orbimpc_ros.loop.goal.forecast import FORECASTS
from orbimpc_ros.loop.goal.motion import GoalMotion, GoalObservation, Route
from orbimpc_ros.loop.intercept import steps_before
from orbimpc_ros.loop.planner import Decision, Planner, Snapshot
from orbimpc_ros.loop.traffic import MOST, ObservedTraffic, ObstacleTracker, silence
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.outcome import Cause, Reason
from orbimpc_ros.mpc.plan import joined
from orbimpc_ros.mpc.solve.solver import Deadline
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import SECOND, Stamp, read_obstacle, stamp_of
from orbimpc_ros.ros.parameters.planner import PlannerSettings
from orbimpc_ros.ros.transforms import AHEAD, TF, TF_STATIC, Transforms

INCREASING = 'stamps that increase'
STREAM = 3  # goals in close succession form a stream, which can become stale
WINDOW = 10  # odometry messages, of which one may lack its goal
COMPARABLE = 60.0  # [s] stamps with a larger difference are on different clocks
UNHURRIED = 0.2  # [s] shorter periods leave no time to wait for others
TIE = 0.02  # [s] measurements within this interval are simultaneous
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
AFRESH = Reason(Cause.AFRESH, 'starting afresh')
RESET = Reason(Cause.RESET, 'reset')
DISABLED = Reason(Cause.DISABLED, 'disabled')
OF_PLANNER = (
    *('projection', 'gap_tolerance', 'response', 'disturbance', 'velocity_source', 'sideslip'),
    *('approach', 'centred', 'odom_timeout', 'goal_timeout'),
)
RECENT = 15  # decisions
LOOK = 1e-4  # [s] counted per check of the deadline in lock-step; some take 3e-3
LONGEST = 0.25  # [s] longest deadline there, where a simulator waits for the answer


@dataclass(frozen=True)
class Received:
    """A message taken in."""

    stamp: Stamp  # the sender's
    value: Any  # its content
    at: float  # time of arrival on the steady clock [s]
    timed: bool | None = None  # whether its stamp is on the node's clock; None if unknown
    run: int = 1  # messages of its source in close succession, including this one
    moved: Any = None  # the original message, if it came in another frame

    @property
    def streams(self) -> bool:
        """Return True if its source streams, so that silence means that it is lost."""
        return self.run >= STREAM

    def age(self, now: float, ros: int | None = None) -> float:
        """Return its age [s], by arrival or by stamp, whichever is greater."""
        return max(now - self.at, self.delay(ros))

    def delay(self, ros: int | None) -> float:
        """Return its age by its stamp [s]; 0 if unknown."""
        if ros is None or not self.timed:
            return 0.0
        return max(0.0, (ros - self.stamp.nanoseconds) / SECOND)


class Inputs:
    """Takes in messages, and makes snapshots of the present inputs.

    The stored state depends on stamps, never on the time of day, so that recordings reproduce it.

    Args:
        settings: dimension, frames, timeouts and limits.
        resolve: makes a topic's full name.

    Attributes:
        others: topics of other vehicles' plans, without one's own.
        lag: how far the ROS clock may trail: simulated time advances only with messages [s].
        latest: message of each topic that has one.
        forecast: predicts the goal from its sightings.
        refused: number of messages refused so far, by topic and field.
        goal_counts: number of goals taken in so far, by topic.
        transforms: between frames.
        displaced: why a goal in another frame is not transformed; otherwise empty.
        bodies: from ``obstacles``.
        altitude: of the last goal on ``goal`` [m]; NaN without one.
        companions: topics that accompany every odometry message, apart from rare losses.
    """

    def __init__(self, settings: PlannerSettings, resolve: Callable[[str], str] = str) -> None:
        self.settings, self._resolve, self.lag = settings, resolve, 0.0
        self.others = others(settings, resolve)
        self.latest: dict[str, Received] = {}
        self.forecast = FORECASTS[settings.goal_prediction]()
        self.refused, self.goal_counts = Counter[str](), Counter[str]()
        self.transforms, self.displaced = Transforms(settings), ''
        self.bodies, self._synchronizer = ObstacleTracker(), messages.PoseTwistSynchronizer()
        self.altitude = math.nan
        # Whether a topic had the stamp of recent odometry, the present one last, from the first on.
        self._shared: dict[str, deque[bool]] = {}
        self.companions = list[str]()

    def adopt(self, settings: PlannerSettings) -> None:
        """Take over new settings; another kind of forecast starts anew from the last goal."""
        renewed = settings.goal_prediction != self.settings.goal_prediction
        self.settings = self.transforms.settings = settings
        if renewed:
            self._see_anew(self.latest.get('goal'))

    def start_afresh(self) -> None:
        """Forget all but a goal sent by hand and bodies that last, as after a clock jump."""
        self._keep_goal_alone()
        # Bodies without a lifetime may never be sent again: they stay where they were, at rest.
        kept = [last for *_, last in self.bodies.values() if math.isinf(last.lifetime)]
        self.bodies = ObstacleTracker()
        for each in kept:
            self.bodies.see(replace(each, time=-COMPARABLE), math.inf)
        self.transforms.forget()
        self._synchronizer = messages.PoseTwistSynchronizer()

    # --- messages

    def update(self, topic: str, message: Any, now: float, ros: int | None = None) -> str:
        """Take in a message; return why it, or a part of it, was refused, or an empty string.

        Markers and transforms are taken in one by one; the first one refused or unusual is named.
        """
        odd = list[tuple[str, str]]()  # culprits and descriptions
        parts: Sequence[Any] = (message,)
        take: Callable[..., str | None] = self._take
        if topic == OBSTACLES:
            parts, take = message.markers, self._take_marker
            self.latest[OBSTACLES] = Received(Stamp(max(0, stamp_of(message))), None, now)
        elif topic in TRANSFORMS:
            parts, take = message.transforms, self._take_transform
        if len(parts) > MOST:  # reading them all would take too long
            many = f' refused: count is {len(parts)}; allowed: {MOST}: the rest are ignored'
            odd.append(('count', many))
        for part in parts[:MOST]:
            try:
                if jump := take(topic, part, now, ros):
                    odd.append(('jump', f': {jump}'))
            except BadInput as error:  # noqa: PERF203
                odd.append((error.culprit, f' refused: {error}'))
        for name, stamp in self.stamps(*GOALS, OBSTACLES).items():
            if stamp == self._time:
                self._shared.setdefault(name, deque([False], WINDOW))[-1] = True
        self.refused.update(f'{topic}: {culprit}' for culprit, _ in odd)
        more = f' (the first of {len(odd)})' if len(odd) > 1 else ''
        return f'{self._named(topic)}{odd[0][1]}{more}' if odd else ''

    def _take_transform(self, topic: str, link: Any, _now: float, ros: int | None) -> None:
        """Take in a transform, or raise BadInput."""
        stamp = messages.nanoseconds(link.header.stamp, 'header.stamp')
        if topic == TF:  # else all later ones would be out of order
            _past(stamp, ros, AHEAD)
        self.transforms.hear(link, stamp, fixed=topic == TF_STATIC)

    def _take(self, topic: str, message: Any, now: float, ros: int | None) -> None:
        """Take in odometry, a goal, a wind or another vehicle's plan, or raise BadInput."""
        if topic in messages.POSE_TWIST:
            topic, message = 'odom', self._synchronizer.take(topic, message)
        if message is None:
            return  # waits for the other half
        settings, last, is_goal = self.settings, self.latest.get(topic), topic in GOALS
        move = self.transforms.move(message.header) if is_goal or topic in self.others else None
        stamp, value = read(topic, message, settings, move)
        apart = abs(_past(stamp.nanoseconds, ros, settings.future_tolerance + self.lag))
        by_hand = is_goal and stamp.nanoseconds == 0  # typed without a stamp: dated by arrival
        timeout = settings.goal_timeout if topic != 'odom' else settings.odom_timeout
        fresh = last is not None and now - last.at <= timeout
        if not by_hand:
            self._require_newer(topic, stamp.nanoseconds, fresh=fresh)
        if is_goal:
            self._require_near(topic, stamp, value, fresh=fresh)
        if topic == 'goal':
            self.altitude = messages.altitude_of(message, move)
        # Once timed, always timed: what is delayed by minutes must not count as fresh.
        timed: bool | None = apart <= COMPARABLE or (last is not None and last.timed is True)
        if by_hand or (not timed and math.isnan(apart)):
            timed = None
        run = last.run + 1 if fresh and last is not None else 1
        moved = None if move is None else message
        self._keep(topic, Received(stamp, value, now, timed, run, moved))

    def _require_newer(self, topic: str, stamp: int, *, fresh: bool) -> None:
        """Reject a stamp [ns] not later than that of the last message, if that is fresh."""
        last = self.latest.get(topic)
        before = -1 if last is None else last.stamp.nanoseconds
        if stamp == 0 and (before == 0 or (topic == 'odom' and last is not None and last.timed)):
            raise BadInput.stating('unset stamp', '0 again' if before == 0 else '0', NOT_SET)
        if stamp == before and topic not in self.others:  # planners repeat their answers
            raise BadInput('duplicate stamp', stamp, INCREASING)
        # Once the last one is stale, an older stamp means that the sender's clock was set back.
        if stamp < before and fresh:
            raise BadInput('reordered stamp', f'{(before - stamp) / SECOND:.3g} s back', INCREASING)

    def _require_near(self, topic: str, stamp: Stamp, value: Any, *, fresh: bool) -> None:
        """Reject a goal that jumps; once the last one is stale, the new one is accepted."""
        limit, last = self.settings.goal_jump_limit, self.latest.get(topic)
        if limit == 0.0 or last is None or isinstance(value, Route):
            return
        at = np.array([stamp.nanoseconds / SECOND])
        before, place = (
            each.position if isinstance(each, GoalObservation) else each.at(at)[0]
            for each in (last.value, value)
        )
        jump = float(np.linalg.norm(place - before))
        if jump > limit and fresh:
            raise BadInput('goal jump', f'{jump:.3g} m', f'at most goal_jump_limit, {limit:g} m')
        if jump > limit and topic == 'goal':
            self._see_anew(None)

    def _keep(self, topic: str, received: Received) -> None:
        last = self.latest.get(topic)
        back = last is not None and received.stamp.nanoseconds <= last.stamp.nanoseconds
        if topic in GOALS:
            self.goal_counts[topic] += 1
        if topic == 'odom':
            # A source in lock-step shares stamps from its first message on. A slower one on the
            # driver's clock has some: waiting would slow the planner down to its rate.
            self.companions = []
            for name, shared in self._shared.items():
                if WINDOW * shared.count(False) <= len(shared):
                    self.companions.append(name)
                shared.append(False)
            if back:
                self._keep_goal_alone()
        first = self.odometry is None
        self.latest[topic] = received
        if topic == 'goal':
            # A goal without a stamp gives a position, but no motion. (In simulations the first
            # goal has a stamp of 0.)
            undated = last and last.stamp.nanoseconds == 0 and last.value.time > 0.0
            if back or undated:
                self._see_anew(received)
            else:
                self.forecast.observe(received.value)
        if topic == 'goal' or (topic == 'odom' and first):
            self._date_goal()
        if topic == 'odom':
            self._place_again(received.stamp.nanoseconds)

    def renew(self, stamp: int, now: float) -> bool:
        """Count odometry of a stamp [ns] as arrived again; return True if it may be answered."""
        if stamp != self._time or not self.complete:
            return False
        self.latest['odom'] = replace(self.latest['odom'], at=now)
        return True

    # --- goals

    def _keep_goal_alone(self) -> None:
        """Forget all but a goal sent by hand, without its stamp; a stream sends its next one."""
        goal, kept = self.latest.get('goal'), None
        if goal is not None and not goal.streams:
            kept = replace(goal, stamp=replace(goal.stamp, nanoseconds=0), timed=None)
        self.latest.clear()
        self._see_anew(kept)

    def _see_anew(self, goal: Received | None) -> None:
        """Replace the goal and all of its history; None forgets the latter."""
        self.forecast = FORECASTS[self.settings.goal_prediction]()
        if goal is not None:
            self.latest['goal'] = goal
            self.forecast.observe(goal.value)

    def _date_goal(self) -> None:
        """Give a goal without a stamp the time of the latest odometry."""
        goal, odometry = self.latest.get('goal'), self.odometry
        if goal is not None and odometry is not None and not goal.stamp.nanoseconds:
            self._see_anew(replace(goal, value=replace(goal.value, time=odometry.value.time)))

    def _place_again(self, at: int) -> None:
        """Transform a resting goal anew, at a stamp [ns]: localisation may have moved its frame."""
        goal, self.displaced = self.latest.get('goal'), ''
        if goal is None or goal.moved is None or goal.streams:
            return
        try:
            move = self.transforms.move(goal.moved.header, at)
            _, value = read('goal', goal.moved, self.settings, move)
            self.altitude = messages.altitude_of(goal.moved, move)
        except BadInput as error:
            self.displaced = f'the goal stays where it was: {error}'
            return
        self._see_anew(replace(goal, value=replace(value, time=goal.value.time)))

    # --- moving obstacles

    def _take_marker(self, _topic: str, marker: Any, _now: float, ros: int | None) -> str:
        """Take in a marker, or raise BadInput; describe it if it is unusual."""
        name, everything = f'{marker.ns}/', marker.action == Marker.DELETEALL
        if everything or marker.action == Marker.DELETE:
            gone = [f'{name}{marker.id}']
            if everything:  # in its namespace, if it has one
                gone = [each for each in self.bodies if name in ('/', each.rstrip('-0123456789'))]
            for each in gone:
                self.bodies.pop(each, None)
            return ''
        context = self.settings.problem.dimension, self.settings.frames
        at, body = read_obstacle(marker, *context, self.transforms.move(marker.header))
        stamp = at.nanoseconds
        _past(stamp, ros, self.settings.future_tolerance + self.lag)
        limit, age = min(body.lifetime, COMPARABLE), (self._time - stamp) / SECOND
        if age > limit:
            stale = BadInput('stale stamp', f'{age:.3g} s old', f'at most {limit:g} s')
            raise stale if stamp else BadInput.stating('unset stamp', '0', NOT_SET)
        return self.bodies.see(body, self.settings.obstacle_speed_limit)

    def traffic(self, at: float) -> ObservedTraffic | None:
        """Return the traffic at a time [s]; None if there has never been a message."""
        if not (self.bodies or self.latest.keys() & {OBSTACLES, *self.others}):
            return None
        agents = tuple(filter(None, map(self._value, self.others)))
        tracks, settings = self.bodies.current(at), self.settings
        return ObservedTraffic(tracks, agents, settings.obstacle_unseen_speed, settings.distance)

    def silences(self) -> list[str]:
        """Return messages on other vehicles that have fallen silent."""
        if self.odometry is None:
            return []
        due = self.odometry.value.time - self.settings.distance.timeout
        return [*filter(None, (silence(name, self._value(name), due) for name in self.others))]

    # --- messages that belong together

    @property
    def odometry(self) -> Received | None:
        """Return the latest odometry, if any."""
        return self.latest.get('odom')

    @property
    def _time(self) -> int:
        return -1 if self.odometry is None else self.odometry.stamp.nanoseconds

    def _value(self, topic: str) -> Any:
        """Return the content of the latest message of a topic, if any."""
        return self.latest[topic].value if topic in self.latest else None

    def stamps(self, *topics: str) -> dict[str, int]:
        """Return the latest stamps of those of the topics that have a message [ns]."""
        latest = self.latest
        return {topic: latest[topic].stamp.nanoseconds for topic in topics if topic in latest}

    @property
    def complete(self) -> bool:
        """Return True if nothing is missing, and all messages that odometry waits for are here.

        These are from its companions, and from vehicles that have measured earlier.
        """
        if self.missing or self.due:
            return False
        stamps = self.stamps(*self.companions)
        return all(stamps.get(topic, -1) >= self._time for topic in self.companions)

    @property
    def due(self) -> list[str]:
        """Return the topics of vehicles that have measured earlier, and still have to plan.

        They are taken to plan as often as this one. Without their new plans, paths might cross. Of
        vehicles that measure at the same time, those of lesser names plan first.
        """
        topics, own, period = [], self._resolve(PLAN), self.settings.period
        for topic, stamp in self.stamps(*self.others).items():
            age, tie = (self._time - stamp) / SECOND, -TIE if topic < own else TIE
            if period >= UNHURRIED and period + tie < age <= self.settings.distance.timeout:
                topics.append(topic)
        return topics

    @property
    def missing(self) -> str:
        """Describe the missing inputs without which there is no plan; empty if complete."""
        latest, absent = self.latest, []
        if 'odom' not in latest:
            absent.append(f'odometry on {self._named("odom")}')
        goals = [latest[topic] for topic in GOALS if topic in latest]
        if not goals:
            absent.append(f'a goal on {" or ".join(map(self._named, GOALS))}')
        elif self.settings.wants_attitude and all(g.value.attitude is None for g in goals):
            absent.append(f'a goal with a yaw on {" or ".join(map(self._named, GOALS))}')
        return ' and '.join(absent)

    def _named(self, topic: str) -> str:
        """Return the full name of a topic, or of the two that odometry comes on."""
        pair = messages.POSE_TWIST
        halves = topic in ('odom', *pair) and self.settings.odometry == 'pose_twist'
        return ' and '.join(map(self._resolve, pair if halves else (topic,)))

    @property
    def untimed(self) -> str:
        """Return the sources whose stamps are not on this node's clock."""
        topics = (t for t in READ if t in self.latest and self.latest[t].timed is False)
        return ', '.join(map(self._named, topics))

    # --- inputs of decisions

    def aim(self, topic: str) -> Array | None:
        """Return the goal, or the end of the path, last received on a topic, shape (n,) [m]."""
        value = self._value(topic)
        if isinstance(value, Route):
            return np.asarray(value.positions[-1])
        return value.position if isinstance(value, GoalObservation) else None

    @property
    def in_step(self) -> bool:
        """Return True if goals come with odometry, as from a simulator that waits for answers."""
        return bool(self.companions) or self._time in self.stamps(*GOALS).values()

    @property
    def heard(self) -> dict[str, Any]:
        """Return what the next decision is based on, by the keys on ``tick``.

        Stamps are by topic [ns]. Goals so far are counted, since some may be lost. The motion of
        the goal is named if the forecast chooses one.
        """
        model = getattr(self.forecast, 'model', '')
        return {
            'goal_stamps': self.stamps(*GOALS),
            'goal_counts': dict(self.goal_counts),
            **({'goal_model': model} if model else {}),
            'traffic_stamps': self.stamps(OBSTACLES, *self.others),
        }

    def snapshot(
        self, now: float, ros: int | None = None, *, stop: Reason | None = None, taking: float = 0.0
    ) -> Snapshot:
        """Return all inputs of a decision that takes a time [s]; ``stop`` forbids any plan."""
        odometry, goal, path = self.odometry, self.latest.get('goal'), self.latest.get('goal_path')
        ages = {t: self._goal_age(t, now, ros) for t in GOALS if t in self.latest}
        motion: GoalMotion | None = None if goal is None else self.forecast
        wanted = None if goal is None else goal.value.attitude
        if path is not None:
            fresh = ages['goal_path'] <= self.settings.goal_timeout
            if fresh or goal is None:  # as the only goal, it is judged by its age
                motion = path.value
            if fresh and path.value.attitude is not None:
                wanted = path.value.attitude
        age = min(ages.values(), default=0.0)
        if odometry is None:
            return Snapshot(None, motion, wanted, goal_age=age, stop=stop)
        compensated = self.settings.delay_compensation and odometry.timed and ros
        return Snapshot(
            odometry=odometry.value,
            goal=motion,
            wanted=wanted,
            traffic=self.traffic(odometry.value.time),
            wind=self._value('wind'),
            odometry_age=odometry.age(now, ros),
            goal_age=age,
            latency=odometry.delay(ros) + taking if compensated else 0.0,
            stop=stop,
        )

    def _goal_age(self, topic: str, now: float, ros: int | None) -> float:
        """Return the age of a goal [s]; 0 for one that does not expire."""
        settings, goal = self.settings, self.latest[topic]
        route = isinstance(goal.value, Route)
        by_hand = (topic == 'goal' or route) and not goal.streams
        lasting = not settings.hand_sent_expire or (route and not settings.given_goal_timeout)
        if settings.given_goal_timeout < 0.0 or (lasting and by_hand):
            return 0.0
        return goal.age(now, ros)


def _past(stamp: int, ros: int | None, allowed: float) -> float:
    """Return the time since a stamp [ns], NaN if unknown; reject one too far ahead [s]."""
    since = math.nan if ros is None else (ros - stamp) / SECOND
    if -since > allowed:
        ahead_of = f"{allowed:g} s ahead of this node's clock"
        raise BadInput('future stamp', f'{-since:.3g} s ahead', f'at most {ahead_of}')
    return since


def read(
    topic: str, message: Any, settings: PlannerSettings, move: Array | None
) -> tuple[Stamp, Any]:
    """Return stamp and content of an input, moved; a goal without a frame is in the world frame.

    Raises:
        BadInput: it is not acceptable; for instance, a goal in the plane needs an attitude, and its
            x axis is vertical.
    """
    frames = settings.frames
    if topic in GOALS and not message.header.frame_id:
        frames = replace(frames, world='')
    context = settings.problem.dimension, frames, *(() if move is None else (move,))
    stamp, value = READ.get(topic, messages.read_agent)(message, *context)
    if topic in GOALS and settings.wants_attitude and value.attitude is None:
        needed = 'one that is not vertical: weights.attitude or approach.cone needs its yaw'
        raise BadInput('pose.orientation', 'that of a vertical x axis', needed)
    return stamp, value


def others(settings: PlannerSettings, resolve: Callable[[str], str]) -> tuple[str, ...]:
    """Return the topics of other vehicles' plans, without one's own: a fleet may share its list."""
    named = dict.fromkeys(map(resolve, settings.avoid))
    return tuple(name for name in named if name != resolve(PLAN))


def planner_of(settings: PlannerSettings) -> Planner:
    """Return a planner compiled for settings."""
    planner = Planner(
        settings.problem,
        shrinking=settings.horizon_mode == 'shrinking',
        safe=settings.safe_command,
        # On a dry run, the commands of another node are unknown.
        estimated=settings.estimated and not settings.dry_run,
        reserve=settings.obstacle_reserve,
        capture_radius=settings.capture_radius if settings.objective == 'intercept' else 0.0,
        **{name: getattr(settings, name) for name in OF_PLANNER},
    )
    if settings.avoid:
        planner.expect_hazards()
    return planner


class Core:
    """Decides on the content of messages; publishing is left to its users.

    Args:
        settings: of the planner.
        planner: compiled for them.
        simulated: whether time stops during a decision.
        clock: of deadlines [s]; None for solves without a deadline, so that results do not depend
            on the machine.
        counted: whether deadlines are measured by work instead while goals come with odometry.
        resolve: makes a topic's full name.

    Attributes:
        inputs: take in messages.
        counts: ``deadline misses``, decisions that exceeded their deadline; ``overruns``, decisions
            that exceeded their period.
        seen: snapshot of the last decision.
    """

    def __init__(
        self,
        settings: PlannerSettings,
        planner: Planner,
        *,
        simulated: bool = True,
        clock: Callable[[], float] | None = time.perf_counter,
        counted: bool = False,
        resolve: Callable[[str], str] = str,
    ) -> None:
        self.settings, self.planner = settings, planner
        self.inputs = Inputs(settings, resolve)
        self.counts = Counter({'deadline misses': 0, 'overruns': 0})
        self._recent: deque[float] = deque(maxlen=RECENT)  # durations of decisions [s]
        self.seen = Snapshot()
        self._simulated, self._counted = simulated, counted
        self._clock, self._unlimited = clock or time.perf_counter, clock is None
        self._deadline = Deadline(self._clock, math.inf)  # of the last decision

    @property
    def expected(self) -> float:
        """Return the usual duration of a decision, in whole nanoseconds, as replays count [s]."""
        return round(statistics.median(self._recent), 9) if self._recent else 0.0

    def install(self, settings: PlannerSettings, planner: Planner) -> None:
        """Continue with other settings and their planner."""
        planner.continue_from(self.planner)
        self.settings, self.planner = settings, planner
        self.inputs.adopt(settings)

    def start_afresh(self, *, wind: bool = False) -> None:
        """Forget plan and inputs, except a goal sent by hand; with ``wind``, its estimate too."""
        self.planner.start_afresh(wind=wind)
        self.inputs.start_afresh()

    def decide(self, now: float, ros: int | None = None, stop: Reason | None = None) -> Decision:
        """Return the next command, with what it is based on; ``stop`` forbids any plan."""
        begun, taking = self._clock(), 0.0 if self._simulated else self.expected
        snapshot = self.inputs.snapshot(now, ros, stop=stop, taking=taking)
        before, measured = self.seen.odometry, snapshot.odometry
        if before is not None and measured is not None and measured.time < before.time:
            self.planner.start_afresh()  # the clock of odometry was set back
        heard, self.seen = self.inputs.heard, snapshot
        clock, end = self._clock, math.inf if self._unlimited else begun + self.settings.deadline
        if self._counted and self.inputs.in_step:
            # This clock advances with each reading, of which a search takes one after each part:
            # its limit is the same on every machine, however busy.
            clock = (LOOK * looks for looks in itertools.count(1)).__next__
            end = min(self.settings.deadline, LONGEST)
        self._deadline = Deadline(clock, end)
        at = None if ros is None else (ros + round(taking * SECOND)) / SECOND
        decision = self.planner.step(snapshot, at, self._deadline)
        took = self._clock() - begun
        if decision.state is None:
            return decision
        self._recent.append(took)
        self.counts['deadline misses'] += took > self.settings.deadline
        self.counts['overruns'] += took > self.settings.period
        solving = 0.0 if decision.cause is Cause.GOAL else 1e3 * took
        return replace(decision, solve_time_ms=solving, heard=heard)

    def look_for(self, events: Events) -> float | None:
        """Check whether the last odometry shows that the goal, or a path's end, is reached.

        Return its distance then, or that of the path [m]; None without a fresh goal.
        """
        motion, measured, settings = self.seen.goal, self.seen.odometry, self.settings
        lost = self.inputs.missing or self.seen.goal_age > settings.goal_timeout
        if lost or measured is None or motion is None or isinstance(motion, np.ndarray):
            return None
        goal, approach = motion.at(np.array([measured.time]))[0], settings.approach
        if approach.is_the_goals and self.seen.wanted is not None:
            approach = replace(approach, direction=tuple(self.seen.wanted[:, 0].tolist()))
        events.note(measured, goal, settings.capture_radius, settings.odom_timeout, approach)
        if isinstance(motion, Route):
            goal = motion.place(np.array([motion.nearest(measured.position)]))[0]
        return math.dist(measured.position, goal)

    def proved(self, decision: Decision, *, catches: bool = False) -> Decision:
        """Return the last decision with a proof of its claim, if one is found by its deadline.

        The claim is infeasibility or, with ``catches``, that there is no catch before some time.
        The command has already been sent, without waiting for the proof.
        """
        sought, count = decision.infeasible, 1
        if sought is None and catches and decision.catch is not None:
            sought = decision.catch.sought
            count = steps_before(decision.catch.bound, sought.problem.step)
        if sought is None or not count:
            return decision
        # Imported by the first decision that needs it: it saves a tenth of a second at the start.
        from orbimpc_ros.mpc.proof.document import WORD, held_in_time
        from orbimpc_ros.mpc.solve.refute import refutation_of

        deadline, claim = (self._deadline.clock, self._deadline.end), (sought, count)
        refutation = held_in_time(lambda late: refutation_of(*claim, late), *deadline)
        reason = decision.reason
        if decision.infeasible is not None and refutation is None:
            reason = joined(reason, WORD)
        return replace(decision, refutation=refutation, reason=reason)
