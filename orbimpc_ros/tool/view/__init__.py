# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc view``: a flight to look at and to scrub through in a browser, live or from a bag."""

from __future__ import annotations

import argparse
import os
import sys
import time
import webbrowser
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from orbimpc_ros.install import command_for_extra
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool.arguments import add_namespace

if TYPE_CHECKING:
    import rerun as rr

    Going = Callable[[], bool]  # until nobody wants to see more

SCREENS = ('DISPLAY', 'WAYLAND_DISPLAY', 'BROWSER')
PAUSE = 0.1  # [s] between looks at the server


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument(
        'bag', nargs='?', metavar='BAG', help='a recorded flight (default: what is running now)'
    )
    add_namespace(parser)
    parser.add_argument(
        '--port', type=int, metavar='N', help='of the page (default: 9090, or any that is free)'
    )
    parser.add_argument('--no-browser', action='store_true', help='only say where the page is')


def run(args: argparse.Namespace) -> int:
    """Show a bag, or what is running, until somebody asks to stop."""
    if not installed():
        raise BadInput.stating('orbimpc view', 'needs rerun-sdk', command_for_extra('view'))
    import rerun as rr

    from orbimpc_ros.tool.run.processes import interruptions
    from orbimpc_ros.tool.view.server import served

    draw, recording = _drawing(args), rr.RecordingStream('orbimpc')
    recording.set_log_tick_enabled(False)  # nothing but the stamps of messages is time
    recording.set_log_time_enabled(False)
    with interruptions() as received, served(args.port) as (page, data, server):
        print(f'page          {page} (Ctrl-C ends it)', flush=True)
        if not args.no_browser and _has_screen():
            webbrowser.open(page)

        def going() -> bool:
            server.require_health()
            return not received

        recording.connect_grpc(data)
        try:
            draw(recording, going)
            while going():
                time.sleep(PAUSE)
        finally:
            recording.disconnect()  # before the server goes
    return 0


def installed() -> bool:
    """Return whether the viewer is there: rerun's library, and its server in the same wheel."""
    return all(find_spec(name) is not None for name in ('rerun', 'rerun_cli'))


def _has_screen() -> bool:
    """Return whether a browser can show itself; else one in the terminal would take its place."""
    return sys.platform == 'darwin' or any(os.environ.get(name) for name in SCREENS)


def _drawing(args: argparse.Namespace) -> Callable[[rr.RecordingStream, Going], None]:
    """Return what draws; a bag has been read by then."""
    if args.bag is None:
        from orbimpc_ros.tool.view import live

        return lambda recording, going: live.draw(args.namespace, recording, going)
    from orbimpc_ros.tool import bags, settings
    from orbimpc_ros.tool.view.scene import Scene

    values = settings.of_bag(Path(args.bag), args.namespace) or settings.read('{}')
    messages = bags.of_vehicle(Path(args.bag), args.namespace)
    return lambda recording, _going: Scene(recording, values).draw(messages)
