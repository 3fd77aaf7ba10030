# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Reading bags that may be hostile: checked as a whole first, then only the topics that we know.

Both of rosbag2's storages, MCAP and SQLite, plain or compressed, as our recorder or ``ros2 bag
record`` writes them.
"""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool.io import topics
from orbimpc_ros.tool.io.bag import limits, mcap, sqlite
from orbimpc_ros.tool.io.bag.folder import Folder, folder_of, plain
from orbimpc_ros.tool.io.bag.raw import Raw, same, store

__all__ = ['Message', 'notes', 'of_vehicle', 'raw', 'read']

NEEDED = ('odom', 'goal')


class Message(NamedTuple):
    """A message from a bag.

    Attributes:
        topic: it came on.
        stamp: under which it was recorded [ns].
        type: of the message.
        content: decoded.
        sent: when it was sent, which orders what happened; the stamp if that is not known [ns].
    """

    topic: str
    stamp: int
    type: str
    content: Any
    sent: int


def read(path: Path, names: Collection[str] = ()) -> Iterator[Message]:
    """Yield the messages of a bag (folder, .mcap or .db3) in the order of their stamps.

    A bag whose recorder was killed is read up to its last complete chunk, and a line says so.

    Args:
        path: of the bag.
        names: of the topics wanted, in whatever namespace; by default all that we know.

    Raises:
        BadInput: missing, damaged, too large, of another version, or not a bag.
    """
    for each in raw(path):
        if not names or each.topic.rpartition('/')[2] in names:
            yield Message(each.topic, each.stamp, each.type, _decoded(each, path), each.sent)


def of_vehicle(path: Path, namespace: str, names: Collection[str] = ()) -> list[tuple[str, Any]]:
    """Return one vehicle's messages, topics named without its namespace, in the order of stamps.

    Args:
        path: of the bag.
        namespace: of the vehicle, such as ``/uav1``.
        names: of the topics wanted; by default all that we know.

    Raises:
        BadInput: no bag, or one without odometry and goal of this vehicle.
    """
    found = list(read(path, names))
    there = {message.topic for message in found}
    for topic in NEEDED:
        if f'{namespace}/{topic}' not in there:
            raise topics.absent(path, f'{namespace}/{topic}', there)
    parted = ((*message.topic.rpartition('/'), message.content) for message in found)
    return [(name, content) for before, _, name, content in parted if before == namespace]


def raw(path: Path) -> list[Raw]:
    """Return the messages on the topics that we know, in the order of their stamps, as bytes.

    Raises:
        BadInput: missing, damaged, too large, of another version, or not a bag.
    """
    folder = folder_of(path)
    with _blamed(path):
        found = _collected(folder)
    if not folder.closed:
        cut = f'{path} was not closed: read up to its last chunk, {len(found)} messages'
        print(f'orbimpc: {cut}', file=sys.stderr)
    return sorted(found, key=lambda each: each.stamp)


def notes(path: Path) -> dict[str, str]:
    """Return what our recorder has noted in a bag; empty if it is not one of ours.

    Notes in the file itself come first: unlike ``metadata.yaml`` it has checksums. They are checked
    as a whole only when the messages are read too.

    Raises:
        BadInput: no bag, or damaged.
    """
    folder = folder_of(path)
    files = [file for file in folder.files if file.suffix == '.mcap']
    with _blamed(path):
        return (mcap.notes(files[0], folder.closed) if files else {}) or folder.notes


@contextmanager
def _blamed(path: Path) -> Iterator[None]:
    """Blame the bag for whatever a decoder that trips over damaged bytes happens to raise."""
    try:
        yield
    except BadInput:
        raise
    except Exception as error:
        raise BadInput.stating(str(path), f'unreadable ({error!r})', limits.ALLOWED) from None


def _collected(folder: Folder) -> list[Raw]:
    found: list[Raw] = []
    kept = 0
    for file in folder.files:
        with plain(file, folder.compression) as path:
            for each in _messages(path, folder):
                kept += len(each.data)
                limits.require(kept, limits.MAX_KEPT, file, 'bytes of messages')
                found.append(each)
    return found


def _messages(file: Path, folder: Folder) -> Iterator[Raw]:
    """Yield a file's messages, each checked for its size and its type."""
    storage = sqlite.messages(file) if file.suffix == '.db3' else mcap.messages(file, folder.closed)
    for each in storage:
        if not isinstance(each.stamp, int) or not isinstance(each.data, bytes):
            problem = 'damaged (a message without stamp or bytes)'
            raise BadInput.stating(str(file), problem, limits.ALLOWED)
        data = each.data
        if folder.compression == 'message':
            data = limits.unpacked(data, limits.MAX_MESSAGE, file)
        limits.require(len(data), limits.MAX_MESSAGE, file, 'bytes in a message')
        if not same(each.type, each.definition):
            problem, hint = f'another version of {each.type}', "ROS 2 Jazzy's is needed"
            raise BadInput.stating(f'{file}: {each.topic}', problem, hint)
        yield each._replace(data=data)


def _decoded(each: Raw, path: Path) -> Any:
    with _blamed(path):
        return store().deserialize_cdr(each.data, each.type)
