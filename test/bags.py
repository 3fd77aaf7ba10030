# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Helpers for demo and golden bags: reading, rewriting, and synthetic flights."""

from collections import defaultdict
from contextlib import closing
from pathlib import Path

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from orbimpc_ros.ros.topics import Topic
from orbimpc_ros.tool import bags
from orbimpc_ros.tool.bags import BagWriter
from orbimpc_ros.tool.history import History


def check_pictures(folder, *names):
    assert {f.name for f in folder.glob('*.png')} == set(names)
    for name in names:
        picture = (folder / name).read_bytes()
        assert picture[:8] == b'\x89PNG\r\n\x1a\n'
        assert len(picture) > 50_000
        width, height = (int.from_bytes(picture[k : k + 4], 'big') for k in (16, 20))
        assert min(width, height) >= 1000


def read(path):
    """Return the decoded messages of a bag."""
    decoded = bags.store().deserialize_cdr
    return [each._replace(content=decoded(each.data, each.type)) for each in bags.raw(path)]


def messages_of(folder):
    """Return the messages of a bag by topic and stamp [ns]; the first one of each stamp."""
    found = defaultdict(dict)
    for message in read(folder / 'bag'):
        found[message.topic[1:]].setdefault(message.stamp, message.content)
    return found


def made_up(positions, values, **others):
    """Return a flight through positions, shape (M, 3), one second apart, its nose along x."""
    count, times = len(positions), 10.0 + np.arange(len(positions))
    known = {
        'attitudes': np.tile(np.eye(3), (count, 1, 1)),
        'velocities': np.diff(positions, axis=0, append=2 * positions[-1:] - positions[-2:-1]),
        'rates': np.zeros((count, 3)),
        'ropes': np.tile(values['rope.center'], (count, 1)),
        'plans': tuple((t, positions[k : k + 3]) for k, t in enumerate(times)),
        'ticks': tuple((t, {'speed_fraction': [1.0, 0.6]}) for t in times),
        'captured': True,
    }
    return History(times, positions, values=values, **known | others).to_the_catch()


GOLDEN = Path(__file__).parent / 'golden'


def rewritten(source, target, change=lambda each: each):
    """Copy a bag, with each message replaced by ``change(message)``, or dropped for None."""
    kept = [new for new in map(change, bags.raw(source)) if new is not None]
    return write(target, kept, bags.notes(source))


def write(target, messages, notes):
    """Write messages unchanged into a bag in our format."""
    listed = {each.topic: Topic(each.topic, each.type) for each in messages}
    with closing(BagWriter(target, list(listed.values()), notes)) as writer:
        for each in messages:
            writer.write(each.topic, each.stamp, each.data, each.sent)
    return target


def ros2_bag(source, target, storage, mode='none', skip=()):
    """Write a bag's messages as ``ros2 bag record`` does: in its storages, without our notes."""
    store = get_typestore(Stores.ROS2_JAZZY)
    writer = Writer(target, version=9, storage_plugin=StoragePlugin[storage.upper()])
    writer.set_compression(CompressionMode[mode.upper()], CompressionFormat.ZSTD)
    with writer:
        topics = {}
        for each in bags.raw(source):
            if each.topic in skip:
                continue
            if each.topic not in topics:
                topics[each.topic] = writer.add_connection(each.topic, each.type, typestore=store)
            writer.write(topics[each.topic], each.sent, each.data)
    return target


def changed(topic, kind, change):
    """Return a function that applies ``change`` to the messages of a topic."""

    def apply(each):
        if each.topic != topic:
            return each
        message = deserialize_message(each.data, kind)
        change(message)
        return each._replace(data=serialize_message(message))

    return apply
