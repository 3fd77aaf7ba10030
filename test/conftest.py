# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The common ground of tests over DDS: a domain of their own, real processes, and an observer."""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from orbimpc_ros.ros.entry import PACKAGES
from orbimpc_ros.tool.run.discovery import claimed, free

os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    # A shell has its background jobs ignore SIGINT, and these all that they start; tests send it.
    signal.signal(signal.SIGINT, signal.default_int_handler)
ROOT = Path(__file__).resolve().parents[1]
PATIENCE = 240.0  # [s] for anything awaited: enough with ten processes for each core, too

_numbers = itertools.count()


@pytest.hookimpl(tryfirst=True)
def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> pytest.Module:
    """Leave importing a module to pytest, which takes a skip there as this module's alone.

    The pytest plugin of ROS's launch_testing imports every module in this very hook, where a
    module-level ``importorskip`` skips the collection of everything.
    """
    return pytest.Module.from_parent(parent, path=module_path)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption('--jitter', type=float, default=0.0, help='moves starts and goals [m]')


def pytest_configure(config: pytest.Config) -> None:
    if size := config.getoption('--jitter', 0.0):
        _move_what_is_solved(size)


def _move_what_is_solved(size: float) -> None:
    """Move the starts and goals of all solves at random by about so much [m], always alike."""
    import numpy as np

    from orbimpc_ros.mpc.solve.solver import Solver

    def moving(solve):
        def moved(self, state, goals, *known, **others):
            rng = np.random.default_rng(0)
            try:
                start = state.position + size * rng.normal(size=state.dimension)
                goals = np.asarray(goals) + size * rng.normal(size=np.shape(goals))
            except (AttributeError, TypeError):  # what no solver takes is left to it
                return solve(self, state, goals, *known, **others)
            return solve(self, replace(state, position=start), goals, *known, **others)

        return moved

    Solver.solve, Solver.propose = moving(Solver.solve), moving(Solver.propose)


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Fail where no test has run: colcon takes pytest's own exit code for that as success."""
    if exitstatus == pytest.ExitCode.NO_TESTS_COLLECTED:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def new_domain() -> int:
    """Return a DDS domain that no other test uses, nor anybody else on this machine just now.

    Workers that run tests side by side draw from domains of their own.
    """
    workers = int(os.environ.get('PYTEST_XDIST_WORKER_COUNT', '1'))
    own = int(os.environ.get('PYTEST_XDIST_WORKER', 'gw0')[2:])
    count = 100 // workers
    drawn = [
        1 + own + workers * ((13 * os.getpid() + next(_numbers)) % count) for _ in range(count)
    ]
    # Where many suites run at a time all may be claimed, though most stand empty.
    return next(filter(claimed, drawn), None) or next(filter(free, drawn))


@pytest.fixture
def domain() -> int:
    return new_domain()


@pytest.fixture
def default_context():
    """The context of nodes that are made without one, fresh: it can be started only once."""
    from rclpy.utilities import get_default_context

    get_default_context(shutting_down=True)
    yield get_default_context()
    get_default_context(shutting_down=True)


class LaunchedProcess:
    """A node in a process of its own, its output kept: a module's, or a test's own script's."""

    def __init__(
        self,
        module: str | Path,
        domain: int,
        log: Path,
        parameters: dict,
        files: list[Path],
        remapped: dict,
    ) -> None:
        runs = [str(module)] if isinstance(module, Path) else ['-m', PACKAGES[module]]
        command = [sys.executable, *runs, '--ros-args']
        for file in files:
            command += ['--params-file', str(file)]
        for name, value in parameters.items():
            command += ['-p', f'{name}:={value}']
        for name, other in remapped.items():
            command += ['-r', f'{name}:={other}']
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain), 'PYTHONFAULTHANDLER': '1'}
        self._log = log
        with log.open('wb') as output:
            self._process = subprocess.Popen(
                command, env=environment, stdout=output, stderr=subprocess.STDOUT, cwd=log.parent
            )

    @property
    def output(self) -> str:
        return self._log.read_text()

    @property
    def ended(self) -> bool:
        return self._process.poll() is not None

    def tell(self, number: int) -> None:
        self._process.send_signal(number)

    def wait(self) -> int:
        return self._process.wait(PATIENCE)

    def stop(self) -> int:
        if not self.ended:
            self.tell(signal.SIGINT)
        try:
            return self.wait()
        except subprocess.TimeoutExpired:
            self.tell(signal.SIGABRT)  # says where each of its threads hangs
            self._process.wait(PATIENCE)
            pytest.fail(f'did not end: {self.output}')


