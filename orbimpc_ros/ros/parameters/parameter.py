# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A parameter: one row of a table from which its descriptor, checks and documentation follow."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidTopicNameException
from rclpy.parameter import Parameter
from rclpy.validate_topic_name import validate_topic_name

from orbimpc_ros.loop.state import SOURCES
from orbimpc_ros.mpc.arrays import ABOVE_ZERO, Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.problem import Box, Problem
from orbimpc_ros.ros.messages import THRUST_AXES, Frames
from orbimpc_ros.sim.vehicle import RANGES, model_of

Value = bool | int | float | str | tuple[float, ...] | tuple[str, ...]
Values = Mapping[str, Any]

FAR = 1e6  # [m]: positions in parameters
MAX_DURATION = 1e3  # [s]: in parameters
TINY = 1e-6  # stands for "above zero" in ranges, which are closed
MODEL = model_of(Problem())


@dataclass(frozen=True)
class Row:
    """One parameter.

    Attributes:
        name: as ROS knows it.
        default: its type is the parameter's; tuples are arrays of doubles, or of words.
        description: one sentence.
        unit: of the value; empty for none.
        low: least value allowed, of every element of an array.
        high: greatest.
        choices: words allowed, if the parameter is one of a few.
        live: whether it may change while the node runs.
        words: whether an array is one of words.
        timed_thrust: the default with ``weights.scaling`` time at translation order 2, if another.
    """

    name: str
    default: Value
    description: str
    unit: str = ''
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    live: bool = False
    words: bool = False
    timed_thrust: Value | None = None

    def default_beside(self, given: Values) -> Value:
        """Return the default where other parameters have values that were given."""
        timed = (given.get('weights.scaling'), given.get('translation_order')) == ('time', 2)
        return self.timed_thrust if timed and self.timed_thrust is not None else self.default

    @property
    def kind(self) -> Parameter.Type:
        """Return the ROS type."""
        if self.words:
            return Parameter.Type.STRING_ARRAY
        if isinstance(self.default, tuple):
            return Parameter.Type.DOUBLE_ARRAY
        return Parameter.Type.from_parameter_value(self.default)

    @property
    def allowed(self) -> str:
        """Return what is allowed, in words."""
        if self.choices:
            return ' | '.join(self.choices)
        if isinstance(self.default, bool):
            return 'true | false'
        if isinstance(self.default, str):
            return 'text'
        if self.words:
            return 'a list of words'
        span = f'in [{self.low:g}, {self.high:g}]'
        if isinstance(self.default, tuple):
            return f'doubles {span}, each with a decimal point'
        if isinstance(self.default, int):
            return f'an integer {span}'
        return f'a double {span}, with a decimal point'

    @property
    def descriptor(self) -> ParameterDescriptor:
        """Return the ROS descriptor."""
        described = ParameterDescriptor(
            name=self.name,
            type=self.kind.value,
            description=self.description + (f' [{self.unit}]' if self.unit else ''),
            additional_constraints=self.allowed,
            read_only=not self.live,
        )
        if isinstance(self.default, float):
            span = FloatingPointRange(from_value=self.low, to_value=self.high)
            described.floating_point_range = [span]
        elif isinstance(self.default, int) and not isinstance(self.default, bool):
            described.integer_range = [
                IntegerRange(from_value=int(self.low), to_value=int(self.high))
            ]
        return described

    def check(self, value: Any) -> None:
        """Check a value's range.

        Raises:
            BadInput: out of range, not finite or none of the choices.
        """
        if self.choices and value not in self.choices:
            raise BadInput.choice(self.name, value, self.choices)
        if self.words:
            good = all(isinstance(each, str) for each in value)
        elif isinstance(self.default, (bool, str)):
            good = True
        else:
            good = bool(np.all((np.asarray(value) >= self.low) & (np.asarray(value) <= self.high)))
        if not good:
            raise BadInput(self.name, value, self.allowed)


def completed(rows: Iterable[Row], given: Values) -> dict[str, Any]:
    """Return the values that were given, and defaults for the rest."""
    return {row.name: row.default_beside(given) for row in rows} | dict(given)


def span(low: float, high: float) -> tuple[float, float]:
    """Return a range as parameters have it: closed, so that a small number stands for zero."""
    return (TINY if low == ABOVE_ZERO else low), high


def vector(values: Values, name: str, dimension: int) -> Array:
    """Return the first n of x, y, z: in the plane z may be left out."""
    if not dimension <= len(values[name]) <= 3:
        wanted = '3 numbers' if dimension == 3 else '2 or 3 numbers'
        raise BadInput(name, list(values[name]), wanted)
    return np.array(values[name][:dimension], dtype=float)


