# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Bags: what is written is read back, by us and by what reads rosbag2; damage is noticed."""

import random

import pytest
import yaml
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool.io import bag
from orbimpc_ros.tool.io.bag import limits
from orbimpc_ros.tool.io.bag.writer import BagWriter
from orbimpc_ros.tool.io.topics import Topic

STORE = get_typestore(Stores.ROS2_JAZZY)
BOOL, CLOCK = 'std_msgs/msg/Bool', 'rosgraph_msgs/msg/Clock'
TOPICS = (Topic('/captured', BOOL, latched=True), Topic('/clock', CLOCK))


def serialised(value):
    return bytes(STORE.serialize_cdr(STORE.types[BOOL](data=value), BOOL))


@pytest.fixture
def folder(tmp_path):
    """Return a bag of five messages."""
    path = tmp_path / 'run'
    with BagWriter(path, TOPICS, {'parameters': 'a: 1\n'}) as writer:
        for k in range(5):
            writer.write('/captured', 1_000_000_000 * (k + 1), serialised(k == 4))
    return path


def test_what_is_written_is_read(folder):
    found = list(bag.read(folder))
    assert [m.stamp for m in found] == [1_000_000_000 * (k + 1) for k in range(5)]
    assert [m.content.data for m in found] == [False] * 4 + [True]
    assert {(m.topic, m.type) for m in found} == {('/captured', BOOL)}
    assert bag.notes(folder) == {'parameters': 'a: 1\n'}


def test_notes_are_read_from_a_bag_recorded_in_real_time(tmp_path):
    with BagWriter(tmp_path / 'run', TOPICS, {'parameters': 'a: 1\n'}) as writer:
        writer.write('/captured', 1_795_235_564_222_543_403, serialised(True))
    assert bag.notes(tmp_path / 'run') == {'parameters': 'a: 1\n'}


def test_rosbag2_metadata_agree_with_the_file(folder):
    metadata = yaml.safe_load((folder / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    assert metadata['storage_identifier'] == 'mcap'
    assert metadata['relative_file_paths'] == ['run.mcap']
    assert metadata['message_count'] == 5
    assert metadata['starting_time']['nanoseconds_since_epoch'] == 1_000_000_000
    assert metadata['duration']['nanoseconds'] == 4_000_000_000
    with Reader(folder / 'run.mcap') as reader:
        assert {c.topic: c.msgcount for c in reader.connections} == {'/captured': 5, '/clock': 0}
        assert all(c.msgdef.data for c in reader.connections)


def test_an_empty_bag_is_a_bag(tmp_path):
    BagWriter(tmp_path / 'run', TOPICS, {}).close()
    assert list(bag.read(tmp_path / 'run')) == []
    assert bag.notes(tmp_path / 'run') == {}


def test_closing_twice_is_closing_once(folder):
    before = (folder / 'metadata.yaml').read_bytes()
    writer = BagWriter(folder.parent / 'other', TOPICS, {})
    writer.close()
    writer.close()
    assert (folder / 'metadata.yaml').read_bytes() == before


def test_a_bag_is_never_overwritten(folder):
    with pytest.raises(FileExistsError):
        BagWriter(folder, TOPICS, {})


def test_no_flipped_bit_changes_what_is_read(folder):
    file = folder / 'run.mcap'
    intact, before = file.read_bytes(), list(bag.read(folder))
    draw, noticed = random.Random(1), 0
    places = range(0, len(intact), 11)
    for place in places:
        damaged = bytearray(intact)
        damaged[place] ^= 1 << draw.randrange(8)
        file.write_bytes(damaged)
        try:
            assert list(bag.read(folder)) == before
        except BadInput:
            noticed += 1
    assert noticed >= len(places) - 2  # the framing of the end of data carries nothing


def test_every_truncation_is_noticed(folder):
    file = folder / 'run.mcap'
    intact = file.read_bytes()
    for length in range(0, len(intact), 101):
        file.write_bytes(intact[:length])
        with pytest.raises(BadInput):
            list(bag.read(folder))


def test_a_missing_bag_is_bad_input(tmp_path):
    with pytest.raises(BadInput, match='nowhere'):
        list(bag.read(tmp_path / 'nowhere'))


def test_metadata_that_are_none_are_bad_input(folder):
    (folder / 'metadata.yaml').write_text('[1, 2]')
    with pytest.raises(BadInput):
        bag.notes(folder)


def test_a_huge_bag_is_refused_unread(folder, monkeypatch):
    monkeypatch.setattr(limits, 'MAX_BYTES', 100)
    with pytest.raises(BadInput, match='at most 100 bytes'):
        list(bag.read(folder))


def test_unknown_topics_and_types_are_not_decoded(tmp_path):
    listed = (Topic('/captured', CLOCK), Topic('/elsewhere', BOOL), Topic('/uav1/captured', BOOL))
    with BagWriter(tmp_path / 'run', listed, {}) as writer:
        for topic in listed:
            writer.write(topic.name, 1, serialised(True))
    assert [m.topic for m in bag.read(tmp_path / 'run')] == ['/uav1/captured']
