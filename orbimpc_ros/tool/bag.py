"""Reading bags that may be damaged: every checksum first, then only the types that we know."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from mcap.records import DataEnd
from mcap.stream_reader import StreamReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool import document

TYPES = frozenset(
    {
        'diagnostic_msgs/msg/DiagnosticArray',
        'geometry_msgs/msg/PoseStamped',
        'geometry_msgs/msg/QuaternionStamped',
        'geometry_msgs/msg/TwistStamped',
        'geometry_msgs/msg/WrenchStamped',
        'nav_msgs/msg/Odometry',
        'nav_msgs/msg/Path',
        'rosgraph_msgs/msg/Clock',
        'std_msgs/msg/Bool',
        'visualization_msgs/msg/MarkerArray',
    }
)  # nothing else is decoded, whatever a bag holds
MAX_BYTES = 1 << 30
MAX_RECORD = 1 << 26
LATEST = 2**63  # [ns]: stamps in metadata
ALLOWED = 'an intact rosbag2 bag of at most 1 GiB'
FOOTER = struct.Struct('<BQQQI8s')  # opcode, length, summary start, offsets, checksum, magic


class Message(NamedTuple):
    """A message from a bag: where and when [ns] it came, of what type, and its decoded content."""

    topic: str
    stamp: int
    type: str
    content: Any


def read(path: Path) -> Iterator[Message]:
    """Yield the messages of a bag (folder, .mcap or .db3) in the order of their stamps.

    Raises:
        BadInput: missing, damaged, too large, or not a bag.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    try:
        _require_intact(path)
        with Reader(path) as reader:
            known = [c for c in reader.connections if c.msgtype in TYPES]
            for connection, stamp, data in reader.messages(known) if known else ():
                content = store.deserialize_cdr(data, connection.msgtype)
                yield Message(connection.topic, stamp, connection.msgtype, content)
    except BadInput:
        raise
    # Damaged bytes surface as whatever the decoder that trips over them happens to raise.
    except Exception as error:
        raise BadInput(str(path), f'unreadable ({error})', ALLOWED) from None


def notes(path: Path) -> dict[str, str]:
    """Return what the recorder has noted in a bag's metadata; empty if it is not one of ours."""
    file = path / 'metadata.yaml'
    if not file.is_file():
        return {}
    try:
        metadata = document.read(str(file), LATEST)['rosbag2_bagfile_information']
        found = metadata.get('custom_data')
    except (TypeError, KeyError, AttributeError):
        raise BadInput(str(file), 'not the metadata of a bag', ALLOWED) from None
    return {str(k): str(v) for k, v in found.items()} if isinstance(found, dict) else {}


def _require_intact(path: Path) -> None:
    """Check the size of a bag's files and, before anything is decoded, every checksum."""
    files = sorted(f for f in path.iterdir() if f.is_file()) if path.is_dir() else [path]
    if sum(file.stat().st_size for file in files) > MAX_BYTES:
        raise BadInput(str(path), 'larger than 1 GiB', ALLOWED)
    for file in files:
        if file.suffix == '.mcap':
            with file.open('rb') as stream:
                reader = StreamReader(stream, validate_crcs=True, record_size_limit=MAX_RECORD)
                if DataEnd not in {type(record) for record in reader.records}:
                    raise BadInput(str(file), 'damaged (no end of its data)', ALLOWED)
                _require_intact_summary(stream, file)


def _require_intact_summary(stream: BinaryIO, file: Path) -> None:
    """Check the index at the end of an MCAP file; the library checks all the rest."""
    end = stream.seek(-FOOTER.size, 2)
    _, _, start, _, checksum, _ = FOOTER.unpack(stream.read())
    if not checksum:
        return
    stream.seek(start)
    covered = stream.read(end - start + FOOTER.size - 12)
    if zlib.crc32(covered) != checksum:
        raise BadInput(str(file), 'damaged (checksum of its index)', ALLOWED)
