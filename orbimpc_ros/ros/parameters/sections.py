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
    """Return the sections of parameter files that no node of this kind takes, and their files.

    Left out are sections for the other kind of node, and those that differ from a used one in
    the namespace alone, as in the file of a fleet.

    Args:
        node: that the files were given to.
        words: the command line; by default this process's.
    """
    own, others = node.get_fully_qualified_name(), {*NODES} - {node.kind}
    unused = []
    for file in _files(sys.argv if words is None else words):
        names = [name for name, _ in _sections(_read(file))]
        used = {_shape(name) for name in names if _matches(name, own) and not _general(name)}
        unused += [
            f'{name} in {file}'
            for name in names
            if not _matches(name, own)
            and name.rpartition('/')[2] not in others
            and _shape(name) not in used
        ]
    return unused


def warn_of_unused(node: Managed) -> None:
    """Say which sections of the parameter files do not reach a node."""
    for section in unused_sections(node):
        name = node.get_fully_qualified_name()
        node.get_logger().warning(f'section {section} is not for {name}: not used')


def given(file: str, node: str, parameter: str) -> Any:
    """Return the value that a parameter file has for a node, of several the last; None without.

    Args:
        file: its path.
        node: its name with its namespace.
        parameter: not nested.
    """
    found = (each.get(parameter) for name, each in _sections(_read(file)) if _matches(name, node))
    return next((value for value in reversed(list(found)) if value is not None), None)


def _read(file: str) -> Any:
    """Return what a parameter file holds; nothing if only rcl can say what is wrong with it."""
    try:
        return yaml.safe_load(Path(file).read_text(errors='replace'))
    except yaml.YAMLError:
        return None


def _files(words: Sequence[str]) -> Iterator[str]:
    for flag, word in pairwise(words):
        if flag == '--params-file':
            yield word


def _sections(tree: Any, above: str = '') -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield sections, which may be nested by namespace: names with a leading slash, and values."""
    for name, below in tree.items() if isinstance(tree, dict) else ():
        if name == PARAMETERS:
            yield above, below if isinstance(below, dict) else {}
        else:
            yield from _sections(below, f'{above}/{str(name).strip("/")}')


def _matches(section: str, node: str) -> bool:
    """Return whether rcl gives a section to a node: ``*`` is one name, ``**`` any number."""
    pattern = re.escape(section).replace(r'/\*\*', r'(/\w+)*').replace(r'/\*', r'/\w+')
    return re.fullmatch(pattern, node) is not None


def _general(section: str) -> bool:
    """Return whether a section holds in more than one namespace."""
    return '*' in section.rpartition('/')[0]


def _shape(section: str) -> tuple[int, str]:
    """Return how deep a section is and what it is for, in whatever namespace."""
    return section.count('/'), section.rpartition('/')[2]
