# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The content of messages in plain numbers, whoever decoded them."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.rotations import from_quaternion


def seconds(message: Any) -> float:
    """Return the stamp of a message with a header [s]."""
    return message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec


def point(vector: Any) -> Array:
    """Return a Point or Vector3, shape (3,)."""
    return np.array([vector.x, vector.y, vector.z])


def attitude(q: Any) -> Array:
    """Return a Quaternion as a rotation, shape (3, 3)."""
    return from_quaternion(np.array([q.w, q.x, q.y, q.z]), 3)


def fields(message: Any) -> dict[str, Any]:
    """Return the values of a DiagnosticArray's first status by key, numbers as numbers."""
    return {pair.key: _value(pair.value) for pair in message.status[0].values}


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text
