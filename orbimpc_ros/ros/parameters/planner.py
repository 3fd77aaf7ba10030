# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner's parameters, in one table, and the settings that they add up to."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum

from orbimpc_ros.loop.compensation import DISTURBANCES, ESTIMATED, GIVEN, Response
from orbimpc_ros.loop.fallback import SAFE_COMMANDS, decided
from orbimpc_ros.loop.goal.forecast import FORECASTS
from orbimpc_ros.loop.traffic import Distance
from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.problem import (
    MAX_HORIZON,
    TERMINALS,
    Approach,
    Floor,
    Problem,
    Weights,
)
from orbimpc_ros.mpc.problem.case import WEIGHTS
from orbimpc_ros.mpc.problem.floor import SHAPES
from orbimpc_ros.mpc.problem.problem import STEEPEST_GLIDE
from orbimpc_ros.mpc.problem.scaling import SCALINGS, weighed
from orbimpc_ros.ros.messages import Frames
from orbimpc_ros.ros.parameters.approach import APPROACH, approach_of
from orbimpc_ros.ros.parameters.parameter import (
    FAR,
    MAX_DURATION,
    OBSTACLES,
    PROCESS,
    TINY,
    VEHICLE,
    Row,
    Values,
    boxes_of,
    disturbance_of,
    frames_of,
    require_topic,
    span,
)
from orbimpc_ros.ros.transforms import Stated, stated
from orbimpc_ros.sim.scenario import LIMITS, retrieval

PROJECTIONS = ('nearest', 'thrust_aligned')
OBJECTIVES = ('track', 'intercept')
ODOMETRY = ('odom', 'pose_twist')
ROUNDING = 1e-5  # of the way of a step: more than a checked plan may be off

