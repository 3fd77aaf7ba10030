# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""package.xml, setup.py and the sources agree on contents and dependencies of the package.

Installation hints keep the NumPy 1 of ROS; one line names what is missing.
"""

import os
import re
import runpy
import shlex
import sys
import xml.etree.ElementTree as ElementTree
from unittest import mock

import pytest
from harness import ROOT, python, run
from test_package_layers import imports_of

from orbimpc_ros import __version__, install
from orbimpc_ros.ros.entry import OTHERS, in_a_line

PACKAGE = ElementTree.parse(ROOT / 'package.xml').getroot()
STANDARD = sys.stdlib_module_names | {'llvmlite'}  # a dependency of numba

# Providers of imports: rosdep key, distribution on PyPI; None: not needed, or not available.
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
BAGS = 'rosbag2_storage_mcap'  # for ros2 bag record, which launch files start
# Modules of distributions that have another name.
MODULES = {'bsk': ('Basilisk',), 'rerun-sdk': ('rerun', 'rerun_cli')}


def setup_keyword(name):
    """Return the value of a keyword of the setup() call."""
    given = {}
    with mock.patch('setuptools.setup', given.update):
        runpy.run_path(str(ROOT / 'setup.py'))
    return given[name]


def imported():
    """Return the top-level modules that the package imports, except its own and Python's."""
    files = (ROOT / 'orbimpc_ros').rglob('*.py')
    found = {name.split('.')[0] for file in files for name in imports_of(file)}
    return {name for name in found if name not in STANDARD and name != 'orbimpc_ros'}


def depends():
    return {e.text for e in PACKAGE if e.tag in ('depend', 'exec_depend')}


@pytest.mark.parametrize('field', ['name', 'version', 'description', 'license'])
def test_manifests_agree(field):
    assert setup_keyword(field) == PACKAGE.find(field).text
    assert field != 'version' or __version__ == PACKAGE.find(field).text


def optional():
    """Return the modules of extras, which commands ask for when they are used."""
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
    """pip must not touch Ubuntu 24.04's own Python: its packages are for an environment."""
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
    # Without the variables of the make that runs these tests.
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


# --- what to install

INSTALL = r'pip install (--constraint \S+ )?'  # depends on the NumPy installed


@pytest.mark.parametrize('numpy', ['1.26.4', '2.4.6'])
@pytest.mark.parametrize('extra', ['basilisk', 'ros', 'view'])
def test_an_extra_is_named_by_its_packages_within_the_numpy_of_ros(extra, numpy, monkeypatch):
    monkeypatch.setattr(install, 'version', lambda _name: numpy)
    words = shlex.split(install.command_for_extra(extra))
    bounds = ['--constraint', str(ROOT / 'requirements-jazzy.txt')] if numpy[0] == '1' else []
    first = [sys.executable, '-m', 'pip', 'install', *bounds]
    assert words[: len(first)] == first
    names = [install_name(each) for each in words[len(first) :]]
    assert sorted(names) == sorted(map(install_name, setup_keyword('extras_require')[extra]))


def install_name(requirement):
    return re.match(r'[\w-]+', requirement)[0]


def test_without_the_file_numpy_stays_below_2_all_the_same(monkeypatch):
    monkeypatch.setattr(install, 'version', lambda _name: '1.26.4')
    monkeypatch.setattr(install, 'shared', lambda _name: None)
    assert install.command('numba').endswith("pip install 'numpy<2' numba")


# --- missing packages: fast methods work without them, others name them in one line

# An installation with the packages of apt alone.
BARE = """
    import sys

    class Absent:
        '''Finds nothing of what is not to be there.'''

        def find_spec(self, name, *_more):
            if name.partition('.')[0] in {others}:
                raise ModuleNotFoundError(f'No module named {{name!r}}', name=name)

    sys.meta_path.insert(0, Absent())
    from orbimpc_ros.ros.entry import {node}
    sys.exit({node}())
"""


@pytest.fixture
def bare(launch):
    """Return a function that starts a node without packages for general methods and the tool."""
    return lambda node, *arguments: launch(BARE.format(node=node, others=OTHERS), *arguments)


def test_a_rope_is_caught_by_a_fast_method_without_any_of_it(bare):
    planner = bare('planner', {'odom_timeout': 60.0, 'goal_timeout': 60.0}, 'retrieval')
    sim = bare('sim', {'exit_when_done': True}, 'retrieval')
    assert sim.wait() == 0, sim.output + planner.output
    assert planner.stop() == 0
    assert 'planning' in planner.output
    assert 'Traceback' not in planner.output + sim.output


def test_a_general_method_says_in_a_line_what_it_needs(bare):
    planner = bare('planner', {}, 'lander')
    assert planner.wait() == 2, planner.output
    said = planner.output.strip()
    assert said.startswith('clarabel: not installed; the general method for this problem needs ')
    assert re.search(f'{INSTALL}clarabel$', said)


@pytest.mark.parametrize(
    ('name', 'line'),
    [
        ('rosbags.typesys', f'rosbags is missing: .*{INSTALL}rosbags$'),
        ('mcap', f'mcap is missing: .*{INSTALL}mcap$'),
        ('distributed', f"distributed is missing: .*{INSTALL}'distributed>="),
    ],
)
def test_what_is_missing_is_said_with_the_way_to_get_it(name, line):
    assert re.match(line, in_a_line(ModuleNotFoundError(name=name)))
    assert in_a_line(ImportError('x: shared object\nnext')).startswith('x: shared object; ')
    for other in (f'orbimpc_ros.{name}', None):
        with pytest.raises(ModuleNotFoundError):
            in_a_line(ModuleNotFoundError(name=other))
