# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Interface to the autopilot of a wing on its own topics: ``odom``, ``wind``, and setpoints.

ROS has x east, y north, z up, and a body with x forward, y left, z up. PX4 and MAVLink have north,
east, down, and forward, right, down. Each conversion is its own inverse.

Setpoints are sent only in the mode that accepts them, and while the autopilot's measurements are
fresh. Otherwise the planner is silent, as the firmwares expect: PX4 reacts when OffboardControlMode
stops, and ArduPlane is sent one command, if it is still connected, to resume its guided target.
"""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property
from importlib import import_module
from typing import Any, ClassVar

import numpy as np
from geometry_msgs.msg import TwistWithCovarianceStamped
from nav_msgs.msg import Odometry as OdometryMessage
from rclpy.publisher import Publisher

from orbimpc_ros.loop.compensation import Odometry
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import from_quaternion
from orbimpc_ros.mpc.plan import Command
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import SECOND, Frames, Stamp
from orbimpc_ros.ros.parameters.planner import PlannerSettings
from orbimpc_ros.ros.process import LATEST, Managed, qos

FRESH = 0.4  # [s]: no setpoints are sent without a position for longer
MODE_LOST = 2.5  # [s]: PX4 and MAVROS report the mode once or twice a second
AIRSPEED_LOST, WIND_LOST = 1.0, 10.0  # [s]: then they are unknown; the latter is PX4's own limit
ALIVE = 0.1  # [s] between messages that keep offboard mode
OFFBOARD = 14  # VehicleStatus.NAVIGATION_STATE_OFFBOARD
REFUSALS = 5.0  # [s] after which an unanswered command counts as lost
QUIET = 10.0  # [s] for which the same line is not logged again
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


def types_of(package: str, parameter: str, value: str) -> Any:
    """Return the module of a package's messages, which a parameter with this value needs.

    Raises:
        BadInput: it is not installed.
    """
    try:
        return import_module(f'{package}.msg')
    except ModuleNotFoundError:
        hint = f'install ros-<distro>-{package.replace("_", "-")}, or build it in your workspace'
        raise BadInput.stating(parameter, f'{value}, and {package} is missing', hint) from None


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
        airspeed: measured true airspeed [m/s]; unknown unless positive and finite.
        wind: east and north, shape (2,) [m/s]; NaN if unknown.
    """
    known = 0.0 < airspeed < math.inf
    if not np.isfinite(wind).all():
        return np.array([airspeed, 0.0, 0.0]) if known else None
    relative = rotation.T @ (velocity - np.append(wind, 0.0))
    speed = float(np.linalg.norm(relative))
    return relative * (airspeed / speed if known and speed > 0.0 else 1.0)


def coordinated(rotation: Array, airspeed: float) -> float:
    """Return the rate of a coordinated turn at an attitude, to the left [rad/s]."""
    bank = rotation[2, 1] / max(float(rotation[2, 2]), STEEPEST)  # tan, to the right
    return -GRAVITY * float(bank) / max(airspeed, 1.0)


