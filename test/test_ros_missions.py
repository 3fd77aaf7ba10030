"""Missions: configurations flown in process on the simulator's vehicle in continuous time."""

import json

import numpy as np
import pytest

SHORT = ('max_ticks=8', 'deadline=0.02')


@pytest.fixture(scope='module')
def missions():
    """The judge of missions, where ROS's messages are installed."""
    pytest.importorskip('rclpy', reason='needs ROS 2, or pip install orbimpc_ros[ros]')
    import missions

    return missions


@pytest.mark.parametrize('name', ['fixed_wing', 'spacecraft', 'multirotor'])
def test_a_mission_is_one_line_and_its_commands_keep_their_limits(missions, name):
    flown = json.loads(json.dumps(missions.row(name, 1, 0, SHORT)))
    assert flown['broken'] == []
    assert flown['stalls'] == 0
    assert sum(flown['roads'].values()) == flown['ticks'] == 8
    assert flown['drawn'] == json.loads(json.dumps(missions.row(name, 1, 0, SHORT)))['drawn']
    assert flown['drawn'] != json.loads(json.dumps(missions.row(name, 1, 1, SHORT)))['drawn']


def test_what_is_drawn_is_not_told_to_the_planner(missions):
    """It hears of its surroundings by odometry and goals alone: the wind moves it all the same."""
    from onboard import Planner

    from orbimpc_ros.ros.parameters import sim_settings
    from orbimpc_ros.tool.io import settings
    from orbimpc_ros.tool.io.share import config

    values = settings.resolve(config('fixed_wing.yaml'), SHORT)
    assert values['wind'] == (0.0, 0.0, 0.0)
    ends = {}
    for wind in ((0.0, 0.0, 0.0), (0.0, 4.0, 0.0)):
        told = settings.of_sim(values) | {'wind': wind, 'gust': 0.0}
        flight, airspeeds, _ = missions.flown(Planner(values), sim_settings(told))
        ends[wind] = flight.vehicle.position
        assert airspeeds.least >= 10.0 * (1.0 - 1e-6)
    assert np.linalg.norm(np.subtract(*ends.values())) > 4.0


def test_a_multirotor_hears_of_the_boxes_and_keeps_clear_of_them(missions):
    """Told of none, it flies through: the simulator judges by its own."""
    from onboard import Planner

    from orbimpc_ros.ros.parameters import sim_settings
    from orbimpc_ros.tool.io import settings
    from orbimpc_ros.tool.io.share import config

    values = settings.resolve(config('multirotor.yaml'), ('max_ticks=25',))
    touched = {}
    for told in (values['obstacles'], ()):
        flight, _, _ = missions.flown(
            Planner(values | {'obstacles': told}), sim_settings(settings.of_sim(values))
        )
        assert flight.distance < 1.0
        touched[told] = flight.touched
    assert not touched[values['obstacles']]
    assert touched[()]


def test_each_limit_is_judged(missions):
    values = {'floor.shape': 'circle', 'floor.fraction': 0.5, 'max_rate': 0.4}

    def found(**changes):
        fine = {'slowest': 0.5, 'fastest': 1.0, 'turned': 0.4}
        return missions.broken(values, missions.Tally(**(fine | changes)))

    assert found() == []
    assert found(slowest=0.499) == ['below the floor']
    assert found(fastest=1.001) == ['above full speed']
    assert found(turned=0.401) == ['beyond max_rate']
    assert missions.broken(values | {'floor.shape': 'none'}, missions.Tally()) == []
