# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A bag as a regression test: inputs in the order of their arrival, and answers made anew.

What was planned is solved again; when it was planned is timing, and taken from the recording. So
is which tick was not planned at all (an input was stale, the planner was disabled) and what was
really commanded on the tick before: one difference does not cause all that follow.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, takewhile
from pathlib import Path
from typing import Any

import numpy as np

from orbimpc_ros.loop.planner import Decision
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.outcome import Cause, Reason
from orbimpc_ros.ros import topics
from orbimpc_ros.ros.messages import POSE_TWIST, SECOND, pushed
from orbimpc_ros.ros.parameters.planner import PlannerSettings
from orbimpc_ros.ros.planner.core import READ, TRANSFORMS, read, require_attitude
from orbimpc_ros.tool import bags
from orbimpc_ros.tool.bags import Message, fields, point, stamp_of
from orbimpc_ros.tool.offline import OfflinePlanner, resolved

CLOCK = '/clock'
TREE = tuple(topic.name for topic in topics.TREE)
INPUTS = tuple(topic.name for topic in topics.INPUTS)
OUTPUTS = tuple(topic.name for topic in topics.OUTPUTS)
COMPARED = tuple(name for name in OUTPUTS if name not in ('plan', 'plan_markers'))
NEEDED = ('odom',), ('goal', 'goal_path'), ('tick', 'cmd_vel')
NUMBER = (int, float)
KINDS: dict[str, type | tuple[type, ...]] = {
    **dict.fromkeys(('status', 'reason', 'cause', 'fallback'), str),
    **dict.fromkeys(('objective', 'lower_bound', 'gap', 'earliest_catch', 'catch_bound'), NUMBER),
    **dict.fromkeys(('advanced', 'solve_time_ms'), NUMBER),
    **dict.fromkeys(('goal_stamps', 'goal_counts', 'traffic_stamps'), dict),
    'bound_checked': bool,
    'speed_fraction': list,
}  # values of ``tick`` that a replay needs; those of another type are dropped
UNDATED = -1  # [ns] for a stamp that is none
Messages = Mapping[str, Any]  # by topic
Answer = dict[str, Any]  # what the planner published on a tick; what is not known is not in it


def published(messages: Messages) -> Answer:
    """Return what messages by topic hold: the values of a tick by their names on it.

    Besides the ``speed`` [m/s], ``body_rate``, shape (3,) [rad/s], ``force`` [N] and ``rotation``,
    a quaternion of shape (4,), that were commanded.
    """
    found: Answer = {}
    if 'cmd_vel' in messages:
        twist = messages['cmd_vel'].twist
        found |= {'speed': pushed(twist.linear), 'body_rate': point(twist.angular)}
    if 'cmd_thrust' in messages:
        found['force'] = pushed(messages['cmd_thrust'].wrench.force)
    if 'rotation' in messages:
        q = messages['rotation'].quaternion
        found['rotation'] = np.array([q.w, q.x, q.y, q.z])
    if 'tick' in messages and messages['tick'].status:
        values = fields(messages['tick'])
        found |= {n: each for n, each in values.items() if isinstance(each, KINDS.get(n, object))}
    return found


def was_solved(answer: Answer) -> bool:
    """Return whether a solver was asked, as far as is known."""
    return answer.get('solve_time_ms') != 0.0


def was_planned(answer: Answer) -> bool:
    """Return whether it came of odometry and goals, be it without a solver, as far as is known.

    Without one it goes on with the plan before, since every goal is old; what is safe for any
    other reason names no goal.
    """
    return was_solved(answer) or bool(answer.get('goal_stamps'))


@dataclass(frozen=True)
class RecordedTick:
    """A tick of the planner."""

    stamp: int  # of the odometry that it answers [ns]
    sent: int  # when its first message was sent, by the clock of the inputs [ns]
    answer: Answer  # what its messages hold


@dataclass(frozen=True)
class Recording:
    """What a bag holds of one planner."""

    namespace: str  # of the vehicle, such as ``/uav1``
    inputs: tuple[Message, ...]  # under the stamps they carry, in the order in which they were sent
    answers: tuple[RecordedTick, ...]  # in the order in which they were sent

    @property
    def received(self) -> int:
        """Return how many messages the planner was sent, besides the time."""
        return sum(each.topic != CLOCK for each in self.inputs)

    @property
    def simulated(self) -> bool:
        """Return whether somebody published simulated time."""
        return self.received < len(self.inputs)