class Wing(ABC):
    """The autopilot of a wing, on topics of a node, with the frames of its odometry.

    Args:
        switched: called with a line when sending of setpoints becomes possible or impossible.

    Attributes:
        engaged: whether setpoints may be sent.
    """

    name: ClassVar[str]  # value of the parameter ``autopilot``
    package: ClassVar[str]
    mode: ClassVar[str]

    def __init__(self, node: Managed, frames: Frames, switched: Callable[[str], None]) -> None:
        self._types = types_of(self.package, 'autopilot', self.name)
        self.engaged = False
        self._node, self._frames, self._switched = node, frames, switched
        self._odometry_out = node.create_publisher(OdometryMessage, 'odom', qos())
        self._wind_out = node.create_publisher(TwistWithCovarianceStamped, 'wind', qos())
        self._latest: dict[str, tuple[float, Any]] = {}  # time [s] and value, by event
        node.create_timer(ALIVE, node.guard(self.look), clock=node.steady)

    @abstractmethod
    def _publish(self, airspeed: float, heading: float, turn: float, altitude: float) -> None:
        """Send a setpoint.

        Args:
            airspeed: true [m/s].
            heading: of the airspeed vector at the next setpoint, from east, to the left [rad].
            turn: turn rate, to the left [rad/s].
            altitude: above the origin [m]; NaN to hold the present one.
        """

    def _keep(self) -> None:  # noqa: B027
        """Keep the mode, or the ability to enter it."""

    def release(self) -> None:  # noqa: B027
        """Return control to the autopilot, if silence does not do so."""

    def send(self, settings: PlannerSettings, command: Command, altitude: float) -> None:
        """Send a planar command if allowed, and the altitude of a setpoint.

        Without commands, the autopilot is not kept in the mode.
        """
        self.look()
        self._note('setpoint')
        if self.engaged:
            turn, axis = float(command.body_rate[-1]), command.rotation[:, 0]
            # The command's rotation is reached after a step; the next one comes after a period.
            heading = math.atan2(axis[1], axis[0]) - (settings.step - settings.period) * turn
            heading = math.remainder(heading, 2.0 * math.pi)
            airspeed = settings.forward * command.speed_fraction
            self._publish(airspeed, heading, turn, altitude)

    def look(self) -> None:
        """Update whether setpoints may be sent, and keep the mode while they are."""
        engaged = in_mode = self._last('mode', math.inf, otherwise=False)
        why = f'{"in" if in_mode else "has left"} {self.mode}'
        for event, limit in (('mode', MODE_LOST), ('position', FRESH)):
            if self._last(event, limit) is None:
                engaged, why = False, f'no {event} for {limit:g} s'
        if engaged != self.engaged:
            self.engaged = engaged
            if not engaged and in_mode and self._last('setpoint', math.inf):  # not on a dry run
                self.release()
            self._switched(f'{self.name}: {why}: {"setpoints" if engaged else "silent"}')
        if self._last('position', FRESH) and self._last('setpoint', 1.0):
            self._keep()

    def _note(self, event: str, value: Any = True) -> None:
        """Record an event with its value and time."""
        self._latest[event] = self._node.steady_now(), value

    def _last(self, event: str, within: float, otherwise: Any = None) -> Any:
        """Return the last value of an event, if that was within a time [s]."""
        at, value = self._latest.get(event, (-math.inf, otherwise))
        return value if self._node.steady_now() - at <= within else otherwise

    def _warn(self, problem: str) -> None:
        self._node.get_logger().warning(f'{self.name}: {problem}', throttle_duration_sec=QUIET)

    def _listen(self, kind: type, topic: str, callback: Callable[..., None], *bound: str) -> None:
        self._node.create_subscription(kind, topic, self._node.guard(callback, *bound), LATEST)

    def _wind_is(self, message: TwistWithCovarianceStamped) -> None:
        """Take in the wind, and publish it."""
        linear = message.twist.twist.linear
        self._note('wind', np.array([linear.x, linear.y]))
        self._wind_out.publish(message)

    def _moved(self, stamp: int, position: Array, velocity: Array, rotation: Array) -> None:
        """Publish odometry through the air, given measurements over ground at a stamp [ns].

        Positions [m] and velocities [m/s] are ENU, shape (3,); rotations FLU to ENU, shape (3, 3).
        """
        airspeed = self._last('airspeed', AIRSPEED_LOST, otherwise=math.nan)
        wind = self._last('wind', WIND_LOST, otherwise=np.full(2, math.nan))
        through = through_air(velocity, rotation, airspeed, wind)
        parts = (position, velocity, rotation.ravel())
        if through is None or not np.isfinite(np.concatenate(parts)).all():
            return  # treated as no measurement
        self._note('position')
        turn = coordinated(rotation, float(np.linalg.norm(through)))
        rates = np.array([0.0, 0.0, turn])
        measured = Odometry(stamp / SECOND, position, rotation, through, rates)
        self._odometry_out.publish(messages.odometry_message(Stamp(stamp, self._frames), measured))


