# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The limits of a bag: far more than a long flight, far less than a machine has."""

from __future__ import annotations

import io

import zstandard

from orbimpc_ros.mpc.errors import BadInput

MAX_BYTES = 1 << 30  # of its files
MAX_KEPT = 1 << 28  # of the messages that are read, decompressed
MAX_MESSAGES = 1 << 22  # of all messages, whatever their topic
MAX_MESSAGE = 1 << 24  # of one message that is read
MAX_CHUNK = 1 << 25  # of a chunk, decompressed, and of any other record
MAX_DEFINITION = 1 << 16  # of a type's text
ALLOWED = 'an intact rosbag2 bag of at most 1 GiB is needed'


def require(amount: int, largest: int, where: object, what: str) -> None:
    """Refuse what is too much.

    Args:
        amount: found.
        largest: allowed.
        where: the file.
        what: it is, and in which unit.

    Raises:
        BadInput: too much.
    """
    if amount > largest:
        raise BadInput.stating(
            str(where), f'hostile or damaged ({amount} {what})', f'at most {largest} are read'
        )


def unpacked(data: bytes, largest: int, where: object) -> bytes:
    """Return what zstd has compressed, as long as it is not too much.

    Raises:
        BadInput: damaged or too large.
    """
    try:
        with zstandard.ZstdDecompressor().stream_reader(io.BytesIO(data)) as stream:
            content = stream.read(largest + 1)
    except (zstandard.ZstdError, MemoryError) as error:
        raise BadInput.stating(str(where), f'damaged ({error})', ALLOWED) from None
    require(len(content), largest, where, 'bytes or more, decompressed')
    return content
