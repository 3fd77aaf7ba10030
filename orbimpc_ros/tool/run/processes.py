# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Nodes as operating-system processes: started, watched, stopped, and gone with their parent.

``python -m`` this module runs another one, or a program, that ends with the process which started
it.
"""

from __future__ import annotations

import ctypes
import os
import runpy
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import Any

from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.ros.entry import leave_at_signals

PR_SET_PDEATHSIG = 1  # <sys/prctl.h>
PROGRAM = '--program'  # instead of a module: its path and arguments follow
PATIENCE = 3.0  # [s] between asking a process to stop and killing it
LAST_LINES = 8


class ProcessFailure(OrbimpcError):
    """A process of the run ended when it should not have."""


class Child:
    """A process of its own, which ends with this one, however that ends.

    Args:
        words: the module to run with its arguments, or :data:`PROGRAM`, a program and its own.
        log: takes what the process prints.
        domain: of ROS; this process's by default.
    """

    def __init__(self, words: Sequence[str], log: Path, domain: int | None = None) -> None:
        self._log = log
        tethered = [sys.executable, '-m', __spec__.name, str(os.getpid())]
        own = {} if domain is None else {'ROS_DOMAIN_ID': str(domain)}
        with log.open('wb') as stream:
            # A session of its own: Ctrl-C reaches the tool alone, which then stops in order.
            self._child = subprocess.Popen(
                [*tethered, *words],
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

    def wait(self, patience: float) -> int | None:
        """Return the exit code; None if the process has not ended after ``patience`` [s]."""
        try:
            return self._child.wait(patience)
        except subprocess.TimeoutExpired:
            return None

    def stop(self, number: int = signal.SIGINT) -> None:
        """Ask the process to end by a signal; kill it if it does not."""
        if not self.running:
            return
        self.tell(number)
        if self.wait(PATIENCE) is None:
            self._child.kill()
            self._child.wait()


class Process(Child):
    """A node in a process.

    Args:
        module: to run, such as ``orbimpc_ros.sim``.
        parameters: file of ROS parameters.
        log: takes what the process prints.
        domain: of ROS; this process's by default.
        namespace: of the node, such as ``/uav1``.
    """

    def __init__(
        self,
        module: str,
        parameters: Path,
        log: Path,
        domain: int | None = None,
        namespace: str = '',
    ) -> None:
        self.name = module.rpartition('.')[2]
        remapped = ['-r', f'__ns:={namespace}'] if namespace else []
        words = [module, '--ros-args', '--params-file', str(parameters), *remapped]
        super().__init__(words, log, domain)

    def require_health(self) -> None:
        """Raise unless the process lives or has ended well.

        Raises:
            ProcessFailure: with the last lines of its log.
        """
        if self._child.poll():
            lines = self.output.splitlines()[-LAST_LINES:]
            print('\n'.join(lines), file=sys.stderr)
            raise ProcessFailure(f'{self.name} ended with code {self._child.returncode}')


class Interruptions:
    """While entered, SIGINT and SIGTERM are remembered instead of breaking in anywhere."""

    def __init__(self) -> None:
        self.requested = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Interruptions:
        for number in (signal.SIGINT, signal.SIGTERM):
            self._before[number] = signal.signal(number, self._remember)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _remember(self, number: int, frame: FrameType | None) -> None:
        self.requested = True


def tether(parent: int) -> None:
    """Have this process stopped as soon as its parent is gone, even if that was killed.

    By SIGTERM: a shell has its background jobs ignore SIGINT, and all that these start.
    """
    leave_at_signals()
    if not sys.platform.startswith('linux'):
        return
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:  # it went before we asked
        sys.exit(1)


if __name__ == '__main__':
    tether(int(sys.argv.pop(1)))
    module = sys.argv.pop(1)
    if module == PROGRAM:
        os.execv(sys.argv[1], sys.argv[1:])  # what was arranged for this process stays
    runpy.run_module(module, run_name='__main__', alter_sys=True)
