# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""ROS messages to plain types and back: pure functions.

What comes in is untrusted. A message is taken whole or refused whole, with the field to blame;
stamps are read as integers, never through rclpy's Time, which raises on negative seconds.
What the planner calls the body frame has the pushing axis along x; a vehicle that pushes along
another axis of its own is turned on the way in and back on the way out, here and nowhere else.
Covariances are read of winds alone: many drivers say NaN there for "unknown", which does no harm.
In the plane (n = 2) poses lie at z = 0 and turn about z.

What a marker on ``obstacles`` covers is what counts, so that a body is never smaller than its
marker. A turned cube becomes the box around it; a cylinder the sphere or the box around it,
whichever is smaller, and in the plane a disc, like a sphere. Where an ellipse is meant, the longest
axis counts. In the plane everything is what it looks like from above.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
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
    Wrench,
    WrenchStamped,
)
from nav_msgs.msg import Odometry as OdometryMessage
from nav_msgs.msg import Path
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from orbimpc_ros.loop.compensation import Odometry, WindReport
from orbimpc_ros.loop.goal.motion import GoalObservation, GoalTrajectory, Route
from orbimpc_ros.loop.traffic import AgentTrajectory, ObservedBody, centre
from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import from_quaternion, heading, to_quaternion
from orbimpc_ros.mpc.plan import Command, Plan
from orbimpc_ros.mpc.problem import Ball, Box, MovingObstacle, Problem

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
LARGEST = 1e7  # [m], [m/s], [rad/s], [N]: beyond any vehicle; squares stay far from overflow
QUATERNION_TOLERANCE = 1e-3  # a unit quaternion may be this far off; it is then normalised
STEEPEST = 1e-3  # in the plane: least horizontal share of the body's x axis that has a yaw
LONGEST_PATH = 10_000  # poses
LONGEST_FRAME = 256  # characters
SECOND = 1_000_000_000  # [ns]
POSE_TWIST = ('pose', 'twist')  # topics of odometry in two halves
APART = SECOND // 10  # [ns] at most, from a pose to its twist
# The body axes that may push, each with the rotation that turns x into it.
THRUST_AXES: dict[str, Array] = {
    'x': sealed(np.eye(3)),
    'z': sealed(np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])),
}


@dataclass(frozen=True)
class Frames:
    """Frames that messages must be in; an empty name accepts any.

    Attributes:
        world: of poses.
        body: of twists.
        thrust_axis: the body axis that pushes, ``x`` or, in space, ``z``.
        velocity: what the linear velocity of odometry is given in: the ``body`` frame, as its type
            has it, or the ``world`` frame, as some autopilots do; then the twist's frame is not
            looked at.
    """

    world: str = ''
    body: str = ''
    thrust_axis: str = 'x'
    velocity: str = 'body'

    def turned(self, own: Array) -> Array:
        """Return an attitude, or a vector of the body, as of the frame whose x axis pushes.

        Args:
            own: the vehicle's attitude, shape (n, n), or a vector in its body frame, shape (3,).
        """
        return own if self.thrust_axis == 'x' else own @ THRUST_AXES[self.thrust_axis]

    def own(self, turned: Array) -> Array:
        """Return the vehicle's own attitude, or a vector of its body: see :meth:`turned`."""
        return turned if self.thrust_axis == 'x' else turned @ THRUST_AXES[self.thrust_axis].T


@dataclass(frozen=True)
class Stamp:
    """When and in which frames an odometry message was measured: outputs carry them on.

    Attributes:
        nanoseconds: the stamp; exact, where seconds as a float are not [ns].
        frames: of the pose and of the twist.
    """

    nanoseconds: int
    frames: Frames = field(default_factory=Frames)


# --- reading


def nanoseconds(stamp: Time, culprit: str) -> int:
    """Return a stamp in nanoseconds.

    Raises:
        BadInput: negative seconds, or a second's worth of nanoseconds and more.
    """
    if stamp.sec < 0:
        raise BadInput(f'{culprit}.sec', stamp.sec, '0 or more')
    if stamp.nanosec >= SECOND:
        raise BadInput(f'{culprit}.nanosec', stamp.nanosec, f'less than {SECOND}')
    return stamp.sec * SECOND + stamp.nanosec


