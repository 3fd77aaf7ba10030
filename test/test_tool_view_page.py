# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The viewer's page: served to this machine alone, seen in a browser; and live nodes drawn."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from urllib.request import urlopen

import browser
import numpy as np
import pytest
from drawing import GOLDEN, INSTALL, Drawing, needs_rerun

from orbimpc_ros.tool import view

needs_chromium = pytest.mark.skipif(
    browser.find() is None, reason='needs a Chromium: apt install chromium, or CHROMIUM=its path'
)


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


@needs_chromium
def test_a_person_sees_the_flight(served, tmp_path):
    """Waits until every view shows its colours; keeps the picture when SCREENSHOT names a file."""
    page = browser.Browser(tmp_path, 1600, 900)
    try:
        page.open(f'{served.page}&theme=light')
        picture = awaited(page)
    finally:
        page.close()
    if 'SCREENSHOT' in os.environ:
        browser.Image.fromarray(picture).save(os.environ['SCREENSHOT'])
    assert missing(picture) == {}


# What must be seen where: shares of width and height, colour, least number of pixels.
LEFT, RIGHT = (0.0, 0.6), (0.6, 1.0)
UPPER, LOWER = (0.06, 0.73), (0.75, 0.96)
SEEN = {
    'flown path': (LEFT, UPPER, '#56B4E9', 500),
    'plan': (LEFT, UPPER, '#009E73', 100),
    'rope': (LEFT, UPPER, '#E69F00', 200),
    'hull': (RIGHT, UPPER, '#8C8C8C', 300),
    'floor': (RIGHT, UPPER, '#D55E00', 500),
    'thrust': (RIGHT, UPPER, '#009E73', 200),
    'distance and speed': (LEFT, LOWER, '#0072B2', 300),
    'floor of the speed': (LEFT, LOWER, '#D55E00', 60),
    'gap': (RIGHT, LOWER, '#009E73', 100),
    'solve time': (RIGHT, LOWER, '#E69F00', 50),
}


def missing(picture):
    """Return what is not seen, and how many pixels of its colour there are."""
    height, width, _ = picture.shape
    found = {}
    for name, (across, down, color, least) in SEEN.items():
        left, right = (int(width * share) for share in across)
        top, bottom = (int(height * share) for share in down)
        wanted = np.frombuffer(bytes.fromhex(color[1:]), dtype=np.uint8).astype(int)
        apart = np.abs(picture[top:bottom, left:right].astype(int) - wanted).max(axis=2)
        count = int((apart < 48).sum())
        if count < least:
            found[name] = count
    return found


def awaited(page):
    """Return the first picture that shows everything, or the last one before patience ends."""
    end = time.monotonic() + 300.0  # drawn by a processor, next to whatever else keeps it busy
    while True:
        picture = page.picture()
        if not missing(picture) or time.monotonic() > end:
            return picture
        time.sleep(0.5)


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
    watcher = Watcher('', lambda: drawing)
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
