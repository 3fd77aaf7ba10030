# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
r"""Interface to autopilots of wings, without ROS messages: axes, speeds and setpoints.

ROS has x east, y north, z up, and a body with x forward, y left, z up. PX4 and MAVLink have north,
east, down, and forward, right, down. Each conversion is its own inverse.

PX4 (FixedWingLateralSetpoint, FixedWingLongitudinalSetpoint) turns the airspeed vector to a
direction by its own control law and adds the given lateral acceleration. NaN means "not
controlled": used for the course in addition to a direction, and for the height rate in addition to
an altitude; with neither of these, the altitude is held.

ArduPlane (MAV_CMD_GUIDED_CHANGE_HEADING) banks in proportion to the heading error, up to the bank
of the given acceleration; with 0 it does not bank. So the heading is sent as far ahead in the turn
as that bank requires, with the acceleration of the turn.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.rotations import from_quaternion
from orbimpc_ros.mpc.plan import Command

AUTOPILOTS = ('px4', 'arduplane')
# Topics by those of the planner. MAVROS needs mav_frame BODY_NED for its setpoints.
TOPICS: Mapping[str, Mapping[str, str]] = {
    'ardupilot': {
        'pose': '/ap/pose/filtered',
        'twist': '/ap/twist/filtered',
        'cmd_vel': '/ap/cmd_vel',
    },
    'mavros': {
        'odom': '/mavros/local_position/odom',
        'cmd_vel': '/mavros/setpoint_velocity/cmd_vel',
    },
    'rover': {},
    'px4': {},  # wings, like arduplane; the parameter autopilot selects the autopilot's own topics
    'arduplane': {},
}
GRAVITY = 9.80665  # [m/s^2]
NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # from or to ENU
FRD = np.diag([1.0, -1.0, -1.0])  # from or to FLU
LAPSE, DENSITY = 2.25577e-5, 4.2559  # [1/m], [1]: standard atmosphere below 11 km
STEEPEST = 0.3  # least upward component of the body's z axis in the computation of a turn
CHANGE_SPEED, CHANGE_ALTITUDE, CHANGE_HEADING = 43000, 43001, 43002  # MAV_CMD_GUIDED_...
HEADING, NO_HEADING = 1.0, 2.0  # HEADING_TYPE: of the vehicle; none, back to the guided target
ABOVE_HOME = 3  # MAV_FRAME_GLOBAL_RELATIVE_ALT
AHEAD = 1.5  # [rad] per tan(bank): by default ArduPlane banks 0.87 rad per radian
HOLD = 0.5  # [m/s^2] least limit, to hold a heading


@dataclass(frozen=True)
class Setpoint:
    """Setpoint of a wing.

    Attributes:
        airspeed: true [m/s].
        heading: of the airspeed vector at the next setpoint, from east, to the left [rad].
        turn: turn rate, to the left [rad/s].
        altitude: above the origin [m]; NaN to hold the present one.
    """

    airspeed: float
    heading: float
    turn: float
    altitude: float = math.nan


def setpoint(
    command: Command, forward: float, step: float, period: float, altitude: float = math.nan
) -> Setpoint:
    """Return the setpoint of a planar command, whose rotation is reached after a step [s].

    ``forward`` is full speed [m/s], ``period`` the time until the next command [s]; ``altitude``
    as of a setpoint.
    """
    turn, axis = float(command.body_rate[-1]), command.rotation[:, 0]
    heading = math.atan2(axis[1], axis[0]) - (step - period) * turn
    heading = math.remainder(heading, 2.0 * math.pi)
    return Setpoint(forward * command.speed_fraction, heading, turn, altitude)


def bearing(angle: float) -> float:
    """Convert an angle from east, to the left, to one from north, to the right; or back [rad]."""
    return math.remainder(0.5 * math.pi - angle, 2.0 * math.pi)


def attitude(unit: Array) -> Array:
    """Return the attitude, FLU to ENU, for a quaternion (w, x, y, z), FRD to NED."""
    return np.asarray(NED @ from_quaternion(unit, 3) @ FRD)


def equivalent(altitude: float) -> float:
    """Return the ratio of equivalent to true airspeed at an altitude above mean sea level [m]."""
    return math.sqrt(max(1e-3, 1.0 - LAPSE * altitude) ** DENSITY)


def through_air(velocity: Array, rotation: Array, airspeed: float, wind: Array) -> Array | None:
    """Return the velocity through the air in the body frame, shape (3,) [m/s]; None if unknown.

    Args:
        velocity: over ground, ENU, shape (3,) [m/s].
        rotation: attitude, FLU to ENU, shape (3, 3).
        airspeed: measured true airspeed [m/s]; NaN without a measurement.
        wind: east and north, shape (2,) [m/s]; NaN if unknown.
    """
    if not np.isfinite(wind).all():
        return np.array([airspeed, 0.0, 0.0]) if math.isfinite(airspeed) else None
    relative = rotation.T @ (velocity - np.append(wind, 0.0))
    speed = float(np.linalg.norm(relative))
    return relative * (airspeed / speed if math.isfinite(airspeed) and speed > 0.0 else 1.0)


def coordinated(rotation: Array, airspeed: float) -> float:
    """Return the rate of a coordinated turn at an attitude, to the left [rad/s]."""
    bank = rotation[2, 1] / max(float(rotation[2, 2]), STEEPEST)  # tan, to the right
    return -GRAVITY * float(bank) / max(airspeed, 1.0)


def lateral(wanted: Setpoint) -> dict[str, float]:
    """Return the fields of PX4's FixedWingLateralSetpoint."""
    return {
        'course': math.nan,
        'airspeed_direction': bearing(wanted.heading),
        'lateral_acceleration': -wanted.airspeed * wanted.turn,  # to the right
    }


def longitudinal(wanted: Setpoint, share: float, origin: float) -> dict[str, float]:
    """Return the fields of PX4's FixedWingLongitudinalSetpoint.

    ``share`` is the ratio of equivalent to true airspeed, ``origin`` the altitude of the origin
    above mean sea level [m].
    """
    return {
        'altitude': origin + wanted.altitude,
        'height_rate': math.nan,
        'equivalent_airspeed': share * wanted.airspeed,
        'pitch_direct': math.nan,
        'throttle_direct': math.nan,
    }


def guided(wanted: Setpoint, share: float) -> list[dict[str, float]]:
    """Return the fields of ArduPlane's commands in GUIDED mode, each a COMMAND_INT.

    ``share`` is the ratio of equivalent to true airspeed.
    """
    sideways = wanted.airspeed * wanted.turn
    heading = wanted.heading + AHEAD * sideways / GRAVITY
    degrees = math.degrees(bearing(heading)) % 360.0
    limit = max(HOLD, abs(sideways))
    commands: list[dict[str, float]] = [
        {'command': CHANGE_HEADING, 'param1': HEADING, 'param2': degrees, 'param3': limit},
        {'command': CHANGE_SPEED, 'param1': 0.0, 'param2': share * wanted.airspeed, 'param3': 0.0},
    ]
    if math.isfinite(wanted.altitude):
        commands.append({'command': CHANGE_ALTITUDE, 'frame': ABOVE_HOME, 'z': wanted.altitude})
    return commands
