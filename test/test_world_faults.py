# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Injected faults between a flight and its planner: each has its effect, by the seed alone."""

from dataclasses import replace

import numpy as np
import pytest
from scenarios import retrieval, retrieval3d

from orbimpc_ros.loop.compensation import Odometry
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import log
from orbimpc_ros.sim.outputs import View
from orbimpc_ros.sim.parameters import Faults, SimSettings
from orbimpc_ros.sim.vehicle import between, measured
from orbimpc_ros.sim.world import departure

TURN = np.array([0.3])


def views(faults, *, seed=0, ticks=400, scenario=None):
    """Return the flight and the view of it at each tick of a turning flight."""
    own = {'faults': faults, 'seed': seed, 'max_ticks': 10**6, 'capture_radius': 1e-9}
    scenario = replace(scenario or retrieval(), **own)
    view, flight, seen = View(scenario), departure(scenario), []
    for _ in range(ticks):
        seen.append((flight, view.of(flight)))
        flight = flight.after(0.8, np.resize(TURN, scenario.model.rates))
    return seen


def of_kind(sent, odometry):
    return [each for each in sent if isinstance(each, Odometry) == odometry]


def test_a_seed_decides_everything():
    faults = Faults(0.1, 0.1, 0.3, 0.4, 0.2, 0.2, 0.2, 1.0, 5.0)
    first, same, other = (
        [[(s.time, *s.position) for s in sent] for _, sent in views(faults, seed=s)]
        for s in (3, 3, 4)
    )
    assert str(first) == str(same)  # as text, since NaN is unequal to itself
    assert str(first) != str(other)


@pytest.mark.parametrize('scenario', [retrieval(), retrieval3d()])
def test_noise_has_its_deviation(scenario):
    shifts, turns = [], []
    for flight, (goal, odometry) in views(Faults(0.05, 0.02), scenario=scenario):
        shifts += [goal.position - flight.goal]
        shifts += [odometry.position - flight.vehicle.position]
        turns += [log(flight.vehicle.attitude.T @ odometry.attitude)]
    assert np.std(shifts) == pytest.approx(0.05, rel=0.1)
    assert np.std(turns) == pytest.approx(0.02, rel=0.1)
    assert abs(np.mean(shifts)) < 0.005


LAGGING = replace(retrieval(), vehicle='continuous', speed_lag=0.5, rate_lag=0.4)
SCENARIOS = {'in steps': retrieval(), 'continuously': LAGGING}


@pytest.mark.parametrize('scenario', SCENARIOS.values(), ids=SCENARIOS)
@pytest.mark.parametrize('delay', [0.2, 0.73, 1.0, 2.5])
def test_delayed_odometry_shows_the_vehicle_where_it_was_on_its_way(delay, scenario):
    """With the speed and the rate at that moment, not at the end of a step."""
    seen = views(Faults(delay=delay), ticks=20, scenario=scenario)
    within = 0.01 if scenario is LAGGING else 1e-9  # error of chords
    passed = [each for flight, _ in seen for each in flight.trail or (flight.vehicle,)]
    for flight, sent in seen[4:]:
        (odometry,) = of_kind(sent, odometry=True)
        then = flight.vehicle.time - delay
        assert odometry.time == pytest.approx(then)
        k = next(k for k, each in enumerate(passed) if each.time > then - 1e-9)
        there = passed[k] if passed[k].time < then + 1e-9 else between(*passed[k - 1 : k + 1], then)
        for name in ('position', 'attitude', 'body_velocity', 'body_rate'):
            wanted = getattr(measured(there), name)
            np.testing.assert_allclose(getattr(odometry, name), wanted, atol=within)


def test_before_its_start_a_vehicle_stood_there():
    flight, sent = views(Faults(delay=2.5), ticks=1)[0]
    (odometry,) = of_kind(sent, odometry=True)
    np.testing.assert_array_equal(odometry.position, flight.vehicle.position)
    assert odometry.time == flight.vehicle.time - 2.5


STRUCK = {
    'dropout': (0.2, lambda _, sent: 2 - len(sent)),
    'reorder': (0.3, lambda now, sent: sum(each.time < now for each in sent)),
    'duplicate': (0.25, lambda _, sent: len(sent) - 2),
    'nan': (0.3, lambda _, sent: sum(np.isnan(each.position).all() for each in sent)),
}


@pytest.mark.parametrize('name', STRUCK)
def test_a_fault_strikes_its_share_of_messages(name):
    share, struck = STRUCK[name]
    seen = views(Faults(**{name: share}), ticks=1000)
    count = sum(struck(flight.vehicle.time, sent) for flight, sent in seen)
    assert count / 2000 == pytest.approx(share, abs=0.05)
    for flight, sent in seen:
        times = [each.time for each in sent]
        assert times == sorted(times)
        assert all(flight.vehicle.time - time in (0.0, 1.0) for time in times)


def test_a_share_of_commands_is_lost():
    view = View(SimSettings(faults=Faults(dropout=0.2), seed=7))
    lost = sum(view.command_lost(tick) for tick in range(2000))
    assert lost / 2000 == pytest.approx(0.2, abs=0.03)


def test_the_goal_is_hidden_once_in_a_period():
    seen = views(Faults(occlusion_length=3.0, occlusion_period=10.0), seed=2, ticks=200)
    visible = [bool(of_kind(sent, odometry=False)) for _, sent in seen]
    begins = set()
    for k in range(0, 200, 10):
        hidden = [i for i in range(10) if not visible[k + i]]
        assert 2 <= len(hidden) <= 3
        assert hidden[-1] - hidden[0] == len(hidden) - 1
        begins.add(hidden[0])
    assert len(begins) > 3
    assert all(of_kind(sent, odometry=True) for _, sent in seen)


@pytest.mark.parametrize('length', [11.0, -1.0])
def test_an_occlusion_longer_than_its_period_is_refused(length):
    with pytest.raises(BadInput, match=r'faults\.occlusion_length'):
        Faults(occlusion_length=length)
