# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The parameters that planner and simulator have in common: vehicle, frames, process."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from orbimpc_ros.loop.state import SOURCES
from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.problem import Box
from orbimpc_ros.mpc.problem.approach import WIDEST_APPROACH, Approach
from orbimpc_ros.ros.messages import THRUST_AXES, Frames
from orbimpc_ros.ros.parameters.spec import FAR, MAX_DURATION, TINY, parameter, specs_of, vector


@dataclass(frozen=True)
class ProcessParameters:
    """How a node's process works."""

    # fmt: off
    autostart: bool = parameter('autostart', True, 'Whether to configure and activate itself at '
        'the start; else whoever manages it does, by ~/change_state')
    executor: str = parameter('executor', 'wait_set', "What waits for messages: wait_set, rclpy's "
        'ordinary executor; events, its experimental one, which takes less processor time (rclpy '
        '7.1.4 and later)', choices=('wait_set', 'events'))
    # fmt: on


@dataclass(frozen=True)
class VehicleParameters(ProcessParameters):
    """What planner and simulator must agree on."""

    # fmt: off
    dimension: int = parameter('dimension', 2, 'Plane (2) or space (3)', '', 2, 3)
    rotation_order: int = parameter('rotation_order', 1,
        'Whether inputs are rates (1) or accelerations (2) of the rotation', '', 1, 2)
    translation_order: int = parameter('translation_order', 1,
        'Whether the forward axis carries a velocity (1) or an acceleration (2)', '', 1, 2)
    step: float = parameter('step', 1.0, 'Length of a step', 's', 1e-3, MAX_DURATION)
    forward: float = parameter('forward', 1.0, 'Full speed or thrust acceleration',
        'm/s or m/s^2', TINY, 1e3, live=True)
    mass: float = parameter('mass', 1.0, 'Turns a thrust acceleration into a force',
        'kg', TINY, 1e6, live=True)
    discretisation: str = parameter('discretisation', 'euler', 'Whether a step pushes along the '
        'old axis alone, as in the paper, or is integrated exactly while that turns',
        choices=('euler', 'exact'))
    wind: tuple[float, ...] = parameter('wind', (0.0, 0.0, 0.0), 'Known wind in the world frame, '
        'at translation order 2 an acceleration: x, y, z', 'm/s or m/s^2', -1e3, 1e3, live=True)
    gravity: float = parameter('gravity', 0.0, 'Along -z (dimension 3, translation order 2); '
        'thrust then carries it, and cmd_thrust is the whole of it', 'm/s^2', 0.0, 1e3, live=True)
    velocity_source: str = parameter('velocity_source', 'ground',
        'Whether the twist of odom is over ground or through the air', choices=SOURCES)
    frame_id: str = parameter('frame_id', 'odom', 'World frame of poses; empty accepts any')
    child_frame_id: str = parameter('child_frame_id', 'base_link',
        'Body frame of twists; empty accepts any')
    thrust_axis: str = parameter('thrust_axis', 'x', 'Body axis that pushes: x, or in space z, as '
        'of a multirotor; speed, force and the start-up line are about it',
        choices=tuple(THRUST_AXES))
    approach_cone: float = parameter('approach.cone', 0.0, 'A catch counts only with the pushing '
        'axis within this angle of approach.direction; 0 for any. Headings only: velocities have '
        'no part in it', 'rad', 0.0, WIDEST_APPROACH, live=True)
    approach_direction: tuple[float, ...] = parameter('approach.direction', (), 'Where to be '
        "headed at a catch, in the world frame: x, y, z; empty for the goal's own pushing axis, "
        'by its orientation', '', -FAR, FAR, live=True)
    obstacles: tuple[float, ...] = parameter('obstacles', (),
        'Boxes to stay out of: lower, then upper corner of each', 'm', -FAR, FAR, live=True)
    # fmt: on

    velocity_frame = 'body'  # of odometry, where it is no parameter

    @cached_property
    def disturbance(self) -> Array:
        """Return the known wind or acceleration, gravity's included, shape (n,).

        Raises:
            BadInput: a vehicle of these orders has no gravity.
        """
        if self.gravity and (self.dimension, self.translation_order) != (3, 2):
            allowed = '0 unless dimension is 3 and translation_order 2'
            raise BadInput('gravity', self.gravity, allowed)
        known = vector(self.wind, 'wind', self.dimension)
        known[-1] -= self.gravity
        return sealed(known)

    @cached_property
    def boxes(self) -> tuple[Box, ...]:
        """Return the obstacles.

        Raises:
            BadInput: a number too many, or an upper corner that is not above the lower one.
        """
        n = self.dimension
        if len(self.obstacles) % (2 * n):
            raise BadInput('obstacles', list(self.obstacles), f'{2 * n} numbers for each box')
        corners = np.array(self.obstacles, dtype=float).reshape(-1, 2, n)
        return tuple(Box(low, high) for low, high in corners)

    @cached_property
    def frames(self) -> Frames:
        """Return the frames that messages must be in, and the body axis that pushes.

        Raises:
            BadInput: an axis that a vehicle in the plane cannot push along.
        """
        if self.thrust_axis != 'x' and self.dimension == 2:
            raise BadInput('thrust_axis', self.thrust_axis, 'x when dimension is 2')
        return Frames(self.frame_id, self.child_frame_id, self.thrust_axis, self.velocity_frame)

    def approach_of_a_catch(self) -> Approach:
        """Return the cone of headings in which a catch counts.

        Raises:
            BadInput: a direction of another dimension, or of length 0.
        """
        if not self.approach_direction:
            return Approach(self.approach_cone)
        direction = vector(self.approach_direction, 'approach.direction', self.dimension)
        if not direction.any():
            raise BadInput('approach.direction', direction.tolist(), 'empty, or not all of it 0')
        return Approach(self.approach_cone, tuple(direction.tolist()))


PROCESS = specs_of(ProcessParameters)
