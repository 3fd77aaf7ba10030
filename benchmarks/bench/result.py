# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The result of a measurement: rows in a file that is whole after each of them, table, picture."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from benchmarks.bench import table
from benchmarks.bench.rows import BenchRow
from benchmarks.machine import machine, versions
from orbimpc_ros.tool.files import write_whole


class Result:
    """What has been measured so far, on disk from the first row on.

    Args:
        file: takes the rows as JSON; None for nowhere.
        picture: takes a PNG at the end; None for none.
    """

    def __init__(self, file: Path | None, picture: Path | None) -> None:
        self._file, self._picture = file, picture
        self._head = {'machine': machine(), 'versions': versions()}
        self.rows: list[BenchRow] = []

    def add(self, rows: Sequence[BenchRow]) -> None:
        """Keep rows: whatever happens later, they are in the file."""
        self.rows += rows
        if self._file is not None:
            content = {**self._head, 'rows': [row.as_json() for row in self.rows]}
            text = json.dumps(content, indent=1, allow_nan=False) + '\n'
            write_whole(self._file, lambda new: new.write_text(text))

    def close(self) -> None:
        """Print the table and draw the picture of what there is."""
        print(table.text(self.rows))
        if self._picture is not None and self.rows:
            from benchmarks.bench.picture import draw

            draw(self.rows, self._picture)