PLANNER: tuple[Row, ...] = (
    *VEHICLE,
    *PROCESS,
    Row('horizon', 5, 'Steps planned ahead', low=1, high=MAX_HORIZON),
    Row('weights.position', 1.0, 'On squared distance to the goal at every step',
        '1/m^2', 0.0, 1e6, live=True),
    Row('weights.input', 0.05, 'On squared inputs (turning, braking); 100 by default with '
        'weights.scaling time at translation_order 2',
        's^2 or s^4', 0.0, 1e6, live=True, timed_thrust=100.0),
    Row('weights.length', 0.0, 'On distance flown or thrust spent',
        '1/m', 0.0, 1e6, live=True),
    Row('weights.terminal', 10.0, 'On squared distance to the goal at the last step',
        '1/m^2', 0.0, 1e6, live=True),
    Row('weights.attitude', 0.0, "On the squared difference (Frobenius norm) of the last step's "
        "rotation from the goal's orientation; 0 leaves the orientation out",
        '1', 0.0, 1e6, live=True),
    Row('weights.scaling', 'paper', 'What the weights mean: paper, sums over steps in the units '
        'above; time, integrals over the horizon, without units: the same at any step and speed',
        choices=SCALINGS, live=True),
    Row('terminal', 'penalty', 'Whether the last step must reach the goal',
        choices=TERMINALS, live=True),
    Row('horizon_mode', 'receding', 'Whether the horizon moves on or shrinks to its end',
        choices=('receding', 'shrinking')),
    Row('floor.shape', 'none', 'Minimum speed: none, the faces of a polygon, or a circle',
        choices=tuple(SHAPES), live=True),
    Row('floor.faces', 4, 'Faces of the polygon, or of the solid (6, 12, 20) in space',
        low=3, high=64, live=True),
    Row('floor.fraction', math.sqrt(0.3), 'Minimum share of full speed',
        low=TINY, high=1.0, live=True),
    Row('max_rate', 0.0, 'Limit of the body rate; 0 for none, at most pi/step. Without a floor it '
        'limits changes of speed as well: R e1 moves by at most 2 sin(step * max_rate / 2) in a '
        'step. With a floor it limits the angle of each step, at any speeds. Of thrust in space '
        'without a floor, cones or a terminal constraint it limits commands alone',
        'rad/s', 0.0, 1e4, live=True),
    Row('max_acceleration', 0.0, 'Limit of the change of speed (translation_order 1); 0 for none. '
        'From one command to the next the speed changes by at most step * max_acceleration',
        'm/s^2', 0.0, 1e6, live=True),
    Row('tilt', 0.0, 'Largest angle of the pushing axis from the vertical (dimension 3, '
        'translation_order 2); 0 for any',
        'rad', 0.0, 0.5 * math.pi, live=True),
    Row('glide_slope', 0.0, 'Stay in a cone above the goal, of this angle between its side and the '
        'horizontal: at least tan(glide_slope) m up for each m aside (dimension 3); 0 for none',
        'rad', 0.0, STEEPEST_GLIDE, live=True),
    OBSTACLES,
    Row('no_corner_cutting', False, 'Whether the path between two steps stays out as well',
        live=True),
    Row('obstacle_speed_limit', 50.0, 'What jumps on the topic obstacles faster than this is taken '
        'for a new body at rest', 'm/s', TINY, FAR, live=True),
    Row('obstacle_unseen_speed', 0.0, 'How fast what moves may be as long as it was seen but once: '
        'it counts as larger by what that comes to in the first 4 steps of a plan',
        'm/s', 0.0, FAR, live=True),
    Row('obstacle_reserve', 0.0, 'Kept away from what moves beyond what is demanded, as far as a '
        'plan is found that does: from nothing at the start of a plan to this much 4 steps later',
        'm', 0.0, FAR, live=True),
    Row('avoid', (), "Topics of other vehicles' plans (nav_msgs/Path) to stay clear of; one's own "
        'among them is passed over', words=True),
    Row('avoid_radius', 0.0, 'Least distance from other vehicles, middle to middle: the sum of '
        'both radii and of what both may be off; above 0 with avoid', 'm', 0.0, FAR, live=True),
    Row('avoid_timeout', 0.0, 'Another vehicle whose plan is older than this is silent, at least '
        '1.5 periods; 0 for 0.5 s', 's', 0.0, MAX_DURATION, live=True),
    Row('projection', 'thrust_aligned', 'How a point of the hull becomes a rotation',
        choices=PROJECTIONS, live=True),
    Row('objective', 'track', 'Whether to be near the goal on average, or to catch it as soon as '
        'it can be', choices=OBJECTIVES, live=True),
    Row('capture_radius', retrieval().capture_radius, 'Within it the goal is caught: by plans '
        '(objective intercept), and as the topics caught and arrived tell', 'm',
        *span(*LIMITS['capture_radius']), live=True),
    Row('capture_centred', False, 'Whether plans of a catch lead through the middle of the goal '
        'with a little to spare: they turn gently, which vehicles follow whose turns take time '
        'to begin; otherwise they gain the last centimetre', live=True),
    Row('odometry', 'odom', 'Where odometry comes from: odom, or the halves pose and twist, as '
        'autopilots publish them', choices=ODOMETRY),
    Row('velocity_frame', 'body', 'What the linear velocity of odom or twist is given in: the '
        "body's axes, as ROS has it, or the world's; rates are about the body's in any case",
        choices=('body', 'world')),
    Row('hover_thrust', 0.0, 'Share of full thrust at which the vehicle hovers, as its autopilot '
        'counts it (gravity above 0): thrust then carries the thrust as such a share; 0 for none',
        '1', 0.0, 1.0),
    Row('tf', False, 'Whether goals, obstacles and plans of other vehicles in other frames than '
        'frame_id are moved by what /tf and /tf_static tell'),
    Row('transforms', (), "The same by transforms that are stated, each 'parent child x y z roll "
        "pitch yaw' [m, rad]: how the child lies in the parent, as in tf", words=True, live=True),
    Row('transform_timeout', 0.2, 'For so long the last transform of /tf holds', 's', 0.0,
        MAX_DURATION, live=True),
    Row('gated', False, 'Whether commands wait for engaged (std_msgs/Bool): none are sent before '
        'it is true, nor while it is false'),
    *APPROACH,
    Row('trigger', 'timer', 'Whether to plan at each odometry or every period',
        choices=('timer', 'odom')),
    Row('plan_period', 0.0, 'How often to plan (trigger timer), or how often odometry comes '
        '(trigger odom): at most a step; 0 for a step', 's', 0.0, MAX_DURATION),
    Row('response.speed', 0.0, 'First-order lag of speed or thrust; a vehicle with any lag obeys '
        'at once, not at the end of a step', 's', 0.0, 10.0, live=True),
    Row('response.rate', 0.0, 'First-order lag of the body rate', 's', 0.0, 10.0, live=True),
    Row('sideslip', False, 'Whether the twist of odom has the velocity through the air with its '
        'part across the axis (velocity_source air, in the plane): a wing is then taken to fly '
        'the way that it moves through the air, not the way its nose points, and at the speed '
        'that is measured'),
    Row('disturbance', GIVEN, 'Whether wind and gravity are all that disturbs, or more is '
        'estimated from odometry against what was commanded', choices=DISTURBANCES, live=True),
    Row('goal_prediction', 'hold', 'How the goal is expected to move: hold, not at all; velocity, '
        'straight on; harmonic, as it swings; auto, as fits best of several motions',
        choices=tuple(FORECASTS), live=True),
    Row('dry_run', False, 'Whether to plan and report, and command nothing: there is no publisher '
        'of commands then'),
    Row('publish_certificate', False, 'Whether to publish on certificate what proves the bound of '
        'a tick, where the method leaves that, and refutes what it excludes, where there is time'),
    Row('odom_timeout', 0.0, 'Odometry older than this is stale; 0 for 0.2 s; at least 1.5 '
        'periods',
        's', 0.0, MAX_DURATION, live=True),
    Row('goal_timeout', 0.0, 'A goal older than this is stale, at least 1.5 periods; 0 for 1 s '
        'once goals stream, never for one sent by hand; below 0 never',
        's', -1.0, MAX_DURATION, live=True),
    Row('future_tolerance', 0.1, 'A stamp this far ahead of the clock is refused; simulated time '
        'may trail by a step more', 's', 0.0, MAX_DURATION, live=True),
    Row('goal_jump_limit', 0.0, 'A goal farther than this from the one before is refused until '
        'that is stale; 0 for no limit', 'm', 0.0, FAR, live=True),
    Row('delay_compensation', True, 'Whether to plan from where the vehicle is by the time the '
        'command comes, not from where it was measured', live=True),
    Row('safe_command', 'auto',
        'Without a plan: stop; hold_rate_zero keeps the speed, at least that of the floor, and '
        'does not turn; loiter circles; hover carries the weight at the present attitude; auto '
        'circles with a floor at translation_order 1, hovers under gravity, else stops',
        choices=SAFE_COMMANDS, live=True),
    Row('deadline', 0.0, 'Limit of a solve; 0 for half a period (plan_period, or a step), which '
        'it must not exceed',
        's', 0.0, MAX_DURATION, live=True),
    Row('gap_tolerance', 1e-4, 'Relative gap within which a plan counts as proved optimal',
        low=1e-9, high=1.0, live=True),
)  # fmt: skip


