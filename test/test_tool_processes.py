# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Processes that the tool has started end with it, whatever it ignores and however it ends."""

import os
import random
import signal
import subprocess
import sys
import textwrap

import pytest
from harness import PATIENCE, alive, wait_for

from orbimpc_ros.ros.entry import PACKAGES

pytest.importorskip('rclpy')

STARTER = """
    import sys, time
    from pathlib import Path
    from orbimpc_ros.tool.run.processes import Process

    folder = Path(sys.argv[1])
    (folder / 'none.yaml').write_text('/**: {ros__parameters: {}}')
    node = Process(sys.argv[2], folder / 'none.yaml', folder / 'node.log', int(sys.argv[3]))
    print(node.pid, flush=True)
    time.sleep(600)
"""
RUNS = {'planner': 'waits for odometry', 'sim': 'waits for'}  # what it says once it is up


@pytest.fixture
def started(tmp_path, domain):
    """Return a function that starts who starts a node, in a shell that ignores SIGINT."""
    script = tmp_path / 'starter.py'
    script.write_text(textwrap.dedent(STARTER))
    starters = []

    def start(node):
        words = [sys.executable, str(script), str(tmp_path), PACKAGES[node], str(domain)]
        starter = subprocess.Popen(
            ['sh', '-c', 'trap "" INT; exec "$@"', 'sh', *words], stdout=subprocess.PIPE, text=True
        )
        starters.append(starter)
        return starter, int(starter.stdout.readline()), tmp_path / 'node.log'

    yield start
    for starter in starters:
        starter.kill()
        starter.wait(PATIENCE)
        starter.stdout.close()


@pytest.mark.parametrize('node', RUNS)
def test_a_node_ends_when_who_started_it_is_killed(started, node):
    starter, pid, log = started(node)
    wait_for(lambda: RUNS[node] in log.read_text())
    starter.kill()
    wait_for(lambda: not alive(pid))
    assert 'received SIGTERM, stopping' in log.read_text()


@pytest.mark.parametrize('node', RUNS)
def test_a_node_that_has_hardly_begun_ends_too(started, node):
    starter, pid, log = started(node)
    starter.kill()
    wait_for(lambda: not alive(pid))
    assert 'Traceback' not in log.read_text()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_node_obeys_whatever_was_ignored_when_it_was_started(started, number):
    _, pid, log = started('sim')
    wait_for(lambda: RUNS['sim'] in log.read_text())
    os.kill(pid, number)
    wait_for(lambda: not alive(pid))
    assert f'received {number.name}, stopping' in log.read_text()


def test_a_domain_belongs_to_who_claims_it_first_until_that_process_ends(domain):
    script = 'import sys; from orbimpc_ros.tool.run.discovery import claimed'
    script += '; print(claimed(int(sys.argv[1])), flush=True); input()'

    def claim(number):
        words = [sys.executable, '-c', script, str(number)]
        process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        return process, process.stdout.readline()

    # Beyond those that tests draw from; another suite on this machine may be at this very test.
    theirs = random.randrange(102, 230)
    holder, answer = claim(theirs)
    assert answer == 'True\n'
    answers = [claim(theirs), claim(domain)]
    assert [answer for _, answer in answers] == ['False\n', 'False\n']
    holder.communicate('\n')
    later = claim(theirs)
    assert later[1] == 'True\n'
    for process, _ in (*answers, later):
        process.communicate('\n')
