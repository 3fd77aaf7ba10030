# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner's parameters, and the settings derived from them."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

from orbimpc_ros.loop.compensation import DISTURBANCES, ESTIMATED, GIVEN, Response
from orbimpc_ros.loop.fallback import SAFE_COMMANDS, decided
from orbimpc_ros.loop.goal.forecast import FORECASTS
from orbimpc_ros.loop.traffic import Distance
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import PROJECTIONS
from orbimpc_ros.mpc.problem import MAX_HORIZON, TERMINALS, Approach, Floor, Problem, Weights
from orbimpc_ros.mpc.problem.floor import SHAPES
from orbimpc_ros.mpc.problem.problem import SCALINGS, STEEPEST_GLIDE, weighed
from orbimpc_ros.ros.parameters.spec import (
    FAR,
    MAX_DURATION,
    TINY,
    TOPIC,
    Values,
    VehicleParameters,
    parameter,
    settings_from,
    specs_of,
)
from orbimpc_ros.ros.transforms import Edge, stated

ROUNDING = 1e-5  # in units of a step's length: above the tolerance of checked plans


@dataclass(frozen=True)
class PlannerSettings(VehicleParameters):
    """The planner's parameters, one per field, and the quantities derived from them.

    A value ``given_...`` may be a placeholder, such as 0 for a default; the effective value has the
    parameter's own name.
    """

    # fmt: off
    horizon: int = parameter('horizon', 5, 'Steps planned ahead', '', 1, MAX_HORIZON)
    weights_position: float = parameter('weights.position', 1.0,
        'On squared distance to the goal at every step', '1/m^2', 0.0, 1e6, live=True)
    weights_input: float = parameter('weights.input', 0.05, 'On squared inputs (turning, braking); '
        '150 by default with weights.scaling time at translation_order 2',
        's^2 or s^4', 0.0, 1e6, live=True)
    weights_length: float = parameter('weights.length', 0.0, 'On distance flown or thrust spent',
        '1/m', 0.0, 1e6, live=True)
    weights_terminal: float = parameter('weights.terminal', 10.0,
        'On squared distance to the goal at the last step', '1/m^2', 0.0, 1e6, live=True)
    weights_attitude: float = parameter('weights.attitude', 0.0, 'On the squared difference '
        "(Frobenius norm) of the last step's rotation from the goal's orientation; 0 ignores the "
        'orientation', '1', 0.0, 1e6, live=True)
    weights_scaling: str = parameter('weights.scaling', 'paper', 'What the weights mean: paper, '
        'sums over steps, each in its unit; time, dimensionless integrals over the horizon: the '
        'same at any step and speed', choices=SCALINGS, live=True)
    terminal: str = parameter('terminal', 'penalty', 'Whether the last step must reach the goal',
        choices=TERMINALS, live=True)
    horizon_mode: str = parameter('horizon_mode', 'receding',
        'Whether the horizon recedes, or shrinks to a fixed end', choices=('receding', 'shrinking'))
    floor_shape: str = parameter('floor.shape', 'none',
        'Minimum speed: none, the faces of a polygon, or a circle',
        choices=tuple(SHAPES), live=True)
    floor_faces: int = parameter('floor.faces', 4,
        'Faces of the polygon, or of the solid (6, 12, 20) in space', '', 3, 64, live=True)
    floor_fraction: float = parameter('floor.fraction', math.sqrt(0.3),
        'Minimum share of full speed', '', TINY, 1.0, live=True)
    tilt: float = parameter('tilt', 0.0, 'Largest angle of the thrust axis from the vertical '
        '(dimension 3, translation_order 2); 0 for any', 'rad', 0.0, 0.5 * math.pi, live=True)
    glide_slope: float = parameter('glide_slope', 0.0, 'Stay in a cone above the goal, of this '
        'angle between its side and the horizontal: at least tan(glide_slope) m up per m aside '
        '(dimension 3); 0 for none', 'rad', 0.0, STEEPEST_GLIDE, live=True)
    no_corner_cutting: bool = parameter('no_corner_cutting', False,
        'Whether the path between steps must avoid obstacles as well', live=True)
    obstacle_speed_limit: float = parameter('obstacle_speed_limit', 50.0, 'Obstacles on the topic '
        'obstacles that jump faster are taken for new bodies at rest', 'm/s', TINY, FAR, live=True)
    obstacle_unseen_speed: float = parameter('obstacle_unseen_speed', 0.0, 'Speed assumed for an '
        'obstacle observed only once: in the first 4 steps of a plan it is enlarged by the '
        'distance it may have moved', 'm/s', 0.0, FAR, live=True)
    obstacle_reserve: float = parameter('obstacle_reserve', 0.0, 'Extra clearance from moving '
        'obstacles, with objective track from boxes too, as far as a plan that keeps it is found: '
        'it grows from 0 at the start of a plan to this value 4 steps later',
        'm', 0.0, FAR, live=True)
    avoid: tuple[str, ...] = parameter('avoid', (), "Topics of other vehicles' plans "
        "(nav_msgs/Path) to stay clear of; the vehicle's own is ignored", words=True)
    avoid_radius: float = parameter('avoid_radius', 0.0, 'Least distance between the centres of '
        'vehicles: the sum of both radii and of both deviations from plans; above 0 with avoid',
        'm', 0.0, FAR, live=True)
    avoid_timeout: float = parameter('avoid_timeout', 0.0, 'Age of a plan from which its vehicle '
        'counts as silent, at least 1.5 periods; 0 for 0.5 s', 's', 0.0, MAX_DURATION, live=True)
    projection: str = parameter('projection', 'thrust_aligned',
        'How a point of the orbitope is projected to a rotation', choices=PROJECTIONS, live=True)
    objective: str = parameter('objective', 'track', 'Whether to stay near the goal, or to catch '
        'it as soon as possible', choices=('track', 'intercept'), live=True)
    centred: bool = parameter('capture_centred', False, 'Whether plans of a catch lead through the '
        'centre of the goal with a small margin: their gentle turns suit vehicles that are slow to '
        'begin a turn; otherwise they gain the last centimetre', live=True)
    odometry: str = parameter('odometry', 'odom', 'Topics of odometry: odom, or separate pose and '
        'twist, as autopilots publish them', choices=('odom', 'pose_twist'))
    velocity_frame: str = parameter('velocity_frame', 'body', 'Frame of the linear velocity of '
        "odom or twist: the body's, as usual in ROS, or the world's; body rates are about body "
        'axes in any case', choices=('body', 'world'))
    hover_thrust: float = parameter('hover_thrust', 0.0, 'Share of full thrust at hover on the '
        "autopilot's scale (gravity above 0): the topic thrust then carries thrust on that scale; "
        '0 for no such topic', '1', 0.0, 1.0)
    tf: bool = parameter('tf', False, 'Whether to transform goals, obstacles and plans of other '
        'vehicles to frame_id by /tf and /tf_static')
    transforms: tuple[str, ...] = parameter('transforms', (), 'Fixed transforms of messages in '
        "other frames, each 'parent child x y z roll pitch yaw' [m, rad]: the pose of the child in "
        'the parent, as in tf', words=True, live=True)
    transform_timeout: float = parameter('transform_timeout', 0.2,
        'How long the last transform of /tf remains valid', 's', 0.0, MAX_DURATION, live=True)
    autopilot: str = parameter('autopilot', '', 'Fixed-wing autopilot to steer on its own topics: '
        'PX4 in offboard mode (px4_msgs), or ArduPlane in GUIDED through MAVROS (mavros_msgs); '
        'setpoints are sent in that mode only', choices=('', 'px4', 'arduplane'))
    gated: bool = parameter('gated', False, 'Whether commands wait for the topic engaged '
        '(std_msgs/Bool): they are sent only while it is true')
    trigger: str = parameter('trigger', 'timer', 'Whether to plan at each odometry or every period',
        choices=('timer', 'odom'))
    plan_period: float = parameter('plan_period', 0.0, 'Period of planning (trigger timer) or of '
        'odometry (trigger odom), at most a step; 0 for a step', 's', 0.0, MAX_DURATION)
    sideslip: bool = parameter('sideslip', False, 'Whether the twist of odom has the full velocity '
        "through the air (velocity_source air, in the plane): a wing's heading and speed are then "
        'those of its motion through the air, not of its nose')
    given_disturbance: str = parameter('disturbance', GIVEN, 'Whether wind and gravity are the '
        'only disturbance, or an additional one is estimated from odometry and commands',
        choices=DISTURBANCES, live=True)
    goal_prediction: str = parameter('goal_prediction', 'hold', 'Predicted motion of the goal: '
        'hold, none; velocity, straight on; harmonic, an oscillation; auto, the best fit of '
        'several motions', choices=FORECASTS, live=True)
    dry_run: bool = parameter('dry_run', False,
        'Whether to plan and report, but send no commands: their publishers are not created')
    publish_certificate: bool = parameter('publish_certificate', False, 'Whether to publish proofs '
        "on certificate: of a tick's bound, where the method leaves one, and of infeasibility or "
        'no earlier catch, where there is time')
    given_odom_timeout: float = parameter('odom_timeout', 0.0, 'Odometry older than this is stale; '
        '0 for 0.2 s; at least 1.5 periods', 's', 0.0, MAX_DURATION, live=True)
    given_goal_timeout: float = parameter('goal_timeout', 0.0, 'A goal older than this is stale, '
        'at least 1.5 periods; 0 for 1 s, but with goal_prediction hold never for one sent by '
        'hand; below 0 for never', 's', -1.0, MAX_DURATION, live=True)
    future_tolerance: float = parameter('future_tolerance', 0.1, 'A stamp farther ahead of the '
        'clock than this is refused; in simulated time one step more is allowed',
        's', 0.0, MAX_DURATION, live=True)
    goal_jump_limit: float = parameter('goal_jump_limit', 0.0, 'A goal farther than this from the '
        'last one is refused until the last one is stale; 0 for no limit', 'm', 0.0, FAR, live=True)
    delay_compensation: bool = parameter('delay_compensation', True, 'Whether to plan from the '
        'state predicted for the time of the command, not from the measured one', live=True)
    given_safe_command: str = parameter('safe_command', 'auto', 'Command without a plan: stop; '
        'hold_rate_zero keeps the speed, at least that of the floor, without turning; loiter '
        'circles; hover carries the weight at the present attitude; auto circles with a floor at '
        'translation_order 1, hovers under gravity, else stops', choices=SAFE_COMMANDS, live=True)
    given_deadline: float = parameter('deadline', 0.0, 'Time limit of a solve, at most half a '
        'period (plan_period, or a step); 0 for half a period', 's', 0.0, MAX_DURATION, live=True)
    gap_tolerance: float = parameter('gap_tolerance', 1e-4,
        'Relative gap within which a plan counts as proved optimal', '', 1e-9, 1.0, live=True)
    # fmt: on

    @cached_property
    def problem(self) -> Problem:
        """Return the problem to solve."""
        parts = ('position', 'input', 'length', 'terminal', 'attitude')
        own = {
            'weights': Weights(*(getattr(self, f'weights_{part}') for part in parts)),
            'floor': Floor(self.floor_shape, self.floor_faces, self.floor_fraction),
            'obstacles': self.boxes,
        }
        names = {each.name for each in fields(Problem)} & {each.name for each in fields(self)}
        shared: dict[str, Any] = {name: getattr(self, name) for name in names}
        return weighed(Problem(**shared | own), self.weights_scaling)

    @cached_property
    def period(self) -> float:
        """Return the planning period, at most a step [s]."""
        return self.plan_period or self.step

    @cached_property
    def deadline(self) -> float:
        """Return the time limit of a solve, at most half a period [s]."""
        return self.given_deadline or 0.5 * self.period

    @cached_property
    def odom_timeout(self) -> float:
        """Return the age at which odometry is stale, at least 1.5 periods [s]."""
        return max(self.given_odom_timeout or 0.2, 1.5 * self.period)

    @cached_property
    def goal_timeout(self) -> float:
        """Return the age at which a goal is stale, at least 1.5 periods [s]."""
        timeout = self.given_goal_timeout
        return max(timeout if timeout > 0.0 else 1.0, 1.5 * self.period)

    @cached_property
    def hand_sent_expire(self) -> bool:
        """Return True if goals sent by hand expire, like streamed ones."""
        # A forecast extrapolated indefinitely from the last goal would be meaningless.
        return self.given_goal_timeout > 0.0 or self.goal_prediction != 'hold'

    @cached_property
    def response(self) -> Response:
        """Return the lags of the vehicle."""
        return Response(self.speed_lag, self.rate_lag)

    @cached_property
    def estimated(self) -> bool:
        """Return True if an additional disturbance is estimated."""
        return self.given_disturbance == ESTIMATED

    @cached_property
    def approach(self) -> Approach:
        """Return the cone of headings in which a catch counts; no cone without interception."""
        approach = self.approach_of_a_catch()
        return approach if self.objective == 'intercept' else Approach()

    @cached_property
    def wants_attitude(self) -> bool:
        """Return True if goals need an orientation."""
        return self.problem.wants_attitude or self.approach.is_the_goals

    @cached_property
    def safe_command(self) -> str:
        """Return ``stop``, ``hold_rate_zero``, ``loiter`` or ``hover``, resolving ``auto``."""
        return decided(self.given_safe_command, self.problem, self.gravity)

    @cached_property
    def stated_transforms(self) -> dict[str, Edge]:
        """Return the transforms given as parameters, by child."""
        return stated(self.transforms)

    @cached_property
    def distance(self) -> Distance:
        """Return the separation from others, enlarged so that rounded plans keep the radius."""
        radius = self.avoid_radius + ROUNDING * self.problem.maps.unit
        return Distance(radius, max(self.avoid_timeout or 0.5, 1.5 * self.period))


