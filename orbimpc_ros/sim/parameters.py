# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The simulator's parameters, in one table, and the settings that they add up to."""

from __future__ import annotations

import math
from array import array
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from orbimpc_ros.mpc.arrays import ABOVE_ZERO, Array, number
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import from_quaternion
from orbimpc_ros.mpc.problem import Approach, Hazard
from orbimpc_ros.ros.messages import QUATERNION_TOLERANCE, Frames
from orbimpc_ros.ros.parameters.spec import (
    FAR,
    MAX_DURATION,
    TINY,
    Value,
    Values,
    settings_from,
    specs_of,
    vector,
)
from orbimpc_ros.ros.parameters.spec import ParameterSpec as Row
from orbimpc_ros.ros.parameters.vehicle import VehicleParameters
from orbimpc_ros.ros.process import LIFE
from orbimpc_ros.sim.contact import drifter
from orbimpc_ros.sim.engine_vehicle import ENGINES, EnginePlant
from orbimpc_ros.sim.faults import FAULT_RANGES, NO_FAULTS, Faults
from orbimpc_ros.sim.gusts import GUST_RANGES, Gusts
from orbimpc_ros.sim.plant import PLANT_RANGES, Plant
from orbimpc_ros.sim.readers import wanted_readers
from orbimpc_ros.sim.rope import FASTEST, Rope
from orbimpc_ros.sim.scenario import FINISHES, LIMITS, Scenario, retrieval
from orbimpc_ros.sim.vehicle import Model, launched

SHARE = 0.75  # of command_timeout without a sign of life; the rest is for telling


def _triple(vector: Array) -> tuple[float, ...]:
    return tuple([*vector.tolist(), 0.0][:3])


def _closed(low: float, high: float) -> tuple[float, float]:
    """Return a range as parameters have it: closed, so that a small number stands for zero."""
    return (TINY if low == ABOVE_ZERO else low), high


FLOWN = retrieval()  # its numbers are the defaults

VEHICLES = ('discrete', 'continuous', *ENGINES)
# What of a plant a vehicle in an engine has, too, by its order of translation.
OF_ENGINES = {1: ('gust', 'stall_speed', 'odom_rate'), 2: ('odom_rate',)}
OF_GOAL = ('goal_path_steps', 'rope.frequency', 'rope.velocity')  # unknown where an engine moves it
IDEAL = Plant()  # its numbers are the defaults


def _row(name: str, attribute: str, description: str, unit: str) -> Row:
    low, high = _closed(*PLANT_RANGES[attribute])
    return Row(name, getattr(IDEAL, attribute), description, unit, low, high)


def _gust_row(name: str, attribute: str, description: str, unit: str) -> Row:
    low, high = _closed(*GUST_RANGES[attribute])
    return Row(name, getattr(IDEAL.gusts, attribute), description, unit, low, high)


COMMON = (  # of the planner, too: with a discrete vehicle they are the planner's alone
    _row('max_rate', 'max_rate', 'The vehicle turns no faster; 0 for no limit', 'rad/s'),
    _row('max_acceleration', 'max_acceleration',
        'The speed changes no faster (translation order 1); 0 for no limit', 'm/s^2'),
)  # fmt: skip

CONTINUOUS = (  # where one has no meaning it is refused
    _row('response.speed', 'speed_lag', 'Lag of speed or thrust, first order', 's'),
    _row('response.rate', 'rate_lag', 'Lag of the body rate, first order', 's'),
    _gust_row('gust', 'deviation', 'Standard deviation of gusts along each axis, on top of wind',
        'm/s or m/s^2'),
    _gust_row('gust_time', 'memory', 'Correlation time of gusts', 's'),
    _row('drag', 'drag', 'Deceleration by the own velocity (translation order 2)', '1/s'),
    _row('gain', 'gain', 'Speed or thrust that is reached, a share of what is commanded', ''),
    _row('stall_speed', 'stall_speed', 'Airspeed below which a vehicle is counted as stalled on '
        'the topic truth; it flies on', 'm/s'),
    Row('odom_rate', 0.0, 'Odometry, goals and ticks of the simulator in a second of its time; '
        '0 for one in each step', 'Hz', 0.0, 1e3),
)  # fmt: skip

PLANT = (
    Row('vehicle', VEHICLES[0], 'Whether the vehicle moves in the steps that the planner '
        'believes in, or in continuous time, with lags and limits, in wind, or in an engine: '
        'cessna is that of JSBSim, hummingbird that of RotorPy in MuJoCo, servicer a spacecraft in '
        'Basilisk', choices=VEHICLES),
    *COMMON,
    *CONTINUOUS,
)  # fmt: skip

