# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Engines of any kind: how a new one is added, one that is missing, and one that fails."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from dying_engine import FAILURES, Straight

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.sim import engine_vehicle as engines
from orbimpc_ros.sim.engine_vehicle import EnginePlant, Kind, class_of
from orbimpc_ros.sim.engines import EngineFailure
from orbimpc_ros.sim.vehicle import launched
from orbimpc_ros.sim.world import Scenario, departure, fixed

BLAME = {
    'Straight': 'broken: went from t = 2.000 s to 2.000 s',
    'Slow': 'broken: its clock is at 2.500 s, and not at 3.000 s',
    'Reset': 'broken: went from t = 2.000 s to 1.000 s',
    'Poisoned': 'broken: numbers that are not finite, after t = 2.000 s',
    'Stopping': 'broken: stopped at t = 2.000 s',
}


def flight_of(engine='cessna'):
    model = EnginePlant(forward=50.0, engine=engine)
    start = launched(model, np.zeros(2), np.eye(2), fraction=0.9)
    return departure(Scenario(model, start, fixed([1e5, 0.0]), 5.0, 1000))


def test_a_new_engine_is_a_module_and_a_line(monkeypatch):
    monkeypatch.setitem(engines.ENGINES, 'glider', Kind((), 'Glider', 2, 1))
    module = SimpleNamespace(Glider=Straight)
    monkeypatch.setitem(sys.modules, 'orbimpc_ros.sim.engines.glider', module)
    vehicle = flight_of('glider').after(0.9, np.zeros(1)).vehicle
    np.testing.assert_allclose(vehicle.position, [45.0, 0.0])
    assert vehicle.airspeed == pytest.approx(45.0)


@pytest.mark.parametrize('failure', FAILURES)
def test_an_engine_that_fails_is_named(monkeypatch, failure):
    monkeypatch.setattr(engines, 'class_of', lambda _name: FAILURES[failure])
    flight = flight_of()
    for _ in range(2):
        flight = flight.after(0.9, np.zeros(1))
    with pytest.raises(EngineFailure) as raised:
        flight.after(0.9, np.zeros(1))
    assert str(raised.value) == BLAME[failure]


@pytest.mark.parametrize(
    ('name', 'module', 'hint'),
    [
        ('cessna', 'jsbsim', r"jsbsim is missing; .*pip install 'jsbsim>="),
        ('hummingbird', 'mujoco', 'mujoco is missing; .*pip install'),
        ('hummingbird', 'rotorpy.vehicles.multirotor', 'rotorpy is missing; .*pip install'),
        ('servicer', 'Basilisk.architecture', r"Basilisk is missing; .*pip install 'bsk>=2.12'"),
    ],
)
def test_the_library_of_an_engine_that_is_missing_is_named(monkeypatch, name, module, hint):
    if module.startswith('rotorpy'):
        pytest.importorskip('mujoco')
    monkeypatch.delitem(sys.modules, f'orbimpc_ros.sim.engines.{name}', raising=False)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(BadInput, match=f'vehicle {name}: {hint}'):
        class_of(name)


@pytest.mark.parametrize(('name', 'value'), [('dimension', 3), ('translation_order', 2)])
def test_an_engine_flies_in_its_own_dimension_and_order(name, value):
    with pytest.raises(BadInput, match=f'{name} is {value}; allowed: [12] with vehicle: cessna'):
        EnginePlant(**{name: value})
