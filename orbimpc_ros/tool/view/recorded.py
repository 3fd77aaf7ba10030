"""A bag's messages, drawn in the order of their stamps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rerun as rr

from orbimpc_ros.tool.io import bag, settings
from orbimpc_ros.tool.io.topics import absent
from orbimpc_ros.tool.view.scene import Scene

NEEDED = ('odom', 'goal')


@dataclass(frozen=True)
class Recorded:
    """A vehicle's flight in a bag.

    Attributes:
        messages: topics, named without the namespace, and contents, in order of time.
        values: parameters of the run.
    """

    messages: tuple[tuple[str, Any], ...]
    values: settings.Values

    def draw(self, recording: rr.RecordingStream) -> None:
        """Draw the flight into a recording."""
        scene = Scene(recording, self.values)
        for topic, content in self.messages:
            scene.take(topic, content)
        recording.flush()


def read(path: Path, namespace: str) -> Recorded:
    """Return a vehicle's flight in a bag.

    Raises:
        BadInput: no bag, or one without odometry and goal of this vehicle.
    """
    values = settings.of_bag(path, namespace) or settings.read('{}')
    found, heard = [], set()
    for message in bag.read(path):
        heard.add(message.topic)
        before, _, name = message.topic.rpartition('/')
        if before == namespace:
            found.append((name, message.content))
    for topic in NEEDED:
        if f'{namespace}/{topic}' not in heard:
            raise absent(path, f'{namespace}/{topic}', heard)
    return Recorded(tuple(found), values)
