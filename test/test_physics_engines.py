# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Vehicles in engines behind the simulator: commands, air, goals, limits, seeds, failures."""

import math
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from dying_engine import FAILURES, Straight
from scipy.integrate import solve_ivp

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import exp, log
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.ros import messages
from orbimpc_ros.sim import vehicle as engines
from orbimpc_ros.sim.engines import EngineFailure
from orbimpc_ros.sim.parameters import SimSettings
from orbimpc_ros.sim.vehicle import class_of
from orbimpc_ros.sim.world import departure, outcome
from orbimpc_ros.tool import offline
from orbimpc_ros.tool.study import draws_of

BASILISK = "Basilisk is not installed: pip install 'orbimpc_ros[basilisk]' runs this"


@pytest.fixture
def cessna():
    return pytest.importorskip('orbimpc_ros.sim.engines.cessna')


@pytest.fixture
def hummingbird():
    pytest.importorskip('mujoco')
    return pytest.importorskip('orbimpc_ros.sim.engines.hummingbird')


@pytest.fixture
def servicer():
    return pytest.importorskip('orbimpc_ros.sim.engines.servicer', reason=BASILISK)


WIND, STILL, AFAR = np.array([-4.0, 6.0]), np.zeros(2), np.array([1e5, 0.0])


def begun(attitude, goal, **own):
    """Return a flight at its start at the origin."""
    turned = messages.quaternion(attitude)
    at = {'start_orientation': (turned.x, turned.y, turned.z, turned.w), 'rope_center': tuple(goal)}
    return departure(SimSettings(**at, max_ticks=1000, **own))


def aircraft(heading=0.0, wind=WIND, goal=AFAR, **others):
    own = {'vehicle': 'cessna', 'forward': 50.0, 'start_fraction': 0.9, 'wind': tuple(wind)}
    own |= {'rope_amplitude': (0.0, 0.0), 'rope_length': 40.0, 'capture_radius': 5.0}
    return begun(exp(np.array([heading])), goal, **own | others)


def flown(flight, seconds, fraction=None, turn=0.0):
    """Return the flights after each step, by default at the initial speed."""
    found, model = [flight], flight.settings.model
    fraction = flight.settings.start_fraction if fraction is None else fraction
    for _ in range(round(seconds / model.step)):
        found.append(found[-1].after(fraction, np.resize(turn, model.rates)))
    return found


# --- engines of any kind

BLAME = {
    'Poisoned': 'broken: numbers that are not finite at t = 3.000 s',
    'Stopping': 'broken: stopped at t = 2.000 s',
}


def test_a_new_engine_is_a_module_and_a_line(monkeypatch):
    monkeypatch.setitem(engines.ENGINES, 'glider', 'physics')
    module = SimpleNamespace(Glider=Straight)
    monkeypatch.setitem(sys.modules, 'orbimpc_ros.sim.engines.glider', module)
    vehicle = aircraft(wind=STILL, vehicle='glider').after(0.9, np.zeros(1)).vehicle
    np.testing.assert_allclose(vehicle.position, [45.0, 0.0])
    assert vehicle.airspeed == pytest.approx(45.0)


@pytest.mark.parametrize('failure', FAILURES)
def test_an_engine_that_fails_is_named(monkeypatch, failure):
    monkeypatch.setattr(engines, 'class_of', lambda _name: FAILURES[failure])
    with pytest.raises(EngineFailure) as raised:
        flown(aircraft(wind=STILL), 3.0)
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


# --- the Cessna of JSBSim


@pytest.mark.parametrize('heading', [0.4, 2.5, -1.9])
def test_it_starts_in_level_flight_through_air_that_moves(cessna, heading):
    vehicle = aircraft(heading).vehicle
    axis = exp(np.array([heading]))[:, 0]
    np.testing.assert_allclose(vehicle.wind, WIND, atol=1e-6)
    np.testing.assert_allclose(vehicle.velocity - WIND, 45.0 * axis, atol=0.1)
    np.testing.assert_allclose(vehicle.attitude[:, 0], axis, atol=1e-3)
    assert vehicle.airspeed == pytest.approx(45.0, abs=0.01)


@pytest.mark.parametrize('turn', [0.06, -0.06])
def test_it_turns_as_it_is_told_within_its_bank(cessna, turn):
    flights = flown(aircraft(wind=STILL), 30, turn=turn)
    late = flights[10:]
    yaws = np.unwrap([math.atan2(*f.vehicle.attitude[::-1, 0]) for f in late])
    assert np.diff(yaws).mean() == pytest.approx(turn, rel=0.1)
    assert late[-1].vehicle.body_rate[0] == pytest.approx(turn, rel=0.1)
    banks = [v.facts['bank'] for f in flights[1:] for v in f.trail]
    assert math.copysign(1.0, banks[-1]) == math.copysign(1.0, turn)
    assert max(map(abs, banks)) < math.radians(30.0)


