# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Hostile files: each is read as it was written, or refused in one line; nothing hangs."""

import os
import random
import shutil
import sqlite3
import struct
import subprocess
import sys

import pytest
import yaml
import zstandard
from bags import GOLDEN, rewritten, ros2_bag
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool import cli
from orbimpc_ros.tool.io import bag
from orbimpc_ros.tool.io.bag import limits
from orbimpc_ros.tool.io.bag.raw import same, store
from orbimpc_ros.tool.io.bag.writer import BagWriter
from orbimpc_ros.tool.io.topics import Topic

CORRUPTIONS = 400


@pytest.fixture(scope='module')
def small(tmp_path_factory):
    """Return a bag of three ticks."""

    def early(each):
        return each if each.stamp < 3_000_000_000 else None

    return rewritten(GOLDEN / 'retrieval', tmp_path_factory.mktemp('small') / 'bag', early)


def line_of(read, *arguments):
    """Return the one line in which something is refused; None if it is not."""
    try:
        read(*arguments)
    except BadInput as error:
        return str(error)
    return None


def content(path):
    """Return all that a bag says."""
    return bag.notes(path), [repr(message) for message in bag.read(path)], bag.raw(path)


def refused(path, *words):
    """Return the one line with which the tool refuses a bag."""
    done = run_process(*(words or ('replay', str(path))))
    assert done.returncode == cli.BAD_INPUT, done.stdout + done.stderr
    assert done.stdout == ''
    assert done.stderr.count('\n') == 1, done.stderr
    assert 'Traceback' not in done.stderr
    return done.stderr


def run_process(*words):
    command = [sys.executable, '-m', 'orbimpc_ros.tool.cli', *map(str, words)]
    return subprocess.run(
        command, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL
    )


def assert_refused(path, culprit=''):
    with pytest.raises(BadInput) as caught:
        content(path)
    assert str(path) in str(caught.value)
    assert culprit in str(caught.value)
    assert '\n' not in str(caught.value)


def require_same(found, before):
    assert found == before


# --- 400 damaged bags


def flipped(data, draw):
    damaged = bytearray(data)
    for _ in range(draw.choice((1, 1, 1, 2, 8))):
        damaged[draw.randrange(len(damaged))] ^= 1 << draw.randrange(8)
    return bytes(damaged)


def cut(data, draw):
    return data[: draw.randrange(len(data))]


def spliced(data, draw):
    """Return data of which a stretch is left out, doubled, moved or overwritten."""
    a, b = sorted(draw.randrange(len(data)) for _ in range(2))
    b = min(b, a + draw.choice((1, 8, 100, 4000)))
    kind = draw.randrange(4)
    if kind == 0:
        return data[:a] + data[b:]
    if kind == 1:
        return data[:b] + data[a:]
    if kind == 2:
        place = draw.randrange(len(data))
        return data[:place] + data[a:b] + data[place:]
    return data[:a] + draw.randbytes(b - a) + data[b:]


DAMAGES = {'flip': flipped, 'cut': cut, 'splice': spliced}


