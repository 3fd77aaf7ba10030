# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The parameters of a run: defaults, then the scenario's file, then ``--set``, checked.

A value is for both nodes. A value that the simulator alone has, such as a wind unknown to the
planner, has a name of its own: ``sim.wind``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import yaml

from orbimpc_ros import install
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.parameters.dynamic import OF_ROS
from orbimpc_ros.ros.parameters.planner import PLANNER, planner_settings
from orbimpc_ros.ros.parameters.spec import ParameterSpec, completed
from orbimpc_ros.sim.parameters import SIM, sim_settings
from orbimpc_ros.tool import bags, files

ROWS = {row.name: row for row in (*PLANNER, *SIM)}
OF_SIM = 'sim.'
PLANNED = {row.name for row in PLANNER}
ROWS_OF_SIM = {f'{OF_SIM}{row.name}': row for row in SIM if row.name in PLANNED}  # may differ
Values = dict[str, Any]
EMPTY: Mapping[str, Values] = MappingProxyType({})


def config(name: str) -> Path:
    """Return the path of a file of parameters under ``config/``.

    Raises:
        BadInput: no such file.
    """
    found = install.shared(f'config/{name}')
    if found is None:
        raise BadInput.stating(f'configuration {name}', 'missing', 'install it under config/')
    return found


def resolve(file: Path, changes: Sequence[str] = ()) -> Values:
    """Return every parameter's value for a run.

    Args:
        file: parameters in ROS's form; one file serves both nodes.
        changes: ``name=value``, as given on the command line.

    Raises:
        BadInput: an unknown name, or a value or combination that is not allowed.
    """
    return changed(_completed(files.read(str(file)), str(file)), changes)


def changed(values: Values, changes: Sequence[str]) -> Values:
    """Return values of which some are changed, checked as a whole.

    Args:
        values: of every parameter.
        changes: ``name=value``, as given on the command line.

    Raises:
        BadInput: an unknown name, or a value or combination that is not allowed.
    """
    found, given = dict(values), dict(map(_change, changes))
    for name in given:  # a value for both nodes, but for what the simulator is given of its own
        found.pop(f'{OF_SIM}{name}', None)
    found |= given
    planner_settings(found)
    sim_settings(of_sim(found))
    return found


def of_sim(values: Values) -> Values:
    """Return the values that the simulator gets."""
    own = {name.removeprefix(OF_SIM): values[name] for name in ROWS_OF_SIM if name in values}
    return {name: each for name, each in values.items() if name not in ROWS_OF_SIM} | own


def text(values: Values, own: Mapping[str, Values] = EMPTY) -> str:
    """Return values as a file of ROS parameters for any node.

    Args:
        values: for all nodes.
        own: values that differ from one namespace, such as ``/uav1``, to another.
    """
    differ = {name for each in own.values() for name in each}
    common = {name: value for name, value in values.items() if name not in differ}
    of_sim_alone = {
        name.removeprefix(OF_SIM): common.pop(name) for name in ROWS_OF_SIM if name in common
    }
    sections = {'/**': common}
    if of_sim_alone:
        sections['/**/sim'] = of_sim_alone
    sections |= {f'{namespace}/**': each for namespace, each in own.items()}
    plain = {name: {'ros__parameters': _plain(each)} for name, each in sections.items()}
    return yaml.safe_dump(plain, sort_keys=False)


def _plain(values: Values) -> Values:
    """Return values for YAML, without empty lists: to ROS they have no type."""
    plain = {k: list(v) if isinstance(v, tuple) else v for k, v in values.items()}
    return {name: value for name, value in plain.items() if value != []}


def of_bag(path: Path, namespace: str = '') -> Values | None:
    """Return the values that the recorder of a bag has noted in it; None if it has not.

    Args:
        path: of the bag.
        namespace: whose values are wanted in the bag of a fleet.

    Raises:
        BadInput: no bag, or notes that are none.
    """
    noted = bags.notes(path).get('parameters')
    return None if noted is None else read(noted, namespace, f'{path}: parameters')


def read(written: str, namespace: str = '', name: str = 'parameters') -> Values:
    """Return the values of what :func:`text` made, defaults where there are none.

    Args:
        written: the parameter file.
        namespace: whose values are wanted in the file of a fleet.
        name: where it comes from, for the message.

    Raises:
        BadInput: not parameters, an unknown name, or a value of another type.
    """
    return _completed(files.parse(written, name), name, namespace)


def _completed(content: Any, name: str, namespace: str = '') -> Values:
    """Return the values in a parameter file over the defaults."""
    if namespace and isinstance(content, dict):
        wanted = ('/**', f'{namespace}/')
        content = {key: each for key, each in content.items() if str(key).startswith(wanted)}
    values: Values = {}
    for given, value in sections(content, name):
        row = ROWS_OF_SIM.get(given) or ROWS.get(given)
        if row is not None:
            values[given] = _typed(row, value)
        elif given in OF_ROS:
            values[given] = value
        elif not given.startswith('qos_overrides.'):
            raise BadInput.unknown('parameter', given, ROWS, name)
    values = completed(ROWS.values(), values)
    for own in ROWS_OF_SIM.keys() & values.keys():
        if values[own] == values[own.removeprefix(OF_SIM)]:
            del values[own]
    return values


def sections(content: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Yield the parameters of every section of a parameter file, nested names joined by dots."""
    for title, section in content.items() if isinstance(content, dict) else (('', None),):
        if not isinstance(section, dict) or not isinstance(section.get('ros__parameters'), dict):
            raise BadInput.stating(
                name, 'not a parameter file', 'sections with ros__parameters are needed'
            )
        for given, value in _flat(section['ros__parameters']):
            own = f'{OF_SIM}{given}'
            alone = str(title).rpartition('/')[2] == 'sim' and own in ROWS_OF_SIM
            yield (own if alone else given), value


def _flat(tree: dict[str, Any], prefix: str = '') -> Iterator[tuple[str, Any]]:
    for name, value in tree.items():
        if isinstance(value, dict):
            yield from _flat(value, f'{prefix}{name}.')
        else:
            yield f'{prefix}{name}', value


def _change(given: str) -> tuple[str, Any]:
    name, equals, word = given.partition('=')
    if not equals:
        raise BadInput('--set', given, 'name=value')
    row = ROWS_OF_SIM.get(name) or ROWS.get(name)
    if row is None:
        raise BadInput.unknown('parameter', name, ROWS, '--set')
    return name, _typed(row, files.parse(word, f'--set {name}'))


def _typed(row: ParameterSpec, value: Any) -> Any:
    """Return a value as the parameter's type; a whole number may stand for a float."""
    kind: type = type(row.default)
    if kind is tuple and isinstance(value, list):
        return tuple(_of_kind(row, str if row.words else float, each) for each in value)
    return _of_kind(row, kind, value)


def _of_kind(row: ParameterSpec, kind: type, value: Any) -> Any:
    if kind is float and type(value) is int:
        return float(value)
    if type(value) is not kind:
        raise BadInput(row.name, value, row.allowed)
    return value
