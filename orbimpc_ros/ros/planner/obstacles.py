# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""What moves around the planner's vehicle: bodies on ``obstacles``, plans of other vehicles."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from orbimpc_ros.loop.traffic import MOST, AgentTrajectory, Bodies, Traffic, silence
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.clock import RosTime
from orbimpc_ros.ros.messages import SECOND, Stamp, read_agent
from orbimpc_ros.ros.obstacles import Gone, Spotted, read_obstacles, stamp_of
from orbimpc_ros.ros.parameters.planner import PlannerSettings

OBSTACLES, PLAN = 'obstacles', 'plan'
COMPARABLE = 60.0  # [s] stamps farther apart are of different clocks
UNHURRIED = 0.2  # [s] a shorter period leaves no time to wait for others
TIE = 0.02  # [s] who measures at such a distance measures at the same time
NOT_SET = (
    'set header.stamp to the time of measurement (in code get_clock().now().to_msg(), with '
    'ros2 topic pub "header: {stamp: now, frame_id: ...}")'
)


def others(avoid: Iterable[str], own: str, resolve: Callable[[str], str]) -> tuple[str, ...]:
    """Return the topics of other vehicles' plans, one's own left out: a fleet may share its list.

    Args:
        avoid: topics, as given.
        own: the topic of one's own plans.
        resolve: makes a topic's full name.
    """
    return tuple(name for name in dict.fromkeys(map(resolve, avoid)) if name != own)


def _require_fresh(stamp: Stamp, measured: RosTime, lifetime: float) -> None:
    age = measured.since(stamp.nanoseconds)
    if age <= min(lifetime, COMPARABLE) or measured.nanoseconds is None:
        return
    if stamp.nanoseconds == 0:
        raise BadInput.stating('unset stamp', '0', NOT_SET)
    raise BadInput('stale stamp', f'{age:.3g} s old', f'at most {min(lifetime, COMPARABLE):g} s')


