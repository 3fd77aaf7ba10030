# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Parameters as fields of a settings class: one definition each, from which all else follows.

A field made by :func:`parameter` holds the parameter's name, default, range and meaning; its
descriptor, its check, its row in docs/parameters.md and its place in the settings are derived from
these. Parameters common to both nodes are defined here, too.
"""

from __future__ import annotations

import math
import re
import sys
from array import array
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields
from fnmatch import fnmatchcase
from functools import cached_property
from importlib import import_module
from itertools import dropwhile, pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import yaml
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.parameter import Parameter

from orbimpc_ros.loop.compensation import SOURCES
from orbimpc_ros.mpc.arrays import Array, sealed, word
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.problem import Box
from orbimpc_ros.mpc.problem.problem import WIDEST_CONE, Approach
from orbimpc_ros.ros.messages import THRUST_AXES, Frames

Value = bool | int | float | str | tuple[float, ...] | tuple[str, ...]
Values = Mapping[str, Any]
Type = Parameter.Type
S = TypeVar('S')

FAR = 1e6  # [m]: positions in parameters
MAX_DURATION = 1e3  # [s]: in parameters
ALLOWED = {  # descriptions, with a place for the range of numbers
    Type.BOOL: 'true | false',
    Type.STRING: 'text',
    Type.STRING_ARRAY: 'a list of words',
    Type.DOUBLE: 'a number {}',
    Type.DOUBLE_ARRAY: 'a list of numbers {}',
    Type.INTEGER: 'an integer {}',
}
NUMBERS = (Type.DOUBLE, Type.DOUBLE_ARRAY, Type.INTEGER)
TIMED_INPUT = 150.0  # default of weights.input for thrust with weights.scaling time
TINY = 1e-6  # means "above zero" in ranges, which are closed
TOPIC = re.compile(r'(~?/)?[a-zA-Z_]\w*(/[a-zA-Z_]\w*)*', re.ASCII)


@dataclass(frozen=True)
class ParameterSpec:
    """One parameter."""

    name: str  # in ROS
    default: Value  # of the parameter's type; tuples are lists of numbers, or of words
    description: str  # one sentence
    unit: str = ''  # of the value; empty without one
    low: float = -math.inf  # least allowed value, of every element of a list
    high: float = math.inf  # greatest allowed value
    choices: Collection[str] = ()  # allowed words, if restricted
    live: bool = False  # whether it may change while the node runs
    words: bool = False  # whether a list is one of words

    @property
    def kind(self) -> Type:
        """Return the ROS type."""
        if isinstance(self.default, tuple):  # may be empty
            return Type.STRING_ARRAY if self.words else Type.DOUBLE_ARRAY
        return Type.from_parameter_value(self.default)

    @property
    def allowed(self) -> str:
        """Describe the allowed values."""
        if self.choices:
            return ' | '.join(each or "''" for each in self.choices)
        return ALLOWED[self.kind].format(f'in [{self.low:g}, {self.high:g}] {self.unit}').rstrip()

    @property
    def descriptor(self) -> ParameterDescriptor:
        """Return the ROS descriptor.

        ROS leaves the type to :meth:`typed`: it would tell 1 from 1.0, and not know that of [].
        """
        described = ParameterDescriptor(
            name=self.name,
            description=self.description + (f' [{self.unit}]' if self.unit else ''),
            additional_constraints=self.allowed,
            read_only=not self.live,
            dynamic_typing=True,
        )
        if self.kind is Type.INTEGER:
            described.integer_range = [IntegerRange(from_value=self.low, to_value=self.high)]
        elif self.kind is Type.DOUBLE:
            span = FloatingPointRange(from_value=self.low, to_value=self.high)
            described.floating_point_range = [span]
        return described

    def typed(self, value: Any) -> Any:
        """Return a value in the parameter's type; integers are accepted for other numbers.

        Raises:
            BadInput: a value of another type.
        """
        if isinstance(value, (list, tuple, array)):
            value = tuple(float(each) if type(each) is int else each for each in value)
        elif self.kind is Type.DOUBLE and type(value) is int:
            value = float(value)
        if not self.kind.check(value) or isinstance(value, bool) != (self.kind is Type.BOOL):
            raise BadInput(
                self.name, repr(value) if isinstance(value, str) else value, self.allowed
            )
        return value

    def checked(self, value: Any) -> Any:
        """Return a value in the parameter's type, within its range.

        Raises:
            BadInput: of another type, out of range, not finite or not among the choices.
        """
        value = self.typed(value)
        if self.choices:
            word(value, self.name, self.choices)
        numbers = np.asarray(value if self.kind in NUMBERS else ())
        if not np.all((numbers >= self.low) & (numbers <= self.high)):
            raise BadInput(self.name, value, self.allowed)
        return value


def parameter(name: str, default: Value, description: str, *range_: Any, **more: Any) -> Any:
    """Return a field of a settings class for a parameter; arguments as of ParameterSpec."""
    spec = ParameterSpec(name, default, description, *range_, **more)
    return field(default=default, metadata={'parameter': spec})


def specs_of(settings: type) -> tuple[ParameterSpec, ...]:
    """Return the parameters of a settings class in their order."""
    return tuple(
        each.metadata['parameter'] for each in fields(settings) if 'parameter' in each.metadata
    )


def settings_from(settings: type[S], values: Values) -> S:
    """Return settings with the checked values of all parameters of their class, ignoring others.

    Raises:
        BadInput: a value of another type, or out of range.
    """
    rows = {each.name: each.metadata.get('parameter') for each in fields(settings)}  # type: ignore[arg-type]
    return settings(**{name: row.checked(values[row.name]) for name, row in rows.items() if row})


def completed(specs: Iterable[ParameterSpec], given: Values) -> dict[str, Any]:
    """Return the given values, and defaults for the rest."""
    values = {spec.name: spec.default for spec in specs}
    if (given.get('weights.scaling'), given.get('translation_order')) == ('time', 2):
        values['weights.input'] = TIMED_INPUT
    return values | dict(given)


# --- values given from outside: rcl matches sections of files, and -p NODE:NAME:=VALUE, with node
# names and silently ignores the rest, so that a node whose name is misspelt keeps its defaults

OF_ROS = ('use_sim_time', 'start_type_description_service')
PARAMETERS = 'ros__parameters'
TABLES = ('ros.parameters.planner', 'PLANNER'), ('sim.parameters', 'SIM')


def refuse_unknown(given: Iterable[str], specs: Iterable[ParameterSpec]) -> None:
    """Reject a parameter that neither node has: one file may serve both."""
    others = set(given).difference(OF_ROS, (spec.name for spec in specs))
    if not others:
        return
    tables = (getattr(import_module(f'orbimpc_ros.{module}'), name) for module, name in TABLES)
    known = {*OF_ROS, *(spec.name for table in tables for spec in table)}
    for name in sorted(others - known):
        raise BadInput.unknown('parameter', name, sorted(known))


def unused(given: Iterable[tuple[str, str]], full: str, kind: str) -> list[str]:
    """Return sections of a node's parameter files, and values of -p, that are for no node.

    Sections in other namespaces belong to other vehicles, but not those without a namespace, nor
    any of a file that has none for this node.

    Args:
        given: sections of files, each with its file.
        full: name of the node, with its namespace.
        kind: its name unless it is remapped.
    """
    name = full.rpartition('/')[2]
    names = {name, '*', '**', 'planner', 'sim'} - ({kind} - {name})  # one file may serve both
    used = {file for each, file in given if fnmatchcase(full, each.replace('/**', '*'))}
    ignored = []
    for section, file in given:
        last = section.rpartition('/')[2]
        if file not in used or last not in names or f'/{name}' == section != full:
            ignored.append(f'section {section} in {file}')
    for flag, rule in pairwise(sys.argv):
        owner, colon, _ = rule.partition(':=')[0].rpartition(':')
        if flag in ('-p', '--param') and colon and f'/{owner}' != full:
            ignored.append(f'-p {rule}')
    return ignored


def outvoted(values: Values, full: str) -> list[str]:
    """Return values of -p for all nodes that are not in force, each with what to do about it.

    Args:
        values: those in force, by name.
        full: name of the node, with its namespace, which ROS does not take in -p.
    """
    lost, alone = [], full.count('/') == 1
    for flag, rule in pairwise(sys.argv):
        name, _, text = rule.partition(':=')
        if flag in ('-p', '--param') and name in values:
            given = np.asarray(yaml.safe_load(text))
            if given.dtype.kind == 'U':  # such as 1e-3, which is a number in ROS alone
                with suppress(ValueError):
                    given = given.astype(float)
            if not np.array_equal(given, values[name]):
                own = f'give -p {full[1:]}:{rule}' if alone else 'set it in a file'
                lost.append(f'-p {rule} loses to another value for {full}, as in a file: {own}')
    return lost


def given_sections() -> list[tuple[str, str]]:
    """Return the sections of this process's parameter files, each with its file.

    Raises:
        BadInput: a file cannot be read, has none, or has values that rcl would misread.
    """
    titles = []
    for flag, file in pairwise(dropwhile('--ros-args'.__ne__, sys.argv)):
        if flag == '--params-file':
            try:
                text = Path(file).read_text(errors='replace')
                tree = yaml.load(text, yaml.BaseLoader)  # tags are ignored, as in rcl
            except (OSError, yaml.YAMLError) as error:
                why = ' '.join((getattr(error, 'strerror', None) or str(error)).split())
                raise BadInput.stating(file, 'unreadable', why) from None
            titles += [(title, file) for title, _ in sections(tree or {}, file)]
            for at, problem, hint in _flaws(yaml.compose(text, yaml.SafeLoader)):
                raise BadInput.stating(f'{file} line {at.start_mark.line + 1}', problem, hint)
    return titles


def _flaws(node: Any, name: str = '') -> Iterator[tuple[Any, str, str]]:
    """Yield what rcl drops, overwrites, or refuses in words of its own: place, problem, hint."""
    if isinstance(node, yaml.MappingNode):
        names = [key.value for key, _ in node.value]
        for key, value in node.value:
            if names.count(key.value) > 1:
                yield key, f'{key.value} is given twice', 'keep one of them'
            yield from _flaws(value, key.value)
    elif isinstance(node, yaml.SequenceNode):
        kinds = {each.tag.rpartition(':')[2] for each in node.value}
        if kinds & {'seq', 'map'} or kinds >= {'int', 'float'}:
            yield node, f'{name} is a list of {" and ".join(sorted(kinds))}', 'needed: [0.0, 1.0]'
    elif node and not node.value and node.style is None:
        yield node, f'{name} has no value', 'give it one, or leave it out'


def sections(tree: Any, file: str, above: str = '') -> list[tuple[str, dict[str, Any]]]:
    """Return sections, nested by namespace ``above``: names with a leading slash, and values."""
    entries = list[tuple[str, dict[str, Any]]]()
    for name, below in tree.items() if isinstance(tree, dict) else ():
        if name != PARAMETERS:
            entries += sections(below, file, f'{above}/{str(name).strip("/")}')
        elif above and isinstance(below, dict):
            entries.append((above, below))
    if not (entries or above or tree == {}):
        needed = 'sections such as "/**: {ros__parameters: {step: 0.5}}" are needed'
        raise BadInput.stating(file, 'not a parameter file', needed)
    return entries


# --- parameters of both nodes


def vector(numbers: tuple[float, ...], name: str, dimension: int) -> Array:
    """Return the first n of x, y, z; in the plane z may be left out.

    Raises:
        BadInput: a wrong number of values; ``name`` is the parameter's.
    """
    if not dimension <= len(numbers) <= 3:
        raise BadInput(name, list(numbers), '3 numbers' if dimension == 3 else '2 or 3 numbers')
    return np.array(numbers[:dimension], dtype=float)


@dataclass(frozen=True)
class VehicleParameters:
    """Parameters of each node's process, and those on which planner and simulator must agree.

    What is derived from parameters raises BadInput, naming one, where they do not fit together.
    """

    # fmt: off
    autostart: bool = parameter('autostart', True, 'Whether to configure and activate itself at '
        'the start; otherwise a lifecycle manager does, by ~/change_state')
    executor: str = parameter('executor', 'wait_set', "Executor of callbacks: wait_set, rclpy's "
        'default; events, its experimental one, which takes less processor time (rclpy 7.1.4 and '
        'later)', choices=('wait_set', 'events'))
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
    discretisation: str = parameter('discretisation', 'euler', 'How a step moves: euler, along the '
        'axis at its start, as in the paper; exact, integrated while the axis turns',
        choices=('euler', 'exact'))
    max_rate: float = parameter('max_rate', 0.0, 'Limit on the body rate; 0 for none, at most '
        'pi/step. Without a floor it also limits changes of speed: R e1 moves by at most 2 '
        'sin(step * max_rate / 2) in a step. With a floor it limits the angle of each step, at any '
        'speed. For thrust in space without a floor, cones or a terminal constraint it limits only '
        'commands', 'rad/s', 0.0, 1e4, live=True)
    max_acceleration: float = parameter('max_acceleration', 0.0, 'Limit on the change of speed '
        '(translation_order 1); 0 for none. From one command to the next the speed changes by at '
        'most step * max_acceleration', 'm/s^2', 0.0, 1e6, live=True)
    speed_lag: float = parameter('response.speed', 0.0, 'First-order lag of speed or thrust; '
        'a vehicle with any lag obeys at once, not at the end of a step', 's', 0.0, 10.0, live=True)
    rate_lag: float = parameter('response.rate', 0.0, 'First-order lag of the body rate',
        's', 0.0, 10.0, live=True)
    wind: tuple[float, ...] = parameter('wind', (0.0, 0.0, 0.0), 'Known wind in the world frame '
        '(an acceleration at translation order 2): x, y, z', 'm/s or m/s^2', -1e3, 1e3, live=True)
    gravity: float = parameter('gravity', 0.0, 'Along -z (dimension 3, translation order 2); '
        'cmd_thrust is the whole thrust, weight included', 'm/s^2', 0.0, 1e3, live=True)
    velocity_source: str = parameter('velocity_source', 'ground',
        'Whether the twist of odom is over ground or through the air', choices=SOURCES)
    frame_id: str = parameter('frame_id', 'odom', 'World frame of poses; empty accepts any')
    child_frame_id: str = parameter('child_frame_id', 'base_link',
        'Body frame of twists; empty accepts any')
    thrust_axis: str = parameter('thrust_axis', 'x', 'Body axis of thrust, along which speed and '
        'force are given: x, or in space z, as for a multirotor', choices=tuple(THRUST_AXES))
    capture_radius: float = parameter('capture_radius', 0.2, 'Distance at which the goal is '
        'caught: in plans (objective intercept), and on the topics caught and arrived',
        'm', TINY, 1e6, live=True)
    approach_cone: float = parameter('approach.cone', 0.0, 'A catch counts only with the thrust '
        'axis within this angle of approach.direction, whatever the velocity; 0 for any',
        'rad', 0.0, WIDEST_CONE, live=True)
    approach_direction: tuple[float, ...] = parameter('approach.direction', (), 'Heading required '
        "at a catch, in the world frame: x, y, z; empty for the thrust axis of the goal's "
        'orientation', '', -FAR, FAR, live=True)
    obstacles: tuple[float, ...] = parameter('obstacles', (),
        'Boxes to stay out of: lower, then upper corner of each', 'm', -FAR, FAR, live=True)
    # fmt: on

    velocity_frame = 'body'  # of odometry, unless it is a parameter

    @cached_property
    def disturbance(self) -> Array:
        """Return the known wind or acceleration, including gravity, shape (n,)."""
        if self.gravity and (self.dimension, self.translation_order) != (3, 2):
            raise BadInput('gravity', self.gravity, '0 unless dimension 3, translation_order 2')
        disturbance = vector(self.wind, 'wind', self.dimension)
        disturbance[-1] -= self.gravity
        return sealed(disturbance)

    @cached_property
    def boxes(self) -> tuple[Box, ...]:
        """Return the obstacles."""
        n = self.dimension
        if len(self.obstacles) % (2 * n):
            raise BadInput('obstacles', list(self.obstacles), f'{2 * n} numbers for each box')
        corners = np.array(self.obstacles, dtype=float).reshape(-1, 2, n)
        return tuple(Box(low, high) for low, high in corners)

    @cached_property
    def frames(self) -> Frames:
        """Return the required frames of messages, and the thrust axis."""
        if self.thrust_axis != 'x' and self.dimension == 2:
            raise BadInput('thrust_axis', self.thrust_axis, 'x when dimension is 2')
        return Frames(self.frame_id, self.child_frame_id, self.thrust_axis, self.velocity_frame)

    def approach_of_a_catch(self) -> Approach:
        """Return the cone of headings in which a catch counts."""
        direction = self.approach_direction
        if direction:
            direction = tuple(vector(direction, 'approach.direction', self.dimension).tolist())
        approach = Approach(self.approach_cone, direction)
        approach.validate(self.dimension)
        return approach
