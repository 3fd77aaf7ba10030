# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Conversion of ROS messages to plain types and back: pure functions.

Incoming messages are untrusted. A message is accepted or rejected as a whole, naming the offending
field; stamps are read as integers, never through rclpy's Time, which raises on negative seconds.
The planner's body frame has its thrust axis along x; a vehicle with another thrust axis is rotated
on input and rotated back on output, only in this module. Covariances are read only for winds: many
drivers set NaN there for "unknown", which is harmless. In the plane (n = 2), poses lie at z = 0 and
turn about z.

A ``move`` is the matrix, shape (4, 4), from the frame of a message to the required one, by which
its poses are transformed; without one, it has to be in that frame.

A body covers at least its marker on ``obstacles``. Cubes and cylinders become their bounding boxes,
in the plane cylinders become discs, like spheres. An ellipsoid counts with its longest axis. In the
plane, bodies are seen from above.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import (
    Point,
    Pose,
    PoseStamped,
    Quaternion,
    QuaternionStamped,
    Transform,
    Twist,
    TwistStamped,
    TwistWithCovarianceStamped,
    Vector3,
    Vector3Stamped,
    Wrench,
    WrenchStamped,
)
from nav_msgs.msg import Odometry as OdometryMessage
from nav_msgs.msg import Path
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from orbimpc_ros.loop.compensation import Odometry, WindReport
from orbimpc_ros.loop.goal.motion import GoalObservation, GoalTrajectory, Route
from orbimpc_ros.loop.traffic import AgentTrajectory, ObservedBody
from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import from_quaternion, to_quaternion
from orbimpc_ros.mpc.plan import Command, Plan
from orbimpc_ros.mpc.problem import Ball, Box, MovingObstacle, Problem

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
LARGEST = 1e7  # [m], [m/s], [rad/s], [N]: beyond any vehicle; squares stay far from overflow
QUATERNION_TOLERANCE = 1e-3  # tolerance of a unit quaternion's norm; it is then normalised
STEEPEST = 1e-3  # in the plane: least horizontal component of a body x axis with a yaw
LONGEST_PATH = 10_000  # poses
LONGEST_FRAME = 256  # characters
SECOND = 1_000_000_000  # [ns]
UNDATED = -1  # [ns], for a missing stamp
POSE_TWIST = ('pose', 'twist')  # topics of odometry in two halves
APART = SECOND // 10  # [ns] largest difference between a pose and its twist
PAIRED = 20  # messages after two with equal stamps, in which others are expected
THINNEST = 1e-3  # [m] least extent of bodies: far from home, rounding would leave nothing of less
# Possible thrust axes of the body, each with the rotation that turns x into it.
THRUST_AXES: dict[str, Array] = {
    'x': sealed(np.eye(3)),
    'z': sealed(np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])),
}


@dataclass(frozen=True)
class Frames:
    """Required frames of messages; an empty name accepts any.

    The linear velocity of odometry is in the frame ``body``, as the message type defines, or
    ``world``, as published by some autopilots; then the frame of the twist is ignored.
    """

    world: str = ''  # of poses
    body: str = ''  # of twists
    thrust_axis: str = 'x'  # body axis of the thrust; in space also ``z``
    velocity: str = 'body'

    def turned(self, own: Array) -> Array:
        """Return an attitude, or a body vector, in the frame whose x axis is the thrust axis.

        Args:
            own: the vehicle's attitude, shape (n, n), or a vector in its body frame, shape (3,).
        """
        return own if self.thrust_axis == 'x' else own @ THRUST_AXES[self.thrust_axis]

    def own(self, turned: Array) -> Array:
        """Return the vehicle's own attitude or body vector, the inverse of :meth:`turned`."""
        return turned if self.thrust_axis == 'x' else turned @ THRUST_AXES[self.thrust_axis].T


