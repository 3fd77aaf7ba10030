# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Processes started by the tool, and its recorder: how they end, and what they keep."""

import os
import random
import signal
import subprocess
import sys
import textwrap
import time
from contextlib import closing

import pytest
from bags import read
from harness import PATIENCE, alive, wait_for
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool
from visualization_msgs.msg import Marker, MarkerArray

from orbimpc_ros.ros import messages
from orbimpc_ros.ros.entry import PACKAGES
from orbimpc_ros.ros.messages import SECOND, header
from orbimpc_ros.ros.process import qos
from orbimpc_ros.ros.topics import topics_of
from orbimpc_ros.tool.demo import Recorder
from orbimpc_ros.tool.processes import interruptions

STARTER = """
    import os, sys, time
    from pathlib import Path
    from orbimpc_ros.tool.processes import Processes

    folder = Path(sys.argv[1])
    file, log = folder / 'none.yaml', folder / 'node.log'
    file.write_text('/**: {ros__parameters: {}}')
    os.environ['ROS_DOMAIN_ID'] = sys.argv[3]
    node = Processes().start(sys.argv[2], file, log)
    print(node.pid, flush=True)
    time.sleep(600)
"""
RUNS = {'planner': 'waits for odometry', 'sim': 'waits for'}  # output once a node is up


@pytest.fixture
def started(tmp_path, domain):
    """Return a function that runs a starter of a node, in a shell that ignores SIGINT."""
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
@pytest.mark.parametrize('begun', [True, False])
def test_a_node_ends_when_who_started_it_is_killed(started, node, begun):
    starter, pid, log = started(node)
    time.sleep(0.3)  # until it is tethered to its starter
    wait_for(lambda: not begun or RUNS[node] in log.read_text())
    starter.kill()
    wait_for(lambda: not alive(pid))
    assert 'Traceback' not in log.read_text()
    assert not begun or 'received SIGTERM, stopping' in log.read_text()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_node_obeys_whatever_was_ignored_when_it_was_started(started, number):
    _, pid, log = started('sim')
    wait_for(lambda: RUNS['sim'] in log.read_text())
    os.kill(pid, number)
    wait_for(lambda: not alive(pid))
    assert f'received {number.name}, stopping' in log.read_text()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_run_is_told_of_a_signal_and_not_interrupted(number):
    with interruptions() as received:
        os.kill(os.getpid(), number)
    assert received == [number]


def test_a_domain_belongs_to_who_claims_it_first_until_that_process_ends(domain):
    script = 'import sys; from orbimpc_ros.tool.processes import claimed'
    script += '; print(claimed(int(sys.argv[1])), flush=True); input()'

    def claim(number):
        words = [sys.executable, '-c', script, str(number)]
        process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        return process, process.stdout.readline()

    # Not a domain of other tests; random, as another suite may be running this very test.
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


# --- the recorder


def test_the_order_of_sending_is_kept(domain, observer, tmp_path, monkeypatch):
    """Stamps need not increase; the time of sending gives the order."""
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    stamps, begun = [10, 12, 11, 11, 13], time.time_ns()
    with closing(Recorder(tmp_path / 'bag', topics_of(), {'parameters': '{}'}, ())) as recorder:
        publisher = observer.node.create_publisher(Odometry, '/odom', qos(1000))
        recorder.spin(0.0)  # subscribes to odometry
        observer.until(publisher.get_subscription_count, 'the recorder')
        for stamp in stamps:
            publisher.publish(Odometry(header=header(stamp * SECOND, 'odom')))
        wait_for(lambda: recorder.spin(0.1) or recorder.counts['/odom'] >= len(stamps))
    found = sorted(read(tmp_path / 'bag'), key=lambda message: message.sent)
    assert [message.content.header.stamp.sec for message in found] == stamps
    assert [message.stamp // SECOND for message in found] == stamps
    assert all(begun <= message.sent <= time.time_ns() for message in found)


# --- stamps


def stamped(seconds, nanoseconds=0):
    found = Odometry()
    found.header.stamp.sec, found.header.stamp.nanosec = seconds, nanoseconds
    return found


@pytest.mark.parametrize(
    ('message', 'stamp'),
    [
        (stamped(5, 7), 5 * SECOND + 7),
        (MarkerArray(markers=[Marker(header=stamped(5, 7).header)]), 5 * SECOND + 7),
        (Clock(clock=stamped(5, 7).header.stamp), 5 * SECOND + 7),
        (MarkerArray(), messages.UNDATED),
        (Bool(), messages.UNDATED),
        (stamped(-1), messages.UNDATED),
        (stamped(3, SECOND), messages.UNDATED),
    ],
)
def test_a_message_goes_under_the_stamp_it_carries_if_that_is_one(message, stamp):
    assert messages.stamp_of(message) == stamp
