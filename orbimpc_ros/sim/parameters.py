# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The simulator's parameters, and the settings that they add up to."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from orbimpc_ros.mpc.arrays import Array, number
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import from_quaternion
from orbimpc_ros.mpc.problem import Approach, Ball, MovingObstacle
from orbimpc_ros.ros.messages import QUATERNION_TOLERANCE
from orbimpc_ros.ros.parameters.spec import (
    FAR,
    MAX_DURATION,
    TINY,
    Values,
    parameter,
    settings_from,
    specs_of,
    vector,
)
from orbimpc_ros.ros.parameters.vehicle import VehicleParameters
from orbimpc_ros.ros.process import LIFE
from orbimpc_ros.sim.engine_vehicle import ENGINES, EnginePlant
from orbimpc_ros.sim.faults import Faults
from orbimpc_ros.sim.plant import Gusts, Plant
from orbimpc_ros.sim.vehicle import Model, Vehicle, launched
from orbimpc_ros.sim.waiting import wanted_readers
from orbimpc_ros.sim.world import FINISHES, Rope, Scenario

SHARE = 0.75  # of command_timeout without a sign of life; the rest is for reporting it
ALONG_AXES = (0.0, 0.0, 0.0)
# What only a vehicle in continuous time has; of that, what one in an engine has, by its order of
# translation; and what is unknown of a goal that an engine moves.
CONTINUOUS = (
    *('response.speed', 'response.rate', 'gust', 'gust_time', 'drag', 'gain', 'stall_speed'),
    'odom_rate',
)
OF_ENGINES = {1: ('gust', 'stall_speed', 'odom_rate'), 2: ('odom_rate',)}
OF_GOAL = ('goal_path_steps', 'rope.frequency', 'rope.velocity')


