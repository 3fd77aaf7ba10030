# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The sections of the parameter files on a command line, and which of them reach a node.

rcl matches sections with node names and passes over the rest without a word: a misspelt name
leaves the node with its defaults.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

if TYPE_CHECKING:
    from orbimpc_ros.ros.lifecycle import Managed

PARAMETERS = 'ros__parameters'
NODES = ('planner', 'sim')  # one file may serve both


def unused_sections(node: Managed, words: Sequence[str] | None = None) -> list[str]:
    """Return the sections of parameter files whose name is that of no node, and their files.

    Those in other namespaces are for other vehicles.

    Args:
        node: that the files were given to.
        words: the command line; by default this process's.
    """
    name = node.get_fully_qualified_name().rpartition('/')[2]
    known = {name, '*', '**', *NODES} - ({node.kind} - {name})
    return [
        f'{section} in {file}'
        for flag, file in pairwise(sys.argv if words is None else words)
        if flag == '--params-file'
        for section, _ in _sections(file)
        if section.rpartition('/')[2] not in known
    ]


def given(file: str, node: str, parameter: str) -> Any:
    """Return the value that a parameter file has for a node, of several the last; None without.

    Args:
        file: its path.
        node: its name with its namespace.
        parameter: not nested.
    """
    value = None
    for name, values in _sections(file):
        if _matches(name, node):
            value = values.get(parameter, value)
    return value


def _sections(file: str) -> list[tuple[str, dict[str, Any]]]:
    """Return the sections of a file; none if only rcl can say what is wrong with it."""
    try:
        return list(_below(yaml.safe_load(Path(file).read_text(errors='replace'))))
    except yaml.YAMLError:
        return []


def _below(tree: Any, above: str = '') -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield sections, which may be nested by namespace: names with a leading slash, and values."""
    for name, below in tree.items() if isinstance(tree, dict) else ():
        if name == PARAMETERS:
            yield above, below if isinstance(below, dict) else {}
        else:
            yield from _below(below, f'{above}/{str(name).strip("/")}')


def _matches(section: str, node: str) -> bool:
    """Return whether rcl gives a section to a node: ``*`` is one name, ``**`` any number."""
    pattern = re.escape(section).replace(r'/\*\*', r'(/\w+)*').replace(r'/\*', r'/\w+')
    return re.fullmatch(pattern, node) is not None
