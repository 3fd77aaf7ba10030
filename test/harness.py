# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Harness for nodes in tests, faults and benchmarks: domains, processes, and an observing node."""

from __future__ import annotations

import contextlib
import io
import itertools
import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

from orbimpc_ros.ros.entry import PACKAGES
from orbimpc_ros.tool.processes import Child, claimed

ROOT = Path(__file__).resolve().parents[1]
PATIENCE = 240.0  # [s] timeout of every wait: enough even with ten processes per core
KEPT = 1000  # messages of queue depth: none may be missed

TOOL = (sys.executable, '-m', 'orbimpc_ros.tool.cli')

os.environ['PYTHONFAULTHANDLER'] = '1'
_numbers = itertools.count()


def run(*words: object, text: str = '', **given: Any) -> subprocess.CompletedProcess:
    """Run a command to completion with input ``text``; ``given`` goes to ``subprocess.run``."""
    known = {'capture_output': True, 'text': True, 'check': False, **given}
    return subprocess.run([*map(str, words)], input=text, **known)


def python(script: str, *words: object, **given: Any) -> subprocess.CompletedProcess:
    """Run a script, which may be indented, in a separate interpreter."""
    return run(sys.executable, '-c', textwrap.dedent(script), *words, **given)


def orbimpc(*words: object, text: str = '') -> subprocess.CompletedProcess:
    """Run a command of the tool as a user does, with input ``text``."""
    return run(*TOOL, *words, text=text)


def ran_here(*words: object) -> subprocess.CompletedProcess:
    """Run a command of the tool in this process, which spares the imports of another."""
    from orbimpc_ros.tool import cli

    out, err, given = io.StringIO(), io.StringIO(), [str(word) for word in words]
    outputs = contextlib.redirect_stdout(out), contextlib.redirect_stderr(err)
    with mock.patch.dict(os.environ), outputs[0], outputs[1]:
        code = cli.main(given)
    return subprocess.CompletedProcess(given, code, out.getvalue(), err.getvalue())


def new_domain() -> int:
    """Return a DDS domain that no other test, and currently no other process here, uses.

    Parallel test workers draw from disjoint sets of domains.
    """
    workers = int(os.environ.get('PYTEST_XDIST_WORKER_COUNT', '1'))
    own = int(os.environ.get('PYTEST_XDIST_WORKER', 'gw0')[2:])
    count = 100 // workers
    drawn = [
        1 + own + workers * ((13 * os.getpid() + next(_numbers)) % count) for _ in range(count)
    ]
    # With many suites at a time all may be claimed, although most are unused.
    return next(filter(claimed, drawn), drawn[0])


class LaunchedProcess(Child):
    """A node in its own process: an executable of the package, or a test's script."""

    def wait(self, timeout: float | None = PATIENCE) -> int:
        return super().wait(timeout)

    def stop(self, number: int = signal.SIGINT) -> int:
        self.send_signal(number)
        try:
            return self.wait()
        except subprocess.TimeoutExpired:
            self.send_signal(signal.SIGABRT)  # faulthandler prints where each thread hangs
            self.wait()
            raise TimeoutError(f'did not end: {self.output}') from None


@contextlib.contextmanager
def launching(domain: int, folder: Path):
    """Start nodes: ``launch('planner', {'step': 0.1}, 'retrieval')``; all are stopped on exit.

    The first argument may also be the text of a script of several lines. The last arguments are
    parameter files: names of files in ``config/``, or paths.
    """
    with contextlib.ExitStack() as stack:

        def start(
            module: str | Path,
            parameters: dict | None = None,
            *names: str | Path,
            domain: int = domain,
            remapped: dict | None = None,
        ) -> LaunchedProcess:
            if '\n' in str(module):
                text, module = textwrap.dedent(str(module)), folder / f'script-{next(_numbers)}.py'
                module.write_text(text)
            script = [str(module)] if isinstance(module, Path) else ['-m', PACKAGES[module]]
            words = [sys.executable, *script, '--ros-args']
            for name in names:
                file = name if isinstance(name, Path) else ROOT / 'config' / f'{name}.yaml'
                words += ['--params-file', str(file)]
            for parameter, value in (parameters or {}).items():
                words += ['-p', f'{parameter}:={value}']
            for name, other in (remapped or {}).items():
                words += ['-r', f'{name}:={other}']
            log = folder / f'{Path(module).stem}-{next(_numbers)}.log'
            with mock.patch.dict(os.environ, ROS_DOMAIN_ID=str(domain)):
                process = LaunchedProcess(str(module), words, log)
            stack.callback(process.stop)
            return process

        yield start


