# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A DDS domain with nodes in child processes, and an observer in this process."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from unittest import mock

from harness import Observer

from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.processes import Child, Processes, isolate

PATIENCE = 60.0  # [s] for any event, even on a busy machine
PLANNER = 'orbimpc_ros.ros.planner'  # the module of the node


class Session(Observer):
    """An observer that starts nodes, which end with it.

    Args:
        nodes: their executor.
        executor: the observer's own.

    Attributes:
        folder: for parameters and logs until the session ends.
        environment: of its processes.
        processes: of the nodes.
    """

    def __init__(self, nodes: str, executor: str = 'wait_set') -> None:
        place = ExitStack()
        self.folder = Path(place.enter_context(tempfile.TemporaryDirectory()))
        with mock.patch.dict(os.environ):
            super().__init__(isolate(self.folder), executor)
            self.environment = dict(os.environ)
        self.processes = Processes()
        for context in (place, self.processes):
            self._stack.push(context)
        self._nodes = nodes

    def launch(self, module: str, values: Mapping[str, Any], namespace: str = '') -> Child:
        """Return a new process of a node's module with parameters."""
        name = f'{module.rpartition(".")[2]}-{len(self.processes) + 1}'
        file = self.folder / f'{name}.yaml'
        file.write_text(settings.text({**values, 'executor': self._nodes}))
        with mock.patch.dict(os.environ, self.environment):
            return self.processes.start(module, file, file.with_suffix('.log'), namespace)

    def until(self, done: Callable[[], Any], what: str = '') -> None:
        """Spin until ``done``.

        Raises:
            OrbimpcError: ``done`` never becomes true, or the last process has ended.
        """
        self.spin(PATIENCE, lambda: bool(done()) or self.processes[-1].poll() is not None)
        if not done():
            self.processes[-1].require_health()
            said = self.processes[-1].output.splitlines()[-3:]
            raise OrbimpcError('; '.join([f'waited {PATIENCE:g} s in vain for {what}', *said]))
