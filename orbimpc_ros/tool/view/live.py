# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A viewer of running nodes: it only listens, and draws messages as they come."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from contextlib import ExitStack
from importlib import import_module
from typing import Any

import rerun as rr
from rclpy.parameter import parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.task import Future

from orbimpc_ros.ros.parameters import PLANNER
from orbimpc_ros.ros.process import RANGE, attached, qos
from orbimpc_ros.sim.parameters import SIM
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.bags import seconds
from orbimpc_ros.tool.topics import VEHICLE, Topic
from orbimpc_ros.tool.view.scene import Scene

SPIN = 0.05  # [s]
ASK = 2.0  # [s] between questions for parameters: they may change, nodes may come later
BACK = 1.0  # [s]: less may be messages out of order
DEPTH = 20  # a viewer that is behind loses messages; it never holds a controller up
NODES = {'sim': SIM, 'planner': PLANNER}


class Watcher:
    """Listens to one vehicle and draws it.

    Args:
        namespace: of the vehicle, such as ``/uav1``.
        recordings: gives one to draw into, at first and whenever the clock has gone back.
    """

    def __init__(self, namespace: str, recordings: Callable[[], rr.RecordingStream]) -> None:
        os.environ.setdefault(RANGE, 'LOCALHOST')
        self._stack = ExitStack()
        self._node, self._executor = self._stack.enter_context(
            attached('viewer', namespace=namespace or '/')
        )
        self._learned: dict[str, settings.Values] = {name: {} for name in NODES}
        self._recordings, self._latest = recordings, -math.inf
        self._scene = Scene(recordings(), self._values)
        for topic in VEHICLE:
            if topic.name in self._scene.topics:
                self._listen(topic)
        self._clients = {name: AsyncParameterClient(self._node, name) for name in NODES}
        self._node.create_timer(ASK, self._ask)

    def _listen(self, topic: Topic) -> None:
        package, _, kind = topic.type.split('/')
        message = getattr(import_module(f'{package}.msg'), kind)
        # What is kept for those who come late is only handed over reliably.
        kept = qos(1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        profile = kept if topic.latched else qos(DEPTH, ReliabilityPolicy.BEST_EFFORT)
        self._node.create_subscription(
            message, topic.name, lambda heard: self.take(topic.name, heard), profile
        )

    def take(self, topic: str, message: Any) -> None:
        """Draw a message, into a new recording where a simulator was started anew."""
        if topic == 'odom':
            before, self._latest = self._latest, seconds(message)
            if self._latest < before - BACK:
                self._scene = Scene(self._recordings(), self._values)
        self._scene.take(topic, message)

    def _ask(self) -> None:
        """Ask which parameters there are, then for those that we know: versions may differ."""
        for name, client in self._clients.items():
            if client.services_are_ready():
                listed = client.list_parameters()
                listed.add_done_callback(lambda done, name=name: self._ask_for(name, done))

    def _ask_for(self, name: str, listed: Future) -> None:
        response: Any = listed.result()
        if response is not None:
            there = set(response.result.names)
            names = [row.name for row in NODES[name] if row.name in there]
            answer = self._clients[name].get_parameters(names)
            answer.add_done_callback(lambda done: self._learn(name, names, done))

    def _learn(self, name: str, names: list[str], answer: Future) -> None:
        """Draw anew what depends on parameters, if they have changed."""
        response: Any = answer.result()
        found = map(parameter_value_to_python, response.values if response is not None else ())
        values = dict(zip(names, found, strict=False))
        if values and values != self._learned[name]:
            self._learned[name] = values
            self._scene.configure(self._values)

    @property
    def _values(self) -> settings.Values:
        """Return the parameters of simulator and planner, defaults until they are known."""
        return settings.read('{}') | self._learned['sim'] | self._learned['planner']

    def spin(self) -> None:
        """Draw what comes for a while."""
        self._executor.spin_once(timeout_sec=SPIN)

    def close(self) -> None:
        """Stop listening."""
        self._stack.close()


def draw(
    namespace: str, recordings: Callable[[], rr.RecordingStream], going: Callable[[], bool]
) -> None:
    """Draw what runs now for as long as ``going()``."""
    watcher = Watcher(namespace, recordings)
    try:
        while going():
            watcher.spin()
    finally:
        watcher.close()
