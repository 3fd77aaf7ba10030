# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""SQLite files, rosbag2's older storage: read only, from plain tables, with bounded effort.

They carry no checksums: damage to the file's structure is noticed, damage to a message only where
its bytes no longer decode.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import quote

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool.io import topics
from orbimpc_ros.tool.io.bag import limits
from orbimpc_ros.tool.io.bag.raw import Raw
from orbimpc_ros.tool.io.files import opened

NEEDED = {
    'topics': {'id', 'name', 'type', 'serialization_format'},
    'messages': {'id', 'topic_id', 'timestamp', 'data'},
}
HASH = 'type_description_hash'
OPERATIONS, CHECKS = 100_000, 10_000  # of SQLite's machine between looks, and looks, for a file


def messages(file: Path) -> Iterator[Raw]:
    """Yield the known messages of an SQLite file in the order in which they were written.

    Raises:
        BadInput: damaged, too large, or not the tables of rosbag2.
    """
    try:
        with opened(file, limits.MAX_BYTES), closing(_connected(file)) as database:
            columns = {table: _columns(database, table, file) for table in NEEDED}
            known = _topics(database, columns['topics'], file)
            rows = database.execute('SELECT topic_id, timestamp, data FROM messages ORDER BY id')
            for count, (topic, stamp, data) in enumerate(rows):
                limits.require(count, limits.MAX_MESSAGES, file, 'messages or more')
                if topic in known:
                    name, kind, definition = known[topic]
                    yield Raw(name, kind, stamp, stamp, data, definition)
    except (sqlite3.Error, OverflowError) as error:
        raise BadInput.stating(str(file), f'damaged ({error})', limits.ALLOWED) from None


def _connected(file: Path) -> sqlite3.Connection:
    address = f'file:{quote(str(file.resolve()))}?mode=ro&immutable=1'
    database = sqlite3.connect(address, uri=True)
    looks = iter(range(CHECKS))
    # An endless query is interrupted: the handler is true once its patience is used up.
    database.set_progress_handler(lambda: next(looks, None) is None, OPERATIONS)
    database.execute('PRAGMA trusted_schema = OFF')
    found = database.execute('PRAGMA quick_check(1)').fetchone()
    if found != ('ok',):
        raise BadInput.stating(str(file), f'damaged ({found})', limits.ALLOWED)
    return database


def _columns(database: sqlite3.Connection, table: str, file: Path) -> set[str]:
    """Return a table's columns; views, virtual tables and computed columns could hold anything."""
    plain = database.execute(
        "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name = ? AND rootpage > 0",
        (table,),
    ).fetchone()[0]
    stored = {row[1] for row in database.execute(f'PRAGMA table_xinfo({table})') if row[6] == 0}
    if not plain or not NEEDED[table] <= stored:
        wanted = f'a rosbag2 bag has {table}({", ".join(sorted(NEEDED[table]))})'
        raise BadInput.stating(str(file), f'without a table {table}', wanted)
    return stored


def _topics(
    database: sqlite3.Connection, columns: set[str], file: Path
) -> dict[Any, tuple[str, str, str]]:
    """Return name, type and definition of the known topics by their number."""
    definition = HASH if HASH in columns else "''"
    found = {}
    for number, name, kind, encoding, text in database.execute(
        f'SELECT id, name, type, serialization_format, {definition} FROM topics'
    ):
        if isinstance(name, str) and topics.known(name, kind):
            if encoding != 'cdr':
                raise BadInput(f'{file}: encoding of {name}', repr(encoding), 'cdr')
            found[number] = name, kind, str(text or '')
    return found
