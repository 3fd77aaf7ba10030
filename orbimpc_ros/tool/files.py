# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Files of users and of the clone, with one-line errors if they cannot be read or written."""

from __future__ import annotations

import json
import os
import re
import sys
from collections import Counter
from collections.abc import Hashable
from contextlib import nullcontext, suppress
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, BinaryIO

import yaml

from orbimpc_ros.mpc.errors import BadInput

LARGEST = 1 << 18  # [bytes] of a document
MAX_NUMBER = 1e12  # rounding errors in larger squares exceed the quantities of a plan
WRITABLE = 'a folder to write to is needed'
CLONE = Path(__file__).resolve().parents[2]


def why(error: OSError) -> str:
    """Return the reason why a file or folder cannot be used, in a few words."""
    if isinstance(error, FileNotFoundError):
        return 'no such file'
    reason = error.strerror or str(error)
    return reason[:1].lower() + reason[1:]


def opened(path: Path, largest: int) -> BinaryIO:
    """Open a regular file for reading; refuse FIFOs and devices, which could block forever.

    Args:
        path: of the file; it may be a link.
        largest: size allowed [bytes].

    Raises:
        BadInput: the file is missing, not readable, not regular, or too large.
    """
    try:
        size = path.stat().st_size
        if not path.is_file():
            problem = 'a folder' if path.is_dir() else 'not a regular file'
            raise BadInput.stating(str(path), problem, 'a regular file is needed')
        if size > largest:
            raise BadInput.stating(str(path), f'{size} bytes', f'at most {largest} bytes are read')
        return path.open('rb')
    except OSError as error:
        raise BadInput.stating(str(path), why(error), 'a readable file is needed') from None


# --- documents


class StrictLoader(yaml.SafeLoader):
    """YAML's safe subset without aliases, which can expand exponentially, or duplicate keys."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose a node, unless it is an alias."""
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark
            raise yaml.composer.ComposerError(None, None, 'aliases are not accepted', mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Hashable, Any]:
        """Construct a mapping, unless a key is duplicated."""
        _unique([(self.construct_object(key, deep=True), None) for key, _ in node.value])
        return super().construct_mapping(node, deep)


# In YAML 1.1, 1e-3 is a string; in JSON and YAML 1.2 it is a number.
StrictLoader.add_implicit_resolver(
    'tag:yaml.org,2002:float',
    re.compile(r'^[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$'),
    list('-+0123456789'),
)


def read(source: str) -> Any:
    """Return the content of a JSON or YAML file by its path, or of standard input for ``-``.

    Raises:
        BadInput: the file is not readable, larger than 256 KiB, or malformed.
    """
    name = 'standard input' if source == '-' else source
    standard = source == '-' and sys.stdin  # None if it is closed
    file = nullcontext(standard.buffer) if standard else opened(Path(source), LARGEST)
    with file as stream:
        raw = stream.read(LARGEST + 1)
    try:
        if len(raw) > LARGEST:
            raise BadInput.stating(name, 'too large', f'at most {LARGEST} bytes are read')
        return parse(raw.decode(), name)
    except UnicodeDecodeError:
        raise BadInput.stating(name, 'not UTF-8', 'UTF-8 text is needed') from None


def parse(text: str, name: str) -> Any:
    """Return the content of JSON or YAML text.

    Raises:
        BadInput: malformed; it names the source.
    """
    try:
        content = None
        if text.lstrip().startswith('{'):
            with suppress(json.JSONDecodeError):  # not JSON, but YAML's flow style
                content = json.loads(text, object_pairs_hook=_unique)
        content = yaml.load(text, StrictLoader) if content is None else content
        _require_plain(content, name)
    except BadInput:
        raise
    except Exception as error:  # of any kind, over which a parser stumbles
        mark = getattr(error, 'problem_mark', None)
        where = f' in line {mark.line + 1}' if mark else ''
        problem = f'malformed{where} ({getattr(error, "problem", None) or error})'
        raise BadInput.stating(name, problem, 'a JSON or YAML mapping is needed') from None
    return content


def _unique(pairs: list[tuple[Any, Any]]) -> dict[str, Any]:
    """Return a mapping of pairs, unless a key is duplicated."""
    ((key, count),) = Counter(str(key) for key, _ in pairs).most_common(1) or [('', 0)]
    if count > 1:
        raise ValueError(f'field {key} given twice')
    return dict(pairs)


def _require_plain(value: Any, name: str, path: str = '') -> None:
    """Require mappings with names as keys, lists, and scalars of bounded magnitude."""
    if isinstance(value, dict):
        for key, inner in value.items():
            if not isinstance(key, str):
                raise BadInput.stating(f'field {key!r}', 'not a name', 'names are needed as keys')
            _require_plain(inner, name, f'{path}.{key}' if path else key)
    elif isinstance(value, list):
        for inner in value:
            _require_plain(inner, name, path)
    elif isinstance(value, (int, float)) and not abs(value) <= MAX_NUMBER:
        raise BadInput(path or name, str(value), f'finite, of a magnitude up to {MAX_NUMBER:g}')
    elif (value is not None and not isinstance(value, (str, int, float))) or '\0' in str(value):
        raise BadInput(path or name, str(value), 'numbers, words, lists and mappings')


# --- results


def folder_at(path: Path, option: str = '--out') -> Path:
    """Return a folder for the results of an option, created if it is missing.

    Raises:
        BadInput: it cannot be created.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput.stating(f'{option} {path}', why(error), WRITABLE) from None
    return path


def new_folder(out: str, name: str) -> Path:
    """Create ``out/name``, or ``out/name-2`` and so on if that exists.

    Raises:
        BadInput: it cannot be created.
    """
    folder, number = Path(out) / name, 1
    while folder.exists():
        number += 1
        folder = folder.with_name(f'{name}-{number}')
    return folder_at(folder)


# --- the clone


def in_clone(name: str, culprit: str) -> ModuleType:
    """Return a module of ``benchmarks/``, which is not installed, for this and child processes.

    Raises:
        BadInput: the package is not run from a clone; ``culprit`` is named in the error.
    """
    if not (CLONE / 'benchmarks' / '__init__.py').is_file():
        raise BadInput.stating(culprit, 'not installed', 'run it from a clone')
    if str(CLONE) not in sys.path:
        sys.path.append(str(CLONE))
        inherited = os.environ.get('PYTHONPATH')
        os.environ['PYTHONPATH'] = os.pathsep.join(filter(None, (str(CLONE), inherited)))
    return import_module(f'benchmarks.{name}')
