# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Imports run one way, mpc <- loop <- ros <- sim <- tool <- benchmarks; mpc and loop need no ROS.

The simulator's engines import no other part of the package.
"""

import ast
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
from harness import python

PACKAGE = Path(__file__).parents[1] / 'orbimpc_ros'
ENGINES = PACKAGE / 'sim' / 'engines'
LAYERS = ('mpc', 'loop', 'ros', 'sim', 'tool')
ROS = ('rclpy', 'rosidl_runtime_py', 'std_msgs', 'geometry_msgs', 'nav_msgs', 'rosbags')


@cache
def imports_of(file):
    found = []
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, file
            found += [f'{node.module}.{alias.name}' for alias in node.names]
    return found


@cache
def all_modules():
    """Return the names of all modules; a package counts as a module."""
    files = (file.relative_to(PACKAGE.parent).with_suffix('') for file in PACKAGE.rglob('*.py'))
    return {'.'.join(file.parts).removesuffix('.__init__') for file in files}


def imported_by(module):
    """Return the modules of the package that a module imports, also inside functions."""
    place = PACKAGE.parent / module.replace('.', '/')
    file = place / '__init__.py' if place.is_dir() else place.with_suffix('.py')
    found = set()
    for name in imports_of(file):
        # A name imported from a module may be a module itself.
        found |= {name} & all_modules() or {name.rpartition('.')[0]} & all_modules()
    return found - {module}


@pytest.mark.parametrize('layer', LAYERS)
def test_a_layer_imports_nothing_above_it(layer):
    above = LAYERS[LAYERS.index(layer) + 1 :]
    for file in (PACKAGE / layer).rglob('*.py'):
        for name in imports_of(file):
            parts = name.split('.')
            assert parts[0] != 'benchmarks', f'{file} imports {name}'
            assert parts[0] != 'orbimpc_ros' or parts[1] not in above, f'{file} imports {name}'
            # Engines and planner share no line of code: only commands connect them.
            engine = file.is_relative_to(ENGINES) and parts[0] == 'orbimpc_ros'
            assert not engine or parts[1:3] == ['sim', 'engines'], f'{file} imports {name}'


@pytest.mark.parametrize('layer', ['mpc', 'loop'])
def test_a_pure_layer_imports_without_ros(layer):
    inside = f'orbimpc_ros.{layer}.'
    modules = sorted(m for m in all_modules() if m.startswith(inside) and '__main__' not in m)
    script = (
        f'import importlib, sys\n'
        f'for name in {modules!r}: importlib.import_module(name)\n'
        f'print([name for name in {ROS!r} if name in sys.modules])'
    )
    assert python(script).stdout.strip() == '[]'


# Packages that a node's process must not load: the other node, the tool, and the compiler.
FOREIGN = {'ros.planner': ('sim', 'tool'), 'sim': ('ros.planner', 'tool', 'mpc.kernels')}
HEAVY = {'cvxpy', 'clarabel', 'scipy.linalg', 'matplotlib', 'PIL', 'rosbags', 'mcap'}


@pytest.mark.parametrize('node', FOREIGN)
def test_a_node_loads_nothing_of_the_other_nor_of_the_tool(node):
    pytest.importorskip('rclpy')
    script = f'import sys, orbimpc_ros.{node}.node; print(*sys.modules)'
    loaded = python(script).stdout.split()
    assert loaded
    for name in FOREIGN[node]:
        above = f'orbimpc_ros.{name}'
        assert not [each for each in loaded if each == above or each.startswith(f'{above}.')]
    assert not HEAVY & {*loaded}


def test_no_modules_import_each_other_in_a_circle():
    """A cycle raises an error that names it."""
    TopologicalSorter({name: imported_by(name) for name in all_modules()}).prepare()


def test_a_safe_command_is_made_in_one_place():
    calls = [
        file.relative_to(PACKAGE).as_posix()
        for file in PACKAGE.rglob('*.py')
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.Call) and getattr(node.func, 'id', '') == 'safe_command'
    ]
    assert calls == ['loop/planner.py']
