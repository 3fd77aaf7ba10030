# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The simulator's parameters, and the settings derived from them."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from orbimpc_ros.mpc.arrays import Array, number
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import from_quaternion, nearest
from orbimpc_ros.mpc.problem import Approach, Ball, MovingObstacle
from orbimpc_ros.ros.messages import QUATERNION_TOLERANCE
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
    vector,
)
from orbimpc_ros.sim.engines import Vehicle
from orbimpc_ros.sim.vehicle import ENGINES, Model, Plant

ALONG_AXES = (0.0, 0.0, 0.0)
READERS = re.compile(rf'(?P<topic>{TOPIC.pattern})(\s+(?P<count>[1-9]\d?|100))?', TOPIC.flags)
PLAIN = ('response.speed', 'response.rate', 'gust_time', 'drag', 'gain')  # in continuous time
BY_ENGINE = ('dimension', 'translation_order', *PLAIN)  # of every engine
SET = {'servicer': {'dimension': 3, 'translation_order': 2}}  # by an engine, besides defaults
FIXED = {  # parameters that do not apply to a vehicle, or that its engine sets
    'discrete': (*PLAIN, 'gust', 'stall_speed', 'odom_rate'),
    'cessna': BY_ENGINE,
    'hummingbird': (*BY_ENGINE, 'goal_path_steps', 'rope.frequency', 'rope.velocity'),
    'servicer': (*BY_ENGINE, 'gust', 'stall_speed'),
}


@dataclass(frozen=True)
class Faults:
    """Rates and magnitudes of message faults; each field is a parameter of the simulator."""

    # fmt: off
    position_noise: float = parameter('faults.position_noise', 0.0,
        'Standard deviation of noise on odometry and goal along each axis', 'm', 0.0, 1e3)
    attitude_noise: float = parameter('faults.attitude_noise', 0.0,
        'Standard deviation of noise on odometry about each axis', 'rad', 0.0, math.pi)
    dropout: float = parameter('faults.dropout', 0.0,
        'Share of odometry, goals and commands that is lost', '', 0.0, 1.0)
    delay: float = parameter('faults.delay', 0.0, 'Age of odometry on arrival', 's', 0.0, 10.0)
    reorder: float = parameter('faults.reorder', 0.0,
        'Share of odometry and goals that arrives a step late', '', 0.0, 1.0)
    duplicate: float = parameter('faults.duplicate', 0.0,
        'Share of odometry and goals that arrives twice', '', 0.0, 1.0)
    nan: float = parameter('faults.nan', 0.0,
        'Share of odometry and goals whose position is not a number', '', 0.0, 1.0)
    occlusion_length: float = parameter('faults.occlusion_length', 0.0,
        'How long the goal is hidden in each period', 's', 0.0, 1e6)
    occlusion_period: float = parameter('faults.occlusion_period', 10.0,
        'Period in which the goal is hidden once, at a random time', 's', TINY, 1e6)
    clock_jump: float = parameter('faults.clock_jump', 0.0,
        'Offset of every stamp from clock_jump_tick on', 's', -1e6, 1e6)
    clock_jump_tick: int = parameter('faults.clock_jump_tick', 0,
        'Steps flown before the clock jumps', '', 0, 1_000_000)
    # fmt: on

    def __post_init__(self) -> None:
        if not 0.0 <= self.occlusion_length <= self.occlusion_period:
            allowed = f'in [0, occlusion_period = {self.occlusion_period:g}]'
            raise BadInput('faults.occlusion_length', self.occlusion_length, allowed)

    def jumped(self, ticks: int) -> float:
        """Return the error of stamps after a number of steps [s]."""
        return self.clock_jump if ticks >= self.clock_jump_tick else 0.0