@dataclass(frozen=True)
class Stamp:
    """Stamp and frames of an odometry message, which outputs reuse."""

    nanoseconds: int  # exact, unlike seconds as a float
    frames: Frames = field(default_factory=Frames)  # of the pose and of the twist


# --- reading: each function raises BadInput, naming the field, for what is not acceptable


def nanoseconds(stamp: Time | Duration, culprit: str) -> int:
    """Return a stamp or a duration in nanoseconds.

    Raises:
        BadInput: negative seconds, or nanoseconds of a whole second or more.
    """
    if stamp.sec < 0:
        raise BadInput(f'{culprit}.sec', stamp.sec, '0 or more')
    if stamp.nanosec >= SECOND:
        raise BadInput(f'{culprit}.nanosec', stamp.nanosec, f'less than {SECOND}')
    return stamp.sec * SECOND + stamp.nanosec


def stamp_of(message: Any) -> int:
    """Return a message's own stamp [ns]; :data:`UNDATED` without a valid one.

    This is the stamp of its header or of its first marker, or the time of ``/clock``.
    """
    for part in getattr(message, 'markers', [message])[:1]:
        stamp = part.header.stamp if hasattr(part, 'header') else getattr(part, 'clock', None)
        with suppress(BadInput):
            return UNDATED if stamp is None else nanoseconds(stamp, 'stamp')
    return UNDATED


def read_odometry(
    message: OdometryMessage, dimension: int, frames: Frames
) -> tuple[Stamp, Odometry]:
    """Return the stamp and the measurement of an Odometry message."""
    at = _stamp(message.header, frames.world)
    in_body, child = frames.velocity == 'body', frames.body
    if in_body:  # in a fleet it has a prefix: uav1/base_link
        name = message.child_frame_id
        wanted = name if name.endswith(f'/{child}') else child
        child = _frame(name, wanted, 'child_frame_id')
    pose, twist = message.pose.pose, message.twist.twist
    place = _triple(pose.position, 'pose.position')[:dimension]
    velocity = _triple(twist.linear, 'twist.linear')
    angular = frames.turned(_triple(twist.angular, 'twist.angular'))
    rate = angular[2 if dimension == 2 else 0 :]
    if in_body:
        velocity = frames.turned(velocity)
    unit = _quaternion(pose.orientation, 'pose.orientation')
    attitude = _attitude(unit, dimension, frames)
    if attitude is None:
        allowed = 'x, y, z, w with the body z axis upwards and its x axis not vertical'
        raise BadInput('pose.orientation', np.roll(unit, -1).tolist(), allowed)
    velocity = velocity[:dimension] if in_body else velocity[:dimension] @ attitude
    odometry = Odometry(at.nanoseconds / SECOND, place, attitude, velocity, rate)
    return Stamp(at.nanoseconds, Frames(at.frames.world, child, frames.thrust_axis)), odometry


def read_sighting(
    message: PoseStamped, dimension: int, frames: Frames, move: Array | None = None
) -> tuple[Stamp, GoalObservation]:
    """Return stamp, position and attitude of a goal's PoseStamped."""
    at = _stamp(message.header, frames.world if move is None else '')
    place, unit = _placed(message.pose, move)
    attitude = _attitude(unit, dimension, frames)
    return at, GoalObservation(at.nanoseconds / SECOND, place[:dimension], attitude)


def read_itinerary(
    message: Path, dimension: int, frames: Frames, move: Array | None = None
) -> tuple[Stamp, GoalTrajectory | Route]:
    """Return the stamp and the stamped positions of a goal's Path, with the last attitude.

    Several positions without any stamps are a path to follow.
    """
    at = _stamp(message.header, frames.world if move is None else '')
    if not 1 <= len(message.poses) <= LONGEST_PATH:
        raise BadInput('poses', f'{len(message.poses)} poses', f'1 to {LONGEST_PATH}')
    times = np.array([_stamp(each.header, '').nanoseconds / SECOND for each in message.poses])
    seen = [_placed(each.pose, move) for each in message.poses]
    places = np.array([place[:dimension] for place, _ in seen])
    if len(seen) > 1 and not times.any():
        return at, Route(places)
    return at, GoalTrajectory(times, places, _attitude(seen[-1][1], dimension, frames))


