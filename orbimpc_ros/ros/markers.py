# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Markers for viewers, and markers as input: the plan and its limits, and the topic ``obstacles``.

What a marker on ``obstacles`` covers is what counts, so that a body is never smaller than its
marker. A turned cube becomes the box around it; a cylinder the sphere or the box around it,
whichever is smaller, and in the plane a disc, like a sphere. Where an ellipse is meant, the longest
axis counts. In the plane everything is what it looks like from above.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from orbimpc_ros.loop.traffic import ObservedBody, centre
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import Ball, Box, MovingObstacle, Problem
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import SECOND, Frames, Stamp

KINDS = {Marker.CUBE: 'CUBE', Marker.SPHERE: 'SPHERE', Marker.CYLINDER: 'CYLINDER'}
FLAT = 0.02  # [m] height of what is shown of a plane
GREEN, BLUE, RED, GREY, ORANGE = (
    (0.1, 0.6, 0.3, 1.0),
    (0.1, 0.4, 0.9, 1.0),
    (0.8, 0.2, 0.1, 0.6),
    (0.5, 0.5, 0.5, 0.5),
    (0.9, 0.5, 0.1, 1.0),
)
LINE = 0.02  # width of lines, as a share of the scene's unit length
LIFETIME = 3.0  # markers of a dead node vanish after so many steps


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
    if len(marker.ns) > messages.LONGEST_FRAME:
        raise BadInput('ns', repr(marker.ns), f'at most {messages.LONGEST_FRAME} characters')
    name = f'{marker.ns}/{marker.id}'
    if marker.action == Marker.DELETE:
        return name
    if marker.action != Marker.ADD:
        raise BadInput('action', marker.action, 'ADD or MODIFY (0) | DELETE (2) | DELETEALL (3)')
    if marker.type not in KINDS:
        allowed = ' | '.join(f'{name} ({kind})' for kind, name in KINDS.items())
        raise BadInput('type', marker.type, allowed)
    # It has the header and the pose of a sighting; no axis of it pushes.
    stamp, seen = messages.read_sighting(placed(marker), 3, Frames(frames.world))
    assert seen.attitude is not None
    body = _body(marker.type, seen.position, seen.attitude, _scale(marker.scale), dimension)
    return stamp, ObservedBody(name, seen.time, body, _lifetime(marker))


def stamp_of(message: MarkerArray) -> int:
    """Return the stamp of the first marker [ns], however nonsensical; 0 without any."""
    first = next(iter(message.markers), None)
    return 0 if first is None else first.header.stamp.sec * SECOND + first.header.stamp.nanosec


def _scale(scale: Vector3) -> Array:
    sizes = np.array([scale.x, scale.y, scale.z])
    if not ((sizes > 0.0) & (sizes <= messages.LARGEST)).all():  # also refuses NaN
        raise BadInput('scale', sizes.tolist(), f'sizes above 0, at most {messages.LARGEST:g}')
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
        marker.type = Marker.SPHERE if body.dimension == 3 else Marker.CYLINDER
        sizes = np.full(body.dimension, 2.0 * body.radius)
    else:
        marker.type, sizes = Marker.CUBE, body.maximum - body.minimum
    if body.dimension == 2:
        sizes = np.append(sizes, FLAT)
    marker.pose.position = messages.point(centre(body))
    marker.scale = messages.vector(sizes)
    return marker


def plan_markers(
    stamp: Stamp, problem: Problem, plan: Plan, hazards: Sequence[MovingObstacle] = ()
) -> MarkerArray:
    """Return the plan as a line, its thrust as arrows, its obstacles and its floor.

    Hazards are shown where they are at the start, with lines to where they will be at its end. The
    floor is what a step at less than the minimum speed would reach, around the vehicle.
    """
    unit, step = problem.forward * problem.step, problem.step
    # A shorter plan has fewer arrows: all that was shown before is removed.
    head = messages.header(stamp.nanoseconds, stamp.frames.world)
    nothing = Marker(header=head, action=Marker.DELETEALL)
    path = marker(stamp, 'plan', 0, Marker.LINE_STRIP, GREEN, step)
    path.scale.x = LINE * unit
    path.points = [messages.point(each) for each in plan.positions]
    found = [nothing, path]
    for k, fraction in enumerate(plan.speed_fraction):
        shaft = marker(stamp, 'thrust', k, Marker.ARROW, BLUE, step)
        shaft.pose = messages.pose(plan.positions[k], plan.projected[k])
        # A viewer warns of an arrow of no length.
        shaft.scale = Vector3(x=max(0.5 * unit * fraction, 1e-3), y=0.05 * unit, z=0.05 * unit)
        found.append(shaft)
    for k, body in enumerate(problem.obstacles):
        found.append(shown(marker(stamp, 'obstacles', k, Marker.CUBE, RED, step), body))
    times = step * np.arange(problem.horizon + 1)
    for k, hazard in enumerate(hazards):
        found.append(shown(marker(stamp, 'hazards', k, Marker.CUBE, RED, step), hazard.body))
        way = marker(stamp, 'ways', k, Marker.LINE_STRIP, RED, step)
        way.scale.x = LINE * unit
        way.points = [messages.point(each) for each in centre(hazard.body) + hazard.moved(times)]
        found.append(way)
    if lines := problem.floor.outline(problem.dimension):
        floor = marker(stamp, 'floor', 0, Marker.LINE_LIST, GREY, step)
        floor.scale.x = LINE * unit
        floor.pose.position = messages.point(plan.positions[0])
        pieces = [line[k : k + 2] for line in lines for k in range(len(line) - 1)]
        floor.points = [messages.point(unit * end) for piece in pieces for end in piece]
        found.append(floor)
    return MarkerArray(markers=found)


def marker(
    stamp: Stamp, name: str, number: int, kind: int, color: tuple[float, ...], step: float
) -> Marker:
    """Return a marker at the origin that vanishes some steps [s] later; to be given a shape."""
    made = Marker(header=messages.header(stamp.nanoseconds, stamp.frames.world), ns=name, id=number)
    made.type, made.action = kind, Marker.ADD
    made.pose.orientation.w = 1.0
    made.color = ColorRGBA(**dict(zip('rgba', color, strict=True)))
    seconds, rest = divmod(LIFETIME * step, 1.0)
    made.lifetime = Duration(sec=int(seconds), nanosec=int(rest * 1e9))
    return made
