# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Bags of rosbag2: MCAP, read and written with checksums, and SQLite, read only.

MCAP uses the ``mcap`` library, which gives each message's time of sending, verifies checksums and
reads a file whose recorder was killed; SQLite uses ``rosbags``.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache, partial
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from mcap.exceptions import EndOfFile
from mcap.reader import NonSeekingReader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros import topics
from orbimpc_ros.ros.messages import POSE_TWIST, SECOND, PoseTwistSynchronizer, stamp_of
from orbimpc_ros.ros.topics import Topic, resolving
from orbimpc_ros.tool.files import opened

METADATA_VERSION = 9
NOTES = 'orbimpc_ros'  # the MCAP record with the recorder's notes
WRITTEN_CHUNK = 1 << 16  # [bytes] lost at most if the recorder is killed
LARGEST_FILE = 1 << 30  # [bytes]
LARGEST_RECORD = 1 << 25  # [bytes] of an MCAP file
LATEST = 2**63  # [ns], beyond the stamps in metadata
DIGITS = 19  # of the longest integers, stamps in nanoseconds
ALLOWED = 'an intact rosbag2 bag of at most 1 GiB is needed'
NEEDED = "a bag's folder, .mcap or .db3 file is needed"
FLOWN = ('odom',), ('goal',)
MCAP, SQLITE = '.mcap', '.db3'
FOREVER = {'sec': 9223372036, 'nsec': 854775807}
QOS = {
    'history': 'keep_last',
    'depth': 1,
    'reliability': 'reliable',
    'deadline': FOREVER,
    'lifespan': FOREVER,
    'liveliness': 'automatic',
    'liveliness_lease_duration': FOREVER,
    'avoid_ros_namespace_conventions': False,
}  # QoS of the interface, with which a player publishes
store = cache(partial(get_typestore, Stores.ROS2_JAZZY))  # returns the types of messages


class Message(NamedTuple):
    """A message in a bag."""

    topic: str  # its name
    type: str  # name of the message's type
    stamp: int  # log time in the bag, or the message's own stamp if it is decoded [ns]
    sent: int  # time of sending; the stamp if unknown [ns]
    data: bytes  # serialised as CDR
    content: Any = None  # decoded message; None if only bytes were read


# --- the content of messages, from bags or from DDS


def seconds(message: Any) -> float:
    """Return a message's own stamp [s]; 0 without a valid one."""
    return max(0, stamp_of(message)) / SECOND


def point(vector: Any) -> Array:
    """Return a Point or Vector3, shape (3,)."""
    return np.array([vector.x, vector.y, vector.z])


def _is_read(name: str, value: Any) -> bool:
    """Return whether a value is one that planner or simulator publish by a name."""
    match name:
        case 'status' | 'reason' | 'cause' | 'fallback':
            return isinstance(value, str)
        case 'objective' | 'lower_bound' | 'gap' | 'earliest_catch' | 'catch_bound':
            return isinstance(value, (int, float))
        case 'advanced' | 'sent' | 'solve_time_ms':
            return isinstance(value, (int, float)) and math.isfinite(value)
        case 'goal_stamps' | 'goal_counts' | 'traffic_stamps':
            return isinstance(value, dict) and all(isinstance(each, int) for each in value.values())
        case 'speed_fraction' | 'touched':
            return isinstance(value, list) and all(isinstance(each, (int, float)) for each in value)
    return True


def _integer(digits: str) -> float:
    return int(digits) if len(digits) <= DIGITS else float(digits)


def fields(message: Any) -> dict[str, Any]:
    """Return the values of a DiagnosticArray's first status by key, decoded if they are JSON.

    Those that no planner or simulator publishes are left out.
    """
    decoded = dict[str, Any]()
    for pair in message.status[0].values if message.status else ():
        value = pair.value
        with suppress(ValueError, RecursionError):
            value = json.loads(value, parse_int=_integer)
        if _is_read(pair.key, value):
            decoded[pair.key] = value
    return decoded


# --- reading


