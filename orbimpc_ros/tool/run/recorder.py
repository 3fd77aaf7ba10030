# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A recorder of a run: messages byte by byte as they come, under the stamps they carry."""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rosgraph_msgs.msg import Clock

from orbimpc_ros.ros.messages import SECOND, time_message
from orbimpc_ros.ros.process import LATCHED, LATEST, attached, qos
from orbimpc_ros.ros.topics import Topic
from orbimpc_ros.tool.bags import BagWriter

DEPTH = 1000  # a slow disk must not cost messages
TRIGGER = 'odom'  # a lock-step simulator starts as soon as it has its subscribers
STAMP_AT = 4  # after CDR's own four bytes, where a message begins with its stamp
UNSTAMPED = ('std_msgs/msg/Bool', 'std_msgs/msg/Float64', 'std_msgs/msg/UInt8MultiArray')
STAMP_ELSEWHERE = {
    **dict.fromkeys(UNSTAMPED),
    'visualization_msgs/msg/MarkerArray': 8,
}
AGAIN = 5.0  # [s] until a planner that has not answered is called again


def carried(data: bytes, kind: str) -> int | None:
    """Return the stamp [ns] that a serialised message carries; None if it has none that is valid.

    Args:
        data: the message in CDR.
        kind: its type.
    """
    place = STAMP_ELSEWHERE.get(kind, STAMP_AT)
    if place is None or len(data) < place + 8:
        return None
    seconds, nanoseconds = struct.unpack_from('<iI' if data[1] & 1 else '>iI', data, place)
    return seconds * SECOND + nanoseconds if seconds >= 0 and nanoseconds < SECOND else None


class Recorder:
    """A node that writes what it hears into a bag.

    A message goes under the stamp it carries, so that the bag plays at the speed of the run
    however fast that was simulated; one without a stamp goes under the last stamp before it, and
    before the first one is left out. The time of sending is kept, too, for the order in which
    things happened.

    Odometry is subscribed to once every planner has answered a call. DDS announces endpoints in
    the order of their creation: a planner that knows the last one knows every subscription, and
    a simulator that waits for the subscription to odometry finds the recorder complete.

    Args:
        folder: of the bag, created.
        topics: to record.
        notes: kept in the bag's metadata.
        planners: nodes that must know the recorder before odometry is asked for.

    Attributes:
        counts: messages taken, by topic.
        latest: stamp of the last message of a topic [ns].
    """

    def __init__(
        self,
        folder: Path,
        topics: Sequence[Topic],
        notes: dict[str, str],
        planners: Sequence[str] = ('/planner',),
    ) -> None:
        self.counts = dict.fromkeys((topic.name for topic in topics), 0)
        self.latest: dict[str, int] = {}
        self._now: int | None = None  # the last stamp [ns]
        self._bag = BagWriter(folder, topics, notes)
        self._stack = ExitStack()
        self._node, self._executor = self._stack.enter_context(
            attached('recorder', enable_rosout=False, start_parameter_services=False)
        )
        self._held = [topic for topic in topics if topic.name.rpartition('/')[2] == TRIGGER]
        for topic in topics:
            if topic not in self._held:
                self._listen(topic)
        self._unmet = {name: self._client(name) for name in planners}
        self._clock: Any = None
        self._called = dict.fromkeys(planners, -math.inf)  # when, on the steady clock [s]

    def _client(self, planner: str) -> Client:
        """Return a client of a service that every node has."""
        return self._node.create_client(GetParameters, f'{planner}/get_parameters')

    def _meet(self) -> None:
        """Call planners that have not answered yet; when all have, listen to odometry too.

        One that is being configured answers when that is done. Who begins again has lost the call.
        """
        now = time.monotonic()
        for name, client in self._unmet.items():
            if now - self._called[name] >= AGAIN and client.service_is_ready():
                self._called[name] = now
                answer = client.call_async(GetParameters.Request())
                answer.add_done_callback(lambda _, name=name: self._unmet.pop(name, None))
        while self._held and not self._unmet:
            self._listen(self._held.pop())

    def _listen(self, topic: Topic) -> None:
        profile = qos(DEPTH, durability=(LATCHED if topic.latched else LATEST).durability)
        take: Any = self._taking(topic)  # rclpy also gives what is known about the message
        self._node.create_subscription(topic.message, topic.name, take, profile, raw=True)

    def _taking(self, topic: Topic) -> Callable[[bytes, dict[str, Any]], None]:
        def take(data: bytes, about: dict[str, Any]) -> None:
            self.counts[topic.name] += 1
            own = carried(data, topic.type)
            self.latest[topic.name] = own or 0
            self._now = self._now if own is None else own
            if self._now is not None:
                self._bag.write(topic.name, self._now, data, about['source_timestamp'])

        return take

    def publish_clock(self, seconds: float) -> None:
        """Publish a time on /clock, for nodes that have no simulator of their own to do so."""
        if self._clock is None:
            self._clock = self._node.create_publisher(Clock, '/clock', DEPTH)
        self._clock.publish(Clock(clock=time_message(round(seconds * SECOND))))

    def spin(self, seconds: float) -> None:
        """Record for a while, or until something has come."""
        self._meet()
        self._executor.spin_once(timeout_sec=seconds)

    def drain(self, quiet: float, limit: float) -> None:
        """Record on until nothing has come for ``quiet`` seconds, ``limit`` seconds at most."""
        last = time.monotonic()
        end, heard = last + limit, sum(self.counts.values())
        while time.monotonic() < min(end, last + quiet):
            self.spin(quiet / 4)
            if sum(self.counts.values()) != heard:
                last, heard = time.monotonic(), sum(self.counts.values())

    def close(self) -> None:
        """Stop recording and finish the bag; the node ends even if the disk is full."""
        with self._stack:
            self._bag.close()