def test_a_point_is_missed_by_height_and_a_line_is_not(cessna):
    flights = flown(aircraft(wind=STILL, goal=np.array([200.0, 0.0])), 6)
    best = min(flights, key=lambda each: each.miss)
    height = abs(best.vehicle.height)
    assert best.captured
    assert best.miss < 2.0 < height
    point = replace(best.settings, rope_length=0.0)
    again = departure(point)
    assert min(f.miss for f in flown(again, 6)) == pytest.approx(height, abs=1.0)


def test_a_start_that_cannot_be_flown_is_refused(cessna):
    with pytest.raises(BadInput, match=r'vehicle is cessna; .*no level flight'):
        aircraft(start_fraction=0.2)


# --- the Hummingbird in MuJoCo

FAR = np.array([50.0, 0.0])


def multirotor(rest=FAR, aside=STILL, wind=STILL, **others):
    own = {'vehicle': 'hummingbird', 'forward': 2.0, 'step': 0.1, 'start_fraction': 0.0}
    own |= {'rope_amplitude': tuple(aside), 'rope_phase': (0.5 * math.pi, 0.5 * math.pi)}
    return begun(np.eye(2), rest, **own, wind=tuple(wind), capture_radius=0.15, **others)


def test_it_hovers_where_it_starts_in_wind(hummingbird):
    flights = flown(multirotor(wind=[0.0, 2.0]), 2.0)
    vehicle = flights[-1].vehicle
    assert np.hypot(*vehicle.position) < 0.3  # the controller has no integral term
    assert np.hypot(*vehicle.velocity) < 0.1
    assert abs(vehicle.height) < 0.1
    assert vehicle.wind.tolist() == [0.0, 2.0]
    assert vehicle.facts['bank'] > 0.02  # it leans against the wind


@pytest.mark.parametrize('turn', [0.5, -0.5])
def test_it_flies_as_fast_and_turns_as_it_is_told(hummingbird, turn):
    vehicle = flown(multirotor(), 3.0, 0.75, turn)[-1].vehicle
    assert vehicle.fraction * 2.0 == pytest.approx(1.5, abs=0.1)
    assert vehicle.body_rate[0] == pytest.approx(turn, abs=0.05)
    assert math.atan2(*vehicle.attitude[::-1, 0]) == pytest.approx(3.0 * turn, abs=0.15)
    assert vehicle.facts['off'] < 0.15


def test_the_rope_is_let_go_aside_and_swings(hummingbird):
    flights = flown(multirotor([6.0, 1.0], [0.3, 0.6]), 1.5)
    goals = np.array([each.goal for each in flights]) - [6.0, 1.0]
    np.testing.assert_allclose(goals[0], [0.3, 0.6], atol=1e-6)
    assert goals[:, 1].min() < -0.4  # half a swing later it is on the other side


def test_a_rope_that_the_hook_touches_is_caught(hummingbird):
    flights = flown(multirotor([1.0, 0.1]), 1.4, 1.0)
    caught = next(each for each in flights if each.captured)
    assert caught.miss == pytest.approx(0.1, abs=0.06)  # distance from the middle of a bar of 0.3 m
    assert caught.over
    assert caught.missed_at < 1.5
    assert flights[0].captured is False


@pytest.mark.parametrize(('aside', 'is_lost'), [(0.22, True), (0.6, False)])
def test_a_rope_that_something_else_touches_or_that_is_passed_is_not_caught(
    hummingbird, aside, is_lost
):
    flights = flown(multirotor([1.0, aside]), 1.4, 1.0)
    assert not any(each.captured for each in flights)
    lost = [each for each in flights if each.vehicle.lost]
    assert bool(lost) == is_lost
    for each in lost[:1]:
        assert each.over
        assert outcome(each).startswith('not captured: another part of the vehicle')


def test_a_motion_that_mujoco_gives_up_is_a_failure(hummingbird):
    flight = flown(multirotor(), 0.2)[-1]
    flight.vehicle.engine._data.qvel[-1] = 1e12
    with pytest.raises(EngineFailure, match=r'mujoco: unstable after t = 0.200 s'):
        flight.after(0.0, np.zeros(1))


def test_a_rope_that_would_be_let_go_too_high_is_refused(hummingbird):
    with pytest.raises(BadInput, match=r'vehicle is hummingbird; .*at most 1.2 m from rest'):
        multirotor(aside=[1.0, 1.0])


# --- the servicer in Basilisk

REST, AWAY = np.zeros(3), np.array([30.0, -20.0, 10.0])
TURNED = exp(np.array([0.4, -0.7, 1.1]))
FULL = 0.015  # [m/s^2]


def spacecraft(goal=AWAY, velocity=REST, rate=REST, push=REST, **others):
    own = {'vehicle': 'servicer', 'dimension': 3, 'translation_order': 2, 'step': 5.0}
    own |= {'forward': FULL, 'mass': 60.0, 'wind': tuple(push), 'rope_amplitude': (0.0, 0.0, 0.0)}
    own |= {'start_velocity': tuple(velocity), 'start_body_rate': tuple(rate)}
    return begun(TURNED, goal, **own, start_fraction=0.0, finish='arrival', **others)


