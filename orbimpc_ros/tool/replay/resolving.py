# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner's answers made anew, from the inputs that a bag holds.

What was planned is solved again; when it was planned is timing, and taken from the recording. So
is which tick was not planned at all (an input was stale, the planner was disabled) and what was
really commanded on the tick before: one difference does not cause all that follow.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile

from orbimpc_ros.loop.planner import Decision
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.outcome import Cause, Reason
from orbimpc_ros.ros.messages import SECOND, RosTime
from orbimpc_ros.ros.parameters.planner import PlannerSettings
from orbimpc_ros.ros.planner.core import GOALS, READ, TRANSFORMS, read, require_attitude
from orbimpc_ros.tool.offline import OfflinePlanner, resolved
from orbimpc_ros.tool.replay.recording import (
    CLOCK,
    Input,
    Messages,
    RecordedTick,
    Recording,
    was_planned,
    was_solved,
)


@dataclass(frozen=True)
class ReplayedTick:
    """A tick made anew."""

    recorded: RecordedTick  # what was answered then
    messages: Messages  # what is answered now, by topic
    refusals: tuple[str, ...]  # complaints of the validators about the inputs since the tick before
    decision: Decision  # behind the messages


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
        messages = _answer(planner, recorded)
        answer = recorded.answer
        pushed = answer.get('force' if settings.problem.translation_order == 2 else 'speed')
        at = recorded.stamp if simulated else recorded.sent
        planner.went_out(at / SECOND, pushed, answer.get('body_rate'))
        assert planner.decision is not None
        yield ReplayedTick(recorded, messages, refusals, planner.decision)


def _answer(planner: OfflinePlanner, recorded: RecordedTick) -> Messages:
    answer, stamp = recorded.answer, recorded.stamp
    word = answer.get('cause')
    cause = Cause(word) if word in list(Cause) else Cause.NONE
    if cause in (Cause.AFRESH, Cause.RESET):
        planner.start_afresh(wind=cause is Cause.RESET)
    if not was_planned(answer):
        return planner.be_safe(stamp, Reason(cause, answer.get('reason', '')))
    if planner.stamp != stamp:
        refused = Reason(Cause.WAITING, 'its odometry was refused, or a goal is missing')
        return planner.be_safe(stamp, refused)
    advanced, took = answer.get('advanced', 0.0), answer.get('solve_time_ms', 0.0)
    return planner.plan(recorded.sent / SECOND, advanced, took)


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

    def _lost(self, came: Sequence[Input], counts: Mapping[str, int]) -> set[Input]:
        """Return the goals that the planner never saw, by how many it reports to have taken in.

        Its queues hold one message: of several, the newest are those that it took.
        """
        lost: set[Input] = set()
        for topic, count in counts.items():
            goals = (each for each in came if each.topic == topic)
            good = _increasing(goals, self._planner.settings)
            surplus = len(good) - (count - self._counts[topic])
            lost.update(good[: max(0, surplus)])
            self._counts[topic] = count
        return lost

    def _take(self, each: Input) -> str:
        if each.topic == CLOCK:
            self._clock = each.stamp
            return ''
        step = self._planner.settings.problem.step
        shown = RosTime(self._clock, step) if self._simulated else RosTime(each.sent)
        return self._planner.inputs.update(each.topic, each.message, each.sent / SECOND, shown)


def _increasing(inputs: Iterable[Input], settings: PlannerSettings) -> list[Input]:
    """Return the valid inputs, without those that come behind a later stamp or repeat one."""
    good: list[Input] = []
    for each in inputs:
        unset = each.topic == 'goal' and each.stamp == 0
        if (not good or unset or each.stamp > good[-1].stamp) and acceptable(each, settings):
            good.append(each)
    return good


def acceptable(each: Input, settings: PlannerSettings) -> bool:
    """Return whether an input is a message that the planner's validators take."""
    if each.topic not in READ:
        return False
    try:
        # Whether a goal of another frame could be moved is not known.
        if each.topic in GOALS and (settings.tf or settings.transforms):
            settings = replace(settings, frame_id='')
        _, value = read(each.topic, each.message, settings)
        if each.topic in GOALS:
            require_attitude(value, settings)
    except BadInput:
        return False
    return True


def _latest(sent: Sequence[Input], recorded: RecordedTick) -> dict[str, int]:
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


def _last(sent: Sequence[Input], topic: str, stamp: int) -> int:
    """Return the last index under which a topic has a stamp; -1 for none."""
    found = (k for k, each in enumerate(sent) if each.topic == topic and each.stamp == stamp)
    return max(found, default=-1)
