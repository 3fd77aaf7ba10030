"""The viewer: what it draws of a bag and of live nodes, what it serves, and what is seen."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections import defaultdict
from pathlib import Path
from urllib.request import urlopen

import browser
import numpy as np
import pytest

from orbimpc_ros.tool import cli, view

GOLDEN = Path(__file__).parent / 'golden'
INSTALL = "pip install 'orbimpc_ros[view]', or with numpy 1 as docs/look.md says"
needs_rerun = pytest.mark.skipif(not view.installed(), reason=f'needs rerun-sdk: {INSTALL}')
needs_chromium = pytest.mark.skipif(
    browser.find() is None, reason='needs a Chromium: apt install chromium, or CHROMIUM=its path'
)


@needs_rerun
@pytest.mark.parametrize('dimension', [2, 3])
def test_the_eye_sees_what_it_is_to_see(dimension):
    from orbimpc_ros.tool.view.layout import OPENING, eye

    rng = np.random.default_rng(dimension)
    points = rng.normal(scale=5.0, size=(20, 3)) * ([1, 1, 0] if dimension == 2 else [1, 1, 1])
    seen = eye(dimension, points)
    ray, ahead = points - seen.position, seen.target - seen.position
    cosines = ray @ ahead / np.linalg.norm(ray, axis=1) / np.linalg.norm(ahead)
    assert np.degrees(np.arccos(cosines)).max() <= 1.2 * np.degrees(OPENING)
    assert abs(seen.up @ ahead) < np.linalg.norm(ahead)


# --- drawing


class Drawing:
    """Takes what is drawn in the place of a recording: archetypes by entity and time."""

    def __init__(self):
        self.drawn, self.now, self.layouts = defaultdict(list), {}, 0

    def set_time(self, _timeline, **at):
        self.now = at

    def log(self, entity, *shown, static=False):
        self.drawn[entity].append(({} if static else self.now, shown))

    def send_blueprint(self, _layout):
        self.layouts += 1

    def flush(self):
        pass

    def numbers(self, entity, which, field, place=0):
        """Return a component of what was drawn ``which``-th, as an array."""
        shown = self.drawn[entity][which][1][place]
        return np.array(getattr(shown, field).as_arrow_array().to_pylist())


@pytest.fixture(scope='module')
def drawn():
    pytest.importorskip('rerun', reason=INSTALL)
    from orbimpc_ros.tool.view import recorded

    found = {}
    for name in ('retrieval', 'spacecraft', 'obstacles'):
        flight = recorded.read(GOLDEN / name, '')
        found[name] = Drawing(), flight
        flight.draw(found[name][0])
    return found


def test_every_odometry_moves_the_vehicle_at_its_own_time(drawn):
    drawing, flight = drawn['retrieval']
    odometry = [content for topic, content in flight.messages if topic == 'odom']
    moves = drawing.drawn['world/vehicle']
    assert [at['duration'] for at, _ in moves] == [m.header.stamp.sec for m in odometry]
    for number, message in enumerate(odometry):
        place = message.pose.pose.position
        assert np.allclose(
            drawing.numbers('world/vehicle', number, 'translation')[0], [place.x, place.y, place.z]
        )


def test_thrust_points_are_the_steps_of_the_plan(drawn):
    drawing, flight = drawn['retrieval']
    plans = [content for topic, content in flight.messages if topic == 'plan']
    assert len(drawing.drawn['thrust/plan']) == len(plans) > 10
    full = flight.values['forward'] * flight.values['step']
    for number, plan in enumerate(plans):
        places = [each.pose.position for each in plan.poses]
        steps = np.diff([[p.x, p.y, p.z] for p in places], axis=0) / full
        points = drawing.numbers('thrust/plan', number, 'positions')
        assert np.allclose(points[:-1], steps, atol=1e-6)
        assert (np.linalg.norm(points, axis=1) <= 1.0 + 1e-6).all()


def test_every_part_is_drawn(drawn):
    for drawing, flight in drawn.values():
        for entity in ('world/flown', 'world/goal', 'world/plan', 'thrust/hull', 'tick'):
            assert drawing.drawn[entity], entity
        for entity in ('distance/to_goal', 'speed/commanded', 'gap/log10', 'time/solve_ms'):
            assert len(drawing.drawn[entity]) > 10, entity
        assert bool(drawing.drawn['speed/floor'][1:]) == (flight.values['floor.shape'] != 'none')
        assert drawing.layouts == 2  # at once, and with the right view when it is known


def test_obstacles_are_drawn_where_they_are(drawn):
    drawing, flight = drawn['obstacles']
    low, high = np.reshape(flight.values['obstacles'], (-1, 2, 2)).transpose(1, 0, 2)
    centers = drawing.numbers('world/obstacles', 0, 'centers')
    halves = drawing.numbers('world/obstacles', 0, 'half_sizes')
    assert np.allclose((centers - halves)[:, :2], low)
    assert np.allclose((centers + halves)[:, :2], high)


@pytest.mark.parametrize('first', ['goal', 'odom'])
def test_distances_are_those_of_one_moment(drawn, first):
    from orbimpc_ros.tool.view.scene import Scene

    _, flight = drawn['retrieval']
    told = {name: [m for topic, m in flight.messages if topic == name] for name in ('odom', 'goal')}
    drawing = Drawing()
    scene = Scene(drawing, flight.values)
    for odometry, goal in zip(told['odom'], told['goal'], strict=True):
        both = [('odom', odometry), ('goal', goal)]
        for topic, message in both if first == 'odom' else both[::-1]:
            scene.take(topic, message)
    found = [drawing.numbers('distance/to_goal', k, 'scalars')[0] for k in range(1, 27)]
    pairs = [(o.pose.pose.position, g.pose.position) for o, g in zip(*told.values(), strict=True)]
    assert np.allclose(found, [np.hypot(o.x - g.x, o.y - g.y) for o, g in pairs])


def test_the_goal_leaves_a_trail(drawn):
    drawing, flight = drawn['retrieval']
    goals = [m.pose.position for topic, m in flight.messages if topic == 'goal'][:5]
    trail = drawing.numbers('world/goal', 4, 'strips', place=1)[0]
    assert np.allclose(trail, [[p.x, p.y, p.z] for p in goals])


def test_what_the_planner_would_refuse_is_not_drawn(drawn):
    from orbimpc_ros.tool import settings
    from orbimpc_ros.tool.view.scene import Scene

    _, flight = drawn['retrieval']
    hostile = dict(flight.messages)['odom']
    hostile.pose.pose.position.x = float('nan')
    drawing = Drawing()
    scene = Scene(drawing, settings.read('{}'))
    scene.take('odom', hostile)
    scene.take('unheard', hostile)
    assert not drawing.drawn['world/vehicle']


# --- the command


def run(capsys, *words):
    """Return the exit code and the lines on stderr."""
    code = cli.main(['view', *map(str, words)])
    return code, capsys.readouterr().err.splitlines()


@needs_rerun
def test_a_recording_is_saved_and_never_over_another(capsys, tmp_path):
    file = tmp_path / 'flight.rrd'
    assert run(capsys, GOLDEN / 'dubins', '--save', file) == (0, [])
    written = file.read_bytes()
    assert written[:3] == b'RRF'
    assert len(written) > 20_000
    code, complaint = run(capsys, GOLDEN / 'dubins', '--save', file)
    assert (code, len(complaint)) == (2, 1)
    assert file.read_bytes() == written


@needs_rerun
@pytest.mark.parametrize(
    ('words', 'culprit'),
    [
        (('nowhere',), 'nowhere'),
        ((GOLDEN / 'dubins', '--namespace', '/uav7'), 'without /uav7/odom'),
        ((GOLDEN / 'dubins', '--port', '70000'), '--port'),
        ((GOLDEN / 'dubins', '--save', '/dev/null/x.rrd'), '--save'),
    ],
)
def test_bad_words_are_refused_in_one_line(capsys, words, culprit):
    code, complaint = run(capsys, *words)
    assert (code, len(complaint)) == (2, 1)
    assert culprit in complaint[0]


@needs_rerun
def test_a_port_that_is_taken_is_refused(capsys):
    with socket.socket() as taken:
        taken.bind(('127.0.0.1', 0))
        taken.listen()
        port = taken.getsockname()[1]
        code, complaint = run(capsys, GOLDEN / 'dubins', '--port', port)
    assert (code, len(complaint)) == (2, 1)
    assert str(port) in complaint[0]


def test_without_the_viewer_it_says_what_to_install(capsys, monkeypatch):
    monkeypatch.setattr(view, 'installed', lambda: False)
    code, complaint = run(capsys, GOLDEN / 'dubins')
    assert (code, len(complaint)) == (2, 1)
    assert 'orbimpc_ros[view]' in complaint[0]


# --- the page


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
    end = time.monotonic() + 90.0
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
        # The floor is not known before the planner has been asked for its parameters.
        spin_until(watcher, lambda: len(found['thrust/floor']) > 1)
    finally:
        watcher.close()
    assert drawing.numbers('thrust/floor', -1, 'strips').shape == (4, 2, 3)
    at, _ = found['world/vehicle'][-1]
    assert abs(at['timestamp'] - time.time()) < 60.0, at


def spin_until(watcher, happened):
    end = time.monotonic() + 40.0
    while not happened():
        assert time.monotonic() < end
        watcher.spin()


@needs_rerun
def test_a_clock_that_goes_back_begins_anew(drawn):
    from orbimpc_ros.tool.view.live import Restarts

    _, flight = drawn['spacecraft']
    odometry = [content for topic, content in flight.messages if topic == 'odom']
    restarts = Restarts()
    assert not any(restarts.seen(message) for message in odometry)
    assert restarts.seen(odometry[0])
    assert not restarts.seen(odometry[1])