def read_odometry(
    message: OdometryMessage, dimension: int, frames: Frames
) -> tuple[Stamp, Odometry]:
    """Return the stamp and the measurement in an Odometry message.

    Raises:
        BadInput: a frame, a stamp, a number or the quaternion is not acceptable.
    """
    at = _stamp(message.header, frames.world)
    in_body, child = frames.velocity == 'body', frames.body
    if in_body:  # which a vehicle of many has behind a prefix: uav1/base_link
        found = message.child_frame_id
        wanted = found if found.endswith(f'/{child}') else child
        child = _frame(found, wanted, 'child_frame_id')
    pose, twist = message.pose.pose, message.twist.twist
    linear = _triple(twist.linear, 'twist.linear')
    angular = _triple(twist.angular, 'twist.angular')
    unit = _quaternion(pose.orientation, 'pose.orientation')
    attitude = _attitude(unit, dimension, frames)
    if attitude is None:
        given = 'a body x axis with a yaw, not a vertical one'
        raise BadInput('pose.orientation', unit.tolist(), given)
    odometry = Odometry(
        at.nanoseconds / SECOND,
        _triple(pose.position, 'pose.position')[:dimension],
        attitude,
        frames.turned(linear)[:dimension] if in_body else linear[:dimension] @ attitude,
        frames.turned(angular)[2 if dimension == 2 else 0 :],
    )
    return Stamp(at.nanoseconds, Frames(at.frames.world, child, frames.thrust_axis)), odometry


def read_sighting(
    message: PoseStamped, dimension: int, frames: Frames
) -> tuple[Stamp, GoalObservation]:
    """Return the stamp, the place and the attitude in a goal's PoseStamped.

    Raises:
        BadInput: a frame, a stamp, a number or the quaternion is not acceptable.
    """
    at, place, unit = _seen(message, dimension, frames.world)
    attitude = _attitude(unit, dimension, frames)
    return at, GoalObservation(at.nanoseconds / SECOND, place, attitude)


def read_itinerary(
    message: Path, dimension: int, frames: Frames
) -> tuple[Stamp, GoalTrajectory | Route]:
    """Return the stamp and the stamped places in a goal's Path, with the last one's attitude.

    Several places none of which has a stamp are a path to follow.

    Raises:
        BadInput: no pose or too many, stamps that do not increase, or a pose not acceptable.
    """
    at = _stamp(message.header, frames.world)
    if not 1 <= len(message.poses) <= LONGEST_PATH:
        raise BadInput('poses', f'{len(message.poses)} poses', f'1 to {LONGEST_PATH}')
    seen = [_seen(pose, dimension, '') for pose in message.poses]
    times = np.array([stamp.nanoseconds / SECOND for stamp, _, _ in seen])
    places = np.array([place for _, place, _ in seen])
    if len(seen) > 1 and not times.any():
        return at, Route(places)
    return at, GoalTrajectory(times, places, _attitude(seen[-1][2], dimension, frames))


def read_wind(
    message: TwistWithCovarianceStamped, dimension: int, _frames: Frames
) -> tuple[Stamp, WindReport]:
    """Return the stamp and the wind in a message; one without a positive variance has none known.

    Raises:
        BadInput: a stamp or a number is not acceptable.
    """
    at = _stamp(message.header, '')
    velocity = _triple(message.twist.twist.linear, 'twist.linear')[:dimension]
    variance = 0.5 * float(message.twist.covariance[0] + message.twist.covariance[7])
    known = variance if 0.0 < variance <= LARGEST else math.nan
    return at, WindReport(at.nanoseconds / SECOND, velocity, known)


def read_agent(message: Path, dimension: int, frames: Frames) -> tuple[Stamp, AgentTrajectory]:
    """Return the stamp and the trajectory in another vehicle's plan.

    Raises:
        BadInput: as :func:`read_itinerary`.
    """
    at, itinerary = read_itinerary(message, dimension, frames)
    if isinstance(itinerary, Route):
        raise BadInput('poses', 'without stamps', 'stamps that increase')
    return at, AgentTrajectory(at.nanoseconds / SECOND, itinerary.times, itinerary.positions)


def read_speed_and_rate(
    message: TwistStamped, dimension: int, frames: Frames
) -> tuple[int, float, Array]:
    """Return the stamp [ns], forward speed [m/s] and body rate [rad/s] of a commanded twist.

    The rate has shape (1,) in the plane and (3,) in space.

    Raises:
        BadInput: a stamp or a number is not acceptable.
    """
    at = _stamp(message.header, '')
    linear = frames.turned(_triple(message.twist.linear, 'twist.linear'))
    angular = frames.turned(_triple(message.twist.angular, 'twist.angular'))
    return at.nanoseconds, float(linear[0]), angular[2 if dimension == 2 else 0 :]


def read_force(message: WrenchStamped, frames: Frames) -> tuple[int, float]:
    """Return the stamp [ns] and the force along the pushing axis [N] of a commanded wrench.

    Raises:
        BadInput: a stamp or a number is not acceptable.
    """
    at = _stamp(message.header, '')
    force = _triple(message.wrench.force, 'wrench.force')
    _triple(message.wrench.torque, 'wrench.torque')
    return at.nanoseconds, float(frames.turned(force)[0])


