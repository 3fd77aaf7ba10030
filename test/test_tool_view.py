# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The viewer: what it draws of bags and live nodes, and what it refuses."""

import re
import signal
import socket
import subprocess
import time
from collections import defaultdict
from urllib.request import urlopen

import numpy as np
import pytest
from bags import GOLDEN
from harness import PATIENCE, TOOL, wait_for
from std_msgs.msg import Bool
from visualization_msgs.msg import MarkerArray

from orbimpc_ros.mpc.problem import Ball, Box
from orbimpc_ros.ros.messages import RED, SECOND, Frames, Stamp, marker, shown
from orbimpc_ros.tool import bags

view = pytest.importorskip('orbimpc_ros.tool.view', reason='needs the extra view')


class Drawing:
    """Stands in for a recording: keeps archetypes by entity and time."""

    def __init__(self):
        self.drawn, self.now, self.layouts = defaultdict(list), {}, 0

    def set_time(self, _timeline, **at):
        self.now = at

    def log(self, entity, *shown, static=False):
        self.drawn[entity].append(({} if static else self.now, shown))

    def send_blueprint(self, _layout):
        self.layouts += 1

    def numbers(self, entity, which, field, place=0):
        """Return a component of the ``which``-th log of an entity, as an array."""
        shown = self.drawn[entity][which][1][place]
        return np.array(getattr(shown, field).as_arrow_array().to_pylist())


# --- drawing


@pytest.fixture(scope='module')
def drawn():
    found = {}
    for name in ('retrieval', 'spacecraft', 'obstacles', 'fixed_wing'):
        messages = bags.of_vehicle(GOLDEN / name, '', view.Scene.topics)
        found[name] = Drawing(), messages
        scene = view.Scene(found[name][0])
        for each in messages:
            scene.take(each.topic, each.content)
        scene.take('captured', Bool(data=True))
    return found


def test_every_odometry_moves_the_vehicle_at_its_own_time(drawn):
    drawing, messages = drawn['retrieval']
    odometry = [each.content for each in messages if each.topic == 'odom']
    moves = drawing.drawn['world/vehicle']
    assert [at['duration'] for at, _ in moves] == [m.header.stamp.sec for m in odometry]
    for number, message in enumerate(odometry):
        place = message.pose.pose.position
        assert np.allclose(
            drawing.numbers('world/vehicle', number, 'translation')[0], [place.x, place.y, place.z]
        )


def test_every_part_is_drawn(drawn):
    for drawing, _ in drawn.values():
        for entity in ('world/flown', 'world/goal', 'world/plan', 'world/captured', 'tick'):
            assert drawing.drawn[entity], entity
        for entity in ('distance', 'speed', 'gap', 'solve_time_ms'):
            assert len(drawing.drawn[f'charts/{entity}']) > 10, entity
        assert drawing.layouts == 1


def test_obstacles_are_drawn_where_they_are():
    drawing, at = Drawing(), Stamp(SECOND, Frames())
    bodies = Box(np.array([1.0, -2.0, 0.0]), np.array([3.0, 2.0, 1.0])), Ball(np.ones(3), 0.5)
    told = [shown(marker(at, 'obstacles', k, 0, RED, 1.0), each) for k, each in enumerate(bodies)]
    view.Scene(drawing).take('plan_markers', MarkerArray(markers=told))
    for number, place, half in ((0, [2.0, 0.0, 0.5], [1.0, 2.0, 0.5]), (1, [1.0] * 3, [0.5] * 3)):
        entity = f'world/plan_markers/obstacles/{number}'
        assert np.allclose(drawing.numbers(entity, 0, 'centers'), place)
        assert np.allclose(drawing.numbers(entity, 0, 'half_sizes'), half)


def test_what_the_planner_would_refuse_is_not_drawn(drawn):
    _, messages = drawn['retrieval']
    hostile = [each.content for each in messages if each.topic == 'odom'][-1]
    hostile.pose.pose.position.x = float('nan')
    drawing = Drawing()
    scene = view.Scene(drawing)
    scene.take('odom', hostile)
    empty = next(each.content for each in messages if each.topic == 'tick')
    empty.status.clear()
    scene.take('tick', empty)
    assert not drawing.drawn['world/vehicle']


# --- the command


def test_a_port_that_is_taken_is_refused(tool):
    with socket.socket() as taken:
        taken.bind(('127.0.0.1', 0))
        taken.listen()
        port = taken.getsockname()[1]
        code, _, complaint = tool('view', GOLDEN / 'dubins', '--port', port)
    assert (code, complaint.count('\n')) == (2, 1)
    assert str(port) in complaint


# --- the page, and live nodes


class Served:
    """A running ``orbimpc view BAG`` and its page."""

    def __init__(self, bag):
        words = [*TOOL, 'view', str(bag), '--no-browser']
        self.process = subprocess.Popen(
            words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
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
    others = {'127.0.0.2'}  # this machine, at another address
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


def test_it_leaves_nothing_when_it_is_killed():
    serving = Served(GOLDEN / 'dubins')
    assert all(reachable('127.0.0.1', port) for port in serving.ports)
    serving.process.kill()
    serving.process.communicate()
    wait_for(lambda: not any(reachable('127.0.0.1', port) for port in serving.ports))


# --- live


def test_live_nodes_are_drawn_with_their_markers(launch, domain, monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    drawing, end = Drawing(), time.monotonic() + PATIENCE
    launch('planner', {'step': 0.2, 'floor.shape': 'polygon'})
    # No capture may end the flight while a busy machine is still discovering topics.
    launch('sim', {'step': 0.2, 'clock': 'wall', 'max_ticks': 500, 'capture_radius': 1e-6})
    found = drawing.drawn
    floor = 'world/plan_markers/floor/0'
    wanted = ('vehicle', 'goal', 'plan', 'world_markers/rope/0')

    def going():
        assert time.monotonic() < end, 'in vain'
        return not (found[floor] and all(len(found[f'world/{each}']) > 3 for each in wanted))

    view.draw_live(view.Scene(drawing), '', going)
    assert drawing.numbers(floor, 0, 'strips').shape == (4, 2, 3)  # a square
    at, _ = found['world/vehicle'][-1]
    assert abs(at['timestamp'] - time.time()) < 60.0, at
