"""Messages as bytes, with the definition of their type, as every storage gives them."""

from __future__ import annotations

import io
from typing import NamedTuple

import zstandard

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool.io.bag import limits


class Raw(NamedTuple):
    """A serialised message.

    Attributes:
        topic: it came on.
        type: of the message.
        stamp: under which it was recorded [ns].
        sent: when it was sent, which orders what happened; the stamp if that is not known [ns].
        data: in CDR.
        definition: text or hash of the type as the sender had it; empty if unknown.
    """

    topic: str
    type: str
    stamp: int
    sent: int
    data: bytes
    definition: str = ''


def unpacked(data: bytes, largest: int, where: object) -> bytes:
    """Return what zstd has compressed, as long as it is not too much.

    Raises:
        BadInput: damaged or too large.
    """
    try:
        with zstandard.ZstdDecompressor().stream_reader(io.BytesIO(data)) as stream:
            content = stream.read(largest + 1)
    except (zstandard.ZstdError, MemoryError) as error:
        raise BadInput.stating(str(where), f'damaged ({error})', limits.ALLOWED) from None
    limits.require(len(content), largest, where, 'bytes or more, decompressed')
    return content
