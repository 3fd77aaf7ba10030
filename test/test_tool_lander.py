# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The lander's demo, end to end over DDS, and its figure."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from bags import check_pictures, messages_of

pytest.importorskip('rclpy', reason='needs ROS 2, or pip install orbimpc_ros[ros]')

from orbimpc_ros.tool import figures, history

GOLDEN = Path(__file__).parent / 'golden'


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


@pytest.mark.parametrize('dark', [False, True])
def test_a_descent_is_drawn_with_its_limits(dark):
    flown = history.of_bag(GOLDEN / 'lander')
    drawn = figures.of_runs({'': flown}, dark)
    assert set(drawn) == {'trajectory.png', 'data.png'}
    figure = drawn['trajectory.png']
    words = {text.get_text() for legend in figure.legends for text in legend.get_texts()}
    words |= {
        text.get_text()
        for axes in figure.axes
        if axes.get_legend() is not None
        for text in axes.get_legend().get_texts()
    }
    assert {
        'flown path',
        'glide slope',
        'pad',
        'least: 0.3',
        'most: 15°',
        'glide slope 50°',
    } <= words
    side = figure.axes[-1].get_lines()[0]
    away = flown.positions - flown.ropes
    assert np.allclose(side.get_xdata(), np.hypot(away[:, 0], away[:, 1]))
    assert 'Lander' in figure.get_suptitle()