class Ageing(Enum):
    """Which goals get stale: all; those of a source that streams; none."""

    ALL = 'all'
    STREAMED = 'streamed'
    NONE = 'none'


@dataclass(frozen=True)
class FrameTree:
    """How other frames are known.

    Attributes:
        heard: whether from ``/tf``.
        stated: those that hold for ever.
        timeout: for how long the last transform of ``/tf`` holds [s].
    """

    heard: bool
    stated: tuple[Stated, ...]
    timeout: float

    @property
    def exists(self) -> bool:
        """Return whether any other frame may be known."""
        return self.heard or bool(self.stated)


@dataclass(frozen=True)
class PlannerSettings:
    """All that the planner's parameters say.

    Attributes:
        problem: what to solve.
        mass: [kg].
        shrinking: whether the horizon shrinks.
        projection: ``nearest`` or ``thrust_aligned``.
        on_odometry: whether to plan at each odometry instead of every period.
        period: how often to plan, at most a step [s].
        response: lags of the vehicle.
        goal_prediction: kind of forecast.
        odom_timeout: after which odometry is stale, at least 1.5 periods [s].
        goal_timeout: after which a goal is stale, at least 1.5 periods [s].
        goal_ageing: which goals get stale.
        future_tolerance: by which a stamp may be ahead of the clock [s].
        goal_jump_limit: distance from one goal to the next; 0 for no limit [m].
        delay_compensation: whether to plan from the state advanced by the odometry's age.
        capture_radius: within which the goal is caught; 0 where it is not to be [m].
        goal_radius: within which the goal counts as caught or reached, whatever the objective [m].
        centred: whether plans lead through its middle.
        approach: the cone of headings in which a catch counts.
        wants_attitude: whether goals need an orientation.
        safe_command: ``stop``, ``hold_rate_zero``, ``loiter`` or ``hover``; ``auto`` is decided.
        deadline: for a solve, at most half a period [s].
        gap_tolerance: relative gap that counts as proved.
        disturbance: the known wind or acceleration, gravity's included, shape (n,).
        gravity: [m/s^2].
        hover_thrust: share of full thrust that carries the weight; 0 where none is to be told.
        estimated: whether to estimate what disturbs besides.
        velocity_source: what odometry measures: velocity over ``ground`` or through the ``air``.
        sideslip: whether odometry measures how a wing slips, which is believed.
        dry_run: whether nothing is to be commanded.
        publish_certificate: whether to publish what proves bounds, and refutes what ticks exclude.
        gated: whether commands wait until the vehicle says that it takes them.
        halves: whether odometry comes as a pose and a twist.
        obstacle_speed_limit: of bodies seen; faster ones have jumped [m/s].
        obstacle_unseen_speed: that bodies may have which were seen but once [m/s].
        obstacle_reserve: kept away from what moves, as far as it can be [m].
        avoid: topics of other vehicles' plans, as given.
        distance: how other vehicles are avoided.
        frames: that messages must be in.
        tree: of frames, by which messages are moved there.
    """

    problem: Problem
    mass: float
    shrinking: bool
    projection: str
    on_odometry: bool
    period: float
    response: Response
    goal_prediction: str
    odom_timeout: float
    goal_timeout: float
    goal_ageing: Ageing
    future_tolerance: float
    goal_jump_limit: float
    delay_compensation: bool
    capture_radius: float
    goal_radius: float
    centred: bool
    approach: Approach
    wants_attitude: bool
    safe_command: str
    deadline: float
    gap_tolerance: float
    disturbance: Array
    gravity: float
    hover_thrust: float
    estimated: bool
    velocity_source: str
    sideslip: bool
    dry_run: bool
    publish_certificate: bool
    gated: bool
    halves: bool
    obstacle_speed_limit: float
    obstacle_unseen_speed: float
    obstacle_reserve: float
    avoid: tuple[str, ...]
    distance: Distance
    frames: Frames
    tree: FrameTree