ROPE = (
    Row('rope.center', _triple(FLOWN.rope.center), 'Middle of the swing: x, y, z',
        'm', -FAR, FAR),
    Row('rope.amplitude', _triple(FLOWN.rope.amplitude), 'Reach of the swing: x, y, z',
        'm', -FAR, FAR),
    Row('rope.frequency', FLOWN.rope.frequency, 'Swings in a second', 'Hz', 0.0, FASTEST),
    Row('rope.phase', _triple(FLOWN.rope.phase), 'Phase at the start: x, y, z',
        'rad', -100.0, 100.0),
    Row('rope.velocity', _triple(FLOWN.rope.velocity), 'Drift of the middle: x, y, z',
        'm/s', -1e3, 1e3),
    Row('rope.length', 0.0, 'It hangs so far, half of it above the plane of flight, for '
        'aircraft, which leave that', 'm', *LIMITS['rope_length']),
)  # fmt: skip

ENDING = (
    Row('capture_radius', FLOWN.capture_radius, 'The goal is caught within it',
        'm', *_closed(*LIMITS['capture_radius'])),
    Row('finish', FLOWN.finish, 'Whether to end with the capture, or at max_ticks by arriving',
        choices=FINISHES),
    Row('arrival_radius', FLOWN.arrival_radius, 'At arrival the goal is within it',
        'm', *_closed(*LIMITS['arrival_radius'])),
    Row('arrival_speed', FLOWN.arrival_speed, 'At arrival the speed is at most this; 0 for any',
        'm/s', *LIMITS['arrival_speed']),
    Row('traffic', (), 'Balls, in the plane discs, that move evenly, shown on obstacles: where '
        'each is at the start, its velocity, its radius', 'm, m/s', -FAR, FAR),
)  # fmt: skip

START = (
    Row('start.position', (0.0, 0.0, 0.0), 'Where the vehicle starts: x, y, z',
        'm', -FAR, FAR),
    Row('start.orientation', (0.0, 0.0, 0.0, 1.0), 'Unit quaternion x, y, z, w at the start',
        '', -1.0, 1.0),
    Row('start.speed_fraction', FLOWN.start.fraction, 'Share of speed or thrust at the start',
        '', 0.0, 1.0),
    Row('start.velocity', (0.0, 0.0, 0.0), 'World velocity at the start (translation order 2)',
        'm/s', -1e6, 1e6),
    Row('start.body_rate', (0.0, 0.0, 0.0), 'Rates about the body axes at the start',
        'rad/s', -1e3, 1e3),
)  # fmt: skip

CONDUCT = (
    Row('max_ticks', FLOWN.max_ticks, 'Steps until the flight ends',
        '', *LIMITS['max_ticks']),
    Row('seed', 0, 'Of everything random', low=0, high=2**31 - 1),
    Row('command_timeout', 0.2, 'A command is in force for so long, at least 1.5 steps; and '
        'a planner is given up after so long without a sign of life', 's', 1e-3, MAX_DURATION),
    Row('goal_path_steps', 0, 'Steps of the true future to publish on goal_path; 0 for none',
        low=0, high=10_000),
    Row('exit_when_done', False, 'Whether to exit once the goal is caught or ticks run out'),
    Row('failsafe.fraction', 0.0, 'Share of full speed or thrust while no command is in force; '
        '0: the vehicle stops', '', 0.0, 1.0),
    Row('failsafe.rate', 0.0, 'Turn about the body z axis meanwhile, at most pi/step',
        'rad/s', -1e4, 1e4),
    Row('rate', 0.0, 'Lock-step at so many times real time; 0 for as fast as it goes',
        '', 0.0, 1e6),
    Row('wait_subscribers', 1, 'Subscribers of odom, the planner among them, that a flight '
        'waits for', low=1, high=100),
    Row('wait_for', '', 'Readers that a flight waits for beside planner and simulator: '
        'topics, each with a count if there are more: tick, odom 2'),
    Row('wait_timeout', 120.0, 'Lock-step gives up after waiting so long for planner and '
        'readers, while the planner is configured not counted, and for an answer, for which it '
        'waits 20 s at most; 0 for never',
        's', 0.0, MAX_DURATION),
)  # fmt: skip


def _fault(name: str, description: str, unit: str = '') -> Row:
    low, high = _closed(*FAULT_RANGES[name])
    return Row(f'faults.{name}', getattr(NO_FAULTS, name), description, unit, low, high)


