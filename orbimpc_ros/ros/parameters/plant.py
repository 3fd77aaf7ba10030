# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The parameters of a simulated vehicle in continuous time, in one table."""

from __future__ import annotations

from array import array
from collections.abc import Collection
from dataclasses import fields

import numpy as np

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.parameters.parameter import Row, Value, Values, span
from orbimpc_ros.sim.engine_vehicle import ENGINES, EnginePlant
from orbimpc_ros.sim.gusts import GUST_RANGES, Gusts
from orbimpc_ros.sim.plant import PLANT_RANGES, Plant
from orbimpc_ros.sim.rope import Rope
from orbimpc_ros.sim.vehicle import Model

VEHICLES = ('discrete', 'continuous', *ENGINES)
# What of a plant a vehicle in an engine has, too, by its order of translation.
OF_ENGINES = {1: ('gust', 'stall_speed', 'odom_rate'), 2: ('odom_rate',)}
OF_GOAL = ('goal_path_steps', 'rope.frequency', 'rope.velocity')  # unknown where an engine moves it
IDEAL = Plant()  # its numbers are the defaults
FASTEST = 1e3  # [Hz]


def _row(name: str, attribute: str, description: str, unit: str) -> Row:
    low, high = span(*PLANT_RANGES[attribute])
    return Row(name, getattr(IDEAL, attribute), description, unit, low, high)


def _gust_row(name: str, attribute: str, description: str, unit: str) -> Row:
    low, high = span(*GUST_RANGES[attribute])
    return Row(name, getattr(IDEAL.gusts, attribute), description, unit, low, high)


LIMITS = (  # of the planner, too: with a discrete vehicle they are the planner's alone
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
        '0 for one in each step', 'Hz', 0.0, FASTEST),
)  # fmt: skip

PLANT = (
    Row('vehicle', VEHICLES[0], 'Whether the vehicle moves in the steps that the planner '
        'believes in, or in continuous time, with lags and limits, in wind, or in an engine: '
        'cessna is that of JSBSim, hummingbird that of RotorPy in MuJoCo, servicer a spacecraft in '
        'Basilisk', choices=VEHICLES),
    *LIMITS,
    *CONTINUOUS,
)  # fmt: skip


def moved_by(values: Values, model: Model, rope: Rope) -> Model:
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
