# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Bags: round trips through our reader and rosbags, and refusals of damaged bags."""

import os
from contextlib import closing

import pytest
import yaml
from bags import GOLDEN, read, rewritten, ros2_bag
from rosbags.rosbag2 import Reader

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.topics import Topic
from orbimpc_ros.tool import bags
from orbimpc_ros.tool.bags import BagWriter, store

BOOL, CLOCK = 'std_msgs/msg/Bool', 'rosgraph_msgs/msg/Clock'
TOPICS = (Topic('/captured', BOOL, latched=True), Topic('/clock', CLOCK))


def serialised(value):
    return bytes(store().serialize_cdr(store().types[BOOL](data=value), BOOL))


@pytest.fixture
def folder(tmp_path):
    """Return a bag of five messages."""
    path = tmp_path / 'run'
    with closing(BagWriter(path, TOPICS, {'parameters': 'a: 1\n'})) as writer:
        for k, stamp in enumerate(range(10**9, 6 * 10**9, 10**9)):
            writer.write('/captured', stamp, serialised(k == 4), stamp + 7)
    return path


@pytest.fixture(scope='module')
def small(tmp_path_factory):
    """Return a bag of three ticks."""

    def early(each):
        return each if each.stamp < 3_000_000_000 else None

    return rewritten(GOLDEN / 'retrieval', tmp_path_factory.mktemp('small') / 'bag', early)


def content(path):
    """Return everything in a bag: its notes, and its messages, decoded and raw."""
    return bags.notes(path), [repr(message) for message in read(path)], bags.raw(path)


def assert_refused(path, culprit=''):
    with pytest.raises(BadInput) as refused:
        content(path)
    line = str(refused.value)
    assert str(path) in line
    assert culprit in line
    assert '\n' not in line


# --- written and read


def test_what_is_written_is_read(folder):
    found = list(read(folder))
    assert [m.stamp for m in found] == [1_000_000_000 * (k + 1) for k in range(5)]
    assert [m.sent - m.stamp for m in found] == [7] * 5
    assert [m.content.data for m in found] == [False] * 4 + [True]
    assert {(m.topic, m.type) for m in found} == {('/captured', BOOL)}
    assert bags.notes(folder) == {'parameters': 'a: 1\n'}


def test_rosbags_reads_the_file_and_its_metadata(folder):
    metadata = yaml.safe_load((folder / 'metadata.yaml').read_text())['rosbag2_bagfile_information']
    assert metadata['storage_identifier'] == 'mcap'
    assert metadata['starting_time']['nanoseconds_since_epoch'] == 1_000_000_000
    assert metadata['duration']['nanoseconds'] == 4_000_000_000
    for path in (folder, folder / 'run.mcap'):
        with Reader(path) as reader:
            assert {c.topic: c.msgcount for c in reader.connections} == {
                '/captured': 5,
                '/clock': 0,
            }
            assert all(c.msgdef.data for c in reader.connections)
            assert len(list(reader.messages())) == 5


@pytest.mark.parametrize(
    ('storage', 'mode'), [('mcap', 'none'), ('mcap', 'storage'), ('sqlite3', 'none')]
)
def test_both_storages_of_rosbag2_are_read(small, tmp_path, storage, mode):
    path = ros2_bag(small, tmp_path / 'bag', storage, mode)
    expected = sorted((each.topic, each.data) for each in bags.raw(small))
    assert sorted((each.topic, each.data) for each in bags.raw(path)) == expected
    assert bags.notes(path) == {}


def test_an_empty_bag_is_a_bag(tmp_path):
    BagWriter(tmp_path / 'run', TOPICS, {}).close()
    assert content(tmp_path / 'run') == ({}, [], [])


def test_a_bag_is_never_overwritten(folder):
    with pytest.raises(FileExistsError):
        BagWriter(folder, TOPICS, {})


def test_unknown_topics_and_types_are_not_decoded(tmp_path):
    listed = (Topic('/captured', CLOCK), Topic('/elsewhere', BOOL), Topic('/uav1/captured', BOOL))
    with closing(BagWriter(tmp_path / 'run', listed, {})) as writer:
        for topic in listed:
            writer.write(topic.name, 1, serialised(True), 1)
    assert [m.topic for m in read(tmp_path / 'run')] == ['/uav1/captured']


