# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Markers for a 3-D viewer: the plan and its limits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from orbimpc_ros.loop.traffic import centre
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import MovingObstacle, Problem
from orbimpc_ros.ros.messages import Stamp, header, point, pose
from orbimpc_ros.ros.obstacles import shown

GREEN, BLUE, RED, GREY, ORANGE = (
    (0.1, 0.6, 0.3, 1.0),
    (0.1, 0.4, 0.9, 1.0),
    (0.8, 0.2, 0.1, 0.6),
    (0.5, 0.5, 0.5, 0.5),
    (0.9, 0.5, 0.1, 1.0),
)
LINE = 0.02  # width of lines, as a share of the scene's unit length
LIFETIME = 3.0  # markers of a dead node vanish after so many steps


def plan_markers(
    stamp: Stamp, problem: Problem, plan: Plan, hazards: Sequence[MovingObstacle] = ()
) -> MarkerArray:
    """Return the plan as a line, its thrust as arrows, its obstacles and its floor.

    Hazards are shown where they are at the start, with lines to where they will be at its end. The
    floor is what a step at less than the minimum speed would reach, around the vehicle.
    """
    unit, step = problem.forward * problem.step, problem.step
    # A shorter plan has fewer arrows: all that was shown before is removed.
    nothing = Marker(header=header(stamp.nanoseconds, stamp.frames.world), action=Marker.DELETEALL)
    path = marker(stamp, 'plan', 0, Marker.LINE_STRIP, GREEN, step)
    path.scale.x = LINE * unit
    path.points = [point(each) for each in plan.positions]
    found = [nothing, path]
    for k, fraction in enumerate(plan.speed_fraction):
        shaft = marker(stamp, 'thrust', k, Marker.ARROW, BLUE, step)
        shaft.pose = pose(plan.positions[k], plan.projected[k])
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
        way.points = [point(each) for each in centre(hazard.body) + hazard.moved(times)]
        found.append(way)
    if lines := problem.floor.outline(problem.dimension):
        floor = marker(stamp, 'floor', 0, Marker.LINE_LIST, GREY, step)
        floor.scale.x = LINE * unit
        floor.pose.position = point(plan.positions[0])
        pieces = [line[k : k + 2] for line in lines for k in range(len(line) - 1)]
        floor.points = [point(unit * end) for piece in pieces for end in piece]
        found.append(floor)
    return MarkerArray(markers=found)


def marker(
    stamp: Stamp, name: str, number: int, kind: int, color: tuple[float, ...], step: float
) -> Marker:
    """Return a marker at the origin that vanishes some steps [s] later; to be given a shape."""
    made = Marker(header=header(stamp.nanoseconds, stamp.frames.world), ns=name, id=number)
    made.type, made.action = kind, Marker.ADD
    made.pose.orientation.w = 1.0
    made.color = ColorRGBA(**dict(zip('rgba', color, strict=True)))
    seconds, rest = divmod(LIFETIME * step, 1.0)
    made.lifetime = Duration(sec=int(seconds), nanosec=int(rest * 1e9))
    return made
