# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A bag's messages, drawn in the order of their stamps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rerun as rr

from orbimpc_ros.tool import bags, settings
from orbimpc_ros.tool.view.scene import Scene


@dataclass(frozen=True)
class RecordedFlight:
    """A vehicle's flight in a bag.

    Attributes:
        messages: topics, named without the namespace, and contents, in order of time.
        values: parameters of the run.
    """

    messages: list[tuple[str, Any]]
    values: settings.Values

    def draw(self, recording: rr.RecordingStream) -> None:
        """Draw the flight into a recording."""
        scene = Scene(recording, self.values)
        for topic, content in self.messages:
            scene.take(topic, content)
        recording.flush()


def read(path: Path, namespace: str) -> RecordedFlight:
    """Return a vehicle's flight in a bag.

    Raises:
        BadInput: no bag, or one without odometry and goal of this vehicle.
    """
    values = settings.of_bag(path, namespace) or settings.read('{}')
    return RecordedFlight(bags.of_vehicle(path, namespace), values)
