# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The lander's demo, end to end over DDS."""

import re
import subprocess
import sys

import numpy as np
import pytest
from bags import check_pictures, messages_of

pytest.importorskip('rclpy', reason='needs ROS 2, or pip install orbimpc_ros[ros]')


def test_the_lander_touches_down(tmp_path):
    command = [sys.executable, '-m', 'orbimpc_ros.tool.cli', 'demo', 'lander', '--out']
    done = subprocess.run([*command, str(tmp_path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r'arrived +yes', done.stdout)
    folder = tmp_path / 'lander'
    found = messages_of(folder)
    forces = [message.wrench.force for message in found['cmd_thrust'].values()]
    flown = np.array([(force.x, force.z) for force in forces][:-1])
    assert not flown[:, 0].any()
    assert flown[:, 1].min() >= 0.3 * 3.6 * 500.0 * (1.0 - 1e-6)
    check_pictures(folder, 'trajectory.png', 'data.png')
