# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""What to install: hints that break no NumPy 1 of ROS, and lines where something is missing."""

import re
import shlex
import sys
from itertools import product
from pathlib import Path

import pytest
from harness import ROOT
from test_package_manifest import setup_keyword

from orbimpc_ros import install
from orbimpc_ros.ros.entry import OTHERS, in_a_line

INSTALL = r'pip install (--constraint \S+ )?'  # which it is hangs on the NumPy installed


def declared(extra):
    return setup_keyword('extras_require')[extra]


@pytest.mark.parametrize(
    ('extra', 'numpy'),
    [*product(('basilisk', 'ros'), ('1.26.4', '2.4.6')), ('view', '2.4.6')],
)
def test_an_extra_is_named_by_its_packages_within_what_the_environment_bears(
    extra, numpy, monkeypatch
):
    monkeypatch.setattr(install, 'version', lambda _name: numpy)
    monkeypatch.setattr(install, 'which', lambda _name: str(Path(sys.executable).parent / 'pip'))
    words = shlex.split(install.command_for_extra(extra))
    names = {install_name(each) for each in declared(extra)}
    bounds = ['--constraint', str(ROOT / 'requirements-jazzy.txt')] if numpy[0] == '1' else []
    assert words[: 2 + len(bounds)] == ['pip', 'install', *bounds]
    assert {install_name(each) for each in words[2 + len(bounds) :]} == names


def install_name(requirement):
    return re.match(r'[\w-]+', requirement)[0]


def test_the_viewer_comes_without_its_numpy(monkeypatch):
    monkeypatch.setattr(install, 'version', lambda _name: '1.26.4')
    words = shlex.split(install.command_for_extra('view'))
    assert '--no-deps' in words
    assert set(declared('view')) <= set(words)


def test_without_the_file_numpy_stays_below_2_all_the_same(monkeypatch):
    monkeypatch.setattr(install, 'version', lambda _name: '1.26.4')
    monkeypatch.setattr(install, 'shared', lambda _name: None)
    monkeypatch.setattr(install, 'which', lambda _name: str(Path(sys.executable).parent / 'pip'))
    assert install.command('numba') == "pip install 'numpy<2' numba"


@pytest.mark.parametrize('sourced', [False, True])
def test_the_systems_python_is_left_alone(sourced, tmp_path, monkeypatch):
    (tmp_path / 'EXTERNALLY-MANAGED').touch()
    monkeypatch.setattr(install.sysconfig, 'get_path', lambda _name: str(tmp_path))
    monkeypatch.setattr(install.sys, 'prefix', install.sys.base_prefix)
    monkeypatch.delenv('COLCON_PREFIX_PATH', raising=False)
    if sourced:
        monkeypatch.setenv('COLCON_PREFIX_PATH', '/ws/install')
    first, *others = install.command('numba').split(' && ')
    assert first == 'python3 -m venv --system-site-packages .venv'
    assert others[0] == '. .venv/bin/activate'
    assert others[1].startswith('pip install ')
    assert others[2:] == (['python -m colcon build'] if sourced else [])


def test_the_pip_is_this_interpreters(tmp_path, monkeypatch):
    monkeypatch.setattr(install, 'which', lambda _name: str(tmp_path / 'pip'))
    assert install.command('numba').startswith(f'{install.sys.executable} -m pip install ')


# --- what is not installed: fast methods do without, the others say in a line what they need


# As where only what apt has is installed.
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
    """Start a node without the packages that only general methods and the tool need."""
    return lambda node, *arguments: launch(BARE.format(node=node, others=OTHERS), *arguments)


def test_a_rope_is_caught_by_a_fast_method_without_any_of_it(bare):
    planner = bare('planner', {'odom_timeout': 60.0, 'goal_timeout': 60.0}, 'retrieval')
    sim = bare('sim', {'exit_when_done': True}, 'retrieval')
    assert sim.wait() == 0, sim.output + planner.output
    assert planner.stop() == 0
    assert 'planning' in planner.output
    assert 'Traceback' not in planner.output + sim.output


def test_a_general_method_says_in_a_line_what_it_needs(bare):
    planner = bare('planner', {}, 'dubins')
    assert planner.wait() == 2, planner.output
    said = planner.output.strip()
    assert said.startswith('clarabel: not installed; this problem takes a general method, which ')
    assert re.search(f'{INSTALL}clarabel$', said)


@pytest.mark.parametrize(
    ('name', 'line'),
    [
        ('rosbags.typesys', f'rosbags is missing: .*{INSTALL}rosbags$'),
        ('mcap', f'mcap is missing: .*{INSTALL}mcap$'),
        (
            'lifecycle_msgs.srv',
            'lifecycle_msgs is missing: install ROS 2, or .*pip install',
        ),
        ('orbimpc_ros.nowhere', ''),
        (None, ''),
    ],
)
def test_what_is_missing_is_said_with_the_way_to_get_it(name, line):
    found = in_a_line(ModuleNotFoundError(f'No module named {name!r}', name=name))
    assert re.match(line, found)
    assert bool(found) == bool(line)
