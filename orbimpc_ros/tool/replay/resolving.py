"""The planner's answers made anew, from the inputs that a bag holds.

What was planned is solved again; when it was planned is timing, and taken from the recording. So
is which tick was not planned at all (an input was stale, the planner was disabled) and what was
really commanded on the tick before: one difference does not cause all that follow.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from orbimpc_ros.ros.parameters.planner import PlannerSettings
from orbimpc_ros.ros.reports import AFRESH
from orbimpc_ros.tool.io.stamps import SECOND
from orbimpc_ros.tool.replay.listener import Listener
from orbimpc_ros.tool.replay.pilot import Pilot, Told
from orbimpc_ros.tool.replay.recording import Recorded, Recording


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
    listener = Listener(pilot, recording, simulated, settings)
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


def _answer(pilot: Pilot, recorded: Recorded) -> Told:
    answer, reason = recorded.answer, recorded.answer.reason or ''
    if reason == AFRESH.words:
        pilot.forget()
    if not answer.planned:
        return pilot.be_safe(recorded.stamp, reason)
    if pilot.stamp != recorded.stamp:
        return pilot.be_safe(recorded.stamp, 'its odometry was refused, or a goal is missing')
    return pilot.plan(recorded.sent / SECOND, answer.advanced or 0.0, recorded.solve_time_ms)