def recording_of(path: Path, namespace: str = '', others: Sequence[str] = ()) -> Recording:
    """Return what a bag holds of the planner in a namespace.

    Args:
        path: of the bag.
        namespace: of the vehicle, such as ``/uav1``.
        others: topics of other vehicles' plans that it heard.

    Raises:
        BadInput: no bag, or not one with odometry, a goal and the planner's answers.
    """
    shared = (CLOCK, *others, *TREE)
    found = bags.of_vehicle(path, namespace, (*INPUTS, *COMPARED), shared, NEEDED)
    found.sort(key=lambda each: each.sent)
    dated = [each._replace(stamp=_own_stamp(each)) for each in found]
    heard = {*INPUTS, *shared}.difference(POSE_TWIST)
    inputs = tuple(each for each in dated if each.topic in heard)
    answers = _answers(each for each in dated if each.topic in COMPARED)
    return Recording(namespace, inputs, tuple(sorted(answers, key=lambda each: each.sent)))


def _own_stamp(each: Message) -> int:
    stamp = stamp_of(each.content)
    return UNDATED if stamp is None else stamp


def _answers(sent: Iterable[Message]) -> Iterator[RecordedTick]:
    """Yield every answer, of which each topic has one message; a mere repetition counts once."""
    by_stamp: dict[int, list[dict[str, Message]]] = defaultdict(lambda: [{}, {}])
    for each in sent:
        groups = by_stamp[each.stamp]
        if each.topic in groups[-1]:
            groups.append({})
        groups[-1][each.topic] = each
    for stamp, groups in by_stamp.items():
        for before, now in pairwise(groups):
            known = {topic: repr(each.content) for topic, each in before.items()}
            if any(known.get(topic) != repr(each.content) for topic, each in now.items()):
                contents = {topic: each.content for topic, each in now.items()}
                begun = min(each.sent for each in now.values())
                yield RecordedTick(stamp, begun, published(contents))


# --- solved again


@dataclass(frozen=True)
class ReplayedTick:
    """A tick made anew."""

    recorded: RecordedTick  # what was answered then
    answer: Answer  # what is answered now
    refusals: tuple[str, ...]  # complaints of the validators about the inputs since the tick before
    decision: Decision  # behind it


def replayed(
    recording: Recording, settings: PlannerSettings, simulated: bool
) -> Iterator[ReplayedTick]:
    """Yield a tick for each that was recorded.

    Args:
        recording: the inputs, and when they were answered.
        settings: of the planner.
        simulated: whether its time came from ``/clock``.
    """
    avoided = resolved(settings, recording.namespace)
    planner = OfflinePlanner(settings, f'{recording.namespace}/planner', avoided)
    feed = Feed(planner, recording, simulated)
    for recorded in recording.answers:
        refusals = tuple(feed.until(recorded))
        answer = published(_answer(planner, recorded))
        then = recorded.answer
        pushed = then.get('force' if settings.problem.translation_order == 2 else 'speed')
        at = recorded.stamp if simulated else recorded.sent
        planner.went_out(at / SECOND, pushed, then.get('body_rate'))
        assert planner.decision is not None
        yield ReplayedTick(recorded, answer, refusals, planner.decision)


def _answer(planner: OfflinePlanner, recorded: RecordedTick) -> Messages:
    answer, stamp = recorded.answer, recorded.stamp
    word = answer.get('cause')
    cause = Cause(word) if word in list(Cause) else Cause.NONE
    if cause in (Cause.AFRESH, Cause.RESET):
        planner.start_afresh(wind=cause is Cause.RESET)
    if not was_planned(answer):
        return planner.answer(stamp, stop=Reason(cause, answer.get('reason', '')))
    if planner.stamp != stamp:
        refused = Reason(Cause.WAITING, 'its odometry was refused, or a goal is missing')
        return planner.answer(stamp, stop=refused)
    return planner.answer(stamp, recorded.sent / SECOND, answer.get('advanced', 0.0))