@dataclass(frozen=True)
class SimSettings(VehicleParameters):
    """The simulator's parameters, one per field, and the quantities derived from them.

    A field ``given_...`` is a raw value; use the quantity derived from it instead.
    """

    # fmt: off
    vehicle: str = parameter('vehicle', 'discrete', 'Motion of the vehicle: discrete, in the '
        "planner's steps; continuous, with lags, limits and gusts; or in an engine: cessna in "
        'JSBSim, hummingbird of RotorPy in MuJoCo, servicer, a spacecraft, in Basilisk',
        choices=('discrete', 'continuous', *ENGINES))
    gust: float = parameter('gust', 0.0,
        'Standard deviation of gusts along each axis, on top of wind', 'm/s or m/s^2', 0.0, 1e3)
    gust_time: float = parameter('gust_time', 3.0, 'Correlation time of gusts', 's', 0.1, 1e3)
    drag: float = parameter('drag', 0.0, 'Deceleration per unit of velocity (translation order 2)',
        '1/s', 0.0, 1e3)
    gain: float = parameter('gain', 1.0, 'Actual speed or thrust, as a share of the commanded one',
        '', 0.1, 10.0)
    stall_speed: float = parameter('stall_speed', 0.0,
        'Airspeed below which the topic truth counts a stall; flight goes on', 'm/s', 0.0, 1e3)
    odom_rate: float = parameter('odom_rate', 0.0,
        'Rate of odometry, goals and ticks in simulated time; 0 for one per step', 'Hz', 0.0, 1e3)
    clock: str = parameter('clock', 'lockstep', 'lockstep waits for each command; shared also for '
        'the common /clock of a fleet; wall runs in real time',
        choices=('lockstep', 'shared', 'wall'))
    rope_center: tuple[float, ...] = parameter('rope.center', (5.0, 0.0, 0.0),
        'Middle of the swing: x, y, z', 'm', -FAR, FAR)
    rope_amplitude: tuple[float, ...] = parameter('rope.amplitude', (0.5, 0.5, 0.0),
        'Reach of the swing: x, y, z', 'm', -FAR, FAR)
    rope_frequency: float = parameter('rope.frequency', 0.1, 'Swings per second', 'Hz', 0.0, 1e3)
    rope_phase: tuple[float, ...] = parameter('rope.phase',
        (5.0 * math.pi / 3.0, 3.5 * math.pi / 3.0, 0.0), 'Phase at the start: x, y, z',
        'rad', -100.0, 100.0)
    rope_velocity: tuple[float, ...] = parameter('rope.velocity', ALONG_AXES,
        'Drift of the middle: x, y, z', 'm/s', -1e3, 1e3)
    rope_length: float = parameter('rope.length', 0.0, 'Length of the rope, half of it above the '
        'plane of flight; for aircraft, which leave that plane', 'm', 0.0, FAR)
    finish: str = parameter('finish', 'capture',
        'Whether a flight ends by capture, or at max_ticks by arrival',
        choices=('capture', 'arrival'))
    arrival_radius: float = parameter('arrival_radius', 0.05,
        'Largest distance to the goal at arrival', 'm', TINY, FAR)
    arrival_speed: float = parameter('arrival_speed', 0.0, 'Largest speed at arrival; 0 for any',
        'm/s', 0.0, FAR)
    given_traffic: tuple[float, ...] = parameter('traffic', (), 'Balls (discs in the plane) at '
        'constant velocity, published on obstacles: for each its position at the start, velocity '
        'and radius', 'm, m/s', -FAR, FAR)
    traffic_margin: float = parameter('traffic_margin', 0.0,
        'Added to the published radii of traffic', 'm', 0.0, FAR)
    start_position: tuple[float, ...] = parameter('start.position', ALONG_AXES,
        'Where the vehicle starts: x, y, z', 'm', -FAR, FAR)
    start_orientation: tuple[float, ...] = parameter('start.orientation', (0.0, 0.0, 0.0, 1.0),
        'Unit quaternion x, y, z, w at the start', '', -1.0, 1.0)
    start_fraction: float = parameter('start.speed_fraction', 1.0,
        'Share of speed or thrust at the start', '', 0.0, 1.0)
    start_velocity: tuple[float, ...] = parameter('start.velocity', ALONG_AXES,
        'World velocity at the start (translation order 2)', 'm/s', -FAR, FAR)
    start_body_rate: tuple[float, ...] = parameter('start.body_rate', ALONG_AXES,
        'Rates about the body axes at the start', 'rad/s', -1e3, 1e3)
    max_ticks: int = parameter('max_ticks', 60, 'Ticks until the flight ends', '', 1, 1_000_000)
    seed: int = parameter('seed', 0, 'Seed of all random numbers', '', 0, 2**31 - 1)
    given_command_timeout: float = parameter('command_timeout', 0.2, 'How long a command remains '
        'in force, at least 1.5 steps, and how long a planner may be without liveliness before it '
        'counts as lost', 's', 1e-3, MAX_DURATION)
    goal_path_steps: int = parameter('goal_path_steps', 0,
        'Future steps of the goal to publish on goal_path; 0 for none', '', 0, 10_000)
    exit_when_done: bool = parameter('exit_when_done', False,
        'Whether to exit once the goal is caught or ticks run out')
    failsafe_fraction: float = parameter('failsafe.fraction', 0.0, 'Share of full speed or thrust '
        'while no command is in force; 0: the vehicle stops', '', 0.0, 1.0)
    failsafe_rate: float = parameter('failsafe.rate', 0.0,
        'Body rate about z while no command is in force, at most pi/step', 'rad/s', -1e4, 1e4)
    rate: float = parameter('rate', 0.0,
        'Speed of lock-step as a multiple of real time; 0 for no limit', '', 0.0, 1e6)
    wait_subscribers: int = parameter('wait_subscribers', 1,
        'Subscribers of odom that a flight waits for, including the planner', '', 1, 100)
    given_wait_for: str = parameter('wait_for', '', 'Other subscribers that a flight waits for: '
        'topics, each with a count if above 1, such as: tick, odom 2')
    wait_timeout: float = parameter('wait_timeout', 120.0, 'How long lock-step waits for '
        "planner and subscribers, not counting the planner's configuration, and for an answer (20 "
        's at most); 0 for no limit', 's', 0.0, MAX_DURATION)
    # fmt: on
    faults: Faults = field(default_factory=Faults)  # between the vehicle and its planner

    @property
    def command_timeout(self) -> float:
        """Return the age at which a command expires, at least 1.5 steps [s]."""
        return max(self.given_command_timeout, 1.5 * self.step)

    @cached_property
    def wait_for(self) -> dict[str, int]:
        """Return the number of readers to wait for, by topic, besides planner and simulator."""
        wanted: dict[str, int] = {}
        for entry in filter(None, map(str.strip, self.given_wait_for.split(','))):
            match = READERS.fullmatch(entry)
            if match is None or match['topic'] in wanted:
                allowed = 'topics, each with the number of its readers, 1 to 100: odom 2'
                raise BadInput('wait_for', self.given_wait_for, allowed)
            wanted[match['topic']] = int(match['count'] or 1)
        return wanted

    @property
    def begin(self) -> float:
        """Return the start time of a flight, late enough for all stamps to be non-negative [s]."""
        return max(0.0, self.faults.delay, -self.faults.clock_jump)

    @cached_property
    def rope(self) -> list[Array]:
        """Return center, velocity, amplitude and phase of the rope, shape (n,) each."""
        names = ('center', 'velocity', 'amplitude', 'phase')
        return [vector(getattr(self, f'rope_{n}'), f'rope.{n}', self.dimension) for n in names]

    def rope_at(self, time: float) -> Array:
        """Return center + velocity t + amplitude * sin(2 pi f t + phase), shape (n,) [m]."""
        center, velocity, amplitude, phase = self.rope
        angle = 2.0 * np.pi * self.rope_frequency * time + phase
        return np.asarray(center + velocity * time + amplitude * np.sin(angle))

    @cached_property
    def model(self) -> Model:
        """Return the vehicle's motion model; one in an engine has its own, but for the step."""
        own: dict[str, Any] = {'disturbance': tuple(self.disturbance.tolist())}
        if self.odom_rate:
            own['step'] = 1.0 / self.odom_rate
        kind: type[Model] = Plant if self.vehicle == 'continuous' else Model
        names = {each.name for each in fields(kind)} - own.keys()
        return kind(**own, **{name: getattr(self, name) for name in names})

    @cached_property
    def failsafe(self) -> tuple[float, Array]:
        """Return share of full speed or thrust, and body rate [rad/s], while without a command."""
        fastest = np.pi / self.model.step
        rate = number(self.failsafe_rate, 'failsafe.rate', -fastest, fastest)
        return self.failsafe_fraction, np.array([0.0, 0.0, rate])[-self.model.rates :]

    @cached_property
    def start(self) -> Vehicle:
        """Return the vehicle before it moves; at translation order 1 its velocity follows then."""
        orientation, unit = self.start_orientation, np.roll(self.start_orientation, 1)  # w, x, y, z
        if len(unit) != 4 or not abs(np.linalg.norm(unit) - 1.0) <= QUATERNION_TOLERANCE:
            raise BadInput('start.orientation', orientation, 'a unit quaternion x, y, z, w')
        attitude = from_quaternion(unit / np.linalg.norm(unit), self.dimension)
        body_rate = vector(self.start_body_rate, 'start.body_rate', 3)
        return Vehicle(
            time=0.0,
            position=vector(self.start_position, 'start.position', self.dimension),
            velocity=vector(self.start_velocity, 'start.velocity', self.dimension),
            attitude=nearest(self.frames.turned(attitude)),
            body_rate=self.frames.turned(body_rate)[-self.model.rates :],
            fraction=self.start_fraction,
            wind=self.disturbance * (self.translation_order == 1),
        )

    @cached_property
    def traffic(self) -> tuple[MovingObstacle, ...]:
        """Return the balls with constant velocities from the start on."""
        numbers, n = self.given_traffic, self.dimension
        if len(numbers) % (2 * n + 1):
            raise BadInput('traffic', list(numbers), f'{2 * n + 1} numbers for each ball')
        balls = []
        for row in np.reshape(numbers, (-1, 2 * n + 1)).astype(float):
            ball = Ball(row[:n], number(float(row[-1]), 'traffic radius', 0.0, above=True))
            balls.append(MovingObstacle.drifting(ball, row[n:-1]))
        return tuple(balls)

    @cached_property
    def bodies(self) -> tuple[MovingObstacle, ...]:
        """Return everything to stay out of: the boxes, then the balls."""
        return (*map(MovingObstacle.drifting, self.boxes), *self.traffic)

    @cached_property
    def approach(self) -> Approach:
        """Return the approach cone of a catch; the goal's orientation is that of the world."""
        approach = self.approach_of_a_catch()
        if not approach.is_the_goals:
            return approach
        own = self.frames.turned(np.eye(3))[: self.dimension, 0]
        return replace(approach, direction=tuple(own.tolist()))


SIM = tuple(replace(spec, live=False) for spec in (*specs_of(SimSettings), *specs_of(Faults)))


def sim_settings(values: Values) -> SimSettings:
    """Return the settings for a full set of simulator parameters.

    Raises:
        BadInput: a value, or a combination, is not allowed.
    """
    settings = replace(settings_from(SimSettings, values), faults=settings_from(Faults, values))
    fixed = FIXED.get(settings.vehicle, ())
    for spec in SIM:  # zero and the default say nothing
        value = spec.typed(values[spec.name])
        needed = SET.get(settings.vehicle, {}).get(spec.name, spec.default)
        if spec.name in fixed and value != needed and np.any(value):
            raise BadInput(spec.name, value, f'{needed} with vehicle: {settings.vehicle}')
    for derived in ('model', 'start', 'failsafe', 'rope', 'bodies', 'approach', 'wait_for'):
        getattr(settings, derived)  # raises if invalid
    return settings
