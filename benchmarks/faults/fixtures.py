# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Fixtures of fault cases: folders, domains, and harnesses that several rows share."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import Any

from benchmarks.faults.harness import Harness
from benchmarks.faults.session import Place
from orbimpc_ros.mpc.kernels.__main__ import PARTS
from orbimpc_ros.tool.run import discovery


class Fixtures(AbstractContextManager['Fixtures']):
    """Hands out harnesses; those that rows share live until the fixtures are closed.

    Machine code is compiled first: a planner that has to do so itself answers nothing for so long.

    Args:
        folder: takes what processes need and print.
        executor: of the nodes.
    """

    def __init__(self, folder: Path, executor: str = 'wait_set') -> None:
        self._folder, self._executor, self._count = folder, executor, 0
        self._shared: dict[str, Harness] = {}
        self._stack = ExitStack()
        for part in PARTS:
            part()

    def place(self) -> Place:
        """Return a place with a folder and a DDS domain of its own."""
        self._count += 1
        folder = self._folder / f'{self._count:03}'
        folder.mkdir()
        return Place(folder, discovery.isolate(folder), self._executor)

    def harness(self, parameters: Mapping[str, Any] | None = None, **more: Any) -> Harness:
        """Return a harness of one's own, to be closed."""
        return Harness(self.place(), parameters, **more)

    def shared(
        self, name: str, parameters: Mapping[str, Any] | None = None, **more: Any
    ) -> Harness:
        """Return the harness of a name, made when first asked for; its planner runs."""
        if name not in self._shared:
            self._shared[name] = self._stack.enter_context(self.harness(parameters, **more))
        harness = self._shared[name]
        if not harness.planner.running:
            harness.start()
        return harness

    def clear(self) -> None:
        """Close the shared harnesses; whoever asks for one gets a new one."""
        self._shared.clear()
        self._stack.close()

    def __exit__(self, *_error: object) -> None:
        self.clear()
