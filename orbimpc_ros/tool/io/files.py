# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Files that may be hostile: opened without blocking, never led out of their folder by a link."""

from __future__ import annotations

import os
import stat
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import BinaryIO

from orbimpc_ros.mpc.errors import BadInput, OrbimpcError

MAX_ENTRIES = 10_000  # of a folder
WRITABLE = 'a folder to write to is needed'
REGULAR = 'a regular file is needed'


def why(error: OSError) -> str:
    """Return in a few words why a file or folder cannot be used."""
    if isinstance(error, FileNotFoundError):
        return 'no such file'
    words = error.strerror or str(error)
    return words[:1].lower() + words[1:]


@contextmanager
def opened(path: Path, largest: int) -> Iterator[BinaryIO]:
    """Open a regular file to read; FIFOs and devices, which could block for ever, are refused.

    Args:
        path: of the file; it may be a link.
        largest: size allowed [bytes].

    Raises:
        BadInput: not there, not readable, not a regular file, or too large.
    """
    with _stream(path) as stream:
        size = os.fstat(stream.fileno()).st_size
        if size > largest:
            raise BadInput.stating(str(path), f'{size} bytes', f'at most {largest} bytes are read')
        yield stream


def _stream(path: Path) -> BinaryIO:
    with _blaming(path):
        mode = path.stat().st_mode
    _require_regular(path, mode)
    with _blaming(path):
        # Non-blocking, in case a FIFO has taken its place just now.
        stream = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK), 'rb')
        mode = os.fstat(stream.fileno()).st_mode
    _require_regular(path, mode)
    return stream


@contextmanager
def _blaming(path: Path) -> Iterator[None]:
    """Say in one line why a file cannot be opened."""
    try:
        yield
    except OSError as error:
        raise BadInput.stating(str(path), why(error), 'a readable file is needed') from None
    except ValueError as error:  # such as a null byte in its name
        raise BadInput.stating(ascii(str(path)), str(error), REGULAR) from None


def _require_regular(path: Path, mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise BadInput.stating(str(path), 'a folder', REGULAR)
    if not stat.S_ISREG(mode):
        raise BadInput.stating(str(path), 'not a regular file', REGULAR)


def inside(folder: Path, name: str) -> Path:
    """Return the path of a file of a folder.

    Raises:
        BadInput: its name, or a link of that name, leads out of the folder.
    """
    path = folder / name
    try:
        stays = Path(name).name == name and path.resolve().parent == folder.resolve()
    except (OSError, RuntimeError, ValueError):  # such as links in a circle
        stays = False
    if not stays:
        raise BadInput.stating(str(path), 'not a file of this folder', f'it must be in {folder}')
    return path


def listed(folder: Path) -> list[Path]:
    """Return what is in a folder, in order of names.

    Raises:
        BadInput: not readable, or absurdly much.
    """
    try:
        found = sorted(islice(folder.iterdir(), MAX_ENTRIES + 1))
    except OSError as error:
        raise BadInput.stating(str(folder), why(error), 'a readable folder is needed') from None
    if len(found) > MAX_ENTRIES:
        raise BadInput.stating(str(folder), 'too full', f'at most {MAX_ENTRIES} files are listed')
    return found


def require_writable(culprit: str, file: Path) -> None:
    """See to it before the work that its result can be written, as far as can be known by then.

    Args:
        culprit: what names the file, such as an option.
        file: to write, or to replace.

    Raises:
        BadInput: it is a folder, or nothing can be written beside it.
    """
    if file.is_dir():
        raise BadInput.stating(f'{culprit} {file}', 'a folder', 'a file is needed')
    try:
        with tempfile.TemporaryFile(dir=file.parent):
            pass
    except OSError as error:
        raise BadInput.stating(f'{culprit} {file}', why(error), WRITABLE) from None


def new_folder(out: str, name: str) -> Path:
    """Create ``out/name``, or ``out/name-2`` and so on: what is there stays.

    Raises:
        BadInput: it cannot be created.
    """
    for number in range(1, 10_000):
        folder = Path(out).resolve() / (name if number == 1 else f'{name}-{number}')
        try:
            folder.mkdir(parents=True)
            return folder
        except FileExistsError:
            if not folder.is_dir():
                break
        except OSError as error:
            raise BadInput.stating(f'--out {out}', why(error), WRITABLE) from None
    raise BadInput.stating(f'--out {out}', 'not a folder', WRITABLE)


@contextmanager
def writing_to(folder: Path) -> Iterator[None]:
    """Report a disk that takes no more as the failure of the job that writes into a folder.

    Raises:
        OrbimpcError: in one line; what was written before stays.
    """
    try:
        yield
    except OSError as error:
        raise OrbimpcError(f'{folder}: {why(error)}') from None


def write_whole(file: Path, write: Callable[[Path], object]) -> None:
    """Write a file whole or not at all.

    Args:
        file: to write; what is there is replaced at once.
        write: fills the file whose path it is given.

    Raises:
        OSError: the disk does not take it; nothing has changed.
    """
    new = file.with_name(f'.{file.name}.new')
    try:
        write(new)
        new.replace(file)
    finally:
        new.unlink(missing_ok=True)


@contextmanager
def replacing(folder: Path) -> Iterator[Path]:
    """Give a new folder to fill, which takes the place of ``folder`` when all went well.

    Until then nothing has changed; at no moment are both gone.

    Raises:
        BadInput: ``folder`` is a link, or cannot be replaced.
    """
    if folder.is_symlink():
        raise BadInput.stating(str(folder), 'a link', 'give the folder itself')
    try:
        with tempfile.TemporaryDirectory(prefix=f'.{folder.name}-', dir=folder.parent) as place:
            new, old = Path(place) / 'new' / folder.name, Path(place) / 'old'
            new.parent.mkdir()
            yield new
            folder.rename(old)
            try:
                new.rename(folder)
            except BaseException:
                old.rename(folder)
                raise
    except OSError as error:
        raise BadInput.stating(str(folder), why(error), WRITABLE) from None
