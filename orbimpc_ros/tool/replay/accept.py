# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Accepting a replay: the bag anew, with the same inputs and the new outputs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool import bags, settings
from orbimpc_ros.tool.bags import BagWriter, Raw, store
from orbimpc_ros.tool.files import replacing
from orbimpc_ros.tool.replay.recording import OUTPUTS, Recording
from orbimpc_ros.tool.replay.resolving import ReplayedTick
from orbimpc_ros.tool.settings import Values
from orbimpc_ros.tool.topics import TYPES, Topic, topics_of


def accept(recording: Recording, replayed: Sequence[ReplayedTick], values: Values) -> None:
    """Replace a bag of our recorder by one with new outputs; until that is whole, nothing changes.

    Args:
        recording: what the bag held.
        replayed: the new answers.
        values: of every parameter; noted in the bag.

    Raises:
        BadInput: the bag is not one of our recorder's, or cannot be replaced.
    """
    path = recording.path
    if not path.is_dir() or 'parameters' not in bags.notes(path):
        raise BadInput.stating(str(path), 'not a bag of orbimpc', 'the folder of one is needed')
    held = bags.raw(path)
    kept = [each for each in held if not _replaced(each, recording)]
    # What was not recorded, such as markers, stays out.
    wanted = {each.topic for each in held}
    fresh = [each for each in _serialised(recording, replayed) if each.topic in wanted]
    notes = bags.notes(path)
    if values != settings.of_bag(path, recording.namespace):
        notes['parameters'] = _text(values, recording)
    with replacing(path) as folder, BagWriter(folder, _topics(kept, recording), notes) as writer:
        for each in sorted([*kept, *fresh], key=lambda each: each.stamp):
            writer.write(each.topic, each.stamp, each.data, each.sent)


def _text(values: Values, recording: Recording) -> str:
    if recording.namespace:
        raise BadInput.stating('--update', 'other parameters are given', 'a fleet keeps its own')
    return settings.text(values)


def _replaced(each: Raw, recording: Recording) -> bool:
    before, _, name = each.topic.rpartition('/')
    return before == recording.namespace and name in OUTPUTS


def _topics(kept: Sequence[Raw], recording: Recording) -> list[Topic]:
    """Return the topics of the bag, as its recorder had them."""
    shared = {topic.name for topic in topics_of(())}
    spaces = {each.topic.rpartition('/')[0] for each in kept if each.topic not in shared}
    return list(topics_of(sorted(spaces | {recording.namespace})))


def _serialised(recording: Recording, replayed: Sequence[ReplayedTick]) -> Iterator[Raw]:
    for each in replayed:
        for name, message in each.messages.items():
            topic, then, kind = f'{recording.namespace}/{name}', each.recorded, TYPES[name]
            yield Raw(topic, kind, then.stamp, then.sent, serialised(message, kind))


def serialised(message: Any, kind: str) -> bytes:
    """Return a ROS message in CDR, the same bytes every time.

    The middleware leaves in the padding whatever was in memory.
    """
    from rclpy.serialization import serialize_message

    types = store()
    return bytes(types.serialize_cdr(types.deserialize_cdr(serialize_message(message), kind), kind))