class Feed:
    """The inputs of a recording, given to a planner as it had them.

    Args:
        planner: takes them in.
        recording: what there is to take in.
        simulated: whether the ROS clock is ``/clock``, or the one by which messages were sent.
    """

    def __init__(self, planner: OfflinePlanner, recording: Recording, simulated: bool) -> None:
        self._planner, self._inputs = planner, list(recording.inputs)
        self._simulated = simulated
        planner.inputs.lag = planner.settings.step if simulated else 0.0
        self._clock: int | None = None
        self._counts: Counter[str] = Counter()

    def until(self, recorded: RecordedTick) -> Iterator[str]:
        """Give what had come when a tick was begun; yield refusals."""
        sent = list(takewhile(lambda each: each.sent <= recorded.sent, self._inputs))
        latest = _latest(sent, recorded)
        came = [each for k, each in enumerate(sent) if k <= latest.get(each.topic, -1)]
        lost = self._lost(came, recorded.answer.get('goal_counts', {}))
        for each in came:
            if each not in lost and (refusal := self._take(each)):
                yield refusal
        rest = [each for k, each in enumerate(sent) if k > latest.get(each.topic, -1)]
        self._inputs[: len(sent)] = rest

    def _lost(self, came: Sequence[Message], counts: Mapping[str, int]) -> list[Message]:
        """Return the goals that the planner never saw, by how many it reports to have taken in.

        Its queues hold one message: of several, the newest are those that it took.
        """
        lost: list[Message] = []
        for topic, count in counts.items():
            goals = (each for each in came if each.topic == topic)
            good = _increasing(goals, self._planner.settings)
            surplus = len(good) - (count - self._counts[topic])
            lost += good[: max(0, surplus)]
            self._counts[topic] = count
        return lost

    def _take(self, each: Message) -> str:
        if each.topic == CLOCK:
            self._clock = each.stamp
            return ''
        shown = self._clock if self._simulated else each.sent
        return self._planner.inputs.update(each.topic, each.content, each.sent / SECOND, shown)


def _increasing(goals: Iterable[Message], settings: PlannerSettings) -> list[Message]:
    """Return the valid goals, without those that come behind a later stamp or repeat one."""
    good: list[Message] = []
    for each in goals:
        unset = each.topic == 'goal' and each.stamp == 0
        if (not good or unset or each.stamp > good[-1].stamp) and _acceptable(each, settings):
            good.append(each)
    return good


def _acceptable(goal: Message, settings: PlannerSettings) -> bool:
    """Return whether a goal is a message that the planner's validators take."""
    # Whether a goal of another frame could be moved is not known.
    if settings.tf or settings.transforms:
        settings = replace(settings, frame_id='')
    try:
        require_attitude(read(goal.topic, goal.content, settings)[1], settings)
    except BadInput:
        return False
    return True


def _latest(sent: Sequence[Message], recorded: RecordedTick) -> dict[str, int]:
    """Return the index of the last input that was known, by topic.

    The stamps on a tick are those of the messages that it was made of. Where it has none, the times
    of sending decide, up to what a message takes on its way.
    """
    answer = recorded.answer
    begun = recorded.sent - round(1e6 * answer.get('solve_time_ms', 0.0))
    measured = _last(sent, 'odom', recorded.stamp)
    # By a clock of stamps no time passes: what was sent before odometry came in time.
    known = begun if measured < 0 else max(begun, sent[measured].sent)
    latest = {each.topic: k for k, each in enumerate(sent) if each.sent <= known}
    if measured >= 0 or was_solved(answer):  # else it came before, for another answer
        latest['odom'] = measured
    for topic, stamp in answer.get('goal_stamps', {}).items():
        latest[topic] = _last(sent, topic, stamp)
    if was_planned(answer):  # other ticks have no stamps of traffic
        for topic in {each.topic for each in sent} - {*READ, *TRANSFORMS, CLOCK}:
            heard = answer.get('traffic_stamps', {}).get(topic)
            latest[topic] = -1 if heard is None else _last(sent, topic, heard)
    return latest


def _last(sent: Sequence[Message], topic: str, stamp: int) -> int:
    """Return the last index under which a topic has a stamp; -1 for none."""
    found = (k for k, each in enumerate(sent) if each.topic == topic and each.stamp == stamp)
    return max(found, default=-1)
