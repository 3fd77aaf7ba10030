# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The files of a bag, and its metadata."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import Any

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool.io import document
from orbimpc_ros.tool.io.bag import limits
from orbimpc_ros.tool.io.files import inside, listed, opened

METADATA = 'metadata.yaml'
NEWEST = 9  # version of rosbag2's metadata
LATEST = 2**63  # [ns]: stamps in metadata
SUFFIXES = ('.mcap', '.db3')
NEEDED = "a bag's folder, .mcap or .db3 file is needed"
COMPRESSIONS = {'none': '', 'file': 'file', 'message': 'message'}


@dataclass(frozen=True)
class Folder:
    """A bag on disk.

    Attributes:
        path: as it was given.
        files: that hold its messages.
        compression: of files or of messages by zstd; or empty.
        closed: whether its recorder came to finish it.
        notes: that the recorder has left in the metadata.
    """

    path: Path
    files: tuple[Path, ...]
    compression: str
    closed: bool
    notes: dict[str, str]


def folder_of(path: Path) -> Folder:
    """Return the bag at a path: a folder, or one of its files.

    Raises:
        BadInput: nothing that is a bag.
    """
    if not path.is_dir():
        if path.suffix not in SUFFIXES:
            raise BadInput.stating(str(path), _nature(path), NEEDED)
        return Folder(path, (path,), '', (path.parent / METADATA).exists(), {})
    if (path / METADATA).exists() or (path / METADATA).is_symlink():
        return _described(path, _information(path))
    files = [inside(path, f.name) for f in listed(path) if f.suffix in SUFFIXES]
    if not files:
        raise BadInput.stating(str(path), 'without metadata.yaml and .mcap', NEEDED)
    return Folder(path, tuple(files), '', False, {})


def _nature(path: Path) -> str:
    return 'no bag' if path.exists() else 'missing'


def _information(path: Path) -> dict[str, Any]:
    file = inside(path, METADATA)
    content = document.read(str(file), LATEST)
    found = content.get('rosbag2_bagfile_information') if isinstance(content, dict) else None
    if not isinstance(found, dict):
        raise BadInput.stating(str(file), 'not the metadata of a bag', limits.ALLOWED)
    version = found.get('version')
    if not isinstance(version, int) or not 1 <= version <= NEWEST:
        raise BadInput(f'{file}: version', version, f'1 to {NEWEST}')
    return found


def _described(path: Path, found: dict[str, Any]) -> Folder:
    notes = found.get('custom_data')
    notes = {str(k): str(v) for k, v in notes.items()} if isinstance(notes, dict) else {}
    return Folder(path, _files(path, found), _compression(path, found), True, notes)


def _files(path: Path, found: dict[str, Any]) -> tuple[Path, ...]:
    names = found.get('relative_file_paths')
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise BadInput(f'{path / METADATA}: relative_file_paths', names, 'a list of names')
    # Up to version 3 the names began with the bag's own.
    files = tuple(inside(path, PurePath(name).name) for name in names)
    for file in files:
        if not file.exists():
            hint = 'every file that metadata.yaml names is needed'
            raise BadInput.stating(str(file), 'missing', hint)
    return files


def _compression(path: Path, found: dict[str, Any]) -> str:
    mode = str(found.get('compression_mode') or 'none').lower()
    by = str(found.get('compression_format') or 'zstd')
    if mode not in COMPRESSIONS or by != 'zstd':
        raise BadInput(f'{path}: compression', f'{mode} {by}', 'zstd, or none')
    return COMPRESSIONS[mode]


@contextmanager
def plain(file: Path, compression: str) -> Iterator[Path]:
    """Give a file's path; of a compressed one a copy that is not, for a while."""
    if compression != 'file':
        yield file
        return
    with TemporaryDirectory() as place, opened(file, limits.MAX_BYTES) as stream:
        copy = Path(place) / file.stem
        copy.write_bytes(limits.unpacked(stream.read(), limits.MAX_KEPT, file))
        yield copy