def read_wind(
    message: TwistWithCovarianceStamped, dimension: int, _frames: Frames
) -> tuple[Stamp, WindReport]:
    """Return stamp and wind of a message; its variance is unknown unless positive."""
    at = _stamp(message.header, '')
    velocity = _triple(message.twist.twist.linear, 'twist.linear')[:dimension]
    each = [float(message.twist.covariance[i]) for i in (0, 7)]
    variance = 0.5 * sum(each) if min(each) > 0.0 and max(each) <= LARGEST else math.nan
    return at, WindReport(at.nanoseconds / SECOND, velocity, variance)


def read_agent(
    message: Path, dimension: int, frames: Frames, move: Array | None = None
) -> tuple[Stamp, AgentTrajectory]:
    """Return the stamp and the trajectory of another vehicle's plan."""
    at, itinerary = read_itinerary(message, dimension, frames, move)
    if isinstance(itinerary, Route):
        raise BadInput('poses', 'without stamps', 'stamps that increase')
    return at, AgentTrajectory(at.nanoseconds / SECOND, itinerary.times, itinerary.positions)


def read_command(message: TwistStamped | WrenchStamped, frames: Frames) -> tuple[int, float, Array]:
    """Return the stamp [ns] of a command, its part along the thrust axis, and that about the axes.

    These are speed [m/s] and body rate [rad/s], or force [N] and torque [N m], of shape (3,).
    """
    at, parts = _stamp(message.header, ''), ('twist.linear', 'twist.angular')
    if isinstance(message, WrenchStamped):
        parts = 'wrench.force', 'wrench.torque'
    along, about = (frames.turned(_triple(attrgetter(part)(message), part)) for part in parts)
    return at.nanoseconds, float(along[0]), about


def read_transform(message: Transform, name: str) -> tuple[Array, Array]:
    """Return the rotation, shape (3, 3), and the translation, shape (3,) [m], of a transform."""
    try:
        unit = _quaternion(message.rotation, 'rotation')
        return from_quaternion(unit, 3), _triple(message.translation, 'translation')
    except BadInput as error:
        problem = f'{name}: {error}'
        raise BadInput.stating('invalid transform', problem, 'publish a valid one') from None


def altitude_of(goal: PoseStamped, move: Array | None) -> float:
    """Return the altitude of a goal, moved [m]; NaN without one, which is sent as 0."""
    return float(_placed(goal.pose, move)[0][2]) if goal.pose.position.z else math.nan


def _placed(pose: Pose, move: Array | None) -> tuple[Array, Array]:
    """Return position, shape (3,) [m], and unit quaternion (w, x, y, z) of a pose, moved."""
    unit = _quaternion(pose.orientation, 'pose.orientation')
    place = _triple(pose.position, 'pose.position')
    if move is not None:
        turn, shift = move[:3, :3], move[:3, 3]
        unit = to_quaternion(turn @ from_quaternion(unit, 3))
        place = _triple(vector(turn @ place + shift), 'pose.position')
    return place, unit


def _stamp(header: Header, frame: str) -> Stamp:
    world = _frame(header.frame_id, frame, 'header.frame_id')
    return Stamp(nanoseconds(header.stamp, 'header.stamp'), Frames(world))


def _frame(name: str, wanted: str, culprit: str) -> str:
    if wanted and name != wanted:
        raise BadInput(culprit, repr(name), f'{wanted!r} (parameter {culprit.split(".")[-1]})')
    if len(name) > LONGEST_FRAME:
        raise BadInput(culprit, repr(name), f'at most {LONGEST_FRAME} characters')
    return name