class Px4(Wing):
    """PX4 in offboard mode, over uXRCE-DDS.

    FixedWingLateralSetpoint and FixedWingLongitudinalSetpoint turn the airspeed vector to a
    direction by the firmware's own control law, and add the given lateral acceleration. NaN means
    "not controlled": used for the course in addition to a direction, and for the height rate in
    addition to an altitude; with neither of these, the altitude is held.
    """

    name, package, mode = 'px4', 'px4_msgs', 'offboard'

    def __init__(self, *wiring: Any) -> None:
        super().__init__(*wiring)
        types = self._types
        self._share, self._origin = 1.0, math.nan
        for kind, *callback in (
            (types.VehicleLocalPosition, self._on_position),
            (types.VehicleAttitude, self._note, 'attitude'),
            (types.AirspeedValidated, self._on_airspeed),
            (types.Wind, self._on_wind),
            (types.VehicleStatus, self._on_status),
        ):
            self._listen(kind, _topic('fmu/out', kind), *callback)

    @cached_property
    def _publishers(self) -> dict[type, Publisher]:
        """Return the publishers of setpoints, created on first use: a dry run has none."""
        types, create = self._types, self._node.create_publisher
        setpoints = types.FixedWingLateralSetpoint, types.FixedWingLongitudinalSetpoint
        kinds = types.OffboardControlMode, *setpoints
        return {kind: create(kind, _topic('fmu/in', kind), qos()) for kind in kinds}

    def _on_position(self, message: Any) -> None:
        other, stamp = self._last('attitude', FRESH), message.timestamp_sample
        if other is None or 1000 * abs(other.timestamp_sample - stamp) > messages.APART:
            return
        if not (message.xy_valid and message.v_xy_valid):
            return
        self._origin = message.ref_alt if message.z_global else math.nan
        place = NED @ np.array([message.x, message.y, message.z], dtype=float)
        velocity = NED @ np.array([message.vx, message.vy, message.vz], dtype=float)
        unit = np.array(other.q, dtype=float)
        self._moved(1000 * stamp, place, velocity, attitude(unit / np.linalg.norm(unit)))

    def _on_airspeed(self, message: Any) -> None:
        true, calibrated = message.true_airspeed_m_s, message.calibrated_airspeed_m_s
        self._note('airspeed', true)
        if true > 0.0 and calibrated > 0.0:  # also refuses NaN, which is "invalid"
            self._share = calibrated / true

    def _on_wind(self, message: Any) -> None:
        wind = TwistWithCovarianceStamped()
        wind.header.stamp = messages.time_message(1000 * message.timestamp_sample)
        wind.twist.twist.linear.x = float(message.windspeed_east)
        wind.twist.twist.linear.y = float(message.windspeed_north)
        wind.twist.covariance[0] = float(message.variance_east)  # 0: not estimated
        wind.twist.covariance[7] = float(message.variance_north)
        self._wind_is(wind)

    def _on_status(self, message: Any) -> None:
        self._note('mode', message.nav_state == OFFBOARD)
        self.look()

    def _keep(self) -> None:
        # Of velocity: with position, PX4's own guidance would publish setpoints, too.
        self._tell(self._types.OffboardControlMode, velocity=True)

    def _publish(self, airspeed: float, heading: float, turn: float, altitude: float) -> None:
        self._tell(
            self._types.FixedWingLateralSetpoint,
            course=math.nan,
            airspeed_direction=bearing(heading),
            lateral_acceleration=-airspeed * turn,  # to the right
        )
        self._tell(
            self._types.FixedWingLongitudinalSetpoint,
            altitude=self._origin + altitude,  # above mean sea level
            height_rate=math.nan,
            equivalent_airspeed=self._share * airspeed,
            pitch_direct=math.nan,
            throttle_direct=math.nan,
        )

    def _tell(self, kind: type, **fields: float) -> None:
        now = self._node.get_clock().now().nanoseconds // 1000
        self._publishers[kind].publish(kind(timestamp=now, **fields))


