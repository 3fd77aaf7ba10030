# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Rerun's web viewer, served from its own wheel to this machine alone."""

from __future__ import annotations

import signal
import socket
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
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


class Ports(NamedTuple):
    """Of the page and of its data."""

    page: int
    data: int


def choose(page: int | None) -> Ports:
    """Return the ports to serve at; without a wish the usual one, or any that is free.

    Raises:
        BadInput: the one wished for is taken or none.
    """
    if page is not None and (not 1 <= page <= 65535 or not _free(page)):
        raise BadInput('--port', page, 'a free port from 1 to 65535')
    chosen = page or (PORT if _free(PORT) else _any())
    return Ports(chosen, _any())


def _free(port: int) -> bool:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError:
            return False
    return True


def _any() -> int:
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return probe.getsockname()[1]


class Server:
    """A page and its data in a process that ends with this one; entered, they can be reached.

    Args:
        ports: to serve at.
    """

    def __init__(self, ports: Ports) -> None:
        import rerun_cli

        self.data = f'rerun+http://{HOST}:{ports.data}/proxy'
        self.page = f'http://{HOST}:{ports.page}/?url={quote(self.data, safe="")}'
        self._place = TemporaryDirectory()
        # The program itself, not the wheel's script: that would leave it behind when stopped.
        program = str(Path(rerun_cli.__file__).parent / 'rerun')
        words = ('--serve-web', '--bind', HOST, '--hide-welcome-screen')
        numbers = ('--port', str(ports.data), '--web-viewer-port', str(ports.page))
        log = Path(self._place.name) / 'log'
        self._child = Child([PROGRAM, program, *words, *numbers], log)

    def require_health(self) -> None:
        """Raise if the server has ended.

        Raises:
            ServerFailure: with the last line that it said.
        """
        if not self._child.running:
            said = self._child.output.splitlines() or ['nothing']
            raise ServerFailure(f"rerun's server has ended, its last words: {said[-1]}")

    def __enter__(self) -> Server:
        end = time.monotonic() + PATIENCE
        try:
            while not self._answers():
                self.require_health()
                if time.monotonic() > end:
                    raise ServerFailure(f"rerun's server does not answer at {self.page}")
                time.sleep(LOOK)
        except BaseException:
            self.close()
            raise
        return self

    def _answers(self) -> bool:
        try:
            with urlopen(self.page, timeout=PATIENCE):
                return True
        except OSError:
            return False

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the server."""
        self._child.stop(signal.SIGTERM)
        self._place.cleanup()
