"""``orbimpc view``: a flight to look at and to scrub through in a browser, live or from a bag."""

from __future__ import annotations

import argparse
import time
import webbrowser
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from orbimpc_ros.mpc.errors import BadInput

if TYPE_CHECKING:
    import rerun as rr

    from orbimpc_ros.tool.view.server import Server

PAUSE = 0.1  # [s] between looks at what has happened
NAME = 'orbimpc'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument(
        'bag', nargs='?', metavar='BAG', help='a recorded flight (default: what is running now)'
    )
    parser.add_argument(
        '--namespace', default='', metavar='NS', help='of the vehicle, such as /uav1'
    )
    parser.add_argument(
        '--port', type=int, metavar='N', help='of the page (default: 9090, or any that is free)'
    )
    parser.add_argument('--no-browser', action='store_true', help='only say where the page is')
    parser.add_argument(
        '--save', metavar='FILE.rrd', help='write a recording into a new file; no page'
    )


def run(args: argparse.Namespace) -> int:
    """Show a bag, or what is running, until somebody asks to stop."""
    if find_spec('rerun') is None or find_spec('rerun_cli') is None:
        raise BadInput('orbimpc view', 'without rerun-sdk', "pip install 'orbimpc_ros[view]'")
    from orbimpc_ros.tool.processes import Interruptions

    with Interruptions() as interruptions:
        show = _save if args.save else _serve
        show(args, lambda: not interruptions.requested)
    return 0


def _save(args: argparse.Namespace, going: Callable[[], bool]) -> None:
    """Write the recording of a bag, or of what runs for as long as ``going()``."""
    file = Path(args.save).resolve()
    if file.exists() or not file.parent.is_dir():
        raise BadInput('--save', str(file), 'a new file in a folder that exists')
    recording = _recording()
    draw = _drawing(args)
    recording.save(file)
    draw(recording, going)
    recording.disconnect()
    print(f'recording     {file}')


def _serve(args: argparse.Namespace, going: Callable[[], bool]) -> None:
    """Serve the page and its data for as long as ``going()``."""
    from orbimpc_ros.tool.view.server import Server, choose

    draw = _drawing(args)
    with Server(choose(args.port)) as server:
        recording = _recording()
        recording.connect_grpc(server.data)
        print(f'page          {server.page} (Ctrl-C ends it)', flush=True)
        if not args.no_browser:
            webbrowser.open(server.page)
        draw(recording, lambda: going() and _healthy(server))
        while going() and _healthy(server):
            time.sleep(PAUSE)
        recording.disconnect()


def _healthy(server: Server) -> bool:
    server.require_health()
    return True


def _recording() -> rr.RecordingStream:
    """Return a recording in which nothing but the stamps of messages is time."""
    import rerun as rr

    recording = rr.RecordingStream(NAME)
    recording.set_log_tick_enabled(False)
    recording.set_log_time_enabled(False)
    return recording


def _drawing(args: argparse.Namespace) -> Callable[[rr.RecordingStream, Callable[[], bool]], None]:
    """Return what draws into a recording; a bag has been read by then."""
    if args.bag is None:
        from orbimpc_ros.tool.view import live

        return lambda recording, going: live.draw(args.namespace, recording, going)
    from orbimpc_ros.tool.view import recorded

    flight = recorded.read(Path(args.bag), args.namespace)
    return lambda recording, _going: flight.draw(recording)
