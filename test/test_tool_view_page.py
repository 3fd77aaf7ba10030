# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The viewer's page, served to this machine alone, and live nodes drawn."""

import re
import signal
import socket
import subprocess
import sys
import time
from urllib.request import urlopen

import pytest
from drawing import GOLDEN, INSTALL, Drawing, needs_rerun

from orbimpc_ros.tool import view


class Served:
    """A running ``orbimpc view BAG`` and its page."""

    def __init__(self, bag):
        words = ['-m', 'orbimpc_ros.tool.cli', 'view', str(bag), '--no-browser']
        self.process = subprocess.Popen(
            [sys.executable, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.line = self.process.stdout.readline()
        self.page = re.search(r'http://\S+', self.line)[0]
        self.ports = [int(port) for port in re.findall(r'127\.0\.0\.1(?::|%3A)(\d+)', self.page)]

    def stop(self):
        self.process.send_signal(signal.SIGINT)
        out, err = self.process.communicate(timeout=30)
        return self.process.returncode, out, err


@pytest.fixture(scope='module')
def served():
    if not view.installed():
        pytest.skip(f'needs rerun-sdk: {INSTALL}')
    serving = Served(GOLDEN / 'retrieval')
    yield serving
    if serving.process.poll() is None:
        serving.stop()


def reachable(host, port):
    with socket.socket() as probe:
        probe.settimeout(2.0)
        return probe.connect_ex((host, port)) == 0


def test_page_program_and_data_come_from_this_machine(served):
    with urlopen(served.page) as answer:
        page = answer.read().decode()
    assert 'Rerun' in page
    root = f'http://127.0.0.1:{served.ports[0]}'
    with urlopen(f'{root}/re_viewer_bg.wasm') as answer:
        assert answer.read(4) == b'\0asm'
    assert all(reachable('127.0.0.1', port) for port in served.ports)


def test_nobody_else_can_reach_it(served):
    others = {'127.0.0.2'}  # also this machine, but another address of it
    others |= {
        info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)
    }
    assert len(served.ports) == 2
    for host in others - {'127.0.0.1'}:
        assert not any(reachable(host, port) for port in served.ports), host


def test_it_ends_in_order_and_leaves_nothing(served):
    code, _, err = served.stop()
    assert (code, err) == (0, '')
    assert not any(reachable('127.0.0.1', port) for port in served.ports)


@needs_rerun
def test_it_leaves_nothing_when_it_is_killed():
    serving = Served(GOLDEN / 'dubins')
    assert all(reachable('127.0.0.1', port) for port in serving.ports)
    serving.process.kill()
    serving.process.communicate()
    end = time.monotonic() + 20.0
    while any(reachable('127.0.0.1', port) for port in serving.ports):
        assert time.monotonic() < end
        time.sleep(0.1)


# --- live


@needs_rerun
def test_live_nodes_are_drawn_with_their_parameters(launch, domain, monkeypatch):
    pytest.importorskip('rclpy')
    from orbimpc_ros.tool.view.live import Watcher

    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    drawing = Drawing()
    watcher = Watcher('', drawing)
    try:
        launch('planner', {'step': 0.2, 'floor.shape': 'polygon'})
        launch('sim', {'step': 0.2, 'clock': 'wall', 'max_ticks': 500})
        found = drawing.drawn
        wanted = ('world/vehicle', 'world/goal', 'world/plan', 'thrust/plan', 'tick')
        spin_until(watcher, lambda: all(len(found[each]) > 3 for each in wanted))
        # The floor is empty until the planner has answered what its parameters are.
        square = (4, 2, 3)
        spin_until(
            watcher,
            lambda: (
                found['thrust/floor']
                and drawing.numbers('thrust/floor', -1, 'strips').shape == square
            ),
        )
    finally:
        watcher.close()
    at, _ = found['world/vehicle'][-1]
    assert abs(at['timestamp'] - time.time()) < 60.0, at


def spin_until(watcher, happened):
    end = time.monotonic() + 40.0
    while not happened():
        assert time.monotonic() < end
        watcher.spin()
