# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Nodes as operating-system processes: started, monitored, stopped, and ended with their parent.

The nodes of a run share a DDS domain of their own, on this machine only, with fast discovery.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import socket
import subprocess
import sys
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from orbimpc_ros.install import shared
from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.ros.entry import SIGNALS

# From util-linux: runs a program that the kernel ends as soon as its parent has ended, even if that
# was killed. By SIGTERM, because the background jobs of a shell and their children ignore SIGINT.
TETHER = ('setpriv', '--pdeathsig', 'TERM', '--')
PATIENCE = 3.0  # [s] between asking a process to stop and killing it
LAST_LINES = 8
DOMAINS = range(1, 102)  # higher domains use ports in Linux's ephemeral range
PROFILE = 'config/fastdds/announced_often.xml'  # without it, nodes wait for each other at the start
LINES = 5  # of progress, where there is no terminal
LOG_VARIABLES = ('ROS_LOG_DIR', 'ROS_HOME')
_CLAIMS: deque[socket.socket] = deque(maxlen=6)
PROFILE_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')  # 2.x, 3.x


class Child(subprocess.Popen):
    """A child process, which ends with this one; on Linux even if this one is killed.

    Args:
        name: for error messages.
        command: the program to run, and its arguments.
        log: for the output of the process.
    """

    def __init__(self, name: str, command: Sequence[str], log: Path) -> None:
        self._name, self._log = name, log
        tether = TETHER if shutil.which(TETHER[0]) else ()
        with log.open('wb') as stream:
            # In its own session: Ctrl-C reaches only the tool, which then stops its children.
            super().__init__(
                [*tether, *command],
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    @property
    def output(self) -> str:
        """Return the output of the process so far."""
        return self._log.read_text(errors='replace')

    def require_health(self) -> None:
        """Raise an error if the process has failed.

        Raises:
            OrbimpcError: it has failed; the last lines of its log are printed.
        """
        if self.poll():
            print('\n'.join(self.output.splitlines()[-LAST_LINES:]), file=sys.stderr)
            raise OrbimpcError(f'{self._name} ended with code {self.returncode}')

    def stop(self, number: int = signal.SIGINT) -> None:
        """End the process by a signal; kill it if it does not end in time."""
        self.send_signal(number)
        try:
            self.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self.kill()
            self.wait()


class Processes(list[Child]):
    """Nodes in processes, all stopped at the same time at the end of a context."""

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *_error: object) -> None:
        for process in self:  # first all, so that they stop in parallel
            process.send_signal(signal.SIGINT)
        for process in self:
            process.stop()

    def start(self, module: str, parameters: Path, log: Path, namespace: str = '') -> Child:
        """Start the node of a module such as ``orbimpc_ros.sim``, with its output in a log.

        It has a file of ROS parameters, and a namespace, such as ``/uav1``.
        """
        command = [sys.executable, '-m', module, '--ros-args', '--params-file', str(parameters)]
        command += ['-r', f'__ns:={namespace}'] if namespace else []
        self.append(Child(module.rpartition('.')[2], command, log))
        return self[-1]


# --- their domain


def isolate(folder: Path) -> int:
    """Give this process and its children a ROS domain of their own and return its number.

    Args:
        folder: for ROS's logs unless the environment sets another place: no home folder is needed.
    """
    candidates = random.sample(DOMAINS, len(DOMAINS))
    domain = next(filter(claimed, candidates), candidates[0])
    os.environ['ROS_DOMAIN_ID'] = str(domain)
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    if profile := shared(PROFILE):
        for variable in PROFILE_VARIABLES:
            os.environ.setdefault(variable, str(profile))
    if not any(map(os.environ.get, LOG_VARIABLES)):
        os.environ[LOG_VARIABLES[0]] = str(folder / 'log')
    return domain


def claimed(domain: int) -> bool:
    """Return whether a domain is free; if so, reserve it against other processes of this package.

    It is free if no participant here has its discovery ports (RTPS 9.6.2.3). Between the choice of
    a domain and its first participant, another process might choose it, too. Therefore the TCP port
    with the number of the domain's UDP port, which DDS does not use, is held until this process
    ends or has claimed several more.
    """
    port = 7400 + 250 * domain
    try:
        for offset in (0, 10):
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                probe.bind(('', port + offset))
        claim = socket.create_server(('127.0.0.1', port))
    except OSError:
        return False
    if len(_CLAIMS) == _CLAIMS.maxlen:
        _CLAIMS.popleft().close()
    _CLAIMS.append(claim)
    return True


# --- signals


@contextmanager
def interruptions() -> Iterator[list[int]]:
    """Record SIGINT and SIGTERM instead of being interrupted; yield the list of those received."""
    received: list[int] = []
    with ExitStack() as stack:
        for number in SIGNALS:
            before = signal.signal(number, lambda number, _frame: received.append(number))
            stack.callback(signal.signal, number, before)
        yield received


# --- progress


class ProgressLine:
    """Progress on stderr: a line redrawn in a terminal, a few lines elsewhere.

    Args:
        total: amount of work.
    """

    def __init__(self, total: int) -> None:
        self._total, self._live = max(1, total), sys.stderr.isatty()
        self._shown: Any = None

    def show(self, done: int, text: str) -> None:
        """Show the share done and a text if they have changed; without a terminal, at times."""
        shown = (done, text) if self._live else LINES * done // self._total
        if shown == self._shown:
            return
        self._shown, line = shown, f'{min(1.0, done / self._total):4.0%}  {text}'
        line = line[: shutil.get_terminal_size().columns - 1]  # a wrapped line could not be redrawn
        print(f'\r{line}\x1b[K' if self._live else f'{line}\n', end='', file=sys.stderr, flush=True)

    def close(self) -> None:
        """End a redrawn line."""
        if self._live and self._shown is not None:
            print(file=sys.stderr)
