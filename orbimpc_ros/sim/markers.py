# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Markers for a 3-D viewer: the simulated world."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Vector3
from visualization_msgs.msg import Marker, MarkerArray

from orbimpc_ros.loop.traffic import centre, placed
from orbimpc_ros.ros.markers import BLUE, GREY, LINE, ORANGE, RED, marker, shown
from orbimpc_ros.ros.messages import Stamp, point, pose
from orbimpc_ros.sim.world import Flight


def world_markers(stamp: Stamp, flight: Flight) -> MarkerArray:
    """Return the rope, as far as it catches, its swing, and the vehicle."""
    model, radius = flight.scenario.model, flight.scenario.capture_radius
    unit = model.forward * model.step
    rope = marker(stamp, 'rope', 0, Marker.SPHERE, ORANGE, model.step)
    rope.scale = _cube(2.0 * radius)
    rope.pose.position = point(flight.goal)
    swing = marker(stamp, 'rope', 1, Marker.LINE_STRIP, GREY, model.step)
    swing.scale.x = LINE * unit
    swing.points = [point(flight.scenario.rope.center), point(flight.goal)]
    vehicle = marker(stamp, 'vehicle', 0, Marker.ARROW, BLUE, model.step)
    vehicle.pose = pose(flight.vehicle.position, flight.vehicle.attitude)
    vehicle.scale = Vector3(x=0.4 * unit, y=0.1 * unit, z=0.1 * unit)
    return MarkerArray(markers=[rope, swing, vehicle])


def traffic_markers(stamp: Stamp, flight: Flight) -> MarkerArray:
    """Return the balls in the traffic where they are now."""
    scenario, markers = flight.scenario, []
    for k, each in enumerate(scenario.traffic):
        moved = each.moved(np.array([flight.elapsed]))[0]
        ball = marker(stamp, 'traffic', k, Marker.SPHERE, RED, scenario.model.step)
        markers.append(shown(ball, placed(each.body, centre(each.body) + moved)))
    return MarkerArray(markers=markers)


def _cube(side: float) -> Vector3:
    return Vector3(x=side, y=side, z=side)
