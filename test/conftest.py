# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Fixtures and hooks: DDS domains, node processes and observers, --quick, a memory limit."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import signal
from collections.abc import Iterable, Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
from harness import Observer, launching, new_domain

os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    # Background jobs of a shell inherit an ignored SIGINT, and so do their children; tests send it.
    signal.signal(signal.SIGINT, signal.default_int_handler)
# Fixtures of tests that start processes or communicate over DDS.
PROCESSES = {'domain', 'launch', 'observer', 'shared', 'short', 'workspace', 'default_context'}
FLIGHTS = {
    *('test_ros_crossing', 'test_ros_physics', 'test_ros_vehicles', 'test_package_colcon'),
    'test_tool_demo',
}  # modules with whole flights and installations


class TestModule(pytest.Module):
    """A test module; skipped if it imports a package of ROS that is not installed."""

    def collect(self) -> Iterable[pytest.Item | pytest.Collector]:
        try:
            return super().collect()
        except self.CollectError as error:
            missing = error.__cause__
            if find_spec('rclpy') is None and isinstance(missing, ModuleNotFoundError):
                pytest.skip(f'no {missing.name}: needs ROS 2, or pip install orbimpc_ros[ros]')
            raise


@pytest.hookimpl(tryfirst=True)
def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> pytest.Module:
    """Create the module here, so that pytest imports it and limits a skip to this module.

    ROS's launch_testing plugin imports every module in this hook, where a module-level
    ``importorskip`` would skip the whole collection.
    """
    return TestModule.from_parent(parent, path=module_path)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption('--quick', action='store_true', help='pure tests, one case of each')


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """With ``--quick`` keep the first case of each test without processes or long flights."""
    if not config.getoption('--quick', default=False):
        return
    first, rest = {}, []
    for item in items:
        pure = not PROCESSES.intersection(item.fixturenames) and item.path.stem not in FLIGHTS
        law = (item.path, item.originalname)
        if pure and first.setdefault(law, item) is item:
            continue
        rest.append(item)
    config.hook.pytest_deselected(items=rest)
    items[:] = first.values()


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Fail if no test has run: colcon takes pytest's own exit code for that as success."""
    if exitstatus == pytest.ExitCode.NO_TESTS_COLLECTED:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


MOST_MEMORY = 6.0e6  # [kB] peak in one test, including everything loaded before it
MUCH = 1.0e6  # [kB] resident above which glibc likely keeps freed memory
PROC = Path('/proc/self')


@pytest.fixture(autouse=True)
def _little_memory() -> Iterator[None]:
    """Fail a test whose peak memory is too high, and return freed memory to the system."""
    try:
        (PROC / 'clear_refs').write_text('5')  # resets the peak
    except OSError:  # not Linux, or no permission
        yield
        return
    yield
    lines = (PROC / 'status').read_text().splitlines()
    known = {name: int(value.split()[0]) for name, value in map(_status, lines) if 'kB' in value}
    if known['VmRSS'] > MUCH:
        gc.collect()
        with contextlib.suppress(OSError, AttributeError):  # another C library
            ctypes.CDLL(None).malloc_trim(0)
    assert known['VmHWM'] < MOST_MEMORY, f'it took {1e-6 * known["VmHWM"]:.2f} GB'


def _status(line: str) -> tuple[str, str]:
    name, _, value = line.partition(':')
    return name, value


@pytest.fixture
def domain() -> int:
    return new_domain()


@pytest.fixture
def default_context():
    """A fresh default context of rclpy: a context can be initialised only once."""
    from rclpy.utilities import get_default_context

    get_default_context(shutting_down=True)
    yield get_default_context()
    get_default_context(shutting_down=True).try_shutdown()


@pytest.fixture
def tool(capsys):
    """Return a function that runs a tool command in this process: (exit code, stdout, stderr)."""
    from orbimpc_ros.tool import cli

    def run(*words):
        capsys.readouterr()
        code = cli.main([str(word) for word in words])
        return code, *capsys.readouterr()

    return run


@pytest.fixture
def launch(domain, tmp_path):
    with launching(domain, tmp_path) as start:
        yield start


@pytest.fixture
def observer(domain):
    with contextlib.closing(Observer(domain)) as seen:
        yield seen


@pytest.fixture(scope='module')
def shared(tmp_path_factory):
    """``launch`` and ``observer`` for a whole module, since DDS discovery is slow."""
    domain = new_domain()
    with (
        contextlib.closing(Observer(domain)) as seen,
        launching(domain, tmp_path_factory.mktemp('shared')) as start,
    ):
        yield start, seen
