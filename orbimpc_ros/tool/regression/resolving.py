"""The planner's answers made anew, from the inputs that a bag holds.

What was planned is solved again; when it was planned is timing, and taken from the recording. So
is which tick was not planned at all (an input was stale, the planner was disabled) and what was
really commanded on the tick before: one difference does not cause all that follow.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile

from orbimpc_ros.ros.arrival import RosTime
from orbimpc_ros.ros.planner_parameters import PlannerSettings
from orbimpc_ros.ros.reports import AFRESH
from orbimpc_ros.tool.regression.pilot import Pilot, Told
from orbimpc_ros.tool.regression.recording import CLOCK, Input, Recorded, Recording
from orbimpc_ros.tool.stamps import SECOND

LOST = 'the goal is'  # how the planner begins to say that it goes on without one


@dataclass(frozen=True)
class Replayed:
    """An answer made anew.

    Attributes:
        recorded: what was answered then.
        messages: what is answered now, by topic.
        refusals: what the validators said of the inputs since the answer before.
    """

    recorded: Recorded
    messages: Told
    refusals: tuple[str, ...]


def replayed(
    recording: Recording, settings: PlannerSettings, simulated: bool
) -> Iterator[Replayed]:
    """Yield an answer for each that was recorded.

    Args:
        recording: the inputs, and when they were answered.
        settings: of the planner.
        simulated: whether its time came from ``/clock``.
    """
    pilot = Pilot(settings, f'{recording.namespace}/planner')
    listener = Listener(pilot, recording, simulated, settings.problem.step)
    for recorded in recording.answers:
        refusals = tuple(listener.heard(recorded))
        told = _answer(pilot, recorded)
        answer = recorded.answer
        pushed = answer.force if settings.problem.translation_order == 2 else answer.speed
        at = recorded.stamp if simulated else recorded.sent
        pilot.went_out(at / SECOND, pushed, answer.body_rate)
        yield Replayed(recorded, told, refusals)


def before(recording: Recording, tick: int) -> Recording:
    """Return the recording up to and including a tick."""
    return replace(recording, answers=recording.answers[: tick + 1])


class Listener:
    """Tells a pilot what the planner had been told by the time of an answer.

    Args:
        pilot: to tell.
        recording: what there is to tell.
        simulated: whether the ROS clock is ``/clock``, or the one by which messages were sent.
        step: by which simulated time moves [s].
    """

    def __init__(self, pilot: Pilot, recording: Recording, simulated: bool, step: float) -> None:
        self._pilot, self._inputs = pilot, list(recording.inputs)
        self._simulated, self._step = simulated, step
        self._clock: int | None = None

    def heard(self, recorded: Recorded) -> Iterator[str]:
        """Take in what had come when the answer was begun; yield refusals."""
        sent = list(takewhile(lambda each: each.sent <= recorded.sent, self._inputs))
        latest = _latest(sent, recorded)
        known = [k for k, each in enumerate(sent) if k <= latest[each.topic]]
        for k in known:
            refusal = self._take(sent[k])
            if refusal:
                yield refusal
        rest = set(range(len(sent))).difference(known)
        self._inputs[: len(sent)] = [sent[k] for k in sorted(rest)]

    def _take(self, each: Input) -> str:
        if each.topic == CLOCK:
            self._clock = each.stamp
            return ''
        shown = RosTime(self._clock, self._step) if self._simulated else RosTime(each.sent)
        return self._pilot.hear(each.topic, each.message, each.sent / SECOND, shown)


def _latest(sent: Sequence[Input], recorded: Recorded) -> dict[str, int]:
    """Return the index of the last input that was known, by topic; -1 for none.

    An answer tells by its stamps which messages it was made of. Where it does not, when they were
    sent tells it, up to what a message takes on its way.
    """
    begun = recorded.sent - round(1e6 * _solve_time_ms(recorded))
    last = {each.topic: k for k, each in enumerate(sent) if each.sent <= begun}
    latest = defaultdict(lambda: -1, last)
    measured = [k for k, each in enumerate(sent) if _is(each, 'odom', recorded.stamp)]
    if measured:
        latest['odom'] = measured[-1]
        # By a clock of stamps no time passes: what was sent before odometry came in time.
        known = max(begun, sent[measured[-1]].sent)
        latest |= {each.topic: k for k, each in enumerate(sent)
                   if each.sent <= known and each.topic != 'odom'}  # fmt: skip
    for topic, stamp in (recorded.answer.goal_stamps or {}).items():
        latest[topic] = max(
            (k for k, each in enumerate(sent) if _is(each, topic, stamp)), default=-1
        )
    return latest


def _is(each: Input, topic: str, stamp: int) -> bool:
    return each.topic == topic and each.stamp == stamp


def _answer(pilot: Pilot, recorded: Recorded) -> Told:
    answer, reason = recorded.answer, recorded.answer.reason or ''
    if reason == AFRESH:
        pilot.forget()
    if not answer.solved and not reason.startswith(LOST):
        return pilot.be_safe(recorded.stamp, reason)
    if pilot.stamp != recorded.stamp:
        return pilot.be_safe(recorded.stamp, 'its odometry was refused, or a goal is missing')
    return pilot.plan(recorded.sent / SECOND, answer.advanced or 0.0, _solve_time_ms(recorded))


def _solve_time_ms(recorded: Recorded) -> float:
    return recorded.answer.solve_time_ms or 0.0
