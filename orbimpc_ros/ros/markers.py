# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Markers for a 3-D viewer: the plan and its limits, and the simulated world."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from orbimpc_ros.loop.traffic import centre, placed
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import Hazard, Problem
from orbimpc_ros.ros.messages import Stamp, header, point, pose
from orbimpc_ros.ros.obstacles import shown

if TYPE_CHECKING:  # a planner shows no world
    from orbimpc_ros.sim.flight import Flight

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
    stamp: Stamp, problem: Problem, plan: Plan, hazards: Sequence[Hazard] = ()
) -> MarkerArray:
    """Return the plan as a line, its thrust as arrows, its obstacles and its floor.

    Hazards are shown where they are at the start, with lines to where they will be at its end.
    """
    unit = problem.forward * problem.step
    path = _marker(stamp, 'plan', 0, Marker.LINE_STRIP, GREEN, problem.step)
    path.scale.x = LINE * unit
    path.points = [point(each) for each in plan.positions]
    return MarkerArray(
        markers=[
            _nothing(stamp),
            path,
            *_arrows(stamp, plan, unit, problem.step),
            *_obstacles(stamp, problem),
            *_hazards(stamp, problem, hazards),
            *_floor(stamp, problem, plan.positions[0], unit),
        ]
    )


def world_markers(stamp: Stamp, flight: Flight) -> MarkerArray:
    """Return the rope, as far as it catches, its swing, and the vehicle."""
    model, radius = flight.scenario.model, flight.scenario.capture_radius
    unit = model.forward * model.step
    rope = _marker(stamp, 'rope', 0, Marker.SPHERE, ORANGE, model.step)
    rope.scale = _cube(2.0 * radius)
    rope.pose.position = point(flight.goal)
    swing = _marker(stamp, 'rope', 1, Marker.LINE_STRIP, GREY, model.step)
    swing.scale.x = LINE * unit
    swing.points = [point(flight.scenario.rope.center), point(flight.goal)]
    vehicle = _arrow(stamp, 'vehicle', 0, BLUE, model.step)
    vehicle.pose = pose(flight.vehicle.position, flight.vehicle.attitude)
    vehicle.scale = Vector3(x=0.4 * unit, y=0.1 * unit, z=0.1 * unit)
    return MarkerArray(markers=[rope, swing, vehicle])


def traffic_markers(stamp: Stamp, flight: Flight) -> MarkerArray:
    """Return the balls in the traffic where they are now."""
    scenario, markers = flight.scenario, []
    for k, each in enumerate(scenario.traffic):
        moved = each.moved(np.array([flight.elapsed]))[0]
        marker = _marker(stamp, 'traffic', k, Marker.SPHERE, RED, scenario.model.step)
        markers.append(shown(marker, placed(each.body, centre(each.body) + moved)))
    return MarkerArray(markers=markers)


def _arrows(stamp: Stamp, plan: Plan, unit: float, step: float) -> list[Marker]:
    arrows = []
    for k, fraction in enumerate(plan.speed_fraction):
        arrow = _arrow(stamp, 'thrust', k, BLUE, step)
        arrow.pose = pose(plan.positions[k], plan.projected[k])
        # A viewer warns of an arrow of no length.
        arrow.scale = Vector3(x=max(0.5 * unit * fraction, 1e-3), y=0.05 * unit, z=0.05 * unit)
        arrows.append(arrow)
    return arrows


def _obstacles(stamp: Stamp, problem: Problem) -> list[Marker]:
    return [
        shown(_marker(stamp, 'obstacles', k, Marker.CUBE, RED, problem.step), body)
        for k, body in enumerate(problem.obstacles)
    ]


def _hazards(stamp: Stamp, problem: Problem, hazards: Sequence[Hazard]) -> list[Marker]:
    times, found = problem.step * np.arange(problem.horizon + 1), []
    for k, hazard in enumerate(hazards):
        found.append(
            shown(_marker(stamp, 'hazards', k, Marker.CUBE, RED, problem.step), hazard.body)
        )
        way = _marker(stamp, 'ways', k, Marker.LINE_STRIP, RED, problem.step)
        way.scale.x = LINE * problem.forward * problem.step
        way.points = [point(each) for each in centre(hazard.body) + hazard.moved(times)]
        found.append(way)
    return found


def _floor(stamp: Stamp, problem: Problem, center: Array, unit: float) -> list[Marker]:
    """Return what a step at less than the minimum speed would reach, around the vehicle."""
    lines = problem.floor.outline(problem.dimension)
    if not lines:
        return []
    drawn = _marker(stamp, 'floor', 0, Marker.LINE_LIST, GREY, problem.step)
    drawn.scale.x = LINE * unit
    drawn.pose.position = point(center)
    pieces = [line[k : k + 2] for line in lines for k in range(len(line) - 1)]
    drawn.points = [point(unit * end) for piece in pieces for end in piece]
    return [drawn]


def _nothing(stamp: Stamp) -> Marker:
    """Return what removes all that was shown before: a shorter plan has fewer arrows."""
    return Marker(header=header(stamp.nanoseconds, stamp.frames.world), action=Marker.DELETEALL)


def _arrow(stamp: Stamp, name: str, number: int, color: tuple[float, ...], step: float) -> Marker:
    return _marker(stamp, name, number, Marker.ARROW, color, step)


def _marker(
    stamp: Stamp, name: str, number: int, kind: int, color: tuple[float, ...], step: float
) -> Marker:
    marker = Marker(header=header(stamp.nanoseconds, stamp.frames.world), ns=name, id=number)
    marker.type, marker.action = kind, Marker.ADD
    marker.pose.orientation.w = 1.0
    marker.color = ColorRGBA(**dict(zip('rgba', color, strict=True)))
    seconds, rest = divmod(LIFETIME * step, 1.0)
    marker.lifetime = Duration(sec=int(seconds), nanosec=int(rest * 1e9))
    return marker


def _cube(side: float) -> Vector3:
    return Vector3(x=side, y=side, z=side)
