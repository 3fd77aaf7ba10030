"""Planner processes with namespaces, for measurements."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

PATIENCE = 5.0  # [s]
PARAMETERS = {
    'trigger': 'odom',
    'floor.shape': 'polygon',
    'floor.fraction': 0.5477225575,
    'odom_timeout': 5.0,
    'goal_timeout': 60.0,
}
MEGABYTE = 1e6


class Planner:
    """A planner process on the paper's UAV problem.

    Args:
        namespace: of the node, such as ``/p1``; empty for none.
        log: takes what the process prints.
    """

    def __init__(self, namespace: str, log: Path) -> None:
        words = [sys.executable, '-m', 'orbimpc_ros.ros.planner', '--ros-args']
        for name, value in PARAMETERS.items():
            words += ['-p', f'{name}:={value}']
        if namespace:
            words += ['-r', f'__ns:={namespace}']
        with log.open('wb') as stream:
            self._child = subprocess.Popen(
                words, stdin=subprocess.DEVNULL, stdout=stream, stderr=subprocess.STDOUT
            )

    def resident(self) -> float:
        """Return the memory that it holds [MB]."""
        status = Path(f'/proc/{self._child.pid}/status').read_text()
        line = next(line for line in status.splitlines() if line.startswith('VmRSS'))
        return 1024 * int(line.split()[1]) / MEGABYTE

    def tell_to_stop(self) -> None:
        """Ask the process to end."""
        self._child.send_signal(signal.SIGINT)

    def wait(self) -> None:
        """Wait until it has ended; kill it if it does not."""
        try:
            self._child.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()


@contextmanager
def running(namespaces: Sequence[str], folder: Path) -> Iterator[list[Planner]]:
    """Run a planner in each namespace; all are stopped at the end."""
    planners: list[Planner] = []
    try:
        for i, namespace in enumerate(namespaces):
            planners.append(Planner(namespace, folder / f'planner-{i}.log'))
        yield planners
    finally:
        for planner in planners:
            planner.tell_to_stop()
        for planner in planners:
            planner.wait()
