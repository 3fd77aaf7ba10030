# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A node's parameters: declared from a table, checked as a whole, changed atomically.

This module also finds parameters that reach no node: rcl matches sections of parameter files, and
``-p NODE:NAME:=VALUE``, with node names and silently ignores the rest, so that a node whose name is
misspelt there keeps its defaults.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import yaml
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.parameters.planner import PLANNER
from orbimpc_ros.ros.parameters.spec import ParameterSpec, Values, completed

if TYPE_CHECKING:
    from orbimpc_ros.ros.process import Managed

S = TypeVar('S')

OF_ROS = ('use_sim_time', 'start_type_description_service')


class DynamicParameters(Generic[S]):
    """A node's parameters as settings: declared, checked, and kept up to date.

    Parameters that reach no node are logged.

    Args:
        specs: the table of the node's parameters.
        settings_of: makes settings of values, or raises BadInput.
        prepare: derives from changed settings what the node works with, or raises BadInput; it
            must not have side effects, because the change may still be rejected.
        install: takes over the result once the change is final.

    Raises:
        BadInput: a parameter is unknown or its value is not allowed.
    """

    def __init__(
        self,
        node: Managed,
        specs: Sequence[ParameterSpec],
        settings_of: Callable[[Values], S],
        prepare: Callable[[S], Any] = lambda settings: settings,
        install: Callable[[Any], None] = lambda _prepared: None,
    ) -> None:
        self._node, self._specs, self._settings_of = node, specs, settings_of
        self._prepare, self._install = prepare, install
        _refuse_unknown(node, specs)
        given = {name: each.value for name, each in node._parameter_overrides.items()}
        values = completed(specs, given)
        settings_of(values)
        for spec in specs:
            node.declare_parameter(spec.name, values[spec.name], spec.descriptor)
        self._pending: Any = None
        node.add_on_set_parameters_callback(self._on_set)
        node.add_post_set_parameters_callback(self._on_changed)
        for lost in unused(node):
            name = node.get_fully_qualified_name()
            node.get_logger().warning(f'{lost} is not for {name}: not used')

    def settings(self) -> S:
        """Return the present settings."""
        return self._settings_of(self._values())

    def _values(self) -> dict[str, Any]:
        return {spec.name: self._node.get_parameter(spec.name).value for spec in self._specs}

    def _on_set(self, changes: list[Parameter]) -> SetParametersResult:
        values, known = self._values(), self._node.get_parameter('use_sim_time').value
        try:
            for change in changes:
                if change.name == 'use_sim_time' and change.value != known:
                    raise BadInput('use_sim_time', change.value, 'set at the start only')
                if change.name in values:
                    values[change.name] = change.value
            self._pending = self._prepare(self._settings_of(values))
        except BadInput as error:
            return SetParametersResult(successful=False, reason=str(error))
        except Exception as error:  # an exception would let remote callers end the node
            return SetParametersResult(successful=False, reason=f'{type(error).__name__}: {error}')
        return SetParametersResult(successful=True)

    def _on_changed(self, _changes: list[Parameter]) -> None:
        if self._pending is not None:
            self._install(self._pending)
        self._pending = None


def _refuse_unknown(node: Node, specs: Sequence[ParameterSpec]) -> None:
    known = {spec.name for spec in specs}.union(OF_ROS)
    if not known.issuperset(node._parameter_overrides):
        # One file may serve both nodes, so a name is unknown only if neither has it.
        simulator = import_module('orbimpc_ros.sim.parameters')
        known.update(spec.name for spec in (*PLANNER, *simulator.SIM))
    for name in node._parameter_overrides:
        if name not in known:
            raise BadInput.unknown('parameter', name, sorted(known))


PARAMETERS = 'ros__parameters'
NODES = ('planner', 'sim')  # one file may serve both


def unused(node: Managed) -> list[str]:
    """Return sections of a node's parameter files, and words after -p, that are for no node.

    Sections in other namespaces belong to other vehicles, but not those without a namespace.
    """
    full = node.get_fully_qualified_name()
    name = full.rpartition('/')[2]
    known = {name, '*', '**', *NODES} - ({node.kind} - {name})
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
