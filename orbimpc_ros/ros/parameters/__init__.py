# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A node's parameters: declared from a table, checked as a whole, changed whole or not at all."""

from __future__ import annotations

from collections.abc import Callable, Sequence, Sized
from dataclasses import replace
from importlib import import_module
from typing import Any, Generic, TypeVar

from rcl_interfaces.msg import SetParametersResult
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.parameters.parameter import Row, Values
from orbimpc_ros.ros.parameters.planner import PLANNER, PlannerSettings, planner_settings

__all__ = ['PLANNER', 'Live', 'PlannerSettings', 'Row', 'planner_settings']

S = TypeVar('S')
W = TypeVar('W')

OF_ROS = ('use_sim_time', 'start_type_description_service')


class Live(Generic[S, W]):
    """A node's parameters as settings: declared, checked, and kept up to date.

    Args:
        node: that has the parameters.
        rows: its table.
        settings_of: makes settings of values, or raises BadInput.
        prepare: makes of settings what the node works with, or raises BadInput; it must not
            change anything, for the change may still be refused.

    Attributes:
        prepared: what was made of the parameters at the start.

    Raises:
        BadInput: a parameter is unknown or its value is not allowed.
    """

    def __init__(
        self,
        node: Node,
        rows: Sequence[Row],
        settings_of: Callable[[Values], S],
        prepare: Callable[[S], W],
    ) -> None:
        self._node, self._rows = node, rows
        self._settings_of, self._prepare = settings_of, prepare
        _refuse_unknown(node, rows)
        given = {name: each.value for name, each in node._parameter_overrides.items()}
        for row in rows:
            _declare(node, replace(row, default=row.default_beside(given)))
        self.settings()
        self._install: Callable[[W], None] | None = None
        self._pending: W | None = None
        node.add_pre_set_parameters_callback(self._typed)
        node.add_on_set_parameters_callback(self._on_set)
        node.add_post_set_parameters_callback(self._on_changed)

    def settings(self) -> S:
        """Return the settings as they are now."""
        return self._settings_of(self._values())

    def prepared(self) -> W:
        """Return what is made of the settings as they are now."""
        return self._prepare(self.settings())

    def keep(self, install: Callable[[W], None]) -> None:
        """From now on install what is made of changed settings, once a change is certain."""
        self._install = install

    def release(self) -> None:
        """From now on only check changes."""
        self._install = None

    def _values(self) -> dict[str, Any]:
        return {row.name: self._node.get_parameter(row.name).value for row in self._rows}

    def _typed(self, changes: list[Parameter]) -> list[Parameter]:
        """Return changes with empty lists as what the parameters are: YAML does not know."""
        arrays = {row.name: row.kind for row in self._rows if isinstance(row.default, tuple)}
        return [
            Parameter(each.name, arrays[each.name], [])
            if each.name in arrays and _empty(each)
            else each
            for each in changes
        ]

    def _on_set(self, changes: list[Parameter]) -> SetParametersResult:
        try:
            settings = self._settings_of(self._merged(changes))
            self._pending = None if self._install is None else self._prepare(settings)
        except BadInput as error:
            return SetParametersResult(successful=False, reason=str(error))
        except Exception as error:  # a raising callback would end the node from afar
            return SetParametersResult(successful=False, reason=f'{type(error).__name__}: {error}')
        return SetParametersResult(successful=True)

    def _merged(self, changes: list[Parameter]) -> dict[str, Any]:
        values = self._values()
        for change in changes:
            if change.name == 'use_sim_time':
                if change.value == self._node.get_parameter('use_sim_time').value:
                    continue
                raise BadInput('use_sim_time', change.value, 'set at the start only')
            if change.name in values:
                values[change.name] = change.value
        return values

    def _on_changed(self, _changes: list[Parameter]) -> None:
        if self._install is not None and self._pending is not None:
            self._install(self._pending)
        self._pending = None


def _empty(given: Parameter) -> bool:
    return isinstance(given.value, Sized) and not isinstance(given.value, str) and not given.value


def _refuse_unknown(node: Node, rows: Sequence[Row]) -> None:
    known = {row.name for row in rows}.union(OF_ROS)
    if not known.issuperset(node._parameter_overrides):
        # One file may serve both nodes, so a name is unknown only if neither has it.
        simulator = import_module('orbimpc_ros.sim.parameters')
        known.update(row.name for row in (*PLANNER, *simulator.SIM))
    for name, given in node._parameter_overrides.items():
        if name.startswith('qos_overrides.'):
            problem = f'{given.value!r} would have no effect'
            hint = 'leave it out: qualities of service are fixed'
            raise BadInput.stating(f'parameter {name}', problem, hint)
        if name not in known:
            raise BadInput.unknown('parameter', name, sorted(known))


def _declare(node: Node, row: Row) -> None:
    empty = row.default == ()
    default = row.kind if empty else row.default
    descriptor = row.descriptor
    descriptor.read_only &= not empty
    try:
        node.declare_parameter(row.name, default, descriptor)
    except (InvalidParameterTypeException, InvalidParameterValueException):
        given = node._parameter_overrides[row.name].value
        raise BadInput(row.name, given, row.allowed) from None
    if empty and node.get_parameter_or(row.name).type_ == Parameter.Type.NOT_SET:
        # rclpy takes an undeclared [] for bytes, so that the type has to be given apart.
        node.set_parameters([Parameter(row.name, row.kind, [])])
    if empty:  # what is read-only could not be given its type
        node.set_descriptor(row.name, row.descriptor)
