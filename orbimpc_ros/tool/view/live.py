# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A viewer of running nodes: it only listens, and draws messages as they come."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from typing import Any

import rerun as rr
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.task import Future

from orbimpc_ros.ros.parameters.planner import PLANNER
from orbimpc_ros.ros.process import LATCHED, LATEST, RANGE, attached, qos
from orbimpc_ros.ros.topics import VEHICLE
from orbimpc_ros.sim.parameters import SIM
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.view.scene import Scene

SPIN = 0.05  # [s]
ASK = 2.0  # [s] between questions for parameters: they may change, nodes may come later
DEPTH = 20  # a viewer that is behind loses messages; it never holds a controller up
NODES = {'sim': SIM, 'planner': PLANNER}


class ParameterWatch:
    """Asks a vehicle's nodes for their parameters, and has a scene show them.

    Args:
        node: that asks.
        scene: of the vehicle.
    """

    def __init__(self, node: Node, scene: Scene) -> None:
        self._scene = scene
        self._learned: dict[str, settings.Values] = {name: {} for name in NODES}
        self._clients = {name: AsyncParameterClient(node, name) for name in NODES}
        node.create_timer(ASK, self._ask)

    def _ask(self) -> None:
        for name, client in self._clients.items():
            if client.services_are_ready():
                answer = client.get_parameters([row.name for row in NODES[name]])
                answer.add_done_callback(partial(self._learn, name))

    def _learn(self, node: str, answer: Future) -> None:
        """Draw anew what depends on parameters, if they have changed."""
        response: Any = answer.result()
        found = map(parameter_value_to_python, response.values if response is not None else ())
        values = {row.name: value for row, value in zip(NODES[node], found, strict=False)}
        if values and values != self._learned[node]:
            self._learned[node] = values
            known = self._learned['sim'] | self._learned['planner']
            self._scene.configure(settings.read('{}') | known)


def draw(namespace: str, recording: rr.RecordingStream, going: Callable[[], bool]) -> None:
    """Draw the vehicle that runs now in a namespace, such as ``/uav1``, while ``going()``."""
    os.environ.setdefault(RANGE, 'LOCALHOST')
    scene, latest = Scene(recording, settings.read('{}')), qos(DEPTH, LATEST.reliability)
    with attached('viewer', namespace=namespace or '/') as (node, executor):
        for topic in VEHICLE:
            if topic.name in scene.topics:
                # What is kept for those who come late is only handed over reliably.
                profile = LATCHED if topic.latched else latest
                take: Any = partial(scene.take, topic.name)
                node.create_subscription(topic.message, topic.name, take, profile)
        ParameterWatch(node, scene)
        while going():
            executor.spin_once(timeout_sec=SPIN)