@dataclass(frozen=True)
class SimSettings(VehicleParameters):
    """The simulator's parameters, each a field, and what follows from them.

    A value for which something else may be used is ``given_...``.
    """

    # fmt: off
    vehicle: str = parameter('vehicle', 'discrete', 'Whether the vehicle moves in the steps that '
        'the planner believes in, or in continuous time, with lags and limits, in wind, or in an '
        'engine: cessna is that of JSBSim, hummingbird that of RotorPy in MuJoCo, servicer a '
        'spacecraft in Basilisk', choices=('discrete', 'continuous', *ENGINES))
    max_rate: float = parameter('max_rate', 0.0, 'The vehicle turns no faster; 0 for no limit',
        'rad/s', 0.0, 1e4)
    max_acceleration: float = parameter('max_acceleration', 0.0,
        'The speed changes no faster (translation order 1); 0 for no limit', 'm/s^2', 0.0, 1e6)
    speed_lag: float = parameter('response.speed', 0.0, 'Lag of speed or thrust, first order',
        's', 0.0, 10.0)
    rate_lag: float = parameter('response.rate', 0.0, 'Lag of the body rate, first order',
        's', 0.0, 10.0)
    gust: float = parameter('gust', 0.0,
        'Standard deviation of gusts along each axis, on top of wind', 'm/s or m/s^2', 0.0, 1e3)
    gust_time: float = parameter('gust_time', 3.0, 'Correlation time of gusts', 's', 0.1, 1e3)
    drag: float = parameter('drag', 0.0, 'Deceleration by the own velocity (translation order 2)',
        '1/s', 0.0, 1e3)
    gain: float = parameter('gain', 1.0,
        'Speed or thrust that is reached, a share of what is commanded', '', 0.1, 10.0)
    stall_speed: float = parameter('stall_speed', 0.0, 'Airspeed below which a vehicle is counted '
        'as stalled on the topic truth; it flies on', 'm/s', 0.0, 1e3)
    odom_rate: float = parameter('odom_rate', 0.0, 'Odometry, goals and ticks of the simulator in '
        'a second of its time; 0 for one in each step', 'Hz', 0.0, 1e3)
    clock: str = parameter('clock', 'lockstep', 'lockstep waits for each command, shared also for '
        'the /clock that the vehicles of a fleet have in common; wall runs in real time',
        choices=('lockstep', 'shared', 'wall'))
    rope_center: tuple[float, ...] = parameter('rope.center', (5.0, 0.0, 0.0),
        'Middle of the swing: x, y, z', 'm', -FAR, FAR)
    rope_amplitude: tuple[float, ...] = parameter('rope.amplitude', (0.5, 0.5, 0.0),
        'Reach of the swing: x, y, z', 'm', -FAR, FAR)
    rope_frequency: float = parameter('rope.frequency', 0.1, 'Swings in a second', 'Hz', 0.0, 1e3)
    rope_phase: tuple[float, ...] = parameter('rope.phase',
        (5.0 * math.pi / 3.0, 3.5 * math.pi / 3.0, 0.0), 'Phase at the start: x, y, z',
        'rad', -100.0, 100.0)
    rope_velocity: tuple[float, ...] = parameter('rope.velocity', ALONG_AXES,
        'Drift of the middle: x, y, z', 'm/s', -1e3, 1e3)
    rope_length: float = parameter('rope.length', 0.0, 'It hangs so far, half of it above the '
        'plane of flight, for aircraft, which leave that', 'm', 0.0, FAR)
    capture_radius: float = parameter('capture_radius', 0.2, 'The goal is caught within it',
        'm', TINY, FAR)
    finish: str = parameter('finish', 'capture',
        'Whether to end with the capture, or at max_ticks by arriving', choices=FINISHES)
    arrival_radius: float = parameter('arrival_radius', 0.05, 'At arrival the goal is within it',
        'm', TINY, FAR)
    arrival_speed: float = parameter('arrival_speed', 0.0,
        'At arrival the speed is at most this; 0 for any', 'm/s', 0.0, FAR)
    given_traffic: tuple[float, ...] = parameter('traffic', (), 'Balls, in the plane discs, that '
        'move evenly, shown on obstacles: where each is at the start, its velocity, its radius',
        'm, m/s', -FAR, FAR)
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
    max_ticks: int = parameter('max_ticks', 60, 'Steps until the flight ends', '', 1, 1_000_000)
    seed: int = parameter('seed', 0, 'Of everything random', '', 0, 2**31 - 1)
    given_command_timeout: float = parameter('command_timeout', 0.2, 'A command is in force for '
        'so long, at least 1.5 steps; and a planner is given up after so long without a sign of '
        'life', 's', 1e-3, MAX_DURATION)
    goal_path_steps: int = parameter('goal_path_steps', 0,
        'Steps of the true future to publish on goal_path; 0 for none', '', 0, 10_000)
    exit_when_done: bool = parameter('exit_when_done', False,
        'Whether to exit once the goal is caught or ticks run out')
    failsafe_fraction: float = parameter('failsafe.fraction', 0.0, 'Share of full speed or thrust '
        'while no command is in force; 0: the vehicle stops', '', 0.0, 1.0)
    failsafe_rate: float = parameter('failsafe.rate', 0.0,
        'Turn about the body z axis meanwhile, at most pi/step', 'rad/s', -1e4, 1e4)
    rate: float = parameter('rate', 0.0,
        'Lock-step at so many times real time; 0 for as fast as it goes', '', 0.0, 1e6)
    wait_subscribers: int = parameter('wait_subscribers', 1,
        'Subscribers of odom, the planner among them, that a flight waits for', '', 1, 100)
    given_wait_for: str = parameter('wait_for', '', 'Readers that a flight waits for beside '
        'planner and simulator: topics, each with a count if there are more: tick, odom 2')
    given_wait_timeout: float = parameter('wait_timeout', 120.0, 'Lock-step gives up after waiting '
        'so long for planner and readers, while the planner is configured not counted, and for an '
        'answer, for which it waits 20 s at most; 0 for never', 's', 0.0, MAX_DURATION)
    position_noise: float = parameter('faults.position_noise', 0.0,
        'Noise of odometry and goal along each axis, deviation', 'm', 0.0, 1e3)
    attitude_noise: float = parameter('faults.attitude_noise', 0.0,
        'Noise of odometry about each axis, deviation', 'rad', 0.0, math.pi)
    dropout: float = parameter('faults.dropout', 0.0,
        'Share of odometry, goals and commands that is lost', '', 0.0, 1.0)
    delay: float = parameter('faults.delay', 0.0, 'Age of odometry when it comes', 's', 0.0, 10.0)
    reorder: float = parameter('faults.reorder', 0.0,
        'Share of odometry and goals that comes a step late', '', 0.0, 1.0)
    duplicate: float = parameter('faults.duplicate', 0.0,
        'Share of odometry and goals that comes twice', '', 0.0, 1.0)
    nan: float = parameter('faults.nan', 0.0,
        'Share of odometry and goals whose position is not a number', '', 0.0, 1.0)
    occlusion_length: float = parameter('faults.occlusion_length', 0.0,
        'How long the goal is hidden in each period', 's', 0.0, 1e6)
    occlusion_period: float = parameter('faults.occlusion_period', 10.0,
        'The goal is hidden once in it, at a random time', 's', TINY, 1e6)
    clock_jump: float = parameter('faults.clock_jump', 0.0,
        'What every stamp is off from clock_jump_tick on', 's', -1e6, 1e6)
    clock_jump_tick: int = parameter('faults.clock_jump_tick', 0,
        'Steps flown before the clock jumps', '', 0, 1_000_000)
    # fmt: on

    @property
    def lockstep(self) -> bool:
        """Return whether to wait for each command instead of running in real time."""
        return self.clock != 'wall'

    @property
    def shared_clock(self) -> bool:
        """Return whether to wait for /clock as well, instead of publishing it."""
        return self.clock == 'shared'

    @property
    def command_timeout(self) -> float:
        """Return after which a command is stale, at least 1.5 steps [s]."""
        return max(self.given_command_timeout, 1.5 * self.step)

    @property
    def lease(self) -> float:
        """Return after which a planner that gives no sign of life is given up [s]."""
        return max(LIFE, SHARE * self.given_command_timeout)

    @property
    def wait_timeout(self) -> float:
        """Return how long lock-step waits for planner and readers; infinite if for ever [s]."""
        return self.given_wait_timeout or math.inf

    @cached_property
    def wait_for(self) -> dict[str, int]:
        """Return how many readers to wait for, by topic, beside planner and simulator."""
        return wanted_readers(self.given_wait_for)

    @cached_property
    def faults(self) -> Faults:
        """Return what goes wrong between the vehicle and its planner."""
        return Faults(**{each.name: getattr(self, each.name) for each in fields(Faults)})

    @property
    def begin(self) -> float:
        """Return the time at which a flight begins [s]: no stamp is ever negative."""
        return max(0.0, self.delay, -self.clock_jump)

    @cached_property
    def rope(self) -> Rope:
        """Return the goal."""
        return Rope(
            self._along('rope.center', self.rope_center),
            self._along('rope.amplitude', self.rope_amplitude),
            self.rope_frequency,
            self._along('rope.phase', self.rope_phase),
            self._along('rope.velocity', self.rope_velocity),
        )

    @cached_property
    def model(self) -> Model:
        """Return how the simulated vehicle moves: the discrete model, a plant, or an engine."""
        self._refuse_unused()
        known = self.disturbance.tolist()
        discrete = Model(
            self.dimension,
            self.rotation_order,
            self.translation_order,
            self.step,
            self.forward,
            self.mass,
            self.failsafe_fraction,
            self.failsafe_rate,
            disturbance=tuple(known) if any(known) else (),
            discretisation=self.discretisation,
            velocity_source=self.velocity_source,
        )
        if self.vehicle == 'discrete':
            return discrete
        common = vars(discrete) | {'stall_speed': self.stall_speed}
        if self.odom_rate:
            common['step'] = 1.0 / self.odom_rate
        if self.vehicle in ENGINES:
            common |= {'turbulence': self.gust, 'seed': self.seed, 'rope': self.rope}
            return EnginePlant(**common, engine=self.vehicle)
        own = ('speed_lag', 'rate_lag', 'max_rate', 'max_acceleration', 'gain', 'drag')
        gusts = Gusts(self.gust, self.gust_time, self.seed)
        return Plant(**common, **{name: getattr(self, name) for name in own}, gusts=gusts)

    @cached_property
    def start(self) -> Vehicle:
        """Return the vehicle at its start."""
        body_rate = vector(self.start_body_rate, 'start.body_rate', 3)
        return launched(
            self.model,
            self._along('start.position', self.start_position),
            self.frames.turned(_orientation(self.start_orientation, self.dimension)),
            fraction=self.start_fraction,
            velocity=self._along('start.velocity', self.start_velocity),
            body_rate=self.frames.turned(body_rate)[-self.model.rates :],
        )

    @cached_property
    def scenario(self) -> Scenario:
        """Return what to simulate."""
        ending = ('capture_radius', 'max_ticks', 'finish', 'arrival_radius', 'arrival_speed')
        return Scenario(
            self.model,
            self.start,
            self.rope,
            **{name: getattr(self, name) for name in ending},
            obstacles=self.boxes,
            traffic=self._traffic(),
            approach=self._approach(),
            rope_length=self.rope_length,
        )

    def _along(self, name: str, numbers: tuple[float, ...]) -> Array:
        return vector(numbers, name, self.dimension)

    def _refuse_unused(self) -> None:
        """Refuse what the vehicle does not have, and what its engine decides itself."""
        kind, own = self.vehicle, {each.metadata['parameter'].name: each for each in fields(self)}
        kept: Collection[str] = CONTINUOUS if kind == 'continuous' else ()
        if kind in ENGINES:
            kept = OF_ENGINES[ENGINES[kind].translation_order]
        for name in CONTINUOUS:
            value, default = getattr(self, own[name].name), own[name].default
            if name not in kept and value != default:
                raise BadInput(name, value, f'{default} with vehicle: {kind}')
        for name in OF_GOAL if kind in ENGINES and ENGINES[kind].moves_goal else ():
            value = getattr(self, own[name].name)
            if np.any(value):
                shown = list(value) if isinstance(value, tuple) else value
                raise BadInput(name, shown, f'0 with vehicle: {kind}')

    def _traffic(self) -> tuple[MovingObstacle, ...]:
        numbers, n = self.given_traffic, self.dimension
        if len(numbers) % (2 * n + 1):
            raise BadInput('traffic', list(numbers), f'{2 * n + 1} numbers for each ball')
        rows = np.array(numbers, dtype=float).reshape(-1, 2 * n + 1)
        for row in rows:
            number(float(row[-1]), 'traffic radius', 0.0, above=True)
        return tuple(
            MovingObstacle.drifting(Ball(row[:n], float(row[-1])), row[n:-1]) for row in rows
        )

    def _approach(self) -> Approach:
        """Return the cone in which a catch counts; the goal's orientation is that of the world."""
        known = self.approach_of_a_catch()
        if not known.is_the_goals:
            return known
        own = self.frames.turned(np.eye(3))[: self.dimension, 0]
        return replace(known, direction=tuple(own.tolist()))


SIM = tuple(replace(spec, live=False) for spec in specs_of(SimSettings))


def sim_settings(values: Values) -> SimSettings:
    """Return the settings of a full set of simulator parameters.

    Raises:
        BadInput: a value, or a combination, is not allowed.
    """
    settings = settings_from(SimSettings, values)
    for made in ('scenario', 'faults', 'wait_for'):
        getattr(settings, made)  # raises
    return settings


def _orientation(numbers: tuple[float, ...], dimension: int) -> Array:
    x, y, z, w = numbers if len(numbers) == 4 else [math.nan] * 4
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    if not abs(norm - 1.0) <= QUATERNION_TOLERANCE:
        raise BadInput('start.orientation', list(numbers), 'a unit quaternion x, y, z, w')
    return from_quaternion(np.array([w, x, y, z]) / norm, dimension)