def disturbance_of(values: Values) -> Array:
    """Return the known wind or acceleration, gravity's included, shape (n,).

    Raises:
        BadInput: a vehicle of these orders does not know gravity.
    """
    n, gravity = values['dimension'], values['gravity']
    known = vector(values, 'wind', n)
    if gravity and (n, values['translation_order']) != (3, 2):
        raise BadInput('gravity', gravity, '0 unless dimension is 3 and translation_order 2')
    known[-1] -= gravity
    return known


def require_topic(parameter: str, topic: str) -> None:
    """Check that a word names a topic.

    Raises:
        BadInput: it does not.
    """
    allowed = 'names of topics, such as /uav2/plan'
    try:
        validate_topic_name(topic)
    except InvalidTopicNameException:
        raise BadInput(parameter, topic, allowed) from None
    if '//' in topic:  # which that lets pass, and a subscription does not
        raise BadInput(parameter, topic, allowed)


def boxes_of(values: Values) -> tuple[Box, ...]:
    """Return the obstacles.

    Raises:
        BadInput: a number too many, or an upper corner that is not above the lower one.
    """
    numbers, n = values['obstacles'], values['dimension']
    if len(numbers) % (2 * n):
        raise BadInput('obstacles', list(numbers), f'{2 * n} numbers for each box')
    corners = np.array(numbers, dtype=float).reshape(-1, 2, n)
    return tuple(Box(low, high) for low, high in corners)


# Of the process rather than the vehicle: the same for both nodes.
PROCESS = (
    Row('autostart', True, 'Whether to configure and activate itself at the start; else whoever '
        'manages it does, by ~/change_state'),
    Row('executor', 'wait_set', "What waits for messages: wait_set, rclpy's ordinary executor; "
        'events, its experimental one, which takes less processor time (rclpy 7.1.4 and later)',
        choices=('wait_set', 'events')),
)  # fmt: skip
OBSTACLES = Row('obstacles', (), 'Boxes to stay out of: lower, then upper corner of each',
    'm', -FAR, FAR, live=True)  # fmt: skip


def _shared(name: str, description: str, unit: str = '', *, live: bool = False) -> Row:
    """Return what planner and simulator must agree on: default and range are the vehicle's."""
    low, high = span(*RANGES[name])
    return Row(name, getattr(MODEL, name), description, unit, low, high, live=live)


VEHICLE = (
    _shared('dimension', 'Plane (2) or space (3)'),
    _shared('rotation_order',
        'Whether inputs are rates (1) or accelerations (2) of the rotation'),
    _shared('translation_order',
        'Whether the forward axis carries a velocity (1) or an acceleration (2)'),
    Row('step', MODEL.step, 'Length of a step', 's', 1e-3, MAX_DURATION),
    _shared('forward', 'Full speed or thrust acceleration', 'm/s or m/s^2', live=True),
    _shared('mass', 'Turns a thrust acceleration into a force', 'kg', live=True),
    Row('discretisation', 'euler', 'Whether a step pushes along the old axis alone, as in the '
        'paper, or is integrated exactly while that turns', choices=('euler', 'exact')),
    Row('wind', (0.0, 0.0, 0.0), 'Known wind in the world frame, at translation order 2 an '
        'acceleration: x, y, z', 'm/s or m/s^2', -1e3, 1e3, live=True),
    Row('gravity', 0.0, 'Along -z (dimension 3, translation order 2); thrust then carries it, '
        'and cmd_thrust is the whole of it', 'm/s^2', 0.0, 1e3, live=True),
    Row('velocity_source', 'ground', 'Whether the twist of odom is over ground or through the air',
        choices=SOURCES),
    Row('frame_id', 'odom', 'World frame of poses; empty accepts any'),
    Row('child_frame_id', 'base_link', 'Body frame of twists; empty accepts any'),
    Row('thrust_axis', 'x', 'Body axis that pushes: x, or in space z, as of a multirotor; '
        'speed, force and the start-up line are about it', choices=tuple(THRUST_AXES)),
)  # fmt: skip


def frames_of(values: Values) -> Frames:
    """Return the frames that messages must be in, and the body axis that pushes.

    Raises:
        BadInput: an axis that a vehicle in the plane cannot push along.
    """
    axis = values['thrust_axis']
    if axis != 'x' and values['dimension'] == 2:
        raise BadInput('thrust_axis', axis, 'x when dimension is 2')
    return Frames(values['frame_id'], values['child_frame_id'], axis)
