# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Results on disk: parts that appear whole or not at all, one Parquet file at the end.

A study's folder holds ``study.json`` (what is studied), ``parts/`` while it runs, then
``runs.parquet``. Interrupted at any moment, it keeps every part that was complete.
"""

from __future__ import annotations

import json
import os
import shutil
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from orbimpc_ros.lab.study.columns import COLUMNS
from orbimpc_ros.lab.study.design import Study, differences, study_of
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool.io import document

CONFIGURATION, PARTS, RESULT = 'study.json', 'parts', 'runs.parquet'
STAMP = b'orbimpc_study'  # what the rows of a file belong to
TYPES = {
    'int32': pa.int32(),
    'string': pa.string(),
    'bool': pa.bool_(),
    'double': pa.float64(),
    'list<item: float>': pa.list_(pa.float32()),
}


def schema(study: Study) -> pa.Schema:
    """Return the columns, each with its description, and the study they come from."""
    return pa.schema(
        [
            pa.field(c.name, TYPES[c.kind], metadata={'description': c.text, 'unit': c.unit})
            for c in COLUMNS
        ],
        metadata={STAMP: json.dumps(study.as_json())},
    )


class Store:
    """The folder of one study.

    Args:
        folder: that exists and holds the study's configuration.
        study: whose results it takes.
    """

    def __init__(self, folder: Path, study: Study) -> None:
        self.folder, self.study = folder, study
        self._parts, self._result = folder / PARTS, folder / RESULT

    @classmethod
    def created(cls, folder: Path, study: Study) -> Store:
        """Return the store of a new study in a folder that is new or empty; see :meth:`begin`.

        Raises:
            BadInput: there is something else in it, or it cannot be made.
        """
        if (folder / CONFIGURATION).is_file():
            found = differences(study_in(folder), study)
            there = f'a study with other {", ".join(found)}' if found else 'this study already'
            raise BadInput(str(folder), there, 'a new folder, or --resume to go on with it')
        with _writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
            if any(folder.iterdir()):
                raise BadInput(str(folder), 'a folder with other files', 'a new or an empty folder')
        return cls(folder, study)

    @classmethod
    def resumed(cls, folder: Path) -> Store:
        """Return the store of a study that was begun.

        Raises:
            BadInput: there is none, or it is damaged.
        """
        if not (folder / CONFIGURATION).is_file():
            raise BadInput(str(folder), 'no study', f'a folder with {CONFIGURATION}')
        store = cls(folder, study_in(folder))
        store._tidy()
        return store

    def _tidy(self) -> None:
        """Remove what a run that was killed has left half-written: its runs are flown again."""
        for file in (*self.folder.glob('*.tmp'), *self._parts.glob('*.tmp')):
            file.unlink()
        if self.complete:
            shutil.rmtree(self._parts, ignore_errors=True)

    def begin(self) -> None:
        """Write down what is studied, unless it is already; from now on it can be resumed.

        Raises:
            BadInput: the disk does not take it.
        """
        with _writing(self.folder):
            self._parts.mkdir(exist_ok=True)
            text = json.dumps(self.study.as_json(), indent=1) + '\n'
            temporary = self.folder / f'{CONFIGURATION}.tmp'
            temporary.write_text(text)
            os.replace(temporary, self.folder / CONFIGURATION)

    @property
    def complete(self) -> bool:
        """Return whether all runs are done and joined."""
        return self._result.is_file()

    def add(self, rows: list[dict[str, Any]]) -> None:
        """Keep the rows of some runs: all of them, or after a failure none.

        Raises:
            BadInput: the disk does not take them.
        """
        table = pa.Table.from_pylist(rows, schema(self.study))
        self._write(table, self._parts / f'{rows[0]["run"]:08d}.parquet')

    def missing(self) -> list[int]:
        """Return the runs that are still to be flown.

        Raises:
            BadInput: a part is damaged.
        """
        if self.complete:
            return []
        done = {run for part in self._tables() for run in part['run'].to_pylist()}
        return [run for run in range(self.study.runs) if run not in done]

    def join(self) -> None:
        """Put all parts into one file, in order, and remove them."""
        table = pa.concat_tables(self._tables()).combine_chunks()
        order = {name: place for place, name in enumerate(self.study.controllers)}
        rank = pa.array([order[name] for name in table['controller'].to_pylist()])
        keys = pa.table({'run': table['run'], 'rank': rank})
        places = pc.sort_indices(keys, [('run', 'ascending'), ('rank', 'ascending')])
        self._write(table.take(places), self._result)
        shutil.rmtree(self._parts)

    def result(self) -> pa.Table:
        """Return the rows of a complete study, run by run.

        Raises:
            BadInput: the file is damaged.
        """
        return self._read(self._result)

    def _tables(self) -> Iterator[pa.Table]:
        for file in sorted(self._parts.glob('*.parquet')):
            yield self._read(file)

    def _read(self, file: Path) -> pa.Table:
        again = 'a whole file of this study (without it, --resume flies its runs again)'
        try:
            table = pq.read_table(file, partitioning=None)
        except (OSError, pa.ArrowException):
            raise BadInput(str(file), 'damaged', again) from None
        wanted = schema(self.study)
        stamped = (table.schema.metadata or {}).get(STAMP) == wanted.metadata[STAMP]
        if not stamped or not table.schema.equals(wanted) or not self._whole(table):
            raise BadInput(str(file), 'of another study or incomplete', again)
        return table.cast(wanted)

    def _whole(self, table: pa.Table) -> bool:
        """Return whether a table has each of its runs once for every controller."""
        rows = Counter(zip(table['run'].to_pylist(), table['controller'].to_pylist(), strict=True))
        runs = {run for run, _ in rows}
        expected = {(run, name): 1 for run in runs for name in self.study.controllers}
        return rows == expected and all(0 <= run < self.study.runs for run in runs)

    def _write(self, table: pa.Table, file: Path) -> None:
        temporary = file.with_suffix('.tmp')
        with _writing(file):
            pq.write_table(table, temporary, compression='zstd')
            os.replace(temporary, file)


def study_in(folder: Path) -> Study:
    """Return the study that a folder holds.

    Raises:
        BadInput: its configuration is damaged or of another version.
    """
    file = str(folder / CONFIGURATION)
    return study_of(document.read(file, largest=float('inf')), file)


def require_agreement(study: Study, given: Mapping[str, Any], folder: Path) -> None:
    """Raise BadInput where what is asked for now is not what a study was begun with.

    Args:
        study: that is to go on.
        given: fields of a study as given on the command line, and under ``settings`` those given.
        folder: where it is.
    """
    kept = {**vars(study), **study.settings}
    for name, value in {**given, **given.get('settings', {})}.items():
        if name != 'settings' and value != kept[name]:
            there = f'a study with {name} {kept[name]}, not {value}'
            raise BadInput(str(folder), there, 'what it was begun with')


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Turn what the operating system refuses into a line for the user."""
    try:
        yield
    except OSError as error:
        raise BadInput(str(path), error.strerror or str(error), 'a place to write to') from None
