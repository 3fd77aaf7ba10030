"""Every parameter of the two nodes, in one table each, and the settings that they add up to.

A table row is the whole truth about a parameter: descriptors, checks and documentation follow
from it. ``settings`` are frozen; a change of parameters makes new ones or is refused whole.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.forecast import FORECASTS
from orbimpc_ros.mpc.problem import (
    FLOOR_SHAPES,
    MAX_HORIZON,
    TERMINALS,
    Box,
    Floor,
    Problem,
    Weights,
)
from orbimpc_ros.mpc.rotations import from_quaternion
from orbimpc_ros.ros.messages import QUATERNION_TOLERANCE, Frames
from orbimpc_ros.world.rope import Rope
from orbimpc_ros.world.scenario import MAX_TICKS, Scenario, retrieval
from orbimpc_ros.world.vehicle import Model, launched

SAFE_COMMANDS = ('stop', 'hold_rate_zero', 'loiter')
Value = bool | int | float | str | tuple[float, ...]
Values = Mapping[str, Any]
S = TypeVar('S')
W = TypeVar('W')


@dataclass(frozen=True)
class Row:
    """One parameter.

    Attributes:
        name: as ROS knows it.
        default: its type is the parameter's; tuples are arrays of doubles.
        description: one sentence.
        unit: of the value; empty for none.
        low: least value allowed, of every element of an array.
        high: greatest.
        choices: words allowed, if the parameter is one of a few.
        live: whether it may change while the node runs.
    """

    name: str
    default: Value
    description: str
    unit: str = ''
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    live: bool = False

    @property
    def kind(self) -> Parameter.Type:
        """Return the ROS type."""
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
        if self.choices:
            good = value in self.choices
        elif isinstance(self.default, (bool, str)):
            good = True
        else:
            good = bool(np.all((np.asarray(value) >= self.low) & (np.asarray(value) <= self.high)))
        if not good:
            raise BadInput(self.name, value, self.allowed)


_FAR = 1e6  # [m]: positions in parameters
_SOON = 1e3  # [s]: durations in parameters
_TINY = 1e-6  # stands for "above zero" in ranges, which are closed


def _vehicle_rows() -> tuple[Row, ...]:
    """Return what planner and simulator must agree on, under the same names."""
    problem = Problem()
    return (
        Row('dimension', problem.dimension, 'Plane (2) or space (3)', low=2, high=3),
        Row(
            'rotation_order',
            problem.rotation_order,
            'Whether inputs are rates (1) or accelerations (2) of the rotation',
            low=1,
            high=2,
        ),
        Row(
            'translation_order',
            problem.translation_order,
            'Whether the forward axis carries a velocity (1) or an acceleration (2)',
            low=1,
            high=2,
        ),
        Row('step', problem.step, 'Length of a step', 's', 1e-3, _SOON),
        Row('forward', problem.forward, 'Full speed or thrust acceleration',
            'm/s or m/s^2', _TINY, 1e3, live=True),
        Row('mass', 1.0, 'Turns a thrust acceleration into a force',
            'kg', _TINY, 1e6, live=True),
        Row('frame_id', 'odom', 'World frame of poses; empty accepts any'),
        Row('child_frame_id', 'base_link', 'Body frame of twists; empty accepts any'),
    )  # fmt: skip


PLANNER: tuple[Row, ...] = (
    *_vehicle_rows(),
    Row('horizon', 5, 'Steps planned ahead', low=1, high=MAX_HORIZON),
    Row('weights.position', 1.0, 'On squared distance to the goal at every step',
        '1/m^2', 0.0, 1e6, live=True),
    Row('weights.input', 0.05, 'On squared inputs (turning, braking)',
        's^2 or s^4', 0.0, 1e6, live=True),
    Row('weights.length', 0.0, 'On distance flown or thrust spent',
        '1/m', 0.0, 1e6, live=True),
    Row('weights.terminal', 10.0, 'On squared distance to the goal at the last step',
        '1/m^2', 0.0, 1e6, live=True),
    Row('terminal', 'penalty', 'Whether the last step must reach the goal',
        choices=TERMINALS, live=True),
    Row('horizon_mode', 'receding', 'Whether the horizon moves on or shrinks to its end',
        choices=('receding', 'shrinking')),
    Row('floor.shape', 'none', 'Minimum speed: none, the faces of a polygon, or a circle',
        choices=FLOOR_SHAPES, live=True),
    Row('floor.faces', 4, 'Faces of the polygon, or of the solid (6, 12, 20) in space',
        low=3, high=64, live=True),
    Row('floor.fraction', math.sqrt(0.3), 'Minimum share of full speed',
        low=_TINY, high=1.0, live=True),
    Row('max_rate', 0.0, 'Limit of the body rate; 0 for none, at most pi/step',
        'rad/s', 0.0, 1e4, live=True),
    Row('obstacles', (), 'Boxes to stay out of: lower, then upper corner of each',
        'm', -_FAR, _FAR, live=True),
    Row('no_corner_cutting', False, 'Whether the path between two steps stays out as well',
        live=True),
    Row('projection', 'thrust_aligned', 'How a point of the hull becomes a rotation',
        choices=('nearest', 'thrust_aligned'), live=True),
    Row('trigger', 'timer', 'Whether to plan at each odometry or every step',
        choices=('timer', 'odom')),
    Row('goal_prediction', 'hold', 'How the goal is expected to move',
        choices=tuple(FORECASTS), live=True),
    Row('odom_timeout', 0.0, 'Odometry older than this is stale; 0 for 0.2 s; at least 1.5 steps',
        's', 0.0, _SOON, live=True),
    Row('goal_timeout', 0.0, 'A goal older than this is stale; 0 for 1 s; at least 1.5 steps',
        's', 0.0, _SOON, live=True),
    Row('safe_command', 'stop',
        'When there is no plan: stop; keep the speed and stop turning; circle',
        choices=SAFE_COMMANDS, live=True),
    Row('deadline', 0.0, 'Limit of a solve; 0 for half a step, which it must not exceed',
        's', 0.0, _SOON, live=True),
    Row('gap_tolerance', 1e-4, 'Relative gap within which a plan counts as proved optimal',
        low=1e-9, high=1.0, live=True),
)  # fmt: skip


def _triple(vector: Array) -> tuple[float, ...]:
    return tuple([*vector.tolist(), 0.0][:3])


def _sim_rows() -> tuple[Row, ...]:
    """Return the simulator's parameters; their defaults are the paper's retrieval."""
    flown = retrieval()
    rope = flown.rope
    return (
        *(_read_only(row) for row in _vehicle_rows()),
        Row('clock', 'lockstep', 'Whether to wait for each command or run in real time',
            choices=('lockstep', 'wall')),
        Row('rope.center', _triple(rope.center), 'Middle of the swing: x, y, z',
            'm', -_FAR, _FAR),
        Row('rope.amplitude', _triple(rope.amplitude), 'Reach of the swing: x, y, z',
            'm', -_FAR, _FAR),
        Row('rope.frequency', rope.frequency, 'Swings in a second', 'Hz', 0.0, 1e3),
        Row('rope.phase', _triple(rope.phase), 'Phase at the start: x, y, z',
            'rad', -100.0, 100.0),
        Row('capture_radius', flown.capture_radius, 'The goal is caught within it',
            'm', _TINY, _FAR),
        Row('start.position', (0.0, 0.0, 0.0), 'Where the vehicle starts: x, y, z',
            'm', -_FAR, _FAR),
        Row('start.orientation', (0.0, 0.0, 0.0, 1.0), 'Unit quaternion x, y, z, w at the start',
            '', -1.0, 1.0),
        Row('start.speed_fraction', flown.start.fraction, 'Share of speed or thrust at the start',
            '', 0.0, 1.0),
        Row('start.velocity', (0.0, 0.0, 0.0), 'World velocity at the start (translation order 2)',
            'm/s', -1e6, 1e6),
        Row('start.body_rate', (0.0, 0.0, 0.0), 'Rates about the body axes at the start',
            'rad/s', -1e3, 1e3),
        Row('max_ticks', flown.max_ticks, 'Steps before giving up', low=1, high=MAX_TICKS),
        Row('seed', 0, 'Of everything random', low=0, high=2**31 - 1),
        Row('command_timeout', 0.2, 'Wall clock: stop if no command came for so long; '
            'at least 1.5 steps', 's', 1e-3, _SOON),
        Row('goal_path_steps', 0, 'Steps of the true future to publish on goal_path; 0 for none',
            low=0, high=10_000),
        Row('exit_when_done', False, 'Whether to exit once the goal is caught or ticks run out'),
        Row('wait_subscribers', 1, 'Subscribers of odom that a lock-step run waits for',
            low=1, high=100),
    )  # fmt: skip


def _read_only(row: Row) -> Row:
    return Row(row.name, row.default, row.description, row.unit, row.low, row.high, row.choices)


SIM: tuple[Row, ...] = _sim_rows()
OF_ROS = ('use_sim_time', 'start_type_description_service')


@dataclass(frozen=True)
class PlannerSettings:
    """All that the planner's parameters say.

    Attributes:
        problem: what to solve.
        mass: [kg].
        shrinking: whether the horizon shrinks.
        projection: ``nearest`` or ``thrust_aligned``.
        on_odometry: whether to plan at each odometry instead of every step.
        goal_prediction: kind of forecast.
        odom_timeout: after which odometry is stale, at least 1.5 steps [s].
        goal_timeout: after which a goal is stale, at least 1.5 steps [s].
        safe_command: kind of safe command.
        deadline: for a solve, at most half a step [s].
        gap_tolerance: relative gap that counts as proved.
        frames: that messages must be in.
    """

    problem: Problem
    mass: float
    shrinking: bool
    projection: str
    on_odometry: bool
    goal_prediction: str
    odom_timeout: float
    goal_timeout: float
    safe_command: str
    deadline: float
    gap_tolerance: float
    frames: Frames


@dataclass(frozen=True)
class SimSettings:
    """All that the simulator's parameters say.

    Attributes:
        scenario: what to simulate.
        lockstep: whether to wait for each command instead of running in real time.
        command_timeout: after which a command is stale, at least 1.5 steps [s].
        goal_path_steps: how much of the goal's future to publish.
        exit_when_done: whether to exit at the end.
        wait_subscribers: subscribers of odometry to wait for.
        seed: of everything random.
        frames: to publish in.
    """

    scenario: Scenario
    lockstep: bool
    command_timeout: float
    goal_path_steps: int
    exit_when_done: bool
    wait_subscribers: int
    seed: int
    frames: Frames


def planner_settings(values: Values) -> PlannerSettings:
    """Return the settings of a full set of planner parameters.

    Raises:
        BadInput: a value, or a combination, is not allowed.
    """
    for row in PLANNER:
        row.check(values[row.name])
    step = values['step']
    if values['deadline'] > 0.5 * step:
        raise BadInput('deadline', values['deadline'], f'at most half a step, {0.5 * step:g} s')
    if values['safe_command'] == 'loiter' and values['translation_order'] == 2:
        raise BadInput('safe_command', 'loiter', 'stop | hold_rate_zero at translation_order 2')
    return PlannerSettings(
        problem=_problem(values),
        mass=values['mass'],
        shrinking=values['horizon_mode'] == 'shrinking',
        projection=values['projection'],
        on_odometry=values['trigger'] == 'odom',
        goal_prediction=values['goal_prediction'],
        odom_timeout=max(values['odom_timeout'] or 0.2, 1.5 * step),
        goal_timeout=max(values['goal_timeout'] or 1.0, 1.5 * step),
        safe_command=values['safe_command'],
        deadline=values['deadline'] or 0.5 * step,
        gap_tolerance=values['gap_tolerance'],
        frames=Frames(values['frame_id'], values['child_frame_id']),
    )


def _problem(values: Values) -> Problem:
    weights = Weights(
        *(values[f'weights.{name}'] for name in ('position', 'input', 'length', 'terminal'))
    )
    return Problem(
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
        obstacles=_boxes(values['obstacles'], values['dimension']),
        no_corner_cutting=values['no_corner_cutting'],
    )


def _boxes(numbers: Sequence[float], dimension: int) -> tuple[Box, ...]:
    if len(numbers) % (2 * dimension):
        raise BadInput('obstacles', list(numbers), f'{2 * dimension} numbers for each box')
    corners = np.array(numbers, dtype=float).reshape(-1, 2, dimension)
    return tuple(Box(low, high) for low, high in corners)


def sim_settings(values: Values) -> SimSettings:
    """Return the settings of a full set of simulator parameters.

    Raises:
        BadInput: a value, or a combination, is not allowed.
    """
    for row in SIM:
        row.check(values[row.name])
    return SimSettings(
        scenario=_scenario(values),
        lockstep=values['clock'] == 'lockstep',
        command_timeout=max(values['command_timeout'], 1.5 * values['step']),
        goal_path_steps=values['goal_path_steps'],
        exit_when_done=values['exit_when_done'],
        wait_subscribers=values['wait_subscribers'],
        seed=values['seed'],
        frames=Frames(values['frame_id'], values['child_frame_id']),
    )


def _scenario(values: Values) -> Scenario:
    n = values['dimension']
    model = Model(
        n,
        values['rotation_order'],
        values['translation_order'],
        values['step'],
        values['forward'],
        values['mass'],
    )
    start = launched(
        model,
        _vector(values, 'start.position', n),
        _orientation(values['start.orientation'], n),
        fraction=values['start.speed_fraction'],
        velocity=_vector(values, 'start.velocity', n),
        body_rate=_vector(values, 'start.body_rate', 3)[-model.rates :],
    )
    rope = Rope(
        _vector(values, 'rope.center', n),
        _vector(values, 'rope.amplitude', n),
        values['rope.frequency'],
        _vector(values, 'rope.phase', n),
    )
    return Scenario(model, start, rope, values['capture_radius'], values['max_ticks'])


def _vector(values: Values, name: str, dimension: int) -> Array:
    """Return the first n of x, y, z: in the plane z may be left out."""
    if not dimension <= len(values[name]) <= 3:
        wanted = '3 numbers' if dimension == 3 else '2 or 3 numbers'
        raise BadInput(name, list(values[name]), wanted)
    return np.array(values[name][:dimension], dtype=float)


def _orientation(numbers: Sequence[float], dimension: int) -> Array:
    x, y, z, w = numbers if len(numbers) == 4 else [math.nan] * 4
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    if not abs(norm - 1.0) <= QUATERNION_TOLERANCE:
        raise BadInput('start.orientation', list(numbers), 'a unit quaternion x, y, z, w')
    return from_quaternion(np.array([w, x, y, z]) / norm, dimension)


class Live(Generic[S, W]):
    """A node's parameters as settings: declared, checked, and kept up to date.

    Args:
        node: that has the parameters.
        rows: its table.
        settings_of: makes settings of values, or raises BadInput.
        prepare: makes of settings what the node works with, or raises BadInput; it must not
            change anything, for the change may still be refused.

    Attributes:
        prepared: what was made of the parameters at the start.

    Raises:
        BadInput: a parameter is unknown or its value is not allowed.
    """

    def __init__(
        self,
        node: Node,
        rows: Sequence[Row],
        settings_of: Callable[[Values], S],
        prepare: Callable[[S], W],
    ) -> None:
        self._node, self._rows = node, rows
        self._settings_of, self._prepare = settings_of, prepare
        _refuse_unknown(node)
        for row in rows:
            _declare(node, row)
        self.prepared = prepare(settings_of(self._values()))

    def keep(self, install: Callable[[W], None]) -> None:
        """From now on check changes, and install what was prepared once a change is certain."""
        self._install = install
        self._pending: W | None = None
        self._node.add_on_set_parameters_callback(self._on_set)
        self._node.add_post_set_parameters_callback(self._on_changed)

    def _values(self) -> dict[str, Any]:
        return {row.name: self._node.get_parameter(row.name).value for row in self._rows}

    def _on_set(self, changes: list[Parameter]) -> SetParametersResult:
        try:
            self._pending = self._prepare(self._settings_of(self._merged(changes)))
        except BadInput as error:
            return SetParametersResult(successful=False, reason=str(error))
        except Exception as error:  # a raising callback would end the node from afar
            return SetParametersResult(successful=False, reason=f'{type(error).__name__}: {error}')
        return SetParametersResult(successful=True)

    def _merged(self, changes: list[Parameter]) -> dict[str, Any]:
        values = self._values()
        for change in changes:
            if change.name == 'use_sim_time':
                raise BadInput('use_sim_time', change.value, 'set at the start only')
            if change.name in values:
                values[change.name] = change.value
        return values

    def _on_changed(self, _changes: list[Parameter]) -> None:
        if self._pending is not None:
            self._install(self._pending)
        self._pending = None


def _refuse_unknown(node: Node) -> None:
    # One file may serve both nodes, so a name is unknown only if neither has it.
    known = {row.name for row in (*PLANNER, *SIM)}.union(OF_ROS)
    for name, given in node._parameter_overrides.items():
        if name not in known and not name.startswith('qos_overrides.'):
            raise BadInput(f'parameter {name}', given.value, 'a parameter of the planner or sim')


def _declare(node: Node, row: Row) -> None:
    empty = row.default == ()
    default = row.kind if empty else row.default
    try:
        node.declare_parameter(row.name, default, row.descriptor)
    except (InvalidParameterTypeException, InvalidParameterValueException):
        given = node._parameter_overrides[row.name].value
        raise BadInput(row.name, given, row.allowed) from None
    if empty and node.get_parameter_or(row.name).type_ == Parameter.Type.NOT_SET:
        # rclpy takes an undeclared [] for bytes, so that the type has to be given apart.
        node.set_parameters([Parameter(row.name, row.kind, [])])
