# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Nodes as operating-system processes: started, watched, stopped, and gone with their parent.

They meet in a DDS domain of one run: its own number, this machine only, and at once. How far a run
is shows a progress bar in plain text: redrawn in a terminal, a few lines elsewhere.
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
from contextlib import contextmanager
from pathlib import Path

from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.ros.entry import SIGNALS

# Of util-linux: runs a program that the kernel ends as soon as whoever started it is gone, even if
# that was killed. By SIGTERM: a shell has its background jobs ignore SIGINT, and all they start.
TETHER = ('setpriv', '--pdeathsig', 'TERM', '--')
PATIENCE = 3.0  # [s] between asking a process to stop and killing it
LAST_LINES = 8
DOMAINS = range(1, 102)  # beyond them DDS ports meet those that Linux hands out
# Fast DDS announces a participant five times in half a second, then every three seconds: nodes
# that start together miss each other and wait. This keeps announcing while they start.
PROFILE = """<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <participant profile_name="announced_often" is_default_profile="true">
    <rtps><builtin><discovery_config><initialAnnouncements>
      <count>100</count><period><sec>0</sec><nanosec>50000000</nanosec></period>
    </initialAnnouncements></discovery_config></builtin></rtps>
  </participant>
</profiles>
"""
WIDTH = 20
LINES = 5  # where there is no terminal
LOG_VARIABLES = ('ROS_LOG_DIR', 'ROS_HOME')
_CLAIMS: deque[socket.socket] = deque(maxlen=6)
PROFILE_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'FASTDDS_DEFAULT_PROFILES_FILE')  # 2.x, 3.x


class Child:
    """A process of its own, which ends with this one, on Linux however that ends.

    Args:
        name: for complaints.
        words: the program to run, and its arguments.
        log: takes what the process prints.
        domain: of ROS; this process's by default.
    """

    def __init__(
        self, name: str, words: Sequence[str], log: Path, domain: int | None = None
    ) -> None:
        self._name, self._log = name, log
        tether = TETHER if shutil.which(TETHER[0]) else ()
        own = {} if domain is None else {'ROS_DOMAIN_ID': str(domain)}
        with log.open('wb') as stream:
            # A session of its own: Ctrl-C reaches the tool alone, which then stops in order.
            self._child = subprocess.Popen(
                [*tether, *words],
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env=os.environ | own,
            )
        self.pid = self._child.pid
        self.tell = self._child.send_signal

    @property
    def output(self) -> str:
        """Return what the process has printed."""
        return self._log.read_text(errors='replace')

    @property
    def running(self) -> bool:
        """Return whether the process lives."""
        return self._child.poll() is None

    def require_health(self) -> None:
        """Raise unless the process lives or has ended well.

        Raises:
            OrbimpcError: with the last lines of its log.
        """
        if self._child.poll():
            print('\n'.join(self.output.splitlines()[-LAST_LINES:]), file=sys.stderr)
            raise OrbimpcError(f'{self._name} ended with code {self._child.returncode}')

    def wait(self, patience: float) -> int | None:
        """Return the exit code; None if the process has not ended after ``patience`` [s]."""
        try:
            return self._child.wait(patience)
        except subprocess.TimeoutExpired:
            return None

    def stop(self, number: int = signal.SIGINT) -> None:
        """Ask the process to end by a signal; kill it if it does not."""
        if self.running:
            self.tell(number)
            if self.wait(PATIENCE) is None:
                self._child.kill()
                self._child.wait()


class Processes(list[Child]):
    """Nodes in processes, stopped all at the same time when a context ends."""

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *_error: object) -> None:
        for process in self:  # each takes its time
            if process.running:
                process.tell(signal.SIGINT)
        for process in self:
            process.stop()

    def start(
        self,
        module: str,
        parameters: Path,
        log: Path,
        domain: int | None = None,
        namespace: str = '',
    ) -> Child:
        """Start a node.

        Args:
            module: to run, such as ``orbimpc_ros.sim``.
            parameters: file of ROS parameters.
            log: takes what the process prints.
            domain: of ROS; this process's by default.
            namespace: of the node, such as ``/uav1``.
        """
        words = [sys.executable, '-m', module, '--ros-args', '--params-file', str(parameters)]
        remapped = ['-r', f'__ns:={namespace}'] if namespace else []
        self.append(Child(module.rpartition('.')[2], [*words, *remapped], log, domain))
        return self[-1]


# --- their domain


def isolate(folder: Path) -> int:
    """Give this process and its children a ROS domain of their own and return its number.

    Args:
        folder: takes the DDS profile, and ROS's logs unless they are to go elsewhere: no home
            folder is needed.
    """
    candidates = random.sample(DOMAINS, len(DOMAINS))
    domain = next((d for d in candidates if claimed(d)), candidates[0])
    os.environ['ROS_DOMAIN_ID'] = str(domain)
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    profile = folder / 'fastdds.xml'
    profile.write_text(PROFILE)
    for variable in PROFILE_VARIABLES:
        os.environ.setdefault(variable, str(profile))
    if not any(os.environ.get(variable) for variable in LOG_VARIABLES):
        os.environ[LOG_VARIABLES[0]] = str(folder / 'log')
    return domain


def claimed(domain: int) -> bool:
    """Return whether a domain is free, and if so keep others of this package from it.

    From the choice of a domain to its first participant takes a while, in which somebody else might
    choose it as well. A TCP port of the same number as the domain's UDP port, which DDS leaves
    alone, is held until this process ends or has claimed many more.
    """
    if not free(domain):
        return False
    claim = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        claim.bind(('127.0.0.1', 7400 + 250 * domain))
    except OSError:
        claim.close()
        return False
    if len(_CLAIMS) == _CLAIMS.maxlen:
        _CLAIMS.popleft().close()
    _CLAIMS.append(claim)
    return True


def free(domain: int) -> bool:
    """Return whether no participant of a domain lives here (RTPS 9.6.2.3: its discovery ports)."""
    for offset in (0, 10):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(('', 7400 + 250 * domain + offset))
            except OSError:
                return False
    return True


# --- signals


@contextmanager
def interruptions() -> Iterator[list[int]]:
    """Remember SIGINT and SIGTERM instead of having them break in; yield those that have come."""
    received: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _frame: received.append(number))
        for number in SIGNALS
    }
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


# --- progress


class ProgressLine:
    """Shows how much of something is done.

    Args:
        total: what there is to do.
    """

    def __init__(self, total: int) -> None:
        self._total = max(1, total)
        self._stream = sys.stderr
        self._live = self._stream.isatty()
        self._shown: tuple[int, str] | None = None

    def show(self, done: int, text: str) -> None:
        """Draw ``done`` with a text beside it, unless nothing has changed that is worth it."""
        share = min(1.0, done / self._total)
        shown = (done, text) if self._live else (int(share * LINES), '')
        if shown == self._shown:
            return
        self._shown = shown
        filled = int(share * WIDTH)
        line = f'[{"#" * filled}{"." * (WIDTH - filled)}] {text}'
        line = line[: shutil.get_terminal_size().columns - 1]  # a second line would stay
        self._stream.write(f'\r{line}\x1b[K' if self._live else f'{line}\n')
        self._stream.flush()

    def close(self) -> None:
        """Leave the bar behind."""
        if self._live and self._shown is not None:
            self._stream.write('\n')
            self._stream.flush()
