# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A node as a process: failing callbacks and starts, signals at any time, hanging shutdowns."""

import re
import signal
import subprocess
import sys

import pytest
from harness import ROOT, python, run

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.entry import PACKAGES
from orbimpc_ros.ros.parameters.planner import PLANNER
from orbimpc_ros.ros.process import executor_named
from orbimpc_ros.sim.parameters import SIM

FILE = '--ros-args', '--params-file'
BROKEN = """
    import sys, time
    from types import SimpleNamespace
    from rclpy.impl.implementation_singleton import rclpy_implementation
    from std_msgs.msg import Bool
    from orbimpc_ros.mpc.errors import BadInput
    from orbimpc_ros.ros import process
    from orbimpc_ros.ros.process import Managed

    class Broken(Managed):
        kind, specs = 'broken', ()
        settings_of = lambda _node, _: SimpleNamespace(autostart=True, executor='wait_set')

        def configure(self):
            self.create_publisher(Bool, 'one', 1)
            print('begins', flush=True)
            if {refused}:
                raise BadInput('mass', 0, '1')

        def trigger_configure(self):
            super().trigger_configure()
            if {refused}:
                raise rclpy_implementation.RCLError('cannot publish data')

        def destroy_node(self):
            print('destroyed', self.context.ok())
            time.sleep({hanging})
            raise rclpy_implementation.RCLError('cannot delete data')

    process.LAST_RESORT = process.LAST_RESORT if {hanging} == 0.0 else 1.0
    sys.exit(process.run(Broken))
"""


def test_a_start_broken_off_is_cleared_away_and_says_why():
    """Despite further errors meanwhile, and before the context is shut down."""
    done = python(BROKEN.format(refused=True, hanging=0.0))
    expected = (2, 'begins\ndestroyed True\n', 'mass is 0; allowed: 1\n')
    assert (done.returncode, done.stdout, done.stderr) == expected


@pytest.mark.parametrize('refused', [False, True])
def test_a_node_that_hangs_at_its_end_is_ended_and_says_where(launch, observer, refused):
    node = launch(BROKEN.format(refused=refused, hanging=1000.0))
    observer.until(lambda: 'begins' in node.output, 'its begin')
    if not refused:
        node.send_signal(signal.SIGTERM)
    assert node.wait() == 1
    assert 'in destroy_node' in node.output


@pytest.mark.parametrize(
    ('node', 'words', 'said'),
    [
        ('planner', ['--params-file', 'x.yaml'], 'x.yaml must follow --ros-args; allowed: --ros'),
        ('sim', ['--ros-args', '-p', 'step:=0.1', '--', 'boat.yaml'], 'boat.yaml'),
        ('sim', [*FILE, 'x.yaml'], '^x.yaml: unreadable; No such file'),
        ('sim', ['--ros-args', '--params', 'x.yaml'], '--params x.yaml; allowed: .* --params-file'),
        ('planner', [*FILE, f'{ROOT}/Makefile'], 'Makefile: unreadable; .* line [0-9]+'),
        ('planner', [*FILE, f'{ROOT}/config/studies/paper.yaml'], 'not a parameter file; '),
    ],
)
def test_words_that_nobody_would_look_at_are_refused_in_one_line(node, words, said, monkeypatch):
    monkeypatch.delenv('HOME')  # as for a service of systemd
    done = run(sys.executable, '-m', PACKAGES[node], *words)
    assert done.returncode == 2
    assert done.stderr.count('\n') == 1, done.stderr
    assert re.search(said, done.stderr), done.stderr


@pytest.mark.parametrize(('node', 'rows'), [('planner', PLANNER), ('sim', SIM)])
def test_help_has_every_parameter_and_the_exit_codes_within_80_columns(node, rows):
    lines = run(sys.executable, '-m', PACKAGES[node], '--help').stdout.splitlines()
    assert max(map(len, lines)) <= 80
    assert {row.name for row in rows} <= {line.split()[0] for line in lines if line.strip()}
    assert any(line.startswith('exit codes: 0 ') for line in lines)


# Background jobs of a shell, and all their children, ignore SIGINT.
BACKGROUND = ('sh', '-c', 'trap "" INT; exec "$@"', 'sh')


@pytest.mark.parametrize(
    ('node', 'imported'),
    [
        *(('planner', each) for each in ('numpy', 'orbimpc_ros.ros.parameters')),
        ('sim', 'orbimpc_ros.ros.parameters'),
    ],
)
def test_a_signal_during_the_start_ends_it_without_a_word(node, imported):
    """It is sent at an import (``-X importtime``); the last one precedes the node's own start."""
    script = f'import sys; from orbimpc_ros.ros.entry import {node}; sys.exit({node}())'
    words = [*BACKGROUND, sys.executable, '-X', 'importtime', '-c', script]
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as starting:
        said = []
        for line in starting.stderr:
            said.append(line)
            if line.rpartition('|')[2].strip() == imported:
                starting.send_signal(signal.SIGINT)
        assert starting.wait() == 0
    others = [line for line in said if not line.startswith('import time:')]
    assert others == []


def test_an_executor_that_is_not_there_is_refused_in_a_line(monkeypatch):
    monkeypatch.setitem(sys.modules, 'rclpy.experimental.events_executor', None)
    with pytest.raises(BadInput, match='executor is events; allowed: wait_set'):
        executor_named('events')


WITHOUT_ROS = """
    import sys
    import pytest

    sys.modules['rclpy'] = None
    sys.exit(pytest.main(sys.argv[1:]))
"""


def test_without_ros_what_needs_it_is_skipped_and_the_rest_is_tested():
    words = '--collect-only', '-rs', 'test/test_ros_path.py', 'test/test_mpc_geometry.py'
    done = python(WITHOUT_ROS, *words, cwd=ROOT)
    assert done.returncode == 0, done.stdout + done.stderr
    assert 'test_mpc_geometry.py::test_' in done.stdout
    assert 'needs ROS 2, or pip install' in done.stdout
