# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Markers to bodies: the topic ``obstacles``, and the marker that shows a body.

What a marker covers is what counts, so that a body is never smaller than its marker. A turned cube
becomes the box around it; a cylinder the sphere or the box around it, whichever is smaller, and in
the plane a disc, like a sphere. Where an ellipse is meant, the longest axis counts. In the plane
everything is what it looks like from above.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import Vector3
from visualization_msgs.msg import Marker, MarkerArray

from orbimpc_ros.loop.traffic import ObservedBody
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import from_quaternion
from orbimpc_ros.mpc.problem import Ball, Box
from orbimpc_ros.ros.messages import (
    LARGEST,
    LONGEST_FRAME,
    SECOND,
    Frames,
    Stamp,
    point,
    read_sighting,
    vector,
)

KINDS = {Marker.CUBE: 'CUBE', Marker.SPHERE: 'SPHERE', Marker.CYLINDER: 'CYLINDER'}
FLAT = 0.02  # [m] height of what is shown of a plane


def read_obstacle(
    marker: Marker,
    dimension: int,
    frames: Frames,
    placed: Callable[[Any], Any] = lambda marker: marker,
) -> tuple[Stamp, ObservedBody] | str | None:
    """Return the body that a marker shows, with its stamp, or what it removes.

    That is the name of a body, or None for all of them.

    Args:
        marker: in a message on ``obstacles``.
        dimension: 2 for what it looks like from above.
        frames: that it must be in.
        placed: moves what has a header and a pose to the frame that it must be in.

    Raises:
        BadInput: its action, kind, frame, stamp, pose, scale or lifetime is not acceptable.
    """
    if marker.action == Marker.DELETEALL:
        return None
    if len(marker.ns) > LONGEST_FRAME:
        raise BadInput('ns', repr(marker.ns), f'at most {LONGEST_FRAME} characters')
    name = f'{marker.ns}/{marker.id}'
    if marker.action == Marker.DELETE:
        return name
    if marker.action != Marker.ADD:
        raise BadInput('action', marker.action, 'ADD or MODIFY (0) | DELETE (2) | DELETEALL (3)')
    if marker.type not in KINDS:
        allowed = ' | '.join(f'{name} ({kind})' for kind, name in KINDS.items())
        raise BadInput('type', marker.type, allowed)
    there = placed(marker)
    stamp, place = read_sighting(there, 3, frames)  # has the header and the pose of one
    q = there.pose.orientation
    unit = np.array([q.w, q.x, q.y, q.z])
    turned = from_quaternion(unit / math.sqrt(unit @ unit), 3)
    body = _body(marker.type, place.position, turned, _scale(marker.scale), dimension)
    return stamp, ObservedBody(name, place.time, body, _lifetime(marker))


def stamp_of(message: MarkerArray) -> int:
    """Return the stamp of the first marker [ns], however nonsensical; 0 without any."""
    first = next(iter(message.markers), None)
    return 0 if first is None else first.header.stamp.sec * SECOND + first.header.stamp.nanosec


def _scale(scale: Vector3) -> Array:
    sizes = np.array([scale.x, scale.y, scale.z])
    if not ((sizes > 0.0) & (sizes <= LARGEST)).all():  # also refuses NaN
        raise BadInput('scale', sizes.tolist(), f'sizes above 0, at most {LARGEST:g}')
    return sizes


def _lifetime(marker: Marker) -> float:
    """Return how long a body is there unless it is seen again [s]; 0 stands for ever."""
    given = marker.lifetime
    if given.sec < 0 or given.nanosec >= SECOND:
        raise BadInput('lifetime', [given.sec, given.nanosec], '0 or more seconds')
    return given.sec + given.nanosec / SECOND or math.inf


def _body(kind: int, middle: Array, turned: Array, size: Array, dimension: int) -> Box | Ball:
    """Return what a marker covers.

    Args:
        kind: of the marker.
        middle: shape (3,) [m].
        turned: its own axes in the world, shape (3, 3).
        size: along its own axes, shape (3,) [m].
        dimension: 2 for what it looks like from above.
    """
    half, n = 0.5 * size, dimension
    if kind == Marker.SPHERE:
        return Ball(middle[:n], float(half.max()))
    if kind == Marker.CUBE:
        reach = (np.abs(turned) @ half)[:n]
        return Box(middle[:n] - reach, middle[:n] + reach)
    radius, axis = float(half[:2].max()), turned[:, 2]
    if n == 2:  # a lying cylinder looks longer than it is wide
        return Ball(middle[:2], radius + float(half[2]) * math.hypot(*axis[:2]))
    across = np.sqrt(np.maximum(0.0, 1.0 - axis**2))  # of the cylinder's disc, along each axis
    reach, around = half[2] * np.abs(axis) + radius * across, math.hypot(radius, half[2])
    if 8.0 * float(reach.prod()) < 4.0 / 3.0 * math.pi * around**3:
        return Box(middle - reach, middle + reach)
    return Ball(middle, around)


def shown(marker: Marker, body: Box | Ball) -> Marker:
    """Return a marker that shows a body, whatever it showed before."""
    if isinstance(body, Ball):
        marker.type, middle = Marker.SPHERE, body.centre
        sizes = np.full(body.dimension, 2.0 * body.radius)
    else:
        marker.type, middle = Marker.CUBE, 0.5 * (body.minimum + body.maximum)
        sizes = body.maximum - body.minimum
    if body.dimension == 2:
        marker.type = Marker.CYLINDER if isinstance(body, Ball) else Marker.CUBE
        sizes, middle = np.append(sizes, FLAT), np.append(middle, 0.0)
    marker.pose.position = point(middle)
    marker.scale = vector(sizes)
    return marker
