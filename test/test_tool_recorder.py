# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A recorder that is told to stop, or killed: what it heard is there, and can be read."""

import os
import signal
import struct
import subprocess
import sys
import textwrap
import time

import numpy as np
import pytest

pytest.importorskip('rclpy')

from nav_msgs.msg import Odometry

from orbimpc_ros.ros.messages import SECOND, header
from orbimpc_ros.ros.process import qos
from orbimpc_ros.tool import bags
from orbimpc_ros.tool.run.recorder import Recorder, carried
from orbimpc_ros.tool.topics import topics_of

PATIENCE = 20.0  # [s]
KIND = 'nav_msgs/msg/Odometry'
SCRIPT = """
    import sys
    from pathlib import Path
    from orbimpc_ros.tool.run.processes import Interruptions
    from orbimpc_ros.tool.run.recorder import Recorder
    from orbimpc_ros.tool.topics import topics_of

    with Interruptions() as interruptions:
        recorder = Recorder(Path(sys.argv[1]), topics_of(), {'parameters': '{}'}, planners=())
        while not interruptions.requested:
            recorder.spin(0.05)
        recorder.close()
"""


@pytest.fixture
def recorder(domain, tmp_path):
    """Return a recorder in a process of its own."""
    command = [sys.executable, '-c', textwrap.dedent(SCRIPT), str(tmp_path / 'bag')]
    process = subprocess.Popen(command, env={**os.environ, 'ROS_DOMAIN_ID': str(domain)})
    yield process
    process.kill()
    process.wait()


@pytest.fixture
def told(recorder, observer, tmp_path):
    """Return how many odometry messages were sent and are, but for the last, on the disk."""
    publisher = observer.node.create_publisher(Odometry, '/odom', qos(1000))
    observer.until(lambda: publisher.get_subscription_count() > 0, 'the recorder')
    count, draw = 600, np.random.default_rng(1)
    for k in range(count):
        message = Odometry(header=header(k * SECOND // 100, 'odom'))
        message.pose.covariance = draw.normal(size=36)
        publisher.publish(message)
    file = tmp_path / 'bag' / 'bag.mcap'
    observer.until(lambda: file.stat().st_size > 100_000, 'chunks on the disk')
    return count


def test_after_sigterm_the_bag_is_closed_and_whole(recorder, told, tmp_path, capsys):
    recorder.send_signal(signal.SIGTERM)
    assert recorder.wait(PATIENCE) == 0
    stamps = [message.stamp for message in bags.read(tmp_path / 'bag')]
    assert capsys.readouterr().err == ''
    assert stamps == sorted(stamps)
    assert told // 2 < len(stamps) <= told
    assert bags.notes(tmp_path / 'bag') == {'parameters': '{}'}


def test_after_sigkill_the_bag_is_read_up_to_its_last_chunk(recorder, told, tmp_path, capsys):
    recorder.kill()
    recorder.wait(PATIENCE)
    stamps = [message.stamp for message in bags.read(tmp_path / 'bag')]
    err = capsys.readouterr().err
    assert err.count('\n') == 1
    assert f'was not closed: read up to its last chunk, {len(stamps)} messages' in err
    assert stamps == [k * SECOND // 100 for k in range(len(stamps))]
    assert told // 2 < len(stamps) <= told
    assert bags.notes(tmp_path / 'bag') == {'parameters': '{}'}
    words = [sys.executable, '-m', 'orbimpc_ros.tool.cli', 'replay', str(tmp_path / 'bag')]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert 'without /goal or /goal_path' in done.stderr


def test_the_order_of_sending_is_kept(domain, observer, tmp_path, monkeypatch):
    """Stamps may lie; when a message was sent tells the order."""
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    recorder = Recorder(tmp_path / 'bag', topics_of(), {}, planners=())
    publisher = observer.node.create_publisher(Odometry, '/odom', qos(1000))
    recorder.spin(0.0)  # asks for odometry
    observer.until(lambda: publisher.get_subscription_count() > 0, 'the recorder')
    stamps, begun = [10, 12, 11, 11, 13], time.time_ns()
    for stamp in stamps:
        publisher.publish(Odometry(header=header(stamp * SECOND, 'odom')))
    end = time.monotonic() + PATIENCE
    while recorder.counts['/odom'] < len(stamps) and time.monotonic() < end:
        recorder.spin(0.1)
    recorder.close()
    found = sorted(bags.read(tmp_path / 'bag'), key=lambda message: message.sent)
    assert [message.content.header.stamp.sec for message in found] == stamps
    assert [message.stamp // SECOND for message in found] == stamps
    assert all(begun <= message.sent <= time.time_ns() for message in found)


# --- stamps


def stamped(seconds, nanoseconds=0):
    return b'\x00\x01\x00\x00' + struct.pack('<iI', seconds, nanoseconds) + bytes(8)


@pytest.mark.parametrize(
    ('data', 'kind', 'stamp'),
    [
        (stamped(5, 7), KIND, 5 * SECOND + 7),
        (
            stamped(5, 7)[:4] + bytes(4) + stamped(5, 7)[4:],
            'visualization_msgs/msg/MarkerArray',
            5 * SECOND + 7,
        ),
        (stamped(5), 'std_msgs/msg/Bool', None),
        (stamped(-1), KIND, None),
        (stamped(3, SECOND), KIND, None),
        (b'\x00\x01\x00\x00', KIND, None),
        (b'', KIND, None),
    ],
)
def test_a_message_goes_under_the_stamp_it_carries_if_that_is_one(data, kind, stamp):
    assert carried(data, kind) == stamp