def planner_settings(values: Values) -> PlannerSettings:
    """Return the settings of a full set of planner parameters.

    Raises:
        BadInput: a value, or a combination, is not allowed.
    """
    for row in PLANNER:
        row.check(values[row.name])
    period = _period(values)
    if values['deadline'] > 0.5 * period:
        raise BadInput('deadline', values['deadline'], f'at most half a period, {0.5 * period:g} s')
    _refuse_unfit(values)
    problem, approach = _problem(values), _approach(values)
    return PlannerSettings(
        problem=problem,
        mass=values['mass'],
        shrinking=values['horizon_mode'] == 'shrinking',
        projection=values['projection'],
        on_odometry=values['trigger'] == 'odom',
        period=period,
        response=Response(values['response.speed'], values['response.rate']),
        goal_prediction=values['goal_prediction'],
        odom_timeout=max(values['odom_timeout'] or 0.2, 1.5 * period),
        goal_timeout=max(
            values['goal_timeout'] if values['goal_timeout'] > 0.0 else 1.0, 1.5 * period
        ),
        goal_ageing=_ageing(values['goal_timeout'], values['goal_prediction']),
        future_tolerance=values['future_tolerance'],
        goal_jump_limit=values['goal_jump_limit'],
        delay_compensation=values['delay_compensation'],
        capture_radius=_capture_radius(values),
        goal_radius=values['capture_radius'],
        centred=values['capture_centred'],
        approach=approach,
        wants_attitude=problem.wants_attitude or approach.is_the_goals,
        safe_command=decided(values['safe_command'], problem, values['gravity']),
        deadline=values['deadline'] or 0.5 * period,
        gap_tolerance=values['gap_tolerance'],
        disturbance=sealed(disturbance_of(values)),
        gravity=values['gravity'],
        hover_thrust=_hover_thrust(values),
        estimated=values['disturbance'] == ESTIMATED,
        velocity_source=values['velocity_source'],
        sideslip=values['sideslip'],
        dry_run=values['dry_run'],
        publish_certificate=values['publish_certificate'],
        gated=values['gated'],
        halves=values['odometry'] == 'pose_twist',
        frames=replace(frames_of(values), velocity=values['velocity_frame']),
        tree=_tree(values),
        obstacle_speed_limit=values['obstacle_speed_limit'],
        obstacle_unseen_speed=values['obstacle_unseen_speed'],
        obstacle_reserve=values['obstacle_reserve'],
        avoid=_avoided(values),
        distance=_distance(values, problem, period),
    )


def _period(values: Values) -> float:
    """Return how often to plan [s]."""
    period, step = values['plan_period'], values['step']
    if period > step:
        raise BadInput('plan_period', period, f'at most a step, {step:g} s')
    return float(period or step)


