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
from typing import NamedTuple
from urllib.parse import quote
from urllib.request import urlopen

from orbimpc_ros.mpc.errors import BadInput, OrbimpcError
from orbimpc_ros.tool.run.processes import Child
from orbimpc_ros.tool.run.tethered import PROGRAM

HOST = '127.0.0.1'
PORT = 9090  # of the page, unless it is taken
PATIENCE = 30.0  # [s] until the page is there
LOOK = 0.05  # [s]


class ServerFailure(OrbimpcError):
    """The server has ended when it should not have."""


class Server(NamedTuple):
    """A page and its data, by their addresses, in a process that ends with this one."""

    page: str
    data: str
    child: Child

    def require_health(self) -> None:
        """Raise if the server has ended.

        Raises:
            ServerFailure: with the last line that it printed.
        """
        if not self.child.running:
            last = (self.child.output.splitlines() or ['nothing'])[-1]
            raise ServerFailure(f"rerun's server has ended, its last words: {last}")

    def wait(self) -> None:
        """Wait until the page is there."""
        end = time.monotonic() + PATIENCE
        while not self._answers():
            self.require_health()
            if time.monotonic() > end:
                raise ServerFailure(f"no answer of rerun's server at {self.page}")
            time.sleep(LOOK)

    def _answers(self) -> bool:
        try:
            with urlopen(self.page, timeout=PATIENCE):
                return True
        except OSError:
            return False


@contextmanager
def served(port: int) -> Iterator[Server]:
    """Serve a page at a port, and its data at any that is free."""
    import rerun_cli

    data = _any()
    source = f'rerun+http://{HOST}:{data}/proxy'
    page = f'http://{HOST}:{port}/?url={quote(source, safe="")}'
    # The program itself, not the wheel's script: that would leave it behind when stopped.
    program = str(Path(rerun_cli.__file__).parent / 'rerun')
    words = ('--serve-web', '--bind', HOST, '--hide-welcome-screen')
    numbers = ('--port', str(data), '--web-viewer-port', str(port))
    with TemporaryDirectory() as place:
        child = Child([PROGRAM, program, *words, *numbers], Path(place) / 'log')
        try:
            server = Server(page, source, child)
            server.wait()
            yield server
        finally:
            child.stop(signal.SIGTERM)


def choose(page: int | None) -> int:
    """Return the port to serve at; by default the usual one, or any that is free.

    Raises:
        BadInput: the one wished for is taken or none.
    """
    if page is not None and (not 1 <= page <= 65535 or not _free(page)):
        raise BadInput('--port', page, 'a free port from 1 to 65535')
    return page or (PORT if _free(PORT) else _any())


def _free(port: int) -> bool:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        return probe.connect_ex((HOST, port)) != 0


def _any() -> int:
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])