PLANNER = specs_of(PlannerSettings)


def planner_settings(values: Values) -> PlannerSettings:
    """Return the settings of a full set of planner parameters.

    Raises:
        BadInput: a value, or a combination, is not allowed.
    """
    settings = settings_from(PlannerSettings, values)
    for topic in settings.avoid:
        if not TOPIC.fullmatch(topic):
            raise BadInput('avoid', topic, 'names of topics, such as /uav2/plan')
    for name, refused, allowed in _combinations(settings):
        if refused:
            raise BadInput(name, values[name], allowed)
    for derived in ('problem', 'approach', 'disturbance', 'frames', 'stated_transforms'):
        getattr(settings, derived)  # raises if invalid
    return settings


def _combinations(s: PlannerSettings) -> list[tuple[str, object, str]]:
    """Return incompatible values: parameter, whether it is refused, and what is allowed."""
    thrust, intercepts = s.translation_order == 2, s.objective == 'intercept'
    return [
        ('plan_period', s.plan_period > s.step, f'at most a step, {s.step:g} s'),
        ('deadline', s.deadline > 0.5 * s.period, f'at most half a period, {0.5 * s.period:g} s'),
        ('safe_command', s.given_safe_command == ('loiter' if thrust else 'hover'),
            f'stop | hold_rate_zero | {"hover" if thrust else "loiter"} at translation_order '
            f'{s.translation_order}'),
        ('gravity', s.gravity >= s.forward,
            f'below the full thrust of forward, {s.forward:g} m/s^2'),
        ('velocity_source', s.velocity_source == 'air' and thrust,
            'ground at translation_order 2, where wind is an acceleration'),
        ('autopilot', s.autopilot and (s.dimension != 2 or thrust),
            "'' unless dimension is 2 and translation_order 1"),
        ('velocity_source', s.autopilot and s.velocity_source != 'air',
            f'air with autopilot {s.autopilot}'),
        ('sideslip', s.sideslip and (s.dimension, s.velocity_source) != (2, 'air'),
            'false unless dimension is 2 and velocity_source air'),
        ('hover_thrust', s.hover_thrust and not s.gravity,
            '0 without gravity, where nothing hovers'),
        ('hover_thrust', s.hover_thrust * s.forward > s.gravity,
            f'at most gravity / forward, {s.gravity / s.forward:.4g}: full thrust is 1'),
        ('objective', intercepts and (s.terminal, s.horizon_mode) != ('penalty', 'receding'),
            'track unless terminal is penalty and horizon_mode receding'),
        ('avoid_radius', s.avoid and not s.avoid_radius,
            "above 0 with avoid: the sum of both vehicles' radii"),
    ]  # fmt: skip
