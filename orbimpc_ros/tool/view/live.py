# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A viewer of running nodes: it only listens, and draws messages as they come."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import ExitStack, closing
from typing import Any

import rerun as rr
from rclpy.parameter import parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.task import Future

from orbimpc_ros.ros.parameters.planner import PLANNER
from orbimpc_ros.ros.process import RANGE, attached, qos
from orbimpc_ros.sim.parameters import SIM
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.topics import VEHICLE
from orbimpc_ros.tool.view.scene import Scene

SPIN = 0.05  # [s]
ASK = 2.0  # [s] between questions for parameters: they may change, nodes may come later
DEPTH = 20  # a viewer that is behind loses messages; it never holds a controller up
NODES = {'sim': SIM, 'planner': PLANNER}


class Watcher:
    """Listens to one vehicle and draws it.

    Args:
        namespace: of the vehicle, such as ``/uav1``.
        recording: to draw into.
    """

    def __init__(self, namespace: str, recording: rr.RecordingStream) -> None:
        os.environ.setdefault(RANGE, 'LOCALHOST')
        self._stack = ExitStack()
        self._node, self._executor = self._stack.enter_context(
            attached('viewer', namespace=namespace or '/')
        )
        self._learned: dict[str, settings.Values] = {name: {} for name in NODES}
        self._scene = Scene(recording, settings.read('{}'))
        # What is kept for those who come late is only handed over reliably.
        kept = qos(1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        latest = qos(DEPTH, ReliabilityPolicy.BEST_EFFORT)
        for topic in VEHICLE:
            if topic.name in self._scene.topics:
                take: Any = lambda heard, name=topic.name: self._scene.take(name, heard)  # noqa: E731
                profile = kept if topic.latched else latest
                self._node.create_subscription(topic.message, topic.name, take, profile)
        self._clients = {name: AsyncParameterClient(self._node, name) for name in NODES}
        self._node.create_timer(ASK, self._ask)

    def _ask(self) -> None:
        for name, client in self._clients.items():
            if client.services_are_ready():
                names = [row.name for row in NODES[name]]
                answer = client.get_parameters(names)
                answer.add_done_callback(lambda done, name=name: self._learn(name, done))

    def _learn(self, node: str, answer: Future) -> None:
        """Draw anew what depends on parameters, if they have changed."""
        response: Any = answer.result()
        found = map(parameter_value_to_python, response.values if response is not None else ())
        values = {row.name: value for row, value in zip(NODES[node], found, strict=False)}
        if values and values != self._learned[node]:
            self._learned[node] = values
            known = self._learned['sim'] | self._learned['planner']
            self._scene.configure(settings.read('{}') | known)

    def spin(self) -> None:
        """Draw what comes for a while."""
        self._executor.spin_once(timeout_sec=SPIN)

    def close(self) -> None:
        """Stop listening."""
        self._stack.close()


def draw(namespace: str, recording: rr.RecordingStream, going: Callable[[], bool]) -> None:
    """Draw what runs now for as long as ``going()``."""
    with closing(Watcher(namespace, recording)) as watcher:
        while going():
            watcher.spin()