def _triple(vector: Vector3 | Point, culprit: str) -> Array:
    x, y, z = vector.x, vector.y, vector.z
    if not (abs(x) <= LARGEST and abs(y) <= LARGEST and abs(z) <= LARGEST):  # also refuses NaN
        raise BadInput(culprit, [x, y, z], f'finite numbers within +-{LARGEST:g}')
    return np.array([x, y, z])


def _quaternion(message: Quaternion, culprit: str) -> Array:
    """Return the unit quaternion (w, x, y, z)."""
    x, y, z, w = numbers = [message.x, message.y, message.z, message.w]
    norm = math.hypot(*numbers)
    if not abs(norm - 1.0) <= QUATERNION_TOLERANCE:  # also refuses NaN
        raise BadInput(culprit, numbers, f'a unit quaternion within {QUATERNION_TOLERANCE:g}')
    return np.array([w, x, y, z]) / norm


def _attitude(unit: Array, dimension: int, frames: Frames) -> Array | None:
    """Return the attitude of a quaternion; None in the plane if it has no yaw, or z points down."""
    attitude = from_quaternion(unit, 3)
    if dimension == 3:
        return frames.turned(attitude)
    level = math.hypot(*attitude[:2, 0]) >= STEEPEST and attitude[2, 2] >= 0.0
    return from_quaternion(unit, 2) if level else None


class PoseTwistSynchronizer:
    """Pairs poses with twists as odometry, stamped as the pose.

    While both come with equal stamps, in any order, those with the same stamp are paired. Otherwise
    both are measured at their own rates, and a pose is paired with the latest twist.
    """

    def __init__(self) -> None:
        self._latest: dict[str, tuple[int, Any]] = {}  # stamps [ns] and messages, by topic
        self._joined_at = -1  # stamp of the last pose turned into odometry [ns]
        self._unequal = PAIRED  # messages since two had equal stamps

    def take(self, topic: str, message: PoseStamped | TwistStamped) -> OdometryMessage | None:
        """Take in a message on ``pose`` or ``twist``; return odometry once a pair is complete.

        Raises:
            BadInput: its stamp is not valid, or those of pose and twist differ too much.
        """
        self._latest[topic] = nanoseconds(message.header.stamp, f'{topic}.header.stamp'), message
        if len(self._latest) < len(POSE_TWIST):
            return None
        (stamp, pose), (other, twist) = (self._latest[each] for each in POSE_TWIST)
        self._unequal = 0 if stamp == other else self._unequal + 1
        alone = self._unequal > PAIRED if topic == 'pose' else self._joined_at < 0
        answered = topic == 'twist' and stamp == self._joined_at
        if answered or not (alone or stamp == other):
            return None
        if abs(stamp - other) > APART:
            apart = f'{abs(stamp - other) / SECOND:.3g} s from that of pose'
            raise BadInput('twist.header.stamp', apart, f'within {APART / SECOND:g} s')
        self._joined_at = stamp
        joined = OdometryMessage(header=pose.header, child_frame_id=twist.header.frame_id)
        joined.pose.pose, joined.twist.twist = pose.pose, twist.twist
        return joined


# --- writing


