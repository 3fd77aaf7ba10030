# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""package.xml, setup.py and the sources agree on what the package is and needs."""

import ast
import os
import re
import sys
import xml.etree.ElementTree as ElementTree

import pytest
from harness import ROOT, python, run
from test_package_layers import imports_of

PACKAGE = ElementTree.parse(ROOT / 'package.xml').getroot()
STANDARD = sys.stdlib_module_names | {'llvmlite'}  # which numba brings

# Who brings what the code imports: rosdep key, distribution on PyPI. None: not needed or not there.
PROVIDERS = {
    'PIL': ('python3-pil', 'pillow'),
    'clarabel': ('python3-cvxpy-pip', 'clarabel'),
    'matplotlib': ('python3-matplotlib', 'matplotlib'),
    'mcap': (None, 'mcap'),
    'mpl_toolkits': ('python3-matplotlib', 'matplotlib'),
    'numba': ('python3-numba', None),
    'packaging': ('python3-packaging', 'packaging'),
    'numpy': ('python3-numpy', 'numpy'),
    'rosbags': ('python3-rosbags-pip', 'rosbags'),
    'scipy': ('python3-scipy', 'scipy'),
    'yaml': ('python3-yaml', 'pyyaml'),
}
BAGS = 'rosbag2_storage_mcap'  # of ros2 bag record, which launch files start
# Of what is not named as its module is.
MODULES = {'bsk': ('Basilisk',), 'rerun-sdk': ('rerun', 'rerun_cli')}


def setup_keyword(name):
    """Return a literal keyword of the setup() call."""
    tree = ast.parse((ROOT / 'setup.py').read_text())
    constants = {
        node.targets[0].id: node.value for node in tree.body if isinstance(node, ast.Assign)
    }
    call = next(
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and getattr(node.func, 'id', '') == 'setup'
    )
    value = next(keyword.value for keyword in call.keywords if keyword.arg == name)
    return ast.literal_eval(constants[value.id] if isinstance(value, ast.Name) else value)


def imported():
    """Return the top-level modules that the package imports, its own and Python's aside."""
    files = (ROOT / 'orbimpc_ros').rglob('*.py')
    found = {name.split('.')[0] for file in files for name in imports_of(file)}
    return {name for name in found if name not in STANDARD and name != 'orbimpc_ros'}


def depends():
    return {e.text for e in PACKAGE if e.tag in ('depend', 'exec_depend')}


@pytest.mark.parametrize('field', ['name', 'version', 'description', 'license'])
def test_manifests_agree(field):
    assert setup_keyword(field) == PACKAGE.find(field).text


def test_the_version_is_stated_once_more_for_python():
    import orbimpc_ros

    assert orbimpc_ros.__version__ == PACKAGE.find('version').text


def test_the_interface_is_there_and_costs_nothing_until_it_is_used():
    script = (
        'import sys, orbimpc_ros as o; print("numpy" in sys.modules);'
        'print(all(getattr(o, name) is not None for name in o.__all__));'
        'print(set(dir(o)) >= set(o.__all__))'
    )
    assert python(script).stdout.split() == ['False', 'True', 'True']


def optional():
    """Return the modules of commands that ask for an extra when they are used."""
    extras = setup_keyword('extras_require')
    names = ('basilisk', 'bench', 'physics', 'study', 'view')
    wanted = [r for name in names for r in extras.get(name, [])]
    brought = {re.split(r'[<>=\[]', r)[0] for r in wanted}
    return brought | {module for name in brought for module in MODULES.get(name, ())}


def test_every_import_is_declared_in_package_xml():
    for module in imported():
        if module in optional():
            continue
        key = PROVIDERS[module][0] if module in PROVIDERS else module
        assert key is None or key in depends(), f'{module} is imported, {key} not in package.xml'


def test_nothing_is_declared_in_package_xml_that_is_not_imported():
    used = {PROVIDERS[module][0] if module in PROVIDERS else module for module in imported()}
    assert {key for key in depends() if key.endswith('-pip') or 'mcap' in key} <= used | {BAGS}


def test_every_third_party_import_is_declared_in_setup():
    declared = {re.split(r'[<>=\[]', r)[0] for r in setup_keyword('install_requires')}
    used = {PROVIDERS[module][1] for module in imported() if module in PROVIDERS}
    assert declared == used - {None}


def test_what_rosdep_would_install_by_pip_comes_from_the_requirements():
    """pip may not touch Ubuntu 24.04's own Python: what it would bring is for an environment."""
    lines = (ROOT / 'requirements-jazzy.txt').read_text().splitlines()
    given = {re.split(r'[<>=]', line)[0] for line in lines if not line.startswith('#')}
    (skipped,) = re.findall(
        r"--skip-keys '([^']+)'", (ROOT / 'docs' / 'getting_started.md').read_text()
    )
    by_pip = {key for key in depends() if key.endswith('-pip')}
    assert by_pip | {'python3-numba'} == set(skipped.split()) <= depends()
    for module, (key, _) in PROVIDERS.items():
        if key is None or key in skipped:
            assert module in given
    assert given <= set(PROVIDERS)


@pytest.mark.parametrize(('numpy', 'kept'), [('1.26.4', True), ('2.3.1', False)])
def test_make_keeps_the_numpy_that_ros_is_compiled_for(tmp_path, numpy, kept):
    python = tmp_path / 'python3'
    python.write_text(f'#!/bin/sh\necho {numpy}\n')
    python.chmod(0o755)
    words = ('make', '-n', '-B', 'demo', f'VENV={tmp_path}/venv', f'PYTHON={python}')
    # Not with what the make that runs these tests was given.
    alone = {k: v for k, v in os.environ.items() if k not in ('MAKEFLAGS', 'MAKEOVERRIDES', 'PINS')}
    done = run(*words, 'ROS_DISTRO=jazzy', cwd=ROOT, env=alone)
    (install,) = (line for line in done.stdout.splitlines() if 'pip install' in line)
    assert ('--constraint requirements-jazzy.txt' in install) == kept


@pytest.mark.parametrize('node', ['planner', 'sim'])
def test_a_node_says_in_one_line_that_ros_is_missing(node):
    script = (
        'import sys; from orbimpc_ros.ros import entry;'
        'sys.modules.update(dict.fromkeys(entry.ROS));'
        f'sys.exit(entry.{node}())'
    )
    done = python(script)
    assert (done.returncode, done.stdout) == (2, '')
    assert done.stderr.count('\n') == 1
    assert done.stderr.startswith(f'{node}: ')
    assert 'is missing: install ROS 2, or ' in done.stderr


STATEMENT = '# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0\n'


def test_each_source_file_begins_with_its_copyright_statement():
    folders = ('docs', 'launch', 'orbimpc_ros', 'test')
    files = [ROOT / 'setup.py', *(f for name in folders for f in (ROOT / name).rglob('*.py'))]
    assert len(files) > 200
    assert [file for file in files if not file.read_text().startswith(STATEMENT)] == []