def of_vehicle(
    path: Path,
    namespace: str,
    names: Collection[str],
    needed: Sequence[Collection[str]] = FLOWN,
) -> list[Message]:
    """Return one vehicle's decoded messages in the order of sending, with their own stamps.

    If there is no odometry, it is joined from pose and twist messages.

    Args:
        path: path of the bag: its folder, .mcap or .db3 file.
        namespace: of the vehicle, such as ``/uav1``.
        names: of the topics to read; those outside its namespace begin with a slash.
        needed: groups of topics; the bag must have at least one topic of each group.

    Raises:
        BadInput: no bag, damaged, too large, of another version, or without a needed topic.
    """
    halved = POSE_TWIST if 'odom' in names else ()
    wanted = {resolving(namespace)(name): name for name in (*names, *halved)}
    recorded, own, halves = raw(path), list[Message](), list[Message]()
    for each in recorded:
        if each.topic in wanted:
            with _reading(path):
                content = store().deserialize_cdr(each.data, each.type)
            name, stamp = wanted[each.topic], stamp_of(content)
            kept = halves if name in POSE_TWIST else own
            kept.append(each._replace(topic=name, stamp=stamp, content=content))
    if not any(each.topic == 'odom' for each in own):
        own = sorted([*own, *_joined(halves)], key=lambda each: each.sent)
    for topics_needed in needed:
        if not any(each.topic in topics_needed for each in own):
            there = sorted({each.topic for each in recorded})
            places = {name.removesuffix('/odom') for name in there if name.endswith('/odom')} - {''}
            hint = f'give --namespace {" or ".join(sorted(places))}'
            missing = ' or '.join(f'{namespace}/{name}' for name in topics_needed)
            has = hint if places else f'it has {", ".join(there) or "none of its topics"}'
            raise BadInput.stating(str(path), f'without {missing}', has)
    return own


def _joined(halves: Iterable[Message]) -> Iterator[Message]:
    """Yield the odometry that the planner joined from pairs, with the second message's times."""
    synchronizer = PoseTwistSynchronizer()
    for each in halves:
        with suppress(BadInput):
            joined = synchronizer.take(each.topic, each.content)
            if joined is not None:
                yield each._replace(topic='odom', content=joined)


def raw(path: Path) -> list[Message]:
    """Return the messages on known topics as bytes, in the order of sending.

    A bag whose recorder was killed is read up to its last complete chunk, with a warning.

    Raises:
        BadInput: missing, damaged, too large, of another version, or not a bag.
    """
    files = _files(path)
    with _reading(path):
        read = _of_mcap(files) if files[0].suffix == MCAP else _of_rosbags(path)
        messages = [each for each in read if topics.known(each.topic, each.type)]
    return sorted(messages, key=lambda each: each.sent)


