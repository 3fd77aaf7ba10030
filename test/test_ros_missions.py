# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Flights in process of vehicles in continuous time: no command is beyond their limits."""

import functools
import json

import numpy as np
import pytest

from orbimpc_ros.mpc.kernels import COMPILED

searched = pytest.mark.skipif(
    not COMPILED, reason='a tick takes seconds in plain Python: pip install numba'
)
SHORT = ('max_ticks=8', 'deadline=0.02')


@pytest.fixture(scope='module')
def missions():
    """The judge of missions, where ROS's messages are installed."""
    pytest.importorskip('rclpy', reason='needs ROS 2, or pip install orbimpc_ros[ros]')
    import missions

    return missions


NAMES = ['fixed_wing', 'tracking', 'hover', 'multirotor', 'spacecraft', 'car', 'retrieval']


@pytest.mark.parametrize('name', NAMES)
def test_a_mission_is_one_line_and_its_commands_keep_their_limits(missions, name):
    flown = json.loads(json.dumps(missions.row(name, 1, 0, SHORT)))
    assert flown['broken'] == []
    assert flown['stalls'] == 0
    assert 1 < sum(flown['roads'].values()) == flown['ticks'] <= 8
    assert flown['drawn'] == json.loads(json.dumps(missions.row(name, 1, 0, SHORT)))['drawn']
    assert flown['drawn'] != json.loads(json.dumps(missions.row(name, 1, 1, SHORT)))['drawn']


def test_what_is_drawn_is_not_told_to_the_planner(missions):
    """It hears of its surroundings by odometry and goals alone: the wind moves it all the same."""
    from orbimpc_ros.ros.parameters import planner_settings
    from orbimpc_ros.sim.parameters import sim_settings
    from orbimpc_ros.tool import settings
    from orbimpc_ros.tool.offline import aboard

    values, drawn = missions.jobs.drawn('fixed_wing', 1, 0, SHORT)
    assert np.linalg.norm(drawn['sim.wind']) > 0.1
    assert not planner_settings(values).disturbance.any()
    ends = {}
    for wind in ((0.0, 0.0, 0.0), (0.0, 4.0, 0.0)):
        told = settings.of_sim(values) | {'wind': wind, 'gust': 0.0}
        flight, airspeeds, _ = missions.flown(aboard(values), sim_settings(told))
        ends[wind] = flight.vehicle.position
        assert airspeeds.least >= 10.0 * (1.0 - 1e-6)
    assert np.linalg.norm(np.subtract(*ends.values())) > 4.0


def test_each_limit_is_judged(missions):
    values = {'floor.shape': 'circle', 'floor.fraction': 0.5, 'max_rate': 0.4}

    def found(stalls=0, **changes):
        fine = {'slowest': 0.5, 'fastest': 1.0, 'turned': 0.4}
        return missions.broken(values, missions.Tally(**(fine | changes)), stalls)

    assert found() == []
    assert found(slowest=0.499) == ['below the floor']
    assert found(fastest=1.001) == ['above full speed']
    assert found(turned=0.401) == ['beyond max_rate']
    assert found(stalls=1) == ['stalled']
    assert missions.broken(values | {'floor.shape': 'none'}, missions.Tally(), 0) == []


@searched
def test_a_patient_planner_takes_its_time(missions):
    """With a millionth of a second for a solve no plan is proved, but by one that may wait."""
    hurried = ('max_ticks=3', 'deadline=0.000001', 'objective=track')
    proved = {
        patient: missions.row('fixed_wing', 1, 0, hurried, patient=patient)['unproved'] == 0
        for patient in (False, True)
    }
    assert proved == {False: False, True: True}


# --- a vehicle with a floor and a rate limit that its planner does not know exactly

QUICK = 6  # flights with steps that are few


@pytest.fixture(scope='module')
def flights():
    """The judge of flights, where ROS's messages are installed."""
    pytest.importorskip('rclpy', reason='needs ROS 2, or pip install orbimpc_ros[ros]')
    import flights

    return flights


@functools.cache
def quick_indices(draw):
    """The first flights of at most 120 ticks, two of them with faults."""
    short = [i for i in range(100) if draw(1, i).duration / draw(1, i).step <= 120.0]
    faulty = [i for i in short if draw(1, i).faults]
    return [*[i for i in short if i not in faulty][: QUICK - 2], *faulty[:2]]


@pytest.mark.parametrize('k', range(QUICK))
def test_no_command_is_beyond_the_limits(flights, k):
    flown = flights.row(1, quick_indices(flights.draw)[k])
    assert not flown['broken'], flown
    assert sum(flown['roads'].values()) >= 60


def test_each_limit_of_a_flight_is_judged(flights):
    flight = flights.draw(1, 0)
    full, turning = flight.parameters['forward'], flight.parameters['max_rate']

    def found(speed, rate):
        return list(flights.beyond(flight, speed, rate))

    assert found(flight.least, turning) == found(full, -turning) == []
    assert found(flight.least * (1.0 - 2e-6), 0.0) == ['below the floor']
    assert found(full * (1.0 + 2e-6), 0.0) == ['above full speed']
    assert found(full, -turning * (1.0 + 2e-6)) == ['beyond max_rate']
    assert found(np.nan, 0.0) == found(full, np.inf)[:1] == ['not finite']