class ArduPlane(Wing):
    """ArduPlane in GUIDED, through MAVROS.

    MAV_CMD_GUIDED_CHANGE_HEADING banks in proportion to the heading error, up to the bank of the
    given acceleration; with 0 it does not bank. So the heading is sent as far ahead in the turn as
    that bank requires, with the acceleration of the turn.
    """

    name, package, mode = 'arduplane', 'mavros_msgs', 'GUIDED'

    def __init__(self, *wiring: Any) -> None:
        super().__init__(*wiring)
        self._command = import_module(f'{self.package}.srv').CommandInt
        self._client = self._node.create_client(self._command, 'mavros/cmd/command_int')
        self._share, self._requested_at = 1.0, -math.inf
        self._due: list[dict[str, float]] = []  # fields of commands, each a COMMAND_INT
        wind = TwistWithCovarianceStamped
        self._listen(OdometryMessage, 'mavros/local_position/odom', self._on_odometry)
        self._listen(self._types.VfrHud, 'mavros/vfr_hud', self._on_hud)
        self._listen(wind, 'mavros/wind_estimation', self._wind_is)
        self._listen(self._types.State, 'mavros/state', self._on_state)

    def _on_odometry(self, message: OdometryMessage) -> None:
        try:
            stamp, measured = messages.read_odometry(message, 3, Frames())
        except BadInput as error:
            self._warn(f'odometry refused: {error}')
            return
        velocity = measured.attitude @ measured.body_velocity
        self._moved(stamp.nanoseconds, measured.position, velocity, measured.attitude)

    def _on_hud(self, message: Any) -> None:
        self._share = equivalent(message.altitude)
        self._note('airspeed', message.airspeed / self._share)

    def _on_state(self, message: Any) -> None:
        self._note('mode', message.connected and message.mode == self.mode)
        self.look()

    def _publish(self, airspeed: float, heading: float, turn: float, altitude: float) -> None:
        """Send the commands of a setpoint in sequence; a new setpoint waits for their end."""
        if self._due and self._node.steady_now() - self._requested_at < REFUSALS:  # busy
            return
        sideways, speed = airspeed * turn, self._share * airspeed
        ahead = math.degrees(bearing(heading + AHEAD * sideways / GRAVITY)) % 360.0
        limit = max(HOLD, abs(sideways))
        self._due = [
            {'command': CHANGE_HEADING, 'param1': HEADING, 'param2': ahead, 'param3': limit},
            {'command': CHANGE_SPEED, 'param1': 0.0, 'param2': speed, 'param3': 0.0},
        ]
        if math.isfinite(altitude):
            self._due.append({'command': CHANGE_ALTITUDE, 'frame': ABOVE_HOME, 'z': altitude})
        self._ask()

    def release(self) -> None:
        """Have ArduPlane drop the heading: it then circles around its guided target."""
        self._due = [{'command': CHANGE_HEADING, 'param1': NO_HEADING}]
        self._ask()

    def _ask(self) -> None:
        if not self._client.service_is_ready():
            self._due = []
            return
        self._requested_at = self._node.steady_now()
        request = self._command.Request(**self._due[0])
        self._client.call_async(request).add_done_callback(self._node.guard(self._on_answer))

    def _on_answer(self, future: Any) -> None:
        done = self._due.pop(0) if self._due else {}
        if not future.result().success:
            self._warn(f'refused command {done.get("command")}')
        if self._due:
            self._ask()


WINGS: dict[str, type[Wing]] = {wing.name: wing for wing in (Px4, ArduPlane)}


def _topic(namespace: str, kind: Any) -> str:
    """Return PX4's topic of a message type, with the message's version in its name, from 1 on."""
    name = re.sub(r'\B[A-Z]', r'_\g<0>', kind.__name__).lower()
    version = getattr(kind, 'MESSAGE_VERSION', 0)
    return f'{namespace}/{name}' + (f'_v{version}' if version else '')