@contextlib.contextmanager
def launching(domain: int, folder: Path):
    """Start nodes: ``launch('planner', {'step': 0.1}, 'retrieval')``; all are stopped at the end.

    The last arguments are parameter files: the names of those in ``config/``, or paths.
    """
    with contextlib.ExitStack() as stack:

        def start(
            module: str | Path,
            parameters: dict | None = None,
            *names: str | Path,
            domain: int = domain,
            remapped: dict | None = None,
        ) -> LaunchedProcess:
            files = [
                name if isinstance(name, Path) else ROOT / 'config' / f'{name}.yaml'
                for name in names
            ]
            log = folder / f'{Path(module).stem}-{next(_numbers)}.log'
            process = LaunchedProcess(module, domain, log, parameters or {}, files, remapped or {})
            stack.callback(process.stop)
            return process

        yield start


@pytest.fixture
def launch(domain, tmp_path):
    with launching(domain, tmp_path) as start:
        yield start


class Observer:
    """A third process's view: this test's own node, spun until something has happened."""

    def __init__(self, domain: int) -> None:
        from orbimpc_ros.ros.process import attached

        self.domain = domain
        self._stack = contextlib.ExitStack()
        self.node, self._executor = self._stack.enter_context(attached('observer', domain=domain))
        self._subscriptions: dict = {}

    def close(self) -> None:
        self._stack.close()

    def listen(self, kind, topic, qos=None) -> list:
        """Return the list that messages on a topic will be added to."""
        from orbimpc_ros.ros.process import qos as kept

        heard: list = []
        self._subscriptions[topic] = self.node.create_subscription(
            kind, topic, heard.append, qos or kept(1000)
        )
        return heard

    def until_connected(self, *topics: str) -> None:
        """Spin until each topic listened to has a publisher: it will miss nothing from then on."""
        for topic in topics:
            subscription = self._subscriptions[topic]
            self.until(lambda s=subscription: s.get_publisher_count() > 0, f'who says {topic}')

    def until(self, happened, what: str = '') -> None:
        """Spin until ``happened()``; fail when that takes too long."""
        end = time.monotonic() + PATIENCE
        while not happened():
            assert time.monotonic() < end, f'in vain: {what or happened}'
            self._executor.spin_once(timeout_sec=0.02)

    def call(self, kind, name: str, request):
        """Return a service's response."""
        client = self.node.create_client(kind, name)
        self.until(client.service_is_ready, name)
        future = client.call_async(request)
        self.until(future.done, name)
        return future.result()


@pytest.fixture
def observer(domain):
    with contextlib.closing(Observer(domain)) as seen:
        yield seen


@pytest.fixture(scope='module')
def shared(tmp_path_factory):
    """``launch`` and ``observer`` for a whole module: processes are slow to meet."""
    domain = new_domain()
    with (
        contextlib.closing(Observer(domain)) as seen,
        launching(domain, tmp_path_factory.mktemp('shared')) as start,
    ):
        yield start, seen


@pytest.fixture
def observers():
    """Five observers, each in a domain of its own."""
    seen = [Observer(new_domain()) for _ in range(5)]
    yield seen
    for each in seen:
        each.close()
