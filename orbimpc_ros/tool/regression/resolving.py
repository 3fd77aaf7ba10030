"""The planner's answers made anew, from the inputs that a bag holds.

What was planned is solved again; when it was planned is timing, and taken from the recording. So
is which tick was not planned at all (an input was stale, the planner was disabled) and what was
really commanded on the tick before: one difference does not cause all that follow.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace

from orbimpc_ros.ros.planner_parameters import PlannerSettings
from orbimpc_ros.tool.regression.pilot import Pilot, Told
from orbimpc_ros.tool.regression.recording import Input, Recorded, Recording
from orbimpc_ros.tool.stamps import SECOND

AFRESH = 'starting afresh'  # why the planner commands what is safe when it has forgotten all


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


def replayed(recording: Recording, settings: PlannerSettings) -> Iterator[Replayed]:
    """Yield an answer for each that was recorded.

    Args:
        recording: the inputs, and when they were answered.
        settings: of the planner.
    """
    pilot = Pilot(settings, f'{recording.namespace}/planner')
    inputs = deque(recording.inputs)
    measured = {each.stamp for each in recording.inputs if each.topic == 'odom'}
    for recorded in recording.answers:
        refusals = tuple(_heard(pilot, inputs, recorded, recorded.stamp in measured))
        told = _answer(pilot, recorded)
        answer = recorded.answer
        pilot.commanded(answer.force if settings.problem.translation_order == 2 else answer.speed)
        yield Replayed(recorded, told, refusals)


def before(recording: Recording, tick: int) -> Recording:
    """Return the recording up to and including a tick."""
    return replace(recording, answers=recording.answers[: tick + 1])


def _heard(pilot: Pilot, inputs: deque[Input], recorded: Recorded, awaited: bool) -> Iterator[str]:
    """Take in what had come when the answer was begun; yield refusals.

    Sent times tell that up to what a message takes on its way. For odometry the answer's own stamp
    tells it exactly.
    """
    begun = recorded.sent - round(1e6 * _solve_time_ms(recorded))
    latest, found = recorded.sent if awaited else begun, False
    while inputs and inputs[0].sent <= latest and not (found and inputs[0].topic == 'odom'):
        each = inputs.popleft()
        refusal = pilot.hear(each.topic, each.message, each.sent / SECOND)
        if refusal:
            yield refusal
        elif each.topic == 'odom' and each.stamp == recorded.stamp:
            found = True
            # By a clock of stamps no time passes: what carries the same stamp came in time.
            latest = max(begun, each.sent)


def _answer(pilot: Pilot, recorded: Recorded) -> Told:
    reason = recorded.answer.reason or ''
    if reason == AFRESH:
        pilot.forget()
    if not recorded.answer.solved:
        return pilot.be_safe(recorded.stamp, reason)
    if pilot.stamp != recorded.stamp:
        return pilot.be_safe(recorded.stamp, 'its odometry was refused, or a goal is missing')
    return pilot.plan(recorded.sent / SECOND, _solve_time_ms(recorded))


def _solve_time_ms(recorded: Recorded) -> float:
    return recorded.answer.solve_time_ms or 0.0