FAULTS = (
    _fault('position_noise', 'Noise of odometry and goal along each axis, deviation', 'm'),
    _fault('attitude_noise', 'Noise of odometry about each axis, deviation', 'rad'),
    _fault('dropout', 'Share of odometry, goals and commands that is lost'),
    _fault('delay', 'Age of odometry when it comes', 's'),
    _fault('reorder', 'Share of odometry and goals that comes a step late'),
    _fault('duplicate', 'Share of odometry and goals that comes twice'),
    _fault('nan', 'Share of odometry and goals whose position is not a number'),
    _fault('occlusion_length', 'How long the goal is hidden in each period', 's'),
    _fault('occlusion_period', 'The goal is hidden once in it, at a random time', 's'),
    _fault('clock_jump', 'What every stamp is off from clock_jump_tick on', 's'),
    _fault('clock_jump_tick', 'Steps flown before the clock jumps'),
)

SIM: tuple[Row, ...] = (
    *(replace(row, live=False) for row in specs_of(VehicleParameters)),
    *PLANT,
    Row('clock', 'lockstep', 'lockstep waits for each command, shared also for the /clock that the '
        'vehicles of a fleet have in common; wall runs in real time',
        choices=('lockstep', 'shared', 'wall')),
    *ROPE,
    *ENDING,
    *START,
    *CONDUCT,
    *FAULTS,
)  # fmt: skip


@dataclass(frozen=True)
class SimSettings:
    """All that the simulator's parameters say.

    Attributes:
        scenario: what to simulate.
        lockstep: whether to wait for each command instead of running in real time.
        shared_clock: whether to wait for /clock besides, instead of publishing it.
        command_timeout: after which a command is stale, at least 1.5 steps [s].
        lease: after which a planner that gives no sign of life is given up [s].
        faults: what goes wrong between the vehicle and its planner.
        goal_path_steps: how much of the goal's future to publish.
        exit_when_done: whether to exit at the end.
        rate: of lock-step, in times of real time; 0 for as fast as it goes.
        wait_subscribers: subscribers of odometry to wait for.
        wait_for: readers to wait for, by topic, beside those of planner and simulator.
        wait_timeout: for all of them, in lock-step; infinite if it waits for ever [s].
        seed: of everything random.
        frames: to publish in.
    """

    scenario: Scenario
    lockstep: bool
    shared_clock: bool
    command_timeout: float
    lease: float
    faults: Faults
    goal_path_steps: int
    exit_when_done: bool
    rate: float
    wait_subscribers: int
    wait_for: Mapping[str, int]
    wait_timeout: float
    seed: int
    frames: Frames

    @property
    def begin(self) -> float:
        """Return the time at which a flight begins [s]: no stamp is ever negative."""
        return max(0.0, self.faults.delay, -self.faults.clock_jump)


def sim_settings(values: Values) -> SimSettings:
    """Return the settings of a full set of simulator parameters.

    Raises:
        BadInput: a value, or a combination, is not allowed.
    """
    for row in SIM:
        row.check(values[row.name])
    return SimSettings(
        scenario=_scenario(values),
        lockstep=values['clock'] != 'wall',
        shared_clock=values['clock'] == 'shared',
        command_timeout=max(values['command_timeout'], 1.5 * values['step']),
        lease=max(LIFE, SHARE * values['command_timeout']),
        faults=_faults(values),
        goal_path_steps=values['goal_path_steps'],
        exit_when_done=values['exit_when_done'],
        rate=values['rate'],
        wait_subscribers=values['wait_subscribers'],
        wait_for=wanted_readers(values['wait_for']),
        wait_timeout=values['wait_timeout'] or math.inf,
        seed=values['seed'],
        frames=settings_from(VehicleParameters, values).message_frames(),
    )


def _faults(values: Values) -> Faults:
    return Faults(**{name: values[f'faults.{name}'] for name in FAULT_RANGES})


