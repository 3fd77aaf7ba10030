# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""ROS messages of a flight: sensor data, the goal's future path, and markers of the world."""

from __future__ import annotations

from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped, Vector3
from nav_msgs.msg import Odometry as OdometryMessage
from nav_msgs.msg import Path
from visualization_msgs.msg import Marker, MarkerArray

from orbimpc_ros.loop.compensation import Odometry
from orbimpc_ros.loop.goal.motion import GoalObservation
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import Stamp, marker, point, pose, shown
from orbimpc_ros.sim.world import Flight


def sensed(stamp: Stamp, content: Odometry | GoalObservation) -> tuple[str, Any]:
    """Return the topic and the message of a measurement."""
    if isinstance(content, Odometry):
        return 'odom', messages.odometry_message(stamp, content)
    return 'goal', messages.goal_message(stamp, content.position)


def future(stamp: Stamp, flight: Flight, steps: int) -> Path:
    """Return the path of the goal over a number of steps from now."""
    step, rope = flight.settings.model.step, flight.settings.rope
    times = flight.vehicle.time + step * np.arange(steps + 1)
    return messages.path_message(stamp, step, map(messages.pose, [rope.at(time) for time in times]))


def transform(odometry: OdometryMessage) -> TransformStamped:
    """Return odometry as a transform."""
    message = TransformStamped(header=odometry.header, child_frame_id=odometry.child_frame_id)
    place = odometry.pose.pose.position
    message.transform.translation = Vector3(x=place.x, y=place.y, z=place.z)
    message.transform.rotation = odometry.pose.pose.orientation
    return message


def truth(at: int, name: str, flight: Flight) -> DiagnosticArray:
    """Return the vehicle's true state at a time [ns] as a diagnostic status with a name."""
    vehicle, now = flight.vehicle, flight.vehicle.airspeed
    values = {
        'airspeed': now,
        'least_airspeed': flight.least_airspeed,
        'stalls': flight.stalls,
        'wind': vehicle.wind.tolist(),
        'position': vehicle.position.tolist(),
        'velocity': vehicle.velocity.tolist(),
        'body_rate': vehicle.body_rate.tolist(),
        'speed_fraction': vehicle.fraction,
        'touched': sorted(flight.touched),
        **vehicle.facts,
    }
    if flight.stalled:
        slow = f'stalled: {now:.3g} m/s, below {flight.settings.stall_speed:g} m/s'
        return messages.diagnostics(at, name, messages.WARN, slow, values)
    return messages.diagnostics(at, name, messages.OK, 'flies', values)


def world_markers(stamp: Stamp, flight: Flight) -> MarkerArray:
    """Return markers of the goal with its capture radius, its swing, and the vehicle."""
    model, radius = flight.settings.model, flight.settings.capture_radius
    unit, side = model.forward * model.step, 2.0 * radius
    rope = marker(stamp, 'rope', 0, Marker.SPHERE, messages.ORANGE, model.step)
    rope.scale = Vector3(x=side, y=side, z=side)
    rope.pose.position = point(flight.goal)
    swing = marker(stamp, 'rope', 1, Marker.LINE_STRIP, messages.GREY, model.step)
    swing.scale.x = messages.LINE * unit
    swing.points = [point(flight.settings.rope.center), point(flight.goal)]
    vehicle = marker(stamp, 'vehicle', 0, Marker.ARROW, messages.BLUE, model.step)
    vehicle.pose = pose(flight.vehicle.position, flight.vehicle.attitude)
    vehicle.scale = Vector3(x=0.4 * unit, y=0.1 * unit, z=0.1 * unit)
    return MarkerArray(markers=[rope, swing, vehicle])


def traffic_markers(stamp: Stamp, flight: Flight, margin: float = 0.0) -> MarkerArray:
    """Return markers of the moving balls at their current positions, larger by a margin [m]."""
    model, markers = flight.settings.model, []
    for k, each in enumerate(flight.settings.traffic):
        moved = each.moved(np.array([flight.vehicle.time]))[0]
        ball = marker(stamp, 'traffic', k, Marker.SPHERE, messages.RED, model.step)
        shown(ball, each.body.shifted(moved))
        for axis in 'xyz'[: model.dimension]:
            setattr(ball.scale, axis, getattr(ball.scale, axis) + 2.0 * margin)
        markers.append(ball)
    return MarkerArray(markers=markers)