# --- damaged


def test_a_bag_without_its_end_is_read_up_to_its_last_chunk(tmp_path, capsys):
    path = tmp_path / 'bag'
    path.mkdir()
    data = (GOLDEN / 'retrieval' / 'retrieval.mcap').read_bytes()
    before, counts = bags.raw(GOLDEN / 'retrieval'), set()
    for length in range(6000, len(data), 9973):
        (path / 'bag.mcap').write_bytes(data[:length])
        found = bags.raw(path)
        assert found == before[: len(found)]
        counts.add(len(found))
        assert bags.notes(path) == bags.notes(GOLDEN / 'retrieval')
        message = capsys.readouterr().err
        assert message.count('\n') == 1
        cut_off = (
            f'{path / "bag.mcap"} was not closed: read up to its last chunk, {len(found)} messages'
        )
        assert cut_off in message
    assert len(counts) > 1
    chunk = data.index(b'zstd') + 100
    (path / 'bag.mcap').write_bytes(data[:chunk] + bytes([data[chunk] ^ 1]) + data[chunk + 1 : -99])
    assert_refused(path)


def test_a_bag_that_is_still_written_is_read_up_to_its_last_chunk(small, tmp_path, capsys):
    """Like a bag whose recorder was killed: data leave the process chunk by chunk."""
    tick = next(each for each in bags.raw(small) if each.topic == '/tick')
    listed = (Topic(tick.topic, tick.type),)
    with closing(BagWriter(tmp_path / 'run', listed, {'parameters': '{}'})) as writer:
        for k in range(600):
            writer.write(tick.topic, k, tick.data, k + 1)
        found = bags.raw(tmp_path / 'run')
        assert bags.notes(tmp_path / 'run') == {'parameters': '{}'}
    assert 300 < len(found) < 600
    assert [each.stamp for each in found] == list(range(len(found)))
    assert f'was not closed: read up to its last chunk, {len(found)}' in capsys.readouterr().err


# --- too large, or not a bag


@pytest.mark.parametrize('name', ['LARGEST_FILE', 'LARGEST_RECORD'])
def test_sizes_are_capped(small, monkeypatch, name):
    monkeypatch.setattr(bags, name, 10)
    assert_refused(small)


@pytest.mark.parametrize('text', ['', '[1, 2]', 'a: &a [l]\nb: &b [*a, *a]', '[' * 10_000])
def test_bad_metadata_are_refused_where_they_are_needed(small, tmp_path, text):
    path = ros2_bag(small, tmp_path / 'bag', 'sqlite3')
    (path / 'metadata.yaml').write_text(text)
    assert_refused(path)


def test_fifos_and_devices_do_not_block(tmp_path):
    os.mkfifo(tmp_path / 'bag.mcap')
    (tmp_path / 'zero.mcap').symlink_to('/dev/zero')
    for path in (tmp_path, tmp_path / 'bag.mcap', tmp_path / 'zero.mcap'):
        assert_refused(path, 'not a regular file')


def test_what_is_no_bag_is_refused(tmp_path):
    assert_refused(tmp_path / 'nowhere', 'missing')
    assert_refused(tmp_path / 'nowhere.mcap', 'no such file; a readable file is needed')
    (tmp_path / 'notes.txt').write_text('no bag')
    assert_refused(tmp_path / 'notes.txt', 'no bag')
    assert_refused(tmp_path, 'no file of messages')
    (tmp_path / 'bag.mcap.zstd').write_bytes(b'')
    assert_refused(tmp_path, 'compressed; unpack it: zstd -d <')
    (tmp_path / 'bag.db3').write_bytes(b'')
    assert_refused(tmp_path / 'bag.db3')


@pytest.mark.parametrize('data', [b'', b'\x00\x01\x00\x00', b'\x00\x09\x00\x00\x01'])
def test_a_message_that_does_not_decode_is_refused(tmp_path, data):
    goal = Topic('/goal', 'geometry_msgs/msg/PoseStamped')
    with closing(BagWriter(tmp_path / 'run', (goal,), {})) as writer:
        writer.write('/goal', 1, data, 1)
    with pytest.raises(BadInput, match='unreadable'):
        bags.of_vehicle(tmp_path / 'run', '', {'goal'}, needed=())