def read_transform(message: Transform, name: str) -> tuple[Array, Array]:
    """Return the rotation, shape (3, 3), and the translation, shape (3,) [m], of a transform.

    Raises:
        BadInput: a number or the quaternion of the transform of that name is not acceptable.
    """
    unit = _quaternion(message.rotation, f'rotation of {name}')
    return from_quaternion(unit, 3), _triple(message.translation, f'translation of {name}')


def _seen(message: PoseStamped, dimension: int, frame: str) -> tuple[Stamp, Array, Array]:
    """Return the stamp, the place and the unit quaternion in a goal's PoseStamped."""
    at = _stamp(message.header, frame)
    unit = _quaternion(message.pose.orientation, 'pose.orientation')
    return at, _triple(message.pose.position, 'pose.position')[:dimension], unit


def _stamp(header: Header, frame: str) -> Stamp:
    world = _frame(header.frame_id, frame, 'header.frame_id')
    return Stamp(nanoseconds(header.stamp, 'header.stamp'), Frames(world))


def _frame(found: str, wanted: str, culprit: str) -> str:
    if wanted and found != wanted:
        raise BadInput(culprit, repr(found), repr(wanted))
    if len(found) > LONGEST_FRAME:
        raise BadInput(culprit, repr(found), f'at most {LONGEST_FRAME} characters')
    return found


def _triple(vector: Vector3 | Point, culprit: str) -> Array:
    x, y, z = vector.x, vector.y, vector.z
    if not (abs(x) <= LARGEST and abs(y) <= LARGEST and abs(z) <= LARGEST):  # also refuses NaN
        raise BadInput(culprit, [x, y, z], f'finite numbers within +-{LARGEST:g}')
    return np.array([x, y, z])


def _quaternion(message: Quaternion, culprit: str) -> Array:
    """Return the unit quaternion (w, x, y, z)."""
    numbers = [message.w, message.x, message.y, message.z]
    norm = math.hypot(*numbers)
    if not abs(norm - 1.0) <= QUATERNION_TOLERANCE:  # also refuses NaN
        raise BadInput(culprit, numbers, f'a unit quaternion within {QUATERNION_TOLERANCE:g}')
    return np.array(numbers) / norm


def _attitude(unit: Array, dimension: int, frames: Frames) -> Array | None:
    """Return the attitude of a quaternion; in the plane None where the x axis has no yaw."""
    if dimension == 2 and math.hypot(*heading(unit)) < STEEPEST:
        return None
    return frames.turned(from_quaternion(unit, dimension))


class PoseTwistSynchronizer:
    """Pairs poses with twists as odometry, stamped as the pose.

    Where the two come with the same stamps, in whatever order, they belong together. Elsewhere each
    is measured at its own pace, and a pose goes with the last twist.
    """

    def __init__(self) -> None:
        self._latest: dict[str, tuple[int, Any]] = {}  # stamps [ns] and messages, by topic
        self._joined_at = -1  # stamp of the last pose that has become odometry [ns]
        self._twins = False  # whether stamps have been seen to be the same

    def take(self, topic: str, message: PoseStamped | TwistStamped) -> OdometryMessage | None:
        """Take in a message on ``pose`` or ``twist``; return odometry as soon as there is some.

        Raises:
            BadInput: its stamp is not valid, or those of pose and twist are too far apart.
        """
        self._latest[topic] = nanoseconds(message.header.stamp, f'{topic}.header.stamp'), message
        if len(self._latest) < len(POSE_TWIST):
            return None
        (stamp, pose), (other, twist) = (self._latest[each] for each in POSE_TWIST)
        alone = not self._twins if topic == 'pose' else self._joined_at < 0
        self._twins = self._twins or stamp == other
        if stamp == self._joined_at or not (alone or stamp == other):
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
    w, x, y, z = to_quaternion(rotation).tolist()
    return Quaternion(x=x, y=y, z=z, w=w)


def vector(xyz: Array) -> Vector3:
    """Return a vector of shape (3,) as a Vector3."""
    x, y, z = xyz.tolist()
    return Vector3(x=x, y=y, z=z)


def angular(body_rate: Array, frames: Frames) -> Vector3:
    """Return a body rate, shape (1,) or (3,) [rad/s], as a Vector3 of the vehicle's own axes."""
    return vector(frames.own(np.concatenate([np.zeros(3 - len(body_rate)), body_rate])))


