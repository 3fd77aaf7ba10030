"""Rerun's web viewer, served from its own wheel to this machine alone."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import NamedTuple
from urllib.parse import quote
from urllib.request import urlopen

from orbimpc_ros.mpc.errors import BadInput, OrbimpcError

HOST = '127.0.0.1'
PORT = 9090  # of the page, unless it is taken
PATIENCE = 30.0  # [s] until the page is there
LOOK = 0.05  # [s]
FAREWELL = 5.0  # [s] to end


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
        self._log = tempfile.TemporaryFile('w+')  # noqa: SIM115 (closed with the server)
        # The program itself, not the wheel's script: that would leave it behind when stopped.
        program = Path(rerun_cli.__file__).parent / 'rerun'
        words = ('--serve-web', '--bind', HOST, '--hide-welcome-screen')
        numbers = ('--port', str(ports.data), '--web-viewer-port', str(ports.page))
        tethered = ('-m', 'orbimpc_ros.tool.run.tethered', str(os.getpid()))
        self._child = subprocess.Popen(
            [sys.executable, *tethered, 'orbimpc_ros.tool.view.host', program, *words, *numbers],
            stdin=subprocess.DEVNULL,
            stdout=self._log,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # Ctrl-C is for the tool, which ends it in order
        )

    def require_health(self) -> None:
        """Raise if the server has ended.

        Raises:
            ServerFailure: with the last line that it said.
        """
        if self._child.poll() is not None:
            self._log.seek(0)
            said = self._log.read().splitlines() or ['nothing']
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
        self._child.terminate()
        try:
            self._child.wait(FAREWELL)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()
        self._log.close()
