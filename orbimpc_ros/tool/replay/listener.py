"""What the planner had been told by the time of an answer, from what was sent to it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise, takewhile

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.clock import RosTime
from orbimpc_ros.ros.messages import read_itinerary, read_sighting
from orbimpc_ros.ros.parameters.planner import PlannerSettings
from orbimpc_ros.tool.io.stamps import SECOND
from orbimpc_ros.tool.replay.pilot import Pilot
from orbimpc_ros.tool.replay.recording import CLOCK, Input, Recorded, Recording

GOALS = {'goal': read_sighting, 'goal_path': read_itinerary}


class Listener:
    """Tells a pilot what the planner had been told.

    Args:
        pilot: to tell.
        recording: what there is to tell.
        simulated: whether the ROS clock is ``/clock``, or the one by which messages were sent.
        settings: of the planner.
    """

    def __init__(
        self, pilot: Pilot, recording: Recording, simulated: bool, settings: PlannerSettings
    ) -> None:
        self._pilot, self._inputs = pilot, list(recording.inputs)
        self._simulated, self._settings = simulated, settings
        self._clock: int | None = None
        self._counts: Counter[str] = Counter()

    def heard(self, recorded: Recorded) -> Iterator[str]:
        """Take in what had come when the answer was begun; yield refusals."""
        sent = list(takewhile(lambda each: each.sent <= recorded.sent, self._inputs))
        latest = _latest(sent, recorded)
        came = [each for k, each in enumerate(sent) if k <= latest.get(each.topic, -1)]
        lost = self._lost(came, recorded)
        for each in came:
            refusal = '' if id(each) in lost else self._take(each)
            if refusal:
                yield refusal
        rest = [each for k, each in enumerate(sent) if k > latest.get(each.topic, -1)]
        self._inputs[: len(sent)] = rest

    def _lost(self, came: Sequence[Input], recorded: Recorded) -> set[int]:
        """Return which goals the planner has never seen, as it tells by how many it took."""
        lost: set[int] = set()
        for topic, count in recorded.answer.goal_counts.items():
            good = self._increasing(each for each in came if each.topic == topic)
            surplus = max(0, len(good) - (count - self._counts[topic]))
            order = _by_risk(good) if self._counts[topic] else good
            lost |= {id(each) for each in order[:surplus]}
            self._counts[topic] = count
        return lost

    def _increasing(self, goals: Iterable[Input]) -> list[Input]:
        """Return the valid goals, without those that come behind a later stamp or repeat one."""
        good: list[Input] = []
        for each in goals:
            newer = not good or each.stamp > good[-1].stamp
            if newer and self._valid(each):
                good.append(each)
        return good

    def _valid(self, each: Input) -> bool:
        settings = self._settings
        try:
            GOALS[each.topic](each.message, settings.problem.dimension, settings.frames)
        except BadInput:
            return False
        return True

    def _take(self, each: Input) -> str:
        if each.topic == CLOCK:
            self._clock = each.stamp
            return ''
        step = self._settings.problem.step
        shown = RosTime(self._clock, step) if self._simulated else RosTime(each.sent)
        return self._pilot.hear(each.topic, each.message, each.sent / SECOND, shown)


def _latest(sent: Sequence[Input], recorded: Recorded) -> dict[str, int]:
    """Return the index of the last input that was known, by topic.

    An answer tells by its stamps which messages it was made of. Where it does not, when they were
    sent tells it, up to what a message takes on its way.
    """
    begun = recorded.sent - round(1e6 * recorded.solve_time_ms)
    measured = _last(sent, 'odom', recorded.stamp)
    # By a clock of stamps no time passes: what was sent before odometry came in time.
    known = begun if measured < 0 else max(begun, sent[measured].sent)
    latest = {each.topic: k for k, each in enumerate(sent) if each.sent <= known}
    if measured >= 0 or recorded.answer.solved:  # else it was told before, for another answer
        latest['odom'] = measured
    for topic, stamp in recorded.answer.goal_stamps.items():
        latest[topic] = _last(sent, topic, stamp)
    return latest


def _by_risk(goals: Sequence[Input]) -> list[Input]:
    """Return goals, those first that were lost most likely.

    The planner's queues hold one message: it is lost if the next one comes before it is taken. (At
    the beginning whoever did not know the planner yet was not heard: the first are lost.)
    """
    gaps = [later.sent - each.sent for each, later in pairwise(goals)]
    return [goals[k] for k in sorted(range(len(gaps)), key=gaps.__getitem__)]


def _last(sent: Sequence[Input], topic: str, stamp: int) -> int:
    """Return the last index under which a topic has a stamp; -1 for none."""
    found = (k for k, each in enumerate(sent) if each.topic == topic and each.stamp == stamp)
    return max(found, default=-1)
