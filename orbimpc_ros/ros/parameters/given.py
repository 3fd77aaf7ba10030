# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Parameters given to a node from outside: names that no node has, and values that reach none.

rcl matches sections of parameter files, and ``-p NODE:NAME:=VALUE``, with node names and silently
ignores the rest, so that a node whose name is misspelt there keeps its defaults.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any

import yaml

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.parameters.planner import PLANNER
from orbimpc_ros.ros.parameters.spec import ParameterSpec

OF_ROS = ('use_sim_time', 'start_type_description_service')
PARAMETERS = 'ros__parameters'
NODES = ('planner', 'sim')  # one file may serve both


def refuse_unknown(given: Iterable[str], specs: Iterable[ParameterSpec]) -> None:
    """Reject a parameter that neither node has: one file may serve both."""
    others = set(given).difference(OF_ROS, (spec.name for spec in specs))
    if not others:
        return
    simulator = import_module('orbimpc_ros.sim.parameters')  # by a planner only if need be
    known = {*OF_ROS, *(spec.name for spec in (*PLANNER, *simulator.SIM))}
    for name in sorted(others - known):
        raise BadInput.unknown('parameter', name, sorted(known))


def unused(full: str, kind: str) -> list[str]:
    """Return sections of a node's parameter files, and words after -p, that are for no node.

    Sections in other namespaces belong to other vehicles, but not those without a namespace.

    Args:
        full: name of the node, with its namespace.
        kind: its name unless it is remapped.
    """
    name = full.rpartition('/')[2]
    known = {name, '*', '**', *NODES} - ({kind} - {name})
    found = []
    for flag, word in pairwise(sys.argv):
        if flag == '--params-file':
            # rcl has parsed it; its tags matter no more here than there.
            tree = yaml.load(Path(word).read_text(errors='replace'), yaml.BaseLoader)
            for section, _ in sections(tree):
                if section.rpartition('/')[2] not in known or f'/{name}' == section != full:
                    found.append(f'section {section} in {word}')
        owner, colon, _ = word.partition(':=')[0].rpartition(':')
        if flag in ('-p', '--param') and colon and f'/{owner}' != full:
            found.append(f'-p {word}')
    return found


def sections(tree: Any, above: str = '') -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield sections, possibly nested by namespace: names with a leading slash, and values."""
    for name, below in tree.items() if isinstance(tree, dict) else ():
        if name != PARAMETERS:
            yield from sections(below, f'{above}/{str(name).strip("/")}')
        elif isinstance(below, dict):
            yield above, below