def _refuse_unfit(values: Values) -> None:
    """Refuse what does not suit the order of translation, and a weight that no thrust carries."""
    order, gravity, full = values['translation_order'], values['gravity'], values['forward']
    if values['safe_command'] == 'loiter' and order == 2:
        allowed = 'stop | hold_rate_zero | hover at translation_order 2'
        raise BadInput('safe_command', 'loiter', allowed)
    if values['safe_command'] == 'hover' and order == 1:
        allowed = 'stop | hold_rate_zero | loiter at translation_order 1'
        raise BadInput('safe_command', 'hover', allowed)
    if gravity >= full:
        raise BadInput('gravity', gravity, f'below the full thrust of forward, {full:g} m/s^2')
    if values['velocity_source'] == 'air' and order == 2:
        allowed = 'ground at translation_order 2, where wind is an acceleration'
        raise BadInput('velocity_source', 'air', allowed)
    if values['sideslip'] and (values['dimension'], values['velocity_source']) != (2, 'air'):
        allowed = 'false but with dimension 2 and velocity_source air'
        raise BadInput('sideslip', values['sideslip'], allowed)


def _hover_thrust(values: Values) -> float:
    """Return the share of thrust at hover: full thrust must be no more than the whole of it."""
    share, gravity = values['hover_thrust'], values['gravity']
    if share and not gravity:
        raise BadInput('hover_thrust', share, '0 without gravity, where nothing hovers')
    if share * values['forward'] > gravity:
        allowed = f'at most gravity / forward, {gravity / values["forward"]:.4g}: full thrust is 1'
        raise BadInput('hover_thrust', share, allowed)
    return float(share)


def _tree(values: Values) -> FrameTree:
    """Return how other frames are known: each stated one lies in one other."""
    found = tuple(map(stated, values['transforms']))
    for each in found:
        if [other.child for other in found].count(each.child) > 1:
            raise BadInput('transforms', list(values['transforms']), f'{each.child} in one parent')
    return FrameTree(values['tf'], found, values['transform_timeout'])


def _avoided(values: Values) -> tuple[str, ...]:
    """Return the topics of other vehicles' plans."""
    for topic in values['avoid']:
        require_topic('avoid', topic)
    if values['avoid'] and not values['avoid_radius']:
        allowed = "above 0 with avoid: the sum of both vehicles' radii"
        raise BadInput('avoid_radius', values['avoid_radius'], allowed)
    return tuple(values['avoid'])


def _distance(values: Values, problem: Problem, period: float) -> Distance:
    """Return how others are avoided: so that plans, once rounded, keep the whole of the radius."""
    radius = values['avoid_radius'] + ROUNDING * problem.length_unit
    return Distance(radius, max(values['avoid_timeout'] or 0.5, 1.5 * period))


def _capture_radius(values: Values) -> float:
    if values['objective'] == 'track':
        return 0.0
    for name, wanted in (('terminal', 'penalty'), ('horizon_mode', 'receding')):
        if values[name] != wanted:
            raise BadInput('objective', 'intercept', f'track with {name} {values[name]}')
    return float(values['capture_radius'])


def _approach(values: Values) -> Approach:
    """Return the cone of a catch; none where nothing is caught."""
    known = approach_of(values)
    known.validate(values['dimension'])
    return known if values['objective'] == 'intercept' else Approach()


def _ageing(timeout: float, prediction: str) -> Ageing:
    if timeout:
        return Ageing.ALL if timeout > 0.0 else Ageing.NONE
    # A forecast that moves on from the last goal for ever would lead anywhere.
    return Ageing.STREAMED if prediction == 'hold' else Ageing.ALL


def _problem(values: Values) -> Problem:
    weights = Weights(*(values[f'weights.{name}'] for name in WEIGHTS))
    problem = Problem(
        dimension=values['dimension'],
        rotation_order=values['rotation_order'],
        translation_order=values['translation_order'],
        horizon=values['horizon'],
        step=values['step'],
        forward=values['forward'],
        weights=weights,
        terminal=values['terminal'],
        floor=Floor(values['floor.shape'], values['floor.faces'], values['floor.fraction']),
        max_rate=values['max_rate'],
        max_acceleration=values['max_acceleration'],
        obstacles=boxes_of(values),
        no_corner_cutting=values['no_corner_cutting'],
        discretisation=values['discretisation'],
        tilt=values['tilt'],
        glide_slope=values['glide_slope'],
    )
    return weighed(problem, values['weights.scaling'])
