# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""JSON and YAML from files that may be hostile: capped, without aliases, without duplicates."""

from __future__ import annotations

import json
import re
import sys
from collections import Counter
from collections.abc import Hashable
from pathlib import Path
from typing import Any, BinaryIO

import yaml

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool.io.files import opened, why

MAX_BYTES = 1 << 20
MAX_NODES = 30_000  # of YAML, which is slow to take apart
LONGEST = 4096  # characters of an unquoted word; converting numbers takes their length squared
MAX_NUMBER = 1e12  # beyond it arithmetic on squares loses what a plan is about
ALLOWED = 'a JSON or YAML mapping is needed'


class StrictLoader(yaml.SafeLoader):
    """YAML's safe subset without aliases, which can blow up, and without duplicate keys."""

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._nodes = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Compose a node, unless it is an alias or there are too many."""
        if self.check_event(yaml.AliasEvent):
            raise yaml.composer.ComposerError(None, None, 'aliases are not accepted')
        self._nodes += 1
        if self._nodes > MAX_NODES:
            raise yaml.composer.ComposerError(None, None, f'more than {MAX_NODES} values')
        return super().compose_node(parent, index)

    def compose_scalar_node(self, anchor: Any) -> Any:
        """Compose a word, a number or a text, unless it is an absurdly long number."""
        node = super().compose_scalar_node(anchor)
        if node.style is None and len(node.value) > LONGEST:
            raise yaml.composer.ComposerError(None, None, f'a word longer than {LONGEST}')
        return node

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Hashable, Any]:
        """Construct a mapping, unless a key comes twice."""
        pairs = [(self.construct_object(k, deep=True), v) for k, v in node.value]
        _refuse_duplicates([str(key) for key, _ in pairs])
        return super().construct_mapping(node, deep)


# YAML 1.1 takes 1e-3 for a string; JSON and YAML 1.2 know that it is a number.
StrictLoader.add_implicit_resolver(
    'tag:yaml.org,2002:float',
    re.compile(r'^[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$'),
    list('-+0123456789'),
)


def read(source: str, largest: float = MAX_NUMBER) -> Any:
    """Return the content of a JSON or YAML file, or of standard input for ``-``.

    Args:
        source: the file's path.
        largest: magnitude allowed of numbers.

    Raises:
        BadInput: not readable, larger than 1 MiB, malformed.
    """
    return parse(_text(source), 'standard input' if source == '-' else source, largest)


def parse(text: str, name: str, largest: float = MAX_NUMBER) -> Any:
    """Return the content of JSON or YAML text.

    Args:
        text: the document.
        name: where it comes from, for the message.
        largest: magnitude allowed of numbers.

    Raises:
        BadInput: malformed.
    """
    try:
        if text.lstrip().startswith('{'):
            try:
                content = json.loads(text, object_pairs_hook=_unique)
            except json.JSONDecodeError:
                content = yaml.load(text, StrictLoader)
        else:
            content = yaml.load(text, StrictLoader)
        _require_plain(content, largest)
    except yaml.YAMLError as error:
        raise BadInput.stating(name, _summary(error), ALLOWED) from None
    except (RecursionError, ValueError, TypeError) as error:
        if isinstance(error, BadInput):
            raise
        raise BadInput.stating(name, f'malformed ({error})', ALLOWED) from None
    return content


def _summary(error: yaml.YAMLError) -> str:
    mark = getattr(error, 'problem_mark', None)
    where = f' in line {mark.line + 1}' if mark else ''
    return f'malformed{where} ({getattr(error, "problem", None) or error})'


def _text(source: str) -> str:
    try:
        if source == '-':
            raw = _capped(sys.stdin.buffer, 'standard input')
        else:
            with opened(Path(source), MAX_BYTES) as stream:
                raw = _capped(stream, source)
        return raw.decode()
    except OSError as error:
        raise BadInput.stating(source, why(error), 'a readable file is needed') from None
    except UnicodeDecodeError:
        raise BadInput.stating(source, 'not UTF-8', 'UTF-8 text is needed') from None


def _capped(stream: BinaryIO, name: str) -> bytes:
    raw = stream.read(MAX_BYTES + 1)
    if len(raw) > MAX_BYTES:
        raise BadInput.stating(name, 'too large', f'at most {MAX_BYTES} bytes are read')
    return raw


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    _refuse_duplicates([key for key, _ in pairs])
    return dict(pairs)


def _refuse_duplicates(keys: list[str]) -> None:
    if len(set(keys)) < len(keys):
        key = Counter(keys).most_common(1)[0][0]
        raise BadInput.stating(f'field {key}', 'given twice', 'give every field once')


def _require_plain(value: Any, largest: float, path: str = '') -> None:
    """Require mappings with names, lists and scalars, with numbers of sane size."""
    if isinstance(value, dict):
        for key, inner in value.items():
            if not isinstance(key, str):
                raise BadInput.stating(f'field {key!r}', 'not a name', 'names are needed as keys')
            _require_plain(inner, largest, f'{path}.{key}' if path else key)
    elif isinstance(value, list):
        for inner in value:
            _require_plain(inner, largest, path)
    elif isinstance(value, (int, float)) and abs(value) > largest:
        raise BadInput(path, _short(value), f'finite, of a magnitude of at most {largest:g}')
    elif value is not None and not isinstance(value, (str, int, float)):
        raise BadInput(path, str(value), 'numbers, words, lists and mappings')


def _short(value: float) -> str:
    text = str(value)
    return text if len(text) <= 20 else text[:17] + '...'
