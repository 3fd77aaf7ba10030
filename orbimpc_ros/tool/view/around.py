# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""What a plan stays clear of, as the planner's markers show it: bodies, and where they go."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool.bags import point
from orbimpc_ros.tool.palette import RED, rgb

CUBE = 1  # type of a Marker; every other body is round
TRANSPARENT = rr.components.FillMode.TransparentFillMajorWireframe


def around(message: Any, width: float) -> dict[str, rr.AsComponents]:
    """Return what to draw of the hazards in a planner's markers, by entity.

    Args:
        message: a MarkerArray.
        width: of lines [m].

    Raises:
        BadInput: a number is not finite.
    """
    bodies = [each for each in message.markers if each.ns == 'hazards']
    boxes = _rows([(_middle(m), _half(m)) for m in bodies if m.type == CUBE])
    balls = _rows([(_middle(m), _half(m)) for m in bodies if m.type != CUBE])
    strips = [_way(each.points) for each in message.markers if each.ns == 'ways']
    color = [rgb(RED)]
    ends = [strip[-1] for strip in strips]
    return {
        'boxes': rr.Boxes3D(
            centers=boxes[:, 0], half_sizes=boxes[:, 1], colors=color, fill_mode=TRANSPARENT
        ),
        'balls': rr.Ellipsoids3D(
            centers=balls[:, 0], half_sizes=balls[:, 1], colors=color, fill_mode=TRANSPARENT
        ),
        'ways': rr.LineStrips3D(strips, colors=color, radii=[width]),
        'ends': rr.Points3D(ends, colors=color, radii=[2.0 * width]),
    }


def _middle(marker: Any) -> Array:
    return point(marker.pose.position)


def _half(marker: Any) -> Array:
    return 0.5 * point(marker.scale)


def _way(points: Sequence[Any]) -> Array:
    return _finite(np.array([point(each) for each in points]))


def _rows(found: list[tuple[Array, Array]]) -> Array:
    return _finite(np.reshape(found, (-1, 2, 3)))


def _finite(numbers: Array) -> Array:
    if not np.isfinite(numbers).all():
        raise BadInput.stating('plan_markers', 'NaN or infinite', 'finite numbers')
    return numbers