class Observer:
    """A node controlled by a test, spun until a condition holds.

    Args:
        domain: DDS domain; by default the environment's.
        executor: type of the executor that spins the node.

    Attributes:
        node: for publishers and clients.
        domain: DDS domain.
    """

    def __init__(self, domain: int | None = None, executor: str = 'wait_set') -> None:
        from orbimpc_ros.ros.process import attached

        self.domain = domain
        self._stack = contextlib.ExitStack()
        attaching = attached('observer', executor, enable_rosout=False)
        with mock.patch.dict(os.environ, {'ROS_DOMAIN_ID': str(domain)} if domain else {}):
            self.node, self._executor = self._stack.enter_context(attaching)
        self._subscriptions: dict[str, Any] = {}

    def close(self) -> None:
        """Destroy the node."""
        self._stack.close()

    def listen(self, kind: Any, topic: str, profile: Any = None) -> list:
        """Subscribe to a topic; return the list to which its messages are appended."""
        heard: list = []
        self.subscribe(kind, topic, heard.append, profile)
        return heard

    def subscribe(
        self, kind: Any, topic: str, heard: Callable[..., None], profile: Any = None
    ) -> None:
        """Call ``heard`` with each message of a topic (and its info, if it takes two arguments)."""
        from orbimpc_ros.ros.process import qos

        subscription = self.node.create_subscription(kind, topic, heard, profile or qos(KEPT))
        self._subscriptions[topic] = subscription

    def until_connected(self, *topics: str) -> None:
        """Spin until each subscribed topic has a publisher, so that no later message is missed."""
        for topic in topics:
            subscription = self._subscriptions[topic]
            self.until(
                lambda s=subscription: s.get_publisher_count() > 0, f'a publisher of {topic}'
            )

    def spin_once(self, seconds: float) -> None:
        """Spin until one callback has run, at most for a time [s]."""
        self._executor.spin_once(timeout_sec=max(0.0, seconds))

    def spin(self, seconds: float, done: Callable[[], bool] = lambda: False) -> None:
        """Spin for a time [s], or until ``done``."""
        end = time.monotonic() + seconds
        while not done() and (left := end - time.monotonic()) > 0.0:
            self.spin_once(min(left, 0.05))

    def until(self, happened: Callable[[], Any], what: str = '') -> None:
        """Spin until a condition holds.

        Raises:
            AssertionError: it does not hold within ``PATIENCE``.
        """
        seen: list[Any] = []

        def done() -> bool:
            seen[:] = [happened()]
            return bool(seen[0])

        self.spin(PATIENCE, done)
        assert seen[0], f'in vain: {what or happened}'

    def call(self, kind: Any, name: str, request: Any) -> Any:
        """Call a service and return its response."""
        client = self.node.create_client(kind, name)
        self.until(client.service_is_ready, name)
        future = client.call_async(request)
        self.until(future.done, name)
        self.node.destroy_client(client)
        return future.result()


def wait_for(happened: Callable[[], Any]) -> None:
    """Wait until a condition holds.

    Raises:
        AssertionError: it does not hold within ``PATIENCE``.
    """
    end = time.monotonic() + PATIENCE
    while not happened():
        assert time.monotonic() < end, f'in vain: {happened}'
        time.sleep(0.05)


def children_of(parent: int) -> list[int]:
    """Return the process ids of the children of a process."""
    words = ['ps', '-o', 'pid=', '--ppid', str(parent)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    return [int(pid) for pid in done.stdout.split()]


def alive(pid: int) -> bool:
    """Return True if a process runs; zombies, which a killed parent may leave, do not count."""
    try:
        os.kill(pid, 0)
        state = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0]
    except (ProcessLookupError, FileNotFoundError):
        return False
    return state != 'Z'