@pytest.mark.parametrize('block', range(10))
def test_a_damaged_bag_is_read_right_or_refused(small, tmp_path, block):
    """400 seeded damages; also to metadata.yaml, which has no checksum but says little."""
    path = tmp_path / 'bag'
    shutil.copytree(small, path)
    before, draw, found = content(path), random.Random(block), 0
    for k in range(CORRUPTIONS // 10):
        name = 'metadata.yaml' if k % 4 == 3 else 'bag.mcap'
        intact = (path / name).read_bytes()
        damage = DAMAGES[draw.choice(list(DAMAGES))]
        (path / name).write_bytes(damage(intact, draw))
        line = line_of(lambda: require_same(content(path), before))
        assert line is None or (str(path) in line and '\n' not in line)
        found += line is not None
        (path / name).write_bytes(intact)
    assert found > CORRUPTIONS // 20
    assert content(path) == before


def test_damaged_bags_end_the_command_in_one_line(small, tmp_path, capsys):
    for k, (name, damage) in enumerate(DAMAGES.items()):
        path = tmp_path / name
        shutil.copytree(small, path)
        file = path / 'bag.mcap'
        file.write_bytes(damage(file.read_bytes(), random.Random(k)))
        capsys.readouterr()
        assert cli.main(['replay', str(path)]) == cli.BAD_INPUT
        out, err = capsys.readouterr()
        assert (out, err.count('\n')) == ('', 1)
        assert str(path) in err
    assert str(path) in refused(path)  # once more as a process


def test_a_damaged_sqlite_bag_never_escapes(small, tmp_path):
    """It has no checksums: what decodes may be wrong, but nothing else may happen."""
    intact = (ros2_bag(small, tmp_path / 'bag', 'sqlite3') / 'bag.db3').read_bytes()
    file, draw, found = tmp_path / 'bag' / 'bag.db3', random.Random(5), 0
    for k in range(60):
        file.write_bytes(list(DAMAGES.values())[k % 3](intact, draw))
        line = line_of(content, file.parent)
        assert line is None or '\n' not in line
        found += line is not None
    assert found > 10


# --- bags that were not closed


def test_a_bag_without_its_end_is_read_up_to_its_last_chunk(tmp_path, capsys):
    path = tmp_path / 'bag'
    path.mkdir()
    data = (GOLDEN / 'retrieval' / 'retrieval.mcap').read_bytes()
    before, counts = bag.raw(GOLDEN / 'retrieval'), set()
    capsys.readouterr()
    for length in range(6000, len(data), 997):
        (path / 'bag.mcap').write_bytes(data[:length])
        found = bag.raw(path)
        assert found == before[: len(found)]
        counts.add(len(found))
        assert bag.notes(path) == bag.notes(GOLDEN / 'retrieval')
        told = capsys.readouterr().err
        assert told.count('\n') == 1
        assert f'{path} was not closed: read up to its last chunk, {len(found)} messages' in told
    assert len(counts) > 1


def test_a_flipped_bit_in_an_unclosed_bag_is_noticed(tmp_path):
    path = tmp_path / 'bag'
    path.mkdir()
    data = (GOLDEN / 'retrieval' / 'retrieval.mcap').read_bytes()
    chunk = data.index(b'zstd') + 100
    (path / 'bag.mcap').write_bytes(data[:chunk] + bytes([data[chunk] ^ 1]) + data[chunk + 1 : -99])
    assert_refused(path)


# --- sizes


def mcap_of(path, records, **options):
    """Write an MCAP file whose messages are given as (topic, type, data)."""
    path.mkdir(exist_ok=True)
    with (path / 'bag.mcap').open('wb') as stream:
        writer = McapWriter(stream, **options)
        writer.start(profile='ros2', library='test')
        for topic, kind, data in records:
            text, _ = store().generate_msgdef(kind, ros_version=2)
            schema = writer.register_schema(kind, 'ros2msg', text.encode())
            channel = writer.register_channel(topic, 'cdr', schema)
            writer.add_message(channel, 1, data, 1)
        writer.finish()
    return path


BOOL = 'std_msgs/msg/Bool'


@pytest.mark.parametrize('compression', [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_chunk_that_swells_is_refused_before_it_does(tmp_path, compression):
    """A thousandfold: a small file that would fill the memory."""
    zeros = bytes(limits.MAX_CHUNK)
    path = mcap_of(tmp_path / 'bag', [('/captured', BOOL, zeros)], compression=compression)
    assert (path / 'bag.mcap').stat().st_size < 300_000
    assert_refused(path, 'bytes in a chunk')


@pytest.mark.parametrize(
    ('claimed', 'held'), [(8, 100), (100, 8), (8, 1 << 28), (limits.MAX_CHUNK, 1 << 28)]
)
def test_a_chunk_that_lies_about_its_size_is_refused(tmp_path, claimed, held):
    """Its records say little, the compressed data hold up to 256 MiB."""
    bomb = zstandard.ZstdCompressor().compress(bytes(held))
    body = struct.pack('<QQQI', 0, 0, claimed, 0) + struct.pack('<I', 4) + b'zstd'
    body += struct.pack('<Q', len(bomb)) + bomb
    record = b'\x06' + struct.pack('<Q', len(body)) + body
    header = b'\x01' + struct.pack('<Q', 8) + bytes(8)
    path = tmp_path / 'bag'
    path.mkdir()
    (path / 'bag.mcap').write_bytes(b'\x89MCAP0\r\n' + header + record)
    assert_refused(path)


def test_a_record_that_asks_for_more_than_there_is_is_refused(tmp_path):
    path = tmp_path / 'bag'
    path.mkdir()
    for length in (1 << 20, 1 << 40, (1 << 64) - 1):
        record = b'\x04' + struct.pack('<Q', 100) + struct.pack('<HHI', 1, 1, length & 0xFFFFFFFF)
        (path / 'bag.mcap').write_bytes(b'\x89MCAP0\r\n' + record + b'x' * 10)
        (path / 'metadata.yaml').write_text(metadata())
        assert_refused(path)
        (path / 'bag.mcap').write_bytes(b'\x89MCAP0\r\n\x05' + struct.pack('<Q', length))
        assert_refused(path)


def test_messages_are_bounded_in_size_and_number(small, monkeypatch):
    for name, what in (
        ('MAX_MESSAGE', 'bytes in a message'),
        ('MAX_MESSAGES', 'messages'),
        ('MAX_KEPT', 'bytes of messages'),
        ('MAX_DEFINITION', 'bytes of a definition'),
        ('MAX_BYTES', 'bytes'),
        ('MAX_CHUNK', ''),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(limits, name, 10)
            assert_refused(small, what)
    content(small)


@pytest.mark.parametrize('mode', ['file', 'message'])
@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_compression_outside_of_the_storage_is_bounded_too(
    small, tmp_path, monkeypatch, storage, mode
):
    path = ros2_bag(small, tmp_path / 'bag', storage, mode)
    content(path)
    monkeypatch.setattr(limits, 'MAX_KEPT', 100)
    monkeypatch.setattr(limits, 'MAX_MESSAGE', 100)
    assert_refused(path, 'decompressed')


# --- metadata


def metadata(**changes):
    found = {
        'version': 9,
        'storage_identifier': 'mcap',
        'relative_file_paths': ['bag.mcap'],
        'compression_format': '',
        'compression_mode': '',
        **changes,
    }
    return yaml.safe_dump({'rosbag2_bagfile_information': found})


METADATA = {
    'empty': ('', 'not the metadata of a bag'),
    'a list': ('[1, 2]', 'not the metadata of a bag'),
    'another version': (metadata(version=10), 'version is 10; allowed: 1 to 9'),
    'no version': (metadata(version=None), 'version'),
    'files that are none': (metadata(relative_file_paths='bag.mcap'), 'relative_file_paths'),
    'a number of a file': (metadata(relative_file_paths=[1]), 'relative_file_paths'),
    'a missing file': (metadata(relative_file_paths=['gone.mcap']), 'gone.mcap: missing'),
    'a way out': (metadata(relative_file_paths=['..']), 'not a file of this folder'),
    'a strange compression': (metadata(compression_mode='file', compression_format='rar'), 'rar'),
    'a strange mode': (metadata(compression_mode='twice'), 'twice'),
    'laughs': ('a: &a [l]\nb: &b [*a, *a]', 'aliases'),
    'a tag': ('!!python/object/apply:os.system [ls]', 'malformed'),
    'deep': ('[' * 100_000, 'malformed'),
    'binary': (b'\xff\xfe', 'UTF-8'),
}


@pytest.mark.parametrize(('text', 'culprit'), METADATA.values(), ids=METADATA)
def test_bad_metadata_is_named(small, tmp_path, text, culprit):
    path = tmp_path / 'bag'
    shutil.copytree(small, path)
    (path / 'metadata.yaml').write_bytes(text if isinstance(text, bytes) else text.encode())
    assert_refused(path, culprit)


def test_metadata_cannot_point_out_of_the_folder(small, tmp_path):
    """Names are taken without their folders, so that the file must be in this one."""
    path = tmp_path / 'bag'
    shutil.copytree(small, path)
    names = [str(small / 'bag.mcap'), '../small/bag.mcap', 'bag/bag.mcap']
    (path / 'metadata.yaml').write_text(metadata(relative_file_paths=names))
    assert bag.raw(path) == sorted(3 * bag.raw(small), key=lambda each: each.stamp)
    (path / 'bag.mcap').unlink()
    assert_refused(path, 'missing')


# --- what is no file


def test_links_are_not_followed_out_of_the_folder(small, tmp_path):
    path = tmp_path / 'bag'
    shutil.copytree(small, path)
    for name in ('bag.mcap', 'metadata.yaml'):
        (path / name).unlink()
        (path / name).symlink_to(small / name)
        assert_refused(path, 'not a file of this folder')
        (path / name).unlink()
        shutil.copy(small / name, path / name)
    content(path)


def test_a_link_to_a_bag_is_the_users_own(small, tmp_path):
    (tmp_path / 'link').symlink_to(small)
    assert bag.raw(tmp_path / 'link') == bag.raw(small)


def test_links_in_a_circle_end(tmp_path):
    (tmp_path / 'a').symlink_to(tmp_path / 'b')
    (tmp_path / 'b').symlink_to(tmp_path / 'a')
    assert_refused(tmp_path / 'a')
    path = tmp_path / 'bag'
    path.mkdir()
    (path / 'bag.mcap').symlink_to(path / 'bag.mcap')
    assert_refused(path)
    (path / 'again').symlink_to(path)  # a folder in itself is not entered
    (path / 'bag.mcap').unlink()
    assert_refused(path, 'without metadata.yaml and .mcap')


def test_fifos_and_devices_do_not_block(tmp_path):
    path = tmp_path / 'bag'
    path.mkdir()
    os.mkfifo(path / 'bag.mcap')
    assert_refused(path, 'not a regular file')
    assert 'not a regular file' in refused(path)
    os.mkfifo(path / 'metadata.yaml')
    assert_refused(path, 'not a regular file')
    (path / 'metadata.yaml').unlink()
    (path / 'metadata.yaml').write_text(metadata())
    assert_refused(path, 'not a regular file')
    device = tmp_path / 'zero.mcap'
    device.symlink_to('/dev/zero')
    assert_refused(device, 'not a regular file')
    os.mkfifo(tmp_path / 'problem.yaml')
    for words in (('solve', tmp_path / 'problem.yaml'), ('solve', '/dev/zero')):
        assert 'not a regular file' in refused(None, *words)


@pytest.mark.parametrize('name', ['nowhere', 'a\x1b[31m', 'folder/' + 'x' * 300])
def test_a_bag_that_is_not_there_is_told(tmp_path, name, capsys):
    assert cli.main(['replay', str(tmp_path / name)]) == cli.BAD_INPUT
    err = capsys.readouterr().err
    assert err.count('\n') == 1
    assert '\x1b' not in err


def test_a_line_says_the_subject_the_problem_and_a_hint(tmp_path):
    with pytest.raises(BadInput) as caught:
        bag.raw(tmp_path / 'nowhere.mcap')
    hint = 'a readable file is needed'
    assert str(caught.value) == f'{tmp_path}/nowhere.mcap: no such file; {hint}'
    error = BadInput.stating('bag', 'damaged\n' + 'x' * 1000, hint)
    assert str(error).count('\n') == 0
    assert len(str(error)) < 150


def test_what_is_no_bag_is_told(tmp_path):
    (tmp_path / 'notes.txt').write_text('no bag')
    assert_refused(tmp_path / 'notes.txt', 'no bag')
    assert_refused(tmp_path, 'without metadata.yaml and .mcap')
    for name in ('bag.mcap', 'bag.db3'):
        (tmp_path / name).write_bytes(b'')
        if name == 'bag.db3':
            assert_refused(tmp_path / name)
        else:
            assert bag.raw(tmp_path / name) == []  # not closed, and nothing in it yet


# --- types


def test_another_packages_bag_is_told(tmp_path):
    kind = 'sensor_msgs/msg/Imu'
    with BagWriter(tmp_path / 'bag', [Topic('/imu', kind)], {'parameters': '{}'}):
        pass
    said = refused(tmp_path / 'bag')
    assert 'without /odom' in said
    assert 'none of its topics' in said


def test_a_type_of_another_version_is_refused(tmp_path):
    """A field more: its bytes would be read as something else."""
    text = 'bool data\nfloat64 certainty\n'
    path = tmp_path / 'bag'
    path.mkdir()
    for meta, definition in (
        ({}, text),
        ({'topic_type_hash': 'RIHS01_' + 64 * '0'}, 'bool data'),
        ({}, 'bool data\n' + '=' * 80 + '\nMSG: std_msgs/Odd\nint32[[ x'),
        ({}, '\x00'),
    ):
        with (path / 'bag.mcap').open('wb') as stream:
            writer = McapWriter(stream)
            writer.start(profile='ros2', library='test')
            schema = writer.register_schema(BOOL, 'ros2msg', definition.encode())
            channel = writer.register_channel('/captured', 'cdr', schema, meta)
            writer.add_message(channel, 1, b'\x00\x01\x00\x00\x01', 1)
            writer.finish()
        assert_refused(path, f'another version of {BOOL}')


def test_another_encoding_is_refused(tmp_path):
    path = tmp_path / 'bag'
    path.mkdir()
    with (path / 'bag.mcap').open('wb') as stream:
        writer = McapWriter(stream)
        writer.start(profile='ros2', library='test')
        schema = writer.register_schema(BOOL, 'ros2msg', b'bool data')
        channel = writer.register_channel('/captured', 'json', schema)
        writer.add_message(channel, 1, b'\x00\x01\x00\x00\x01', 1)
        writer.finish()
    assert_refused(path, 'allowed: cdr')


def test_definitions_as_ros_writes_them_are_the_same():
    """With comments, constants and other spaces; the hash says it too."""
    text = 'uint8 LOW=1  # a constant\n\n# a comment\nbool   data # true or false\n'
    assert same(BOOL, text)
    assert same(BOOL, store().hash_rihs01(BOOL))
    assert same(BOOL, '')
    assert not same(BOOL, 'bool other')


def test_a_message_that_does_not_decode_is_refused(tmp_path):
    for data in (b'', b'\x00\x01\x00\x00', b'\x00\x09\x00\x00\x01'):
        path = mcap_of(tmp_path / 'bag', [('/goal', 'geometry_msgs/msg/PoseStamped', data)])
        assert_refused(path, 'unreadable')


def test_a_sequence_that_claims_to_be_endless_is_refused(tmp_path):
    stamp_and_frame = struct.pack('<iII', 0, 0, 1) + b'\x00' + bytes(3)
    data = b'\x00\x01\x00\x00' + stamp_and_frame + struct.pack('<I', 0xFFFFFFFF)
    path = mcap_of(tmp_path / 'bag', [('/plan', 'nav_msgs/msg/Path', data)])
    assert_refused(path, 'unreadable')


# --- SQLite


SCRIPTS = {
    'no tables': ('CREATE TABLE other (id)', 'without a table topics'),
    'a view that never ends': (
        'CREATE TABLE topics (id, name, type, serialization_format);'
        'CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id FROM n)'
        ' SELECT id, 1 AS topic_id, 1 AS timestamp, x\'00\' AS data FROM n',
        'without a table messages',
    ),
    'computed columns': (
        'CREATE TABLE topics (id, name, type, serialization_format);'
        'CREATE TABLE messages (id, topic_id, timestamp, data AS (zeroblob(1000000000)))',
        'without a table messages',
    ),
    'stamps that are words': (
        'CREATE TABLE topics (id, name, type, serialization_format);'
        'CREATE TABLE messages (id, topic_id, timestamp, data);'
        f"INSERT INTO topics VALUES (1, '/captured', '{BOOL}', 'cdr');"
        "INSERT INTO messages VALUES (1, 1, 'soon', x'00010000');",
        'without stamp or bytes',
    ),
    'data that are none': (
        'CREATE TABLE topics (id, name, type, serialization_format);'
        'CREATE TABLE messages (id, topic_id, timestamp, data);'
        f"INSERT INTO topics VALUES (1, '/captured', '{BOOL}', 'cdr');"
        'INSERT INTO messages VALUES (1, 1, 1, NULL);',
        'without stamp or bytes',
    ),
    'another serialisation': (
        'CREATE TABLE topics (id, name, type, serialization_format);'
        'CREATE TABLE messages (id, topic_id, timestamp, data);'
        f"INSERT INTO topics VALUES (1, '/captured', '{BOOL}', 'pickle');",
        'allowed: cdr',
    ),
}  # fmt: skip


@pytest.mark.parametrize(('script', 'culprit'), SCRIPTS.values(), ids=SCRIPTS)
def test_hostile_tables_are_refused(tmp_path, script, culprit):
    file = tmp_path / 'bag.db3'
    database = sqlite3.connect(file)
    database.executescript(script)
    database.close()
    assert_refused(file, culprit)


def test_a_query_that_takes_too_long_is_interrupted(small, tmp_path, monkeypatch):
    path = ros2_bag(small, tmp_path / 'bag', 'sqlite3')
    monkeypatch.setattr(bag.sqlite, 'OPERATIONS', 1)
    monkeypatch.setattr(bag.sqlite, 'CHECKS', 3)
    assert_refused(path, 'interrupted')
