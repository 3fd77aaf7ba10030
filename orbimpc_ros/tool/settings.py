# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The parameters of a run: defaults, overridden by the scenario's file and ``--set``, validated.

A value applies to both nodes. A value for the simulator only, such as a wind unknown to the
planner, has a prefix: ``sim.wind``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from orbimpc_ros import install
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.parameters.planner import PLANNER, planner_settings
from orbimpc_ros.ros.parameters.spec import OF_ROS, PARAMETERS, completed, sections
from orbimpc_ros.sim.parameters import SIM, sim_settings
from orbimpc_ros.tool import bags, files

OF_SIM = 'sim.'
ROWS = {row.name: row for row in (*PLANNER, *SIM)}
ROWS |= {f'{OF_SIM}{row.name}': row for row in SIM if row.name in {each.name for each in PLANNER}}
Values = dict[str, Any]


def config(name: str) -> Path:
    """Return the path of a file of parameters under ``config/``.

    Raises:
        BadInput: no such file.
    """
    if (found := install.shared(f'config/{name}')) is None:
        raise BadInput.stating(f'configuration {name}', 'missing', 'install it under config/')
    return found


def resolve(file: Path, changes: Sequence[str] = ()) -> Values:
    """Return every parameter's value for a run: a file's and defaults, :func:`changed`.

    Raises:
        BadInput: an unknown name, or a value or combination that is not allowed.
    """
    return changed(read(files.read(str(file)), str(file)), changes)


def named(changes: Sequence[str]) -> set[str]:
    """Return the names of the parameters that changes, ``name=value``, set."""
    return {change.partition('=')[0].strip() for change in changes}


def changed(values: Values, changes: Sequence[str], *, simulated: bool = True) -> Values:
    """Return the values of all parameters with changes, ``name=value``, validated together.

    Unless ``simulated``, only those of the planner are validated: its vehicle may be a real one.

    Raises:
        BadInput: an unknown name, or a value or combination that is not allowed.
    """
    merged, overrides = dict(values), Values()
    for change in changes:
        name, equals, word = map(str.strip, change.partition('='))
        if not equals:
            raise BadInput('--set', change, 'name=value')
        if name not in ROWS:
            raise BadInput.unknown('parameter', name, ROWS, '--set')
        overrides[name] = ROWS[name].typed(files.parse(word, f'--set {name}'))
        merged.pop(f'{OF_SIM}{name}', None)  # a value for both nodes replaces the simulator's own
    merged |= overrides
    planner_settings(merged)
    if simulated:
        sim_settings(of_sim(merged))
    return merged


def of_sim(values: Values) -> Values:
    """Return the values for the simulator: without prefix its own, which precede those for both."""
    common, own = _parted(values)
    return common | own


def _parted(values: Values) -> tuple[Values, Values]:
    """Return the values for both nodes, and those for the simulator only, without prefix."""
    own = {n.removeprefix(OF_SIM): value for n, value in values.items() if n.startswith(OF_SIM)}
    return {n: value for n, value in values.items() if not n.startswith(OF_SIM)}, own


def text(values: Values, own: Mapping[str, Values] = {}) -> str:
    """Return values as a file of ROS parameters for any node.

    Args:
        values: for all nodes.
        own: values that differ between vehicles, by namespace, such as ``/uav1``.
    """
    differ = {name for each in own.values() for name in each}
    common, of_sim = _parted(values)
    sections = {'/**': {n: each for n, each in common.items() if n not in differ}}
    sections |= {'/**/sim': of_sim, **{f'{name}/**': each for name, each in own.items()}}
    plain = {name: {PARAMETERS: _plain(each)} for name, each in sections.items() if each}
    return yaml.safe_dump(plain, sort_keys=False)


def _plain(values: Values) -> Values:
    """Return values for YAML, without empty lists, which have no type in ROS."""
    return {k: list(v) if isinstance(v, tuple) else v for k, v in values.items() if v != ()}


def of_bag(path: Path, namespace: str = '', params: str | None = None) -> Values:
    """Return the values of a vehicle in the notes of a bag, or in a file instead.

    Raises:
        BadInput: no bag, or malformed notes; no such file, or a malformed one.
    """
    if params is not None:
        return read(files.read(params), params, namespace)
    name = f'{path}: parameters'
    return read(files.parse(bags.notes(path).get('parameters', '{}'), name), name, namespace)


def read(content: Any, name: str = 'parameters', namespace: str = '') -> Values:
    """Return the values in the content of a parameter file, and defaults for all others.

    Args:
        content: such as of :func:`text`.
        name: of the source, for error messages.
        namespace: of the vehicle, in the file of a fleet.

    Raises:
        BadInput: not parameters, an unknown name, or a value of another type.
    """
    return completed(ROWS.values(), dict(parameters_of(content, name, namespace)))


def parameters_of(content: Any, name: str, namespace: str = '') -> Iterator[tuple[str, Any]]:
    """Yield the parameters in every section of a parameter file, nested names joined by dots.

    With a ``namespace``, sections in others are left out.

    Raises:
        BadInput: not parameters, an unknown name, or a value of another type.
    """
    entries = sections(content, name)
    if entries and all(title.endswith('/sim') for title, _ in entries):
        raise BadInput.stating(name, 'for the simulator alone', 'add a section "/**/planner"')
    for title, section in entries:
        place, _, node = title.rpartition('/')
        if namespace and place not in ('', '/**', namespace):
            continue
        for field, value in _flat(section):
            key = f'{OF_SIM}{field}' if node == 'sim' and f'{OF_SIM}{field}' in ROWS else field
            if key in ROWS:
                yield key, ROWS[key].typed(value)
            elif field in OF_ROS:
                yield field, value
            elif not field.startswith('qos_overrides.'):
                raise BadInput.unknown('parameter', field, ROWS, name)


def _flat(tree: dict[str, Any], prefix: str = '') -> Iterator[tuple[str, Any]]:
    for name, value in tree.items():
        if isinstance(value, dict):
            yield from _flat(value, f'{prefix}{name}.')
        else:
            yield f'{prefix}{name}', value
