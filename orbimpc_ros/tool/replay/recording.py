"""A bag as a regression test sees it: inputs in the order of their arrival, and the answers."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool.io import bag, topics
from orbimpc_ros.tool.io.bag import Message
from orbimpc_ros.tool.io.stamps import SECOND
from orbimpc_ros.tool.replay.answer import Answer, Messages, answer_of

CLOCK = 'clock'
INPUTS = tuple(topic.name for topic in topics.INPUTS)
OUTPUTS = tuple(topic.name for topic in topics.OUTPUTS)
COMPARED = tuple(name for name in OUTPUTS if name not in ('plan', 'plan_markers'))


@dataclass(frozen=True)
class Input:
    """Something that the planner was told.

    Attributes:
        topic: without its namespace, or ``clock``.
        stamp: that it carries [ns].
        sent: when, on the recording machine's clock or under which stamp [ns].
        message: its content.
    """

    topic: str
    stamp: int
    sent: int
    message: Any


@dataclass(frozen=True)
class Recorded:
    """An answer of the planner.

    Attributes:
        stamp: of the odometry that it answers [ns].
        sent: when its first message was sent, by the clock of the inputs [ns].
        messages: by topic.
        answer: what they tell.
    """

    stamp: int
    sent: int
    messages: Messages
    answer: Answer

    @property
    def solve_time_ms(self) -> float:
        """Return what the tick took, as far as is known [ms]."""
        return self.answer.solve_time_ms or 0.0


@dataclass(frozen=True)
class Recording:
    """What a bag holds of one planner.

    Attributes:
        path: of the bag.
        namespace: of the vehicle, such as ``/uav1``.
        inputs: in the order in which they were sent.
        answers: in the order in which they were sent.
    """

    path: Path
    namespace: str
    inputs: tuple[Input, ...]
    answers: tuple[Recorded, ...]

    @property
    def simulated(self) -> bool:
        """Return whether somebody published simulated time."""
        return self.told < len(self.inputs)

    @property
    def told(self) -> int:
        """Return how many messages the planner was told, beside the time."""
        return sum(each.topic != CLOCK for each in self.inputs)


def recording_of(path: Path, namespace: str = '') -> Recording:
    """Return what a bag holds of the planner in a namespace.

    Raises:
        BadInput: no bag, or not one with odometry, a goal and the planner's answers.
    """
    found = list(bag.read(path, {CLOCK, *INPUTS, *COMPARED}))
    own = _by_topic(found, namespace)
    _require(own, found, path, namespace)
    clock = [_input(CLOCK, m) for m in found if m.topic == f'/{CLOCK}']
    inputs = clock + [_input(topic, m) for topic in INPUTS for m in own[topic]]
    answers = _answers({topic: own[topic] for topic in COMPARED})
    return Recording(
        path,
        namespace,
        tuple(sorted(inputs, key=lambda each: each.sent)),
        tuple(sorted(answers, key=lambda each: each.sent)),
    )


def _by_topic(found: Iterable[Message], namespace: str) -> dict[str, list[Message]]:
    own: dict[str, list[Message]] = defaultdict(list)
    for message in found:
        before, _, name = message.topic.rpartition('/')
        if before == namespace:
            own[name].append(message)
    return own


def _require(
    own: dict[str, list[Message]], found: list[Message], path: Path, namespace: str
) -> None:
    missing = [
        ' or '.join(f'{namespace}/{name}' for name in names)
        for names in (('odom',), ('goal', 'goal_path'), ('tick', 'cmd_vel'))
        if not any(own[name] for name in names)
    ]
    if missing:
        has = ', '.join(sorted({m.topic for m in found})) or 'none of its topics'
        raise BadInput(str(path), f'without {missing[0]}', f'a bag of a planner (this has {has})')


def stamp_of(message: Any) -> int:
    """Return the stamp [ns] in a message's header, or of ``/clock``, however nonsensical."""
    stamp = message.header.stamp if hasattr(message, 'header') else message.clock
    return int(stamp.sec) * SECOND + int(stamp.nanosec)


def _input(topic: str, message: Message) -> Input:
    return Input(topic, stamp_of(message.content), message.sent, message.content)


def _answers(outputs: dict[str, list[Message]]) -> Iterable[Recorded]:
    """Yield every answer; one that was merely repeated counts once."""
    told: dict[int, list[tuple[int, str, Any]]] = defaultdict(list)
    for topic, messages in outputs.items():
        for each in messages:
            told[stamp_of(each.content)].append((each.sent, topic, each.content))
    for stamp, said in told.items():
        said.sort(key=lambda each: each[0])
        before: Messages = {}
        for sent, contents in _grouped(said):
            if any(repr(before.get(topic)) != repr(each) for topic, each in contents.items()):
                yield Recorded(stamp, sent, contents, answer_of(contents))
            before = contents


def _grouped(said: Iterable[tuple[int, str, Any]]) -> Iterable[tuple[int, dict[str, Any]]]:
    """Yield messages by topic, and when the first of them was sent: each topic once an answer."""
    begun, contents = 0, dict[str, Any]()
    for sent, topic, content in said:
        if topic in contents:
            yield begun, contents
            contents = {}
        begun = begun if contents else sent
        contents[topic] = content
    yield begun, contents