def _scenario(values: Values) -> Scenario:
    vehicle = settings_from(VehicleParameters, values)
    n, known = vehicle.dimension, vehicle.known_disturbance().tolist()

    def of(name: str, size: int = n) -> Array:
        return vector(values[name], name, size)

    steps = Model(
        n,
        values['rotation_order'],
        values['translation_order'],
        values['step'],
        values['forward'],
        values['mass'],
        values['failsafe.fraction'],
        values['failsafe.rate'],
        disturbance=tuple(known) if any(known) else (),
        discretisation=values['discretisation'],
        source=values['velocity_source'],
    )
    rope = Rope(
        of('rope.center'),
        of('rope.amplitude'),
        values['rope.frequency'],
        of('rope.phase'),
        of('rope.velocity'),
    )
    model = _moved_by(values, steps, rope)
    frames = vehicle.message_frames()
    start = launched(
        model,
        of('start.position'),
        frames.turned(_orientation(values['start.orientation'], n)),
        fraction=values['start.speed_fraction'],
        velocity=of('start.velocity'),
        body_rate=frames.turned(of('start.body_rate', 3))[-model.rates :],
    )
    ending = ('capture_radius', 'max_ticks', 'finish', 'arrival_radius', 'arrival_speed')
    known_ends = {name: values[name] for name in ending}
    return Scenario(
        model,
        start,
        rope,
        **known_ends,
        obstacles=vehicle.boxes(),
        traffic=_traffic(values),
        approach=_approach(vehicle),
        rope_length=values['rope.length'],
    )


def _moved_by(values: Values, model: Model, rope: Rope) -> Model:
    """Return how the simulated vehicle moves: the discrete model, a plant, or an engine.

    Args:
        values: a full set of the simulator's parameters.
        model: the discrete one, with the orders, speed, mass, failsafe and wind of a plant, too.
        rope: the goal, which some engines move themselves.

    Raises:
        BadInput: a value, or a combination, is not allowed.
    """
    kind = values['vehicle']
    _refuse_unused(values, _kept_by(kind))
    if kind == 'discrete':
        return model
    common = {each.name: getattr(model, each.name) for each in fields(Model)}
    if values['odom_rate']:
        common['step'] = 1.0 / values['odom_rate']
    common['stall_speed'] = values['stall_speed']
    if kind in ENGINES:
        _refuse_goals_of(values, kind)
        chance = {'turbulence': values['gust'], 'seed': values['seed']}
        return EnginePlant(**common, engine=kind, **chance, rope=rope)
    return Plant(
        **common,
        speed_lag=values['response.speed'],
        rate_lag=values['response.rate'],
        max_rate=values['max_rate'],
        max_acceleration=values['max_acceleration'],
        gain=values['gain'],
        drag=values['drag'],
        gusts=Gusts(values['gust'], values['gust_time'], values['seed']),
    )


def _kept_by(kind: str) -> Collection[str]:
    """Return what of a plant a kind of vehicle has."""
    if kind in ENGINES:
        return OF_ENGINES[ENGINES[kind].translation_order]
    return [row.name for row in CONTINUOUS] if kind == 'continuous' else ()


def _refuse_unused(values: Values, kept: Collection[str]) -> None:
    """Refuse what a vehicle does not have, beside what is kept: it would have no effect."""
    for row in CONTINUOUS:
        if row.name not in kept and not np.array_equal(values[row.name], row.default):
            allowed = f'{_shown(row.default)} with vehicle: {values["vehicle"]}'
            raise BadInput(row.name, _shown(values[row.name]), allowed)


def _refuse_goals_of(values: Values, kind: str) -> None:
    """Refuse what says how a goal moves that the engine of a vehicle moves itself."""
    for name in OF_GOAL if ENGINES[kind].moves_goal else ():
        if np.any(values[name]):
            raise BadInput(name, _shown(values[name]), f'0 with vehicle: {kind}')


def _shown(value: Value) -> object:
    return list(value) if isinstance(value, (tuple, array)) else value


def _traffic(values: Values) -> tuple[Hazard, ...]:
    numbers, n = values['traffic'], values['dimension']
    if len(numbers) % (2 * n + 1):
        raise BadInput('traffic', list(numbers), f'{2 * n + 1} numbers for each ball')
    rows = np.array(numbers, dtype=float).reshape(-1, 2 * n + 1)
    for row in rows:
        number(float(row[-1]), 'traffic radius', 0.0, above=True)
    return tuple(drifter(row[:n], row[n:-1], float(row[-1])) for row in rows)


def _approach(vehicle: VehicleParameters) -> Approach:
    """Return the cone in which a catch counts; the goal's orientation is that of the world."""
    known = vehicle.approach_of_a_catch()
    if not known.is_the_goals:
        return known
    own = vehicle.message_frames().turned(np.eye(3))[: vehicle.dimension, 0]
    return replace(known, direction=tuple(own.tolist()))


def _orientation(numbers: Sequence[float], dimension: int) -> Array:
    x, y, z, w = numbers if len(numbers) == 4 else [math.nan] * 4
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    if not abs(norm - 1.0) <= QUATERNION_TOLERANCE:
        raise BadInput('start.orientation', list(numbers), 'a unit quaternion x, y, z, w')
    return from_quaternion(np.array([w, x, y, z]) / norm, dimension)