def pushing(size: float, frames: Frames) -> Vector3:
    """Return a speed or force along the pushing axis as a Vector3 of the vehicle's own axes."""
    return vector(frames.own(np.array([size, 0.0, 0.0])))


def pushed(vector: Vector3) -> float:
    """Return the size of a speed or force that is along whatever body axis pushes."""
    return vector.x or vector.z


def pose(position: Array, rotation: Array) -> Pose:
    """Return a position, shape (n,), and a rotation, shape (n, n), as a Pose."""
    return Pose(position=point(position), orientation=quaternion(rotation))


def twist_message(stamp: Stamp, speed: float, body_rate: Array) -> TwistStamped:
    """Return a forward speed [m/s] and body rate, shape (1,) or (3,) [rad/s], in the body frame."""
    frames = stamp.frames
    twist = Twist(linear=pushing(speed, frames), angular=angular(body_rate, frames))
    return TwistStamped(header=header(stamp.nanoseconds, frames.body), twist=twist)


def wrench_message(stamp: Stamp, force: float) -> WrenchStamped:
    """Return a commanded force along the pushing axis [N], in the body frame."""
    wrench = Wrench(force=pushing(force, stamp.frames))
    return WrenchStamped(header=header(stamp.nanoseconds, stamp.frames.body), wrench=wrench)


def rotation_message(stamp: Stamp, command: Command) -> QuaternionStamped:
    """Return the attitude commanded for the next step, in the world frame."""
    head = header(stamp.nanoseconds, stamp.frames.world)
    own = stamp.frames.own(command.rotation)
    return QuaternionStamped(header=head, quaternion=quaternion(own))


def path_message(stamp: Stamp, step: float, poses: Iterable[Pose], after: float = 0.0) -> Path:
    """Return a path of poses, the first ``after`` [s] the stamp, then one every ``step`` [s]."""
    frame = stamp.frames.world
    path = Path(header=header(stamp.nanoseconds, frame))
    for k, each in enumerate(poses):
        at = stamp.nanoseconds + round((after + k * step) * SECOND)
        path.poses.append(PoseStamped(header=header(at, frame), pose=each))
    return path


def goal_message(stamp: Stamp, position: Array) -> PoseStamped:
    """Return where the goal is, shape (n,) [m], in the world frame."""
    head = header(stamp.nanoseconds, stamp.frames.world)
    return PoseStamped(header=head, pose=Pose(position=point(position)))


def goal_path_message(stamp: Stamp, step: float, positions: Sequence[Array]) -> Path:
    """Return where the goal will be, from the stamp on every ``step`` [s].

    Args:
        stamp: of the first position.
        step: from one to the next [s].
        positions: in the world frame, each of shape (n,) [m].
    """
    return path_message(stamp, step, (Pose(position=point(each)) for each in positions))


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
    """Return a status for /diagnostics, named as diagnostic_updater does.

    Args:
        at: its stamp [ns].
        node: fully qualified name of who reports; the namespace tells the vehicle.
        task: what it reports on.
        level: how it is.
        message: the same in words.
        values: figures behind it, by key.
    """
    name = node.strip('/')
    made = diagnostics(at, f'{name}: {task}', level, message, values)
    made.status[0].hardware_id = name.rpartition('/')[0] or 'none'
    return made


def diagnostics(
    at: int, name: str, level: bytes, message: str, values: Mapping[str, object]
) -> DiagnosticArray:
    """Return one diagnostic status, stamped ``at`` [ns]; values that are no text become JSON."""
    pairs = [
        KeyValue(key=key, value=value if isinstance(value, str) else json.dumps(value))
        for key, value in values.items()
    ]
    status = DiagnosticStatus(name=name, level=level, message=message, values=pairs)
    return DiagnosticArray(header=header(at, ''), status=[status])


# --- markers, for viewers and as input

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
    # It has the header and the pose of a sighting; no axis of it pushes.
    stamp, seen = read_sighting(placed(marker), 3, Frames(frames.world))
    assert seen.attitude is not None
    body = _body(marker.type, seen.position, seen.attitude, _scale(marker.scale), dimension)
    return stamp, ObservedBody(name, seen.time, body, _lifetime(marker))


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
        marker.type = Marker.SPHERE if body.dimension == 3 else Marker.CYLINDER
        sizes = np.full(body.dimension, 2.0 * body.radius)
    else:
        marker.type, sizes = Marker.CUBE, body.maximum - body.minimum
    if body.dimension == 2:
        sizes = np.append(sizes, FLAT)
    marker.pose.position = point(centre(body))
    marker.scale = vector(sizes)
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
    head = header(stamp.nanoseconds, stamp.frames.world)
    nothing = Marker(header=head, action=Marker.DELETEALL)
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
