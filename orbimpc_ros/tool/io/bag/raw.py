# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Messages as bytes, and their types as the sender had them: they must be those we decode."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

HASHED = 'RIHS01_'


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


@lru_cache(maxsize=1)
def store() -> Any:
    """Return the types of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


@lru_cache(maxsize=256)
def same(kind: str, definition: str) -> bool:
    """Return whether a definition, by text or by hash, is ours; an unknown one is trusted."""
    if not definition:
        return True
    if definition.startswith(HASHED):
        return bool(definition == store().hash_rihs01(kind))
    try:
        found = get_types_from_msg(definition, kind)
    except Exception:  # whatever a hostile text makes the parser raise
        return False
    return kind in found and all(_fields(found[name]) == _known(name) for name in found)


def _known(name: str) -> Any:
    return _fields(store().fielddefs[name]) if name in store().fielddefs else None


def _fields(definition: Any) -> Any:
    """Return names and types of fields; constants do not change what is sent."""
    return definition[1]
