# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Nodes under test: processes in a domain of their own, and the monitor that hears them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped

from benchmarks.faults.monitor import Limits, Monitor
from benchmarks.test_node import TestNode
from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.run.processes import Process

Some = TypeVar('Some', bound='Session')
PATIENCE = 60.0  # [s] for anything awaited, on a busy machine too


@dataclass(frozen=True)
class Place:
    """Where processes run.

    Attributes:
        folder: takes parameters and logs.
        domain: of ROS, nobody else's.
        executor: of the nodes.
    """

    folder: Path
    domain: int
    executor: str


class Session:
    """Processes that are stopped, the last one first, when the session ends.

    Args:
        place: of the processes.
        limits: of commands.

    Attributes:
        folder: takes parameters and logs.
        domain: of ROS, nobody else's.
        monitor: hears commands, ticks and diagnostics.
        test_node: publishes and subscribes in the domain.
    """

    def __init__(self, place: Place, limits: Limits) -> None:
        self.folder, self.domain, self._executor = place.folder, place.domain, place.executor
        self.monitor, self.test_node = Monitor(limits), TestNode(place.domain)
        self.test_node.subscribe(TwistStamped, 'cmd_vel', self.monitor.on_command)
        self.test_node.subscribe(DiagnosticArray, 'tick', self.monitor.on_tick)
        self.test_node.subscribe(DiagnosticArray, '/diagnostics', self.monitor.on_health)
        self._processes: list[Process] = []

    def launch(self, module: str, values: Mapping[str, Any]) -> Process:
        """Return a new process of a node's module with parameters."""
        name = f'{module.rpartition(".")[2]}-{len(self._processes) + 1}'
        file = self.folder / f'{name}.yaml'
        settings.write(file, {**values, 'executor': self._executor})
        process = Process(module, file, file.with_suffix('.log'), self.domain)
        self._processes.append(process)
        return process

    def spin(self, seconds: float, done: Callable[[], bool] = lambda: False) -> None:
        """Listen for a while, or until ``done``."""
        self.test_node.spin_until(time.monotonic() + seconds, done)

    def until(self, done: Callable[[], bool], what: str) -> None:
        """Spin until ``done``.

        Raises:
            OrbimpcError: it never is, or the last process has ended.
        """
        self.spin(PATIENCE, lambda: done() or not self._processes[-1].running)
        if not done():
            self._processes[-1].require_health()
            raise OrbimpcError(f'waited {PATIENCE:g} s in vain for {what}')

    def until_first(self, event: Callable[..., float], since: float, *about: str) -> float:
        """Spin until an event of the monitor since a time [s]; return when, infinite for never."""
        self.spin(PATIENCE, lambda: event(since, *about) < math.inf)
        return event(since, *about)

    def __enter__(self: Some) -> Some:
        return self

    def __exit__(self, *_error: object) -> None:
        for process in reversed(self._processes):
            process.stop()
        self.test_node.close()