@dataclass
class ObstacleTracker:
    """What moves around the vehicle.

    What stays of a message depends on its stamps alone, so that a recording shows the same.

    Attributes:
        settings: dimension, frames, distances and limits.
        names: of ``obstacles`` and ``plan`` as they are resolved.
        others: topics of other vehicles' plans.
        refused: what was refused so far, by topic and field.
        placed: moves a message to the world's frame.
        bodies: on ``obstacles``.
        agents: the latest plans of other vehicles, by topic.
        stamps: of the latest message of each topic [ns]; empty while there is nothing around.
        leaders: topics of the vehicles that plan before this one where stamps are shared. Planners
            that answer odometry of the same moment would each avoid what the others planned the
            moment before; by the names of their plans one comes after the other instead.
        periods: from one plan to the next of each topic [ns].
    """

    settings: PlannerSettings
    names: Mapping[str, str]
    others: tuple[str, ...]
    refused: Counter[str]
    placed: Callable[[Any], Any]
    bodies: Bodies = field(default_factory=Bodies)
    agents: dict[str, AgentTrajectory] = field(default_factory=dict)
    stamps: dict[str, int] = field(default_factory=dict)
    leaders: tuple[str, ...] = field(init=False)
    periods: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.leaders = tuple(name for name in self.others if name < self.names[PLAN])

    def take(self, topic: str, message: Any, ros: RosTime, measured: RosTime) -> str:
        """Take in a message; return what was refused or is odd, or an empty string.

        Args:
            topic: ``obstacles``, or that of another vehicle's plan.
            message: its content.
            ros: on the node's ROS clock.
            measured: the latest odometry's stamp, by which all that moves is aged.
        """
        if topic == OBSTACLES:
            return self._take_obstacles(message, ros, measured)
        try:
            self._take_plan(topic, message, ros, measured)
        except BadInput as error:
            self.refused[f'{topic}: {error.culprit}'] += 1
            return f'{topic} refused: {error}'
        return ''

    def _take_plan(self, topic: str, message: Any, ros: RosTime, measured: RosTime) -> None:
        settings, placed = self.settings, self.placed(message)
        stamp, agent = read_agent(placed, settings.problem.dimension, settings.frames)
        ros.require_past(stamp.nanoseconds, settings.future_tolerance)
        _require_fresh(stamp, measured, COMPARABLE)
        if stamp.nanoseconds < self.stamps.get(topic, 0):
            raise BadInput('reordered stamp', stamp.nanoseconds, 'stamps that do not decrease')
        self.agents[topic] = agent
        last = self.stamps.get(topic, stamp.nanoseconds)
        if last < stamp.nanoseconds:
            self.periods[topic] = stamp.nanoseconds - last
        self.stamps[topic] = stamp.nanoseconds

    def _take_obstacles(self, message: Any, ros: RosTime, measured: RosTime) -> str:
        settings, wrong, odd = self.settings, list[BadInput](), list[str]()
        count = len(message.markers)
        if count > MOST:  # to read them all would take long
            wrong.append(BadInput('count', f'{count} markers', f'{MOST}: the first are taken'))
        asked = settings.problem.dimension, settings.frames, MOST, self.placed
        for change in read_obstacles(message, *asked):
            if isinstance(change, Gone):
                self._remove(change)
                continue
            try:
                odd.append(self._see(change, ros, measured))
            except BadInput as error:
                wrong.append(error)
        self.stamps[OBSTACLES] = stamp_of(message)
        return self._counted(wrong, list(filter(None, odd)))

    def _remove(self, gone: Gone) -> None:
        if gone.name:
            self.bodies.remove(gone.name)
        else:
            self.bodies.clear()

    def _see(self, change: Spotted | BadInput, ros: RosTime, measured: RosTime) -> str:
        if isinstance(change, BadInput):
            raise change
        ros.require_past(change.stamp.nanoseconds, self.settings.future_tolerance)
        _require_fresh(change.stamp, measured, change.seen.lifetime)
        return self.bodies.see(change.seen, self.settings.obstacle_speed_limit)

    def _counted(self, wrong: list[BadInput], odd: list[str]) -> str:
        """Count what is wrong and odd about a message, and return it in a line."""
        counts, first = Counter[str](), dict[str, BadInput]()
        for error in wrong:
            counts[error.culprit] += 1
            first.setdefault(error.culprit, error)
        for culprit, count in counts.items():
            self.refused[f'{OBSTACLES}: {culprit}'] += count
        if odd:
            self.refused[f'{OBSTACLES}: jump'] += len(odd)
        parts = [f'{_count(counts[culprit])}{error}' for culprit, error in first.items()]
        name, lines = self.names[OBSTACLES], []
        if parts:
            lines.append(f'{name} refused: {"; ".join(parts)}')
        if odd:
            lines.append(f'{name}: {_count(len(odd))}{odd[0]}')
        return '; '.join(lines)

    def is_due(self, topic: str, measured: int) -> bool:
        """Return whether a vehicle has measured before a stamp [ns], and its plan is on its way.

        It is known by its period. Who plans without it may choose a way that crosses its new one.
        At the same time it is the leaders who plan first.
        """
        period = self.periods.get(topic)
        if period is None or self.settings.period < UNHURRIED:
            return False
        late = (measured - self.stamps[topic] - period) / SECOND
        if late + period / SECOND > self.settings.distance.timeout:
            return False  # it is silent
        return late > (-TIE if topic in self.leaders else TIE)

    def traffic(self, at: float) -> Traffic | None:
        """Return what is known at a time [s]; None where nothing was ever heard."""
        if not self.stamps:
            return None
        settings = self.settings
        known = self.bodies.current(at), tuple(self.agents.values())
        return Traffic(*known, settings.obstacle_unseen_speed, settings.distance)

    def silences(self, at: float) -> list[str]:
        """Return which other vehicles are not heard at a time [s], in words."""
        due = at - self.settings.distance.timeout
        found = (silence(name, self.agents.get(name), due) for name in self.others)
        return [words for words in found if words]

    def forget(self) -> None:
        """Forget all that was seen and heard."""
        self.bodies.clear()
        self.agents.clear()
        self.stamps.clear()
        self.periods.clear()


def _count(number: int) -> str:
    return '' if number == 1 else f'{number} times: '
