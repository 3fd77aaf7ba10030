# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Rerun's web viewer, served from its own wheel to this machine alone."""

from __future__ import annotations

import signal
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import quote

from orbimpc_ros.mpc.errors import BadInput, OrbimpcError
from orbimpc_ros.tool.run.processes import PROGRAM, Child

HOST = '127.0.0.1'
PORT = 9090  # of the page, unless it is taken
PATIENCE = 30.0  # [s] until the page is there
LOOK = 0.05  # [s]


@contextmanager
def served(wanted: int | None) -> Iterator[tuple[str, str, Child]]:
    """Yield the address of a page, that of its data, and their server, which ends with this one.

    The page is at the port that is wanted, by default the usual one or any; its data at any.

    Raises:
        BadInput: the port that is wanted is taken or none.
    """
    import rerun_cli

    if wanted is not None and not (1 <= wanted <= 65535 and _free(wanted)):
        raise BadInput('--port', wanted, 'a free port from 1 to 65535')
    port, data = wanted or (PORT if _free(PORT) else _any()), _any()
    source = f'rerun+http://{HOST}:{data}/proxy'
    page = f'http://{HOST}:{port}/?url={quote(source, safe="")}'
    # The program itself, not the wheel's script: that would leave it behind when stopped.
    program = str(Path(rerun_cli.__file__).parent / 'rerun')
    words = ['--serve-web', '--bind', HOST, '--hide-welcome-screen']
    numbers = ['--port', str(data), '--web-viewer-port', str(port)]
    with TemporaryDirectory() as place:
        words = [PROGRAM, program, *words, *numbers]
        child = Child("rerun's server", words, Path(place) / 'log')
        try:
            end = time.monotonic() + PATIENCE
            while _free(port) or _free(data):
                child.require_health()
                if time.monotonic() > end:
                    raise OrbimpcError(f"no answer of rerun's server at {page}")
                time.sleep(LOOK)
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
