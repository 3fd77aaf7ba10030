# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc view``: a flight in a browser with a timeline to scrub, live or from a bag.

The page is Rerun's web viewer, served from its wheel to this machine only. With running nodes, the
viewer publishes nothing, and draws messages as they arrive, at the time of their stamps.
"""

from __future__ import annotations

import math
import os
import signal
import socket
import time
import webbrowser
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import quote

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
import rerun_cli
from visualization_msgs.msg import Marker

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput, OrbimpcError
from orbimpc_ros.ros.messages import (
    BLUE,
    GREEN,
    ORANGE,
    UNDATED,
    Frames,
    read_itinerary,
    read_odometry,
    read_sighting,
    stamp_of,
)
from orbimpc_ros.ros.process import LATCHED, LATEST, RANGE, attached, qos
from orbimpc_ros.ros.topics import VEHICLE
from orbimpc_ros.tool import bags
from orbimpc_ros.tool.bags import fields, point, seconds
from orbimpc_ros.tool.processes import Child, interruptions

SCREENS = ('DISPLAY', 'WAYLAND_DISPLAY', 'BROWSER')
PAUSE = 0.05  # [s] between checks of the server
HOST = '127.0.0.1'
PORT = 9090  # of the page, unless it is in use
PATIENCE = 30.0  # [s] for the page to come up
DEPTH = 20  # a slow viewer loses messages; it never delays a controller
TIMELINE = 'ros_time'
WORLD, TICK, CHARTS = 'world', 'tick', 'charts'
SHOWN = {
    'Distance to the goal [m]': ('distance',),
    'Share of full speed |R e₁|': ('speed',),
    'Gap to the bound, log₁₀': ('gap',),
    'Solve time [ms]': ('solve_time_ms',),
    'Earliest catch, and its bound [s]': ('earliest_catch', 'catch_bound'),
}  # lines of each chart, below CHARTS
WALL_CLOCK = 1e8  # [s]: later stamps are dates, earlier ones count from a simulation's start
REMEMBERED = 500  # positions kept of the flown path
SWING = 50  # sightings kept of the goal
SIZE = 0.06  # of a vehicle's axes, as a share of its largest distance from the goal
LEAST_GAP = 1e-12  # drawn for smaller gaps, since zero has no logarithm
CLEAR = rr.components.FillMode.TransparentFillMajorWireframe
THIN, THICK = (rr.components.Radius.ui_points(points) for points in (1.5, 5.0))


def run(bag: str | None, namespace: str, port: int | None, *, browser: bool) -> int:
    """Show a bag, or the running nodes, until a signal arrives."""
    messages = bags.of_vehicle(Path(bag), namespace, Scene.topics) if bag is not None else []
    recording = rr.RecordingStream('orbimpc')
    recording.set_log_tick_enabled(False)  # the only timeline is that of message stamps
    recording.set_log_time_enabled(False)
    with interruptions() as received, served(port) as (page, data, server):
        print(f'page          {page} (Ctrl-C ends it)', flush=True)
        # Without a screen, a text browser would occupy the terminal.
        if browser and any(map(os.environ.get, SCREENS)):
            webbrowser.open(page)

        def going() -> bool:
            server.require_health()
            return not received

        recording.connect_grpc(data)
        try:
            scene = Scene(recording)
            for each in messages:
                scene.take(each.topic, each.content)
            recording.flush()
            if bag is None:
                draw_live(scene, namespace, going)
            while going():
                time.sleep(PAUSE)
        finally:
            recording.disconnect()  # before the server stops
    return 0


# --- the page


@contextmanager
def served(wanted: int | None) -> Iterator[tuple[str, str, Child]]:
    """Yield the address of the page, that of its data, and their server process.

    The page is at the wanted port, by default at 9090 or any free one; its data at any free port.

    Raises:
        BadInput: the wanted port is in use or invalid.
    """
    if wanted is not None and not (1 <= wanted <= 65535 and _free(wanted)):
        raise BadInput('--port', wanted, 'a free port from 1 to 65535')
    port, data = wanted or (PORT if _free(PORT) else _any()), _any()
    source = f'rerun+http://{HOST}:{data}/proxy'
    page = f'http://{HOST}:{port}/?url={quote(source, safe="")}'
    # The program itself, not the wheel's script, which leaves the program running when stopped.
    program = str(Path(rerun_cli.__file__).parent / 'rerun')
    options = ['--serve-web', '--bind', HOST, '--hide-welcome-screen']
    numbers = ['--port', str(data), '--web-viewer-port', str(port)]
    with TemporaryDirectory() as place:
        child = Child("rerun's server", [program, *options, *numbers], Path(place) / 'log')
        try:
            end = time.monotonic() + PATIENCE
            while _free(port) or _free(data):
                child.require_health()
                if time.monotonic() > end:
                    raise OrbimpcError(f"no answer of rerun's server at {page}")
                time.sleep(PAUSE)
            yield page, source, child
        finally:
            child.stop(signal.SIGTERM)


def _free(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((HOST, port)) != 0


def _any() -> int:
    with socket.create_server((HOST, 0)) as probe:
        return int(probe.getsockname()[1])


# --- running nodes


def draw_live(scene: Scene, namespace: str, going: Callable[[], bool]) -> None:
    """Draw the running vehicle in a namespace, such as ``/uav1``, while ``going()``."""
    os.environ.setdefault(RANGE, 'LOCALHOST')
    latest = qos(DEPTH, reliability=LATEST.reliability)
    with attached('viewer', namespace=namespace or '/') as (node, executor):
        for topic in VEHICLE:
            if topic.name in scene.topics:
                # Late subscribers get latched messages only with reliable QoS.
                profile = LATCHED if topic.latched else latest
                take: Any = partial(scene.take, topic.name)
                node.create_subscription(topic.message, topic.name, take, profile)
        while going():
            executor.spin_once(timeout_sec=PAUSE)


# --- what is drawn


class Scene:
    """Draws the messages of one vehicle, and the markers that its nodes publish for viewers.

    Args:
        recording: to draw into.
    """

    topics = ('odom', 'goal', 'plan', 'plan_markers', 'world_markers', 'tick', 'captured')

    def __init__(self, recording: rr.RecordingStream) -> None:
        self._to = recording
        self._flown: deque[Array] = deque(maxlen=REMEMBERED)
        self._swing: deque[Array] = deque(maxlen=SWING)
        self._farthest = 0.0  # from the goal so far [m]
        self._to.send_blueprint(layout())

    def take(self, topic: str, message: Any) -> None:
        """Draw a message unless the planner would refuse it; ``topic`` has no namespace."""
        now = seconds(message)
        if stamp_of(message) != UNDATED and (now or topic != 'goal'):  # one by hand has no stamp
            kind = 'timestamp' if now > WALL_CLOCK else 'duration'
            self._to.set_time(TIMELINE, **{kind: now})
        with suppress(BadInput):
            if topic.endswith('_markers'):
                self._take_markers(topic, message)
            else:
                getattr(self, f'_take_{topic}')(message)

    def _take_odom(self, message: Any) -> None:
        _, odometry = read_odometry(message, 3, Frames())
        place = odometry.position
        self._flown.append(place)
        self._to.log(f'{WORLD}/flown', _line(self._flown, BLUE))
        if self._swing:
            apart = float(np.linalg.norm(place - self._swing[-1]))
            self._farthest = max(self._farthest, apart)
            self._chart('distance', apart)
        own = rr.Transform3D(translation=place, mat3x3=odometry.attitude)
        axes = rr.TransformAxes3D(SIZE * (self._farthest or 1.0))
        self._to.log(f'{WORLD}/vehicle', own, axes)

    def _take_goal(self, message: Any) -> None:
        self._swing.append(read_sighting(message, 3, Frames())[1].position)
        dot = rr.Points3D(self._swing[-1], radii=THICK, colors=[ORANGE])
        self._to.log(f'{WORLD}/goal', dot, _line(self._swing, ORANGE))

    def _take_plan(self, message: Any) -> None:
        places = read_itinerary(message, 3, Frames())[1].positions
        dots = rr.Points3D(places, radii=2.0 * THIN, colors=[GREEN])
        self._to.log(f'{WORLD}/plan', dots, _line(places, GREEN))

    def _take_markers(self, topic: str, message: Any) -> None:
        """Draw markers in place of the last ones on their topic."""
        self._to.log(f'{WORLD}/{topic}', rr.Clear(recursive=True))
        for each in message.markers:
            if each.action == Marker.ADD and (drawn := _drawn(each)) is not None:
                self._to.log(f'{WORLD}/{topic}/{each.ns}/{each.id}', drawn)

    def _take_tick(self, message: Any) -> None:
        values = fields(message)
        self._to.log(TICK, rr.TextDocument(_table(values), media_type=rr.MediaType.MARKDOWN))
        values |= zip(('start', 'speed'), values.get('speed_fraction', ()), strict=False)
        if 'gap' in values:
            values['gap'] = math.log10(max(values['gap'], LEAST_GAP))
        for name, value in values.items():
            self._chart(name, value)

    def _take_captured(self, message: Any) -> None:
        if message.data and self._swing:
            star = rr.Points3D(self._swing[-1], radii=THICK, colors=[GREEN], labels=['captured'])
            self._to.log(f'{WORLD}/captured', star)

    def _chart(self, name: str, value: Any) -> None:
        if isinstance(value, (int, float)) and math.isfinite(value):
            self._to.log(f'{CHARTS}/{name}', rr.Scalars([value]))


def _line(points: Iterable[Array], color: tuple[float, ...]) -> rr.LineStrips3D:
    return rr.LineStrips3D([np.array(points)], colors=[color], radii=THIN)


def _drawn(marker: Marker) -> Any:
    """Return Rerun's shape for a marker; None for kinds that no node here publishes.

    Raises:
        BadInput: its pose is not acceptable, or a number is not finite.
    """
    _, seen = read_sighting(marker, 3, Frames())  # a marker has a header and a pose, too
    assert seen.attitude is not None
    size, ends = point(marker.scale), [seen.position + point(each) for each in marker.points]
    if not np.isfinite([size, *ends]).all():
        raise BadInput.stating(f'marker {marker.ns}', 'NaN or infinite', 'finite numbers')
    shade = marker.color
    how: Any = {'colors': [(shade.r, shade.g, shade.b, shade.a)]}
    match marker.type:
        case Marker.CUBE:
            return rr.Boxes3D(centers=[seen.position], sizes=[size], fill_mode=CLEAR, **how)
        case Marker.SPHERE | Marker.CYLINDER:
            half = 0.5 * size
            return rr.Ellipsoids3D(
                centers=[seen.position], half_sizes=[half], fill_mode=CLEAR, **how
            )
        case Marker.ARROW:
            along = size[0] * seen.attitude[:, 0]
            return rr.Arrows3D(origins=[seen.position], vectors=[along], **how)
        case Marker.LINE_STRIP:
            return rr.LineStrips3D([ends], radii=THIN, **how)
        case Marker.LINE_LIST:
            return rr.LineStrips3D(np.reshape(ends, (-1, 2, 3)), radii=THIN, **how)
    return None


def _table(values: dict[str, Any]) -> str:
    """Return the known values of a tick as a Markdown table."""
    rows = [
        f'| {key} | {_text(value)} |'
        for key, value in values.items()
        if value not in ('', [], {}) and value == value  # NaN is unknown
    ]
    return '\n'.join([*rows[:1], '| --- | --- |', *rows[1:]])


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return ', '.join(f'{key} {_text(each)}' for key, each in value.items())
    if isinstance(value, list):
        return ', '.join(_text(each) for each in value)
    return f'{value:.4g}' if isinstance(value, float) else str(value)


def layout() -> rrb.Blueprint:
    """Return the layout of the page: the world, the tick as text, and charts."""
    charts = [
        rrb.TimeSeriesView(name=title, contents=[f'/{CHARTS}/{name}' for name in lines])
        for title, lines in SHOWN.items()
    ]
    world = rrb.Spatial3DView(origin=WORLD, name='Vehicle, plan, goal')
    text = rrb.TextDocumentView(origin=TICK, name='Tick')
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(world, rrb.Horizontal(*charts[:3]), row_shares=[3, 1]),
            rrb.Vertical(text, *charts[3:], row_shares=[2, 1, 1]),
            column_shares=[3, 2],
        ),
        rrb.TimePanel(timeline=TIMELINE, state='collapsed'),
        collapse_panels=True,
    )
