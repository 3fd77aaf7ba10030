"""Imports run one way, mpc <- world <- ros <- tool, and the mathematics needs no ROS."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / 'orbimpc_ros'
LAYERS = ('mpc', 'world', 'ros', 'tool')
ROS = ('rclpy', 'rosidl_runtime_py', 'std_msgs', 'geometry_msgs', 'nav_msgs', 'rosbags')


def modules_of(layer):
    folder = PACKAGE / layer
    for file in folder.rglob('*.py'):
        yield '.'.join(file.relative_to(PACKAGE.parent).with_suffix('').parts)


def imports_of(file):
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f'{file}: relative import'
            yield from (f'{node.module}.{alias.name}' for alias in node.names)


@pytest.mark.parametrize('layer', LAYERS)
def test_a_layer_imports_nothing_above_it(layer):
    above = LAYERS[LAYERS.index(layer) + 1 :]
    for file in (PACKAGE / layer).rglob('*.py'):
        for name in imports_of(file):
            parts = name.split('.')
            assert parts[0] != 'orbimpc_ros' or parts[1] not in above, f'{file} imports {name}'


@pytest.mark.parametrize('layer', ['mpc', 'world'])
def test_a_pure_layer_imports_without_ros(layer):
    script = (
        f'import importlib, sys\n'
        f'for name in {sorted(modules_of(layer))!r}: importlib.import_module(name)\n'
        f'print([name for name in {ROS!r} if name in sys.modules])'
    )
    done = subprocess.run(
        [sys.executable, '-c', script], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == '[]'


def test_nodes_do_not_import_each_other():
    for node, other in (('planner', 'sim'), ('sim', 'planner')):
        names = imports_of(PACKAGE / 'ros' / f'{node}.py')
        assert not any(name.startswith(f'orbimpc_ros.ros.{other}') for name in names)