def falling(_time, state):
    """Return the derivative of a point's position and velocity in the Earth's gravity."""
    return np.append(state[3:], -3.986004418e14 * state[:3] / np.linalg.norm(state[:3]) ** 3)


def test_the_earth_pulls_it_and_its_client_differently(servicer, monkeypatch):
    monkeypatch.setattr(servicer, 'OFF_CENTER', 0.0)
    client = np.array([6.878e6, 0.0, 0.0, 0.0, math.sqrt(3.986004418e14 / 6.878e6), 0.0])
    ends = [
        solve_ivp(falling, (0.0, 300.0), state, method='DOP853', rtol=1e-13, atol=1e-7).y[:3, -1]
        for state in (client, client - np.append(AWAY, REST))
    ]
    drifted = flown(spacecraft(), 300.0)[-1].vehicle.position
    np.testing.assert_allclose(drifted, AWAY + ends[1] - ends[0], atol=1e-5)
    assert np.linalg.norm(drifted) > 1.0


def test_pulses_come_to_the_thrust_that_is_commanded(servicer, monkeypatch):
    for name in ('OFF_CENTER', 'OFF_FORCE', 'OFF_AXIS'):
        monkeypatch.setattr(servicer, name, 0.0)
    vehicle = flown(spacecraft(REST), 60.0, 0.5)[-1].vehicle
    np.testing.assert_allclose(vehicle.velocity, 60.0 * 0.5 * FULL * TURNED[:, 0], atol=0.02)
    assert vehicle.fraction == pytest.approx(0.5, abs=0.05)
    assert vehicle.facts['pointing'] < 1e-3


@pytest.mark.parametrize('rate', [[0.05, -0.1, 0.15], [-0.2, 0.05, 0.0]])
def test_it_turns_at_the_rate_that_is_commanded(servicer, rate):
    before, after = (each.vehicle for each in flown(spacecraft(), 20.0, 0.3, rate)[-2:])
    np.testing.assert_allclose(after.body_rate, rate, atol=2e-3)
    turned = log(before.attitude.T @ after.attitude)
    np.testing.assert_allclose(turned, 5.0 * np.array(rate), atol=5e-3)
    assert 0.0 < after.facts['pointing'] < 0.05
    assert after.facts['wheel'] > 1.0


def test_an_error_of_basilisk_is_a_failure(servicer, monkeypatch):
    def failing(*_words):
        raise servicer.bskLogging.BasiliskError('the task list is empty')

    flight = spacecraft()
    monkeypatch.setattr(flight.vehicle.engine._simulation, 'StepUntilStop', failing)
    with pytest.raises(EngineFailure, match='basilisk: the task list is empty'):
        flight.after(0.0, REST)


# --- all engines

ENGINES = {'cessna': aircraft, 'hummingbird': multirotor, 'servicer': spacecraft}


@pytest.mark.parametrize(
    ('name', 'own', 'seconds'),
    [('cessna', {'gust': 1.0}, 10.0), ('hummingbird', {'gust': 0.8}, 0.5), ('servicer', {}, 20.0)],
)
def test_a_seed_brings_the_same_air_and_vehicle_again(request, name, own, seconds):
    request.getfixturevalue(name)
    ends = [
        flown(ENGINES[name](seed=seed, **own), seconds, 1.0)[-1].vehicle.position
        for seed in (1, 1, 2)
    ]
    assert np.array_equal(ends[0], ends[1])
    assert not np.array_equal(ends[0], ends[2])


@pytest.mark.parametrize(
    ('name', 'own', 'there', 'seconds', 'command', 'within'),
    [
        ('cessna', {'wind': np.array([3.0, 0.0])}, [600.0, 400.0], 40.0, (0.9, -0.09), 50.0),
        ('hummingbird', {}, [2.0, 1.0], 2.0, (1.0, -1.5), 0.15),  # the hook's reach
    ],
)
def test_its_own_guidance_flies_to_a_waypoint(request, name, own, there, seconds, command, within):
    request.getfixturevalue(name)
    flight = ENGINES[name](**own)
    flight.vehicle.engine.steer_to(np.array(there))
    places = [each.vehicle.position for each in flown(flight, seconds, *command)]
    assert min(np.hypot(*(place - there)) for place in places) < within


@pytest.mark.skipif(not COMPILED, reason='slow in plain Python: pip install numba')
@pytest.mark.parametrize(
    ('name', 'task', 'most'),
    [
        ('cessna', 'cessna', {'closest': 5.0, 'bank': 0.55}),
        ('hummingbird', 'rope', {'time': 15.0, 'off': 0.5}),
        ('servicer', 'servicer', {'missed': 0.1, 'speed': 0.05, 'pointing': 0.1}),
    ],
)
def test_the_planner_does_its_job(request, name, task, most):
    """On the first flight of a seed that no study has used."""
    request.getfixturevalue(name)
    row = offline.flown(task, 'orbitope', 0, draws_of(task).of(901, 0))
    assert row['caught']
    assert all(row[field] < value for field, value in most.items())