def notes(path: Path) -> dict[str, str]:
    """Return the notes that this package's recorder stored in a bag; empty without them.

    Raises:
        BadInput: no bag, or damaged.
    """
    file = _files(path)[0]
    if file.suffix == MCAP:
        with _reading(path), suppress(EndOfFile), opened(file, LARGEST_FILE) as stream:
            records = (each for each in _mcap(stream).iter_metadata() if each.name == NOTES)
            return next((each.metadata for each in records), {})
    return {}  # not MCAP, or it ended before its notes


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Turn every exception that damaged bytes cause in a decoder into a BadInput about the bag."""
    try:
        yield
    except BadInput:
        raise
    except Exception as error:
        raise BadInput.stating(str(path), f'unreadable ({error!r})', ALLOWED) from None


def _files(path: Path) -> list[Path]:
    if path.is_dir():
        files = sorted(path.glob(f'*{MCAP}')) or sorted(path.glob(f'*{SQLITE}'))
    elif path.suffix in (MCAP, SQLITE):
        files = [path]
    else:
        raise BadInput.stating(str(path), 'no bag' if path.exists() else 'missing', NEEDED)
    if not files:
        packed = next(path.glob('*.zstd'), None)
        if packed:  # by ros2 bag record --compression-mode file
            hint = f'unpack it: zstd -d < {packed} > {packed.with_suffix("")}'
            raise BadInput.stating(str(path), 'its file is compressed', hint)
        raise BadInput.stating(str(path), 'no file of messages', NEEDED)
    for file in files:
        opened(file, LARGEST_FILE).close()
    return files


def _of_rosbags(path: Path) -> Iterator[Message]:
    with Reader(path) as reader:
        for each, stamp, data in reader.messages():
            yield Message(each.topic, each.msgtype, stamp, stamp, bytes(data))


def _of_mcap(files: Sequence[Path]) -> Iterator[Message]:
    """Yield the messages in MCAP files in the order of writing."""
    for file in files:
        count = 0
        with opened(file, LARGEST_FILE) as stream:
            try:
                for schema, channel, each in _mcap(stream).iter_messages(log_time_order=False):
                    kind, count = schema.name if schema else '', count + 1
                    sent = each.publish_time or each.log_time
                    yield Message(channel.topic, kind, each.log_time, sent, each.data)
            except EndOfFile:
                cut = f'{file} was not closed: read up to its last chunk, {count} messages'
                print(f'orbimpc: {cut}', file=sys.stderr)


def _mcap(stream: BinaryIO) -> NonSeekingReader:
    return NonSeekingReader(stream, validate_crcs=True, record_size_limit=LARGEST_RECORD)


# --- writing


class BagWriter:
    """Writer of a new MCAP bag that ``ros2 bag`` can read.

    Args:
        folder: created; the MCAP file in it has the folder's name.
        listed: topics of the bag, including those without messages.
        notes: stored in the bag's metadata, by name.

    Attributes:
        counts: number of messages written, by topic.
    """

    def __init__(self, folder: Path, listed: Sequence[Topic], notes: Mapping[str, str]) -> None:
        folder.mkdir(parents=True)
        self._file = folder / f'{folder.name}.mcap'
        self.counts = {topic.name: 0 for topic in listed}
        self._described = dict[str, dict[str, Any]]()  # metadata of topics, by name
        self._first, self._last = LATEST, 0
        self._stream = self._file.open('wb')
        self._writer = McapWriter(
            self._stream, WRITTEN_CHUNK, compression=CompressionType.ZSTD, enable_data_crcs=True
        )
        self._writer.start(profile='ros2', library='orbimpc_ros')
        self._writer.add_metadata(NOTES, dict(notes))
        self._channels = dict[str, int]()
        for name, kind, latched in listed:
            qos = [QOS | {'durability': 'transient_local' if latched else 'volatile'}]
            text, _ = store().generate_msgdef(kind, ros_version=2)
            schema, digest = text.encode(), store().hash_rihs01(kind)
            about = {'offered_qos_profiles': json.dumps(qos), 'topic_type_hash': digest}
            number = self._writer.register_schema(kind, 'ros2msg', schema)
            self._channels[name] = self._writer.register_channel(name, 'cdr', number, about)
            self._described[name] = {
                'name': name,
                'type': kind,
                'serialization_format': 'cdr',
                'offered_qos_profiles': qos,
                'type_description_hash': digest,
            }

    def write(self, topic: str, stamp: int, data: bytes, sent: int) -> None:
        """Append a serialised message.

        Args:
            topic: its name.
            stamp: log time [ns].
            data: the message, serialised as CDR.
            sent: time of sending [ns].
        """
        self._first, self._last = min(self._first, stamp), max(self._last, stamp)
        self.counts[topic] += 1
        self._writer.add_message(self._channels[topic], stamp, data, sent, self.counts[topic])
        self._stream.flush()  # complete chunks survive even if the recorder is killed

    def close(self) -> None:
        """Write the index and the metadata."""
        self._writer.finish()
        self._stream.close()
        begin = min(self._first, self._last)
        span = {
            'starting_time': {'nanoseconds_since_epoch': begin},
            'duration': {'nanoseconds': self._last - begin},
            'message_count': sum(self.counts.values()),
        }
        about = {
            'version': METADATA_VERSION,
            'storage_identifier': 'mcap',
            **span,
            'topics_with_message_count': [
                {'topic_metadata': about, 'message_count': self.counts[name]}
                for name, about in self._described.items()
            ],
            'compression_format': '',
            'compression_mode': '',
            'relative_file_paths': [self._file.name],
            'files': [{'path': self._file.name, **span}],
            'ros_distro': 'jazzy',
        }
        content = json.dumps({'rosbag2_bagfile_information': about}, indent=1)
        self._file.with_name('metadata.yaml').write_text(content)  # JSON is YAML, too
