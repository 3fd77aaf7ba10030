# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc view``: a flight in a browser with a timeline to scrub, live or from a bag.

The page is Rerun's web viewer, served from its wheel to this machine only. With running nodes, the
viewer publishes nothing, and draws messages as they arrive.
"""

from __future__ import annotations

import os
import signal
import socket
import time
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from orbimpc_ros.install import command_for_extra
from orbimpc_ros.mpc.errors import BadInput, OrbimpcError
from orbimpc_ros.ros.process import LATCHED, LATEST, RANGE, attached, qos
from orbimpc_ros.ros.topics import VEHICLE
from orbimpc_ros.tool import bags
from orbimpc_ros.tool.processes import Child, interruptions

if TYPE_CHECKING:
    from orbimpc_ros.tool.scene import Scene

SCREENS = ('DISPLAY', 'WAYLAND_DISPLAY', 'BROWSER')
PAUSE = 0.05  # [s] between checks of the server
HOST = '127.0.0.1'
PORT = 9090  # of the page, unless it is in use
PATIENCE = 30.0  # [s] for the page to come up
DEPTH = 20  # a slow viewer loses messages; it never delays a controller


def run(bag: str | None, namespace: str, port: int | None, *, browser: bool) -> int:
    """Show a bag, or the running nodes, until a signal arrives."""
    if not installed():
        raise BadInput.stating('orbimpc view', 'needs rerun-sdk', command_for_extra('view'))
    import rerun as rr

    from orbimpc_ros.tool.scene import Scene

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


def installed() -> bool:
    """Return whether the viewer is installed: rerun's library, and its server in the same wheel."""
    return all(find_spec(name) is not None for name in ('rerun', 'rerun_cli'))


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


# --- the page


@contextmanager
def served(wanted: int | None) -> Iterator[tuple[str, str, Child]]:
    """Yield the address of the page, that of its data, and their server process.

    The page is at the wanted port, by default at 9090 or any free one; its data at any free port.

    Raises:
        BadInput: the wanted port is in use or invalid.
    """
    import rerun_cli

    if wanted is not None and not (1 <= wanted <= 65535 and _free(wanted)):
        raise BadInput('--port', wanted, 'a free port from 1 to 65535')
    port, data = wanted or (PORT if _free(PORT) else _any()), _any()
    source = f'rerun+http://{HOST}:{data}/proxy'
    page = f'http://{HOST}:{port}/?url={quote(source, safe="")}'
    # The program itself, not the wheel's script, which leaves the program running when stopped.
    program = str(Path(rerun_cli.__file__).parent / 'rerun')
    words = ['--serve-web', '--bind', HOST, '--hide-welcome-screen']
    numbers = ['--port', str(data), '--web-viewer-port', str(port)]
    with TemporaryDirectory() as place:
        words = [program, *words, *numbers]
        child = Child("rerun's server", words, Path(place) / 'log')
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
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])