def time_message(at: int) -> Time:
    """Return a stamp given in nanoseconds."""
    return Time(sec=at // SECOND, nanosec=at % SECOND)


def header(at: int, frame: str) -> Header:
    """Return a header for a stamp [ns] and a frame."""
    return Header(stamp=time_message(at), frame_id=frame)


def point(position: Array) -> Point:
    """Return a position, shape (n,) [m], as a Point."""
    return Point(**dict(zip('xyz', map(float, position), strict=False)))


def quaternion(rotation: Array) -> Quaternion:
    """Return a rotation, shape (n, n), as a Quaternion."""
    return Quaternion(**dict(zip('wxyz', to_quaternion(rotation).tolist(), strict=True)))


def vector(xyz: Array) -> Vector3:
    """Return a vector of shape (3,) as a Vector3."""
    return Vector3(**dict(zip('xyz', xyz.tolist(), strict=True)))


def angular(body_rate: Array, frames: Frames) -> Vector3:
    """Return a body rate, shape (1,) or (3,) [rad/s], as a Vector3 in the vehicle's own axes."""
    return vector(frames.own(np.concatenate([np.zeros(3 - len(body_rate)), body_rate])))


def pushing(size: float, frames: Frames) -> Vector3:
    """Return a speed or force along the thrust axis as a Vector3 in the vehicle's own axes."""
    return vector(frames.own(np.array([size, 0.0, 0.0])))


def pushed(vector: Vector3) -> float:
    """Return the size of a speed or force along the thrust axis, x or z."""
    return vector.x or vector.z


def pose(position: Array, rotation: Array | None = None) -> Pose:
    """Return a position, shape (n,), and a rotation, shape (n, n), as a Pose; upright without."""
    turned = Quaternion() if rotation is None else quaternion(rotation)
    return Pose(position=point(position), orientation=turned)


def twist_message(stamp: Stamp, speed: float, body_rate: Array) -> TwistStamped:
    """Return a forward speed [m/s] and body rate, shape (1,) or (3,) [rad/s], in the body frame."""
    frames = stamp.frames
    twist = Twist(linear=pushing(speed, frames), angular=angular(body_rate, frames))
    return TwistStamped(header=header(stamp.nanoseconds, frames.body), twist=twist)


def wrench_message(stamp: Stamp, force: float) -> WrenchStamped:
    """Return a commanded force along the thrust axis [N], in the body frame."""
    wrench = Wrench(force=pushing(force, stamp.frames))
    return WrenchStamped(header=header(stamp.nanoseconds, stamp.frames.body), wrench=wrench)


def command_messages(
    settings: Any, stamp: Stamp, command: Command, *, oriented: bool = True
) -> Iterator[tuple[str, Any]]:
    """Yield the messages to the vehicle, with their topics.

    ``settings`` are the planner's, ``stamp`` is that of the answered odometry. ``oriented`` tells
    whether the vehicle's attitude is known, so that one can be commanded.
    """
    frames, inertial = stamp.frames, settings.problem.inertial
    commanded = settings.problem.forward * command.speed_fraction  # [m/s] or [m/s^2]
    if inertial:
        yield 'cmd_thrust', wrench_message(stamp, settings.mass * commanded)
    yield 'cmd_vel', twist_message(stamp, 0.0 if inertial else commanded, command.body_rate)
    if oriented:  # in the world frame, at the end of the next step
        head, turned = header(stamp.nanoseconds, frames.world), frames.own(command.rotation)
        yield 'rotation', QuaternionStamped(header=head, quaternion=quaternion(turned))
    if settings.hover_thrust:
        share = pushing(settings.hover_thrust * commanded / settings.gravity, frames)
        yield 'thrust', Vector3Stamped(header=header(stamp.nanoseconds, frames.body), vector=share)


def path_message(stamp: Stamp, step: float, poses: Iterable[Pose], after: float = 0.0) -> Path:
    """Return a path of poses every ``step`` [s], the first one ``after`` [s] the stamp."""
    frame = stamp.frames.world
    path = Path(header=header(stamp.nanoseconds, frame))
    for k, each in enumerate(poses):
        at = stamp.nanoseconds + round((after + k * step) * SECOND)
        path.poses.append(PoseStamped(header=header(at, frame), pose=each))
    return path


def goal_message(stamp: Stamp, position: Array) -> PoseStamped:
    """Return the position of the goal, shape (n,) [m], in the world frame."""
    return PoseStamped(header=header(stamp.nanoseconds, stamp.frames.world), pose=pose(position))


def odometry_message(stamp: Stamp, odometry: Odometry) -> OdometryMessage:
    """Return a measurement as an Odometry message."""
    message = OdometryMessage(
        header=header(stamp.nanoseconds, stamp.frames.world), child_frame_id=stamp.frames.body
    )
    frames, velocity = stamp.frames, np.zeros(3)
    velocity[: len(odometry.body_velocity)] = odometry.body_velocity
    message.pose.pose = pose(odometry.position, frames.own(odometry.attitude))
    message.twist.twist.linear = vector(frames.own(velocity))
    message.twist.twist.angular = angular(odometry.body_rate, frames)
    return message


def health_message(
    at: int, node: str, task: str, level: bytes, message: str, values: Mapping[str, object]
) -> DiagnosticArray:
    """Return a status for /diagnostics, stamped ``at`` [ns], named as by diagnostic_updater.

    The namespace in the full name of the reporting ``node`` identifies the vehicle.
    """
    name = node.strip('/')
    diagnostic = diagnostics(at, f'{name}: {task}', level, message, values)
    diagnostic.status[0].hardware_id = name.rpartition('/')[0] or 'none'
    return diagnostic


def diagnostics(
    at: int, name: str, level: bytes, message: str, values: Mapping[str, object]
) -> DiagnosticArray:
    """Return one diagnostic status, stamped ``at`` [ns]; values other than text become JSON."""
    pairs = [
        KeyValue(key=key, value=value if isinstance(value, str) else json.dumps(value))
        for key, value in values.items()
    ]
    status = DiagnosticStatus(name=name, level=level, message=message, values=pairs)
    return DiagnosticArray(header=header(at, ''), status=[status])


# --- markers, for viewers and as input

FLAT = 0.02  # [m] height of planar bodies
GREEN, BLUE, RED = (0.1, 0.6, 0.3, 1.0), (0.1, 0.4, 0.9, 1.0), (0.8, 0.2, 0.1, 0.6)
GREY, ORANGE = (0.5, 0.5, 0.5, 0.5), (0.9, 0.5, 0.1, 1.0)
LINE = 0.02  # width of lines, in units of the scene's unit length
LIFETIME = 3.0  # [steps] after which markers of a dead node vanish


def read_obstacle(
    marker: Marker, dimension: int, frames: Frames, move: Array | None = None
) -> tuple[Stamp, ObservedBody]:
    """Return the stamp of a marker, and the body that it shows, named ``ns/id``."""
    if len(marker.ns) > LONGEST_FRAME:
        raise BadInput('ns', repr(marker.ns), f'at most {LONGEST_FRAME} characters')
    if marker.action != Marker.ADD:
        raise BadInput('action', marker.action, 'ADD or MODIFY (0) | DELETE (2) | DELETEALL (3)')
    if marker.type not in (Marker.CUBE, Marker.SPHERE, Marker.CYLINDER):
        raise BadInput('type', marker.type, 'CUBE (1) | SPHERE (2) | CYLINDER (3)')
    sizes = np.array([marker.scale.x, marker.scale.y, marker.scale.z])
    if not ((sizes > 0.0) & (sizes <= LARGEST)).all():  # also refuses NaN
        raise BadInput('scale', sizes.tolist(), f'sizes above 0, at most {LARGEST:g}')
    # It has the header and pose of a sighting, but no thrust axis.
    stamp, seen = read_sighting(marker, 3, Frames(frames.world), move)
    assert seen.attitude is not None
    body = _body(marker.type, seen.position, seen.attitude, sizes, dimension)
    lasting = nanoseconds(marker.lifetime, 'lifetime') / SECOND or math.inf  # 0: for ever
    return stamp, ObservedBody(f'{marker.ns}/{marker.id}', seen.time, body, lasting)


def _body(kind: int, middle: Array, turned: Array, size: Array, dimension: int) -> Box | Ball:
    """Return the body that covers a marker with its middle at a place, shape (3,) [m].

    Its axes in the world are ``turned``, shape (3, 3), and along them it has a size, (3,) [m].
    """
    half, n = 0.5 * np.maximum(size, THINNEST), dimension
    if kind == Marker.SPHERE:
        return Ball(middle[:n], float(half.max()))
    radius, axis = float(half[:2].max()), turned[:, 2]
    if kind == Marker.CYLINDER and n == 2:  # a lying one looks longer than it is wide
        return Ball(middle[:2], radius + float(half[2]) * math.hypot(*axis[:2]))
    reach = np.abs(turned) @ half
    if kind == Marker.CYLINDER:  # its discs reach less far than squares
        reach = half[2] * np.abs(axis) + radius * np.sqrt(np.maximum(0.0, 1.0 - axis**2))
    return Box(middle[:n] - reach[:n], middle[:n] + reach[:n])


def shown(marker: Marker, body: Box | Ball) -> Marker:
    """Return a marker changed to show a body."""
    if isinstance(body, Ball):
        marker.type = Marker.SPHERE if body.dimension == 3 else Marker.CYLINDER
        sizes = np.full(body.dimension, 2.0 * body.radius)
    else:
        marker.type, sizes = Marker.CUBE, body.maximum - body.minimum
    if body.dimension == 2:
        sizes = np.append(sizes, FLAT)
    marker.pose.position = point(body.centre)
    marker.scale = vector(sizes)
    return marker


def plan_markers(
    stamp: Stamp, problem: Problem, plan: Plan, hazards: Sequence[MovingObstacle] = ()
) -> MarkerArray:
    """Return markers of the plan (a line), its thrust (arrows), its obstacles and its floor.

    Hazards are shown at their positions at the start, with lines along their motion to the end. The
    floor is the region reached in a step below the minimum speed, around the vehicle.
    """
    unit = problem.forward * problem.step
    # A shorter plan has fewer arrows: earlier markers are removed.
    drawn = [Marker(header=header(stamp.nanoseconds, stamp.frames.world), action=Marker.DELETEALL)]

    def add(name: str, kind: int, color: tuple[float, ...], number: int = 0) -> Marker:
        drawn.append(marker(stamp, name, number, kind, color, problem.step))
        drawn[-1].scale.x = LINE * unit
        return drawn[-1]

    add('plan', Marker.LINE_STRIP, GREEN).points = [point(each) for each in plan.positions]
    for k, fraction in enumerate(plan.speed_fraction):
        shaft = add('thrust', Marker.ARROW, BLUE, k)
        shaft.pose = pose(plan.positions[k], plan.projected[k])
        # Viewers warn about arrows of length zero.
        shaft.scale = Vector3(x=max(0.5 * unit * fraction, 1e-3), y=0.05 * unit, z=0.05 * unit)
    for k, body in enumerate(problem.obstacles):
        shown(add('obstacles', Marker.CUBE, RED, k), body)
    times = problem.step * np.arange(problem.horizon + 1)
    for k, hazard in enumerate(hazards):
        shown(add('hazards', Marker.CUBE, RED, k), hazard.body)
        path = hazard.body.centre + hazard.moved(times)
        add('ways', Marker.LINE_STRIP, RED, k).points = [point(each) for each in path]
    if lines := problem.floor.outline(problem.dimension):
        floor = add('floor', Marker.LINE_LIST, GREY)
        floor.pose.position = point(plan.positions[0])
        pieces = [line[k : k + 2] for line in lines for k in range(len(line) - 1)]
        floor.points = [point(unit * end) for piece in pieces for end in piece]
    return MarkerArray(markers=drawn)


def marker(
    stamp: Stamp, name: str, number: int, kind: int, color: tuple[float, ...], step: float
) -> Marker:
    """Return a marker at the origin, without a shape, that vanishes after some steps [s]."""
    head, lasting = header(stamp.nanoseconds, stamp.frames.world), round(LIFETIME * step * SECOND)
    blank = Marker(header=head, ns=name, id=number, type=kind, action=Marker.ADD)
    blank.pose.orientation.w = 1.0
    blank.color = ColorRGBA(**dict(zip('rgba', color, strict=True)))
    blank.lifetime = Duration(sec=lasting // SECOND, nanosec=lasting % SECOND)
    return blank
