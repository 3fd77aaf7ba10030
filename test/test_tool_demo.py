# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The demo as a newcomer runs it: real processes over DDS."""

import shutil
import signal
import subprocess
import sys
from collections import defaultdict

import numpy as np
import pytest
from bags import check_pictures, check_rollout
from harness import alive, children_of, wait_for
from rosbags.rosbag2 import Reader

from orbimpc_ros.tool import bags, cli, demo, history

pytest.importorskip('rclpy')
EVERY_TICK = ('odom', 'goal', 'cmd_vel', 'rotation', 'plan', 'plan_markers', 'tick')
LISTED = ('captured', 'cmd_thrust', 'goal_path', *EVERY_TICK)


def command(*words):
    return [sys.executable, '-m', 'orbimpc_ros.tool.cli', 'demo', *words]


def run(*words):
    return subprocess.run(command(*words), capture_output=True, text=True, check=False)


@pytest.fixture(scope='module')
def flown(tmp_path_factory):
    """Return the finished process of a demo and its folder."""
    out = tmp_path_factory.mktemp('demo')
    return run('retrieval', '--out', str(out)), out / 'retrieval'


def test_the_rope_is_caught(flown):
    done, folder = flown
    assert done.returncode == 0, done.stdout + done.stderr
    rows = [line.split(maxsplit=1) for line in done.stdout.splitlines()[1:]]
    paper = dict(rows[: rows.index(['first_pass:'])])
    assert paper['captured'].startswith('t = ')
    assert ['picture', str(folder / 'trajectory.png')] in rows
    assert ['bag', str(folder / 'bag')] in rows
    rows = paper
    assert rows['fallbacks'] == '0'
    for word in ('near misses', 'solve time    p50', 'worst gap'):
        assert word in done.stdout
    assert 'tick' in done.stderr
    check_pictures(folder, 'trajectory.png')


def test_the_same_rope_is_intercepted_on_the_first_pass(flown):
    _, folder = flown
    paper, other = (history.of_bag(folder / name / 'bag') for name in ('.', 'first_pass'))
    np.testing.assert_array_equal(other.ropes[:5], paper.ropes[:5])
    assert not other.near_misses
    assert other.capture.time - other.times[0] < 0.5 * (paper.capture.time - paper.times[0])


@pytest.mark.parametrize('flight', ['.', 'first_pass'])
def test_what_was_flown_over_dds_is_what_is_replayed(flown, capsys, flight):
    assert cli.main(['replay', str(flown[1] / flight / 'bag')]) == 0, capsys.readouterr().out


def test_a_retrieval_that_is_not_the_papers_is_flown_alone():
    assert len(demo.variants('retrieval', [])) == 2
    assert len(demo.variants('retrieval', ['rope.frequency=0.2'])) == 1


def test_the_bag_holds_every_topic_complete(flown):
    _, folder = flown
    stamps = defaultdict(set)
    for message in bags.read(folder / 'bag'):
        stamps[message.topic].add(message.stamp)
    for name in (*EVERY_TICK, 'clock'):
        assert stamps[f'/{name}'] == stamps['/odom'], name
    assert len(stamps['/odom']) > 5
    assert stamps['/captured']
    assert stamps['/diagnostics']
    with Reader(folder / 'bag') as reader:
        assert {f'/{name}' for name in LISTED} <= set(reader.topics)


def test_every_plan_is_what_is_flown(flown):
    _, folder = flown
    check_rollout(folder)


def test_what_is_not_caught_is_a_failure_with_a_bag(tmp_path):
    done = run('--out', str(tmp_path), '--set', 'max_ticks=2')
    assert done.returncode == 1
    assert 'captured      no' in done.stdout
    assert 'Traceback' not in done.stderr
    assert len([m for m in bags.read(tmp_path / 'retrieval' / 'bag') if m.topic == '/tick']) == 3


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_demo_leaves_a_readable_bag_and_no_process(tmp_path, number):
    # In real time the flight takes many seconds: there is time to break in.
    words = ('--out', str(tmp_path), '--set', 'clock=wall')
    child = subprocess.Popen(command(*words), stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    wait_for(lambda: (tmp_path / 'retrieval' / 'bag').exists() and len(children_of(child.pid)) == 2)
    nodes = children_of(child.pid)
    child.send_signal(number)
    _, err = child.communicate(timeout=20)
    assert child.returncode != 0
    assert b'Traceback' not in err
    assert isinstance(list(bags.read(tmp_path / 'retrieval' / 'bag')), list)
    assert not [pid for pid in nodes if alive(pid)]


def test_a_node_that_fails_is_shown(tmp_path):
    script = (
        'import orbimpc_ros.tool.run.processes as p, sys;'
        'start = p.Process.__init__;'
        'p.Process.__init__ = lambda self, module, *a, **k: start(self, module + "x", *a, **k);'
        'from orbimpc_ros.tool import cli; sys.exit(cli.main(sys.argv[1:]))'
    )
    words = [sys.executable, '-c', script, 'demo', '--out', str(tmp_path)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert 'No module named' in done.stderr
    assert 'orbimpc: ' in done.stderr
    assert 'tool/cli.py' not in done.stderr  # the node's own traceback, not the tool's


@pytest.mark.skipif(shutil.which('prlimit') is None, reason='no prlimit: apt install util-linux')
def test_a_disk_that_is_full_fails_the_job_in_one_line(tmp_path):
    """A limit on the size of files stands for the disk: the bag is larger than that."""
    done = subprocess.run(
        ['prlimit', '--fsize=40000', *command('retrieval', '--out', str(tmp_path))],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == f'orbimpc: {tmp_path}/retrieval: file too large'
    assert 'Traceback' not in done.stderr


def test_no_home_folder_is_needed(tmp_path, monkeypatch):
    monkeypatch.setenv('HOME', '/proc/nobody')
    for name in ('ROS_LOG_DIR', 'ROS_HOME'):
        monkeypatch.delenv(name, raising=False)
    done = run('retrieval', '--set', 'max_ticks=2', '--out', str(tmp_path))
    assert 'Traceback' not in done.stderr
    assert 'captured      no' in done.stdout
    assert list((tmp_path / 'retrieval' / 'log').iterdir())


def test_results_are_never_overwritten(tmp_path):
    names = [demo.new_folder(str(tmp_path / 'new'), 'retrieval').name for _ in range(3)]
    assert names == ['retrieval', 'retrieval-2', 'retrieval-3']
