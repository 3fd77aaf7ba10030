# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""MCAP files: every checksum checked, every size bounded before anything is allocated."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import IO, BinaryIO, cast

import lz4.frame
from mcap.exceptions import EndOfFile
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool.io import topics
from orbimpc_ros.tool.io.bag import limits
from orbimpc_ros.tool.io.bag.raw import Raw
from orbimpc_ros.tool.io.files import opened

NOTES = 'orbimpc_ros'  # name of the record with the recorder's notes
FOOTER = struct.Struct('<BQQQI8s')  # opcode, length, summary start, offsets, checksum, magic
HASH = 'topic_type_hash'


class Exact:
    """A stream that gives what is asked for or nothing, however much a damaged length asks for."""

    def __init__(self, stream: BinaryIO, size: int) -> None:
        self._stream, self._left = stream, size

    def read(self, size: int) -> bytes:
        """Return exactly ``size`` bytes; none if there are fewer."""
        if not 0 <= size <= self._left:
            return b''
        self._left -= size
        return self._stream.read(size)


def messages(file: Path, closed: bool) -> Iterator[Raw]:
    """Yield the known messages of an MCAP file in the order in which they were written.

    Args:
        file: its path.
        closed: whether the recorder came to finish it; one that did not ends anywhere.

    Raises:
        BadInput: damaged, too large, or of another version.
    """
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    count = 0
    for record in _records(file, closed):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message):
            count += 1
            limits.require(count, limits.MAX_MESSAGES, file, 'messages')
            channel = channels[record.channel_id]
            schema = schemas[channel.schema_id]
            if topics.known(channel.topic, schema.name):
                yield _raw(record, channel, schema, file)


def _raw(message: Message, channel: Channel, schema: Schema, file: Path) -> Raw:
    if channel.message_encoding != 'cdr':
        raise BadInput(
            f'{file}: encoding of {channel.topic}', repr(channel.message_encoding), 'cdr'
        )
    limits.require(len(schema.data), limits.MAX_DEFINITION, file, 'bytes of a definition')
    text = schema.data.decode() if schema.encoding == 'ros2msg' else ''
    definition = channel.metadata.get(HASH) or text
    stamp = message.log_time
    sent = message.publish_time or stamp
    return Raw(channel.topic, schema.name, stamp, sent, message.data, definition)


def notes(file: Path, closed: bool) -> dict[str, str]:
    """Return the notes that stand at the beginning of a file of our recorder; else none.

    Raises:
        BadInput: damaged before them.
    """
    for record in _records(file, closed):
        if isinstance(record, Metadata) and record.name == NOTES:
            return record.metadata
        if isinstance(record, Message):
            break
    return {}


def _records(file: Path, closed: bool) -> Iterator[McapRecord]:
    """Yield every record up to the end of the data, those of chunks included."""
    with opened(file, limits.MAX_BYTES) as stream:
        size = stream.seek(0, 2)
        stream.seek(0)
        reader = StreamReader(
            cast(IO[bytes], Exact(stream, size)),
            emit_chunks=True,
            validate_crcs=True,
            record_size_limit=limits.MAX_CHUNK,
        )
        try:
            for record in reader.records:
                if isinstance(record, Chunk):
                    yield from breakup_chunk(_plain(record, file), validate_crc=True)
                else:
                    yield record
            _require_intact_summary(stream, file)
        except EndOfFile:
            if closed:
                raise BadInput.stating(str(file), 'damaged (cut off)', limits.ALLOWED) from None


def _plain(chunk: Chunk, file: Path) -> Chunk:
    """Return a chunk decompressed, unless it pretends to be of another size than it is."""
    limits.require(chunk.uncompressed_size, limits.MAX_CHUNK, file, 'bytes in a chunk')
    data = chunk.data
    if chunk.compression == 'zstd':
        data = limits.unpacked(data, limits.MAX_CHUNK, file)
    elif chunk.compression == 'lz4':
        data = lz4.frame.LZ4FrameDecompressor().decompress(data, limits.MAX_CHUNK + 1)
    elif chunk.compression:
        raise BadInput(f'{file}: compression', chunk.compression, 'zstd or lz4')
    if len(data) != chunk.uncompressed_size:
        raise BadInput.stating(str(file), 'damaged (a chunk of another size)', limits.ALLOWED)
    return replace(chunk, compression='', data=data)


def _require_intact_summary(stream: BinaryIO, file: Path) -> None:
    """Check the index at the end of an MCAP file; the library checks all the rest."""
    end = stream.seek(-FOOTER.size, 2)
    _, _, start, _, checksum, _ = FOOTER.unpack(stream.read())
    if not checksum:
        return
    stream.seek(start)
    covered = stream.read(end - start + FOOTER.size - 12)
    if zlib.crc32(covered) != checksum:
        raise BadInput.stating(str(file), 'damaged (checksum of its index)', limits.ALLOWED)
