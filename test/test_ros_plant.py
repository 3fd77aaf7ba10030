# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A vehicle in continuous time as a simulator's: its parameters, and flights over DDS."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry

from orbimpc_ros.sim.parameters import SIM, sim_settings
from orbimpc_ros.sim.plant import Plant
from orbimpc_ros.tool import bags, cli
from orbimpc_ros.tool.bags import fields

DEFAULTS = {row.name: row.default for row in SIM}
PLANNER = {
    'use_sim_time': True,
    'trigger': 'odom',
    'floor.shape': 'circle',
    'odom_timeout': 5.0,
    'goal_timeout': 5.0,
}
WING = {
    'vehicle': 'continuous',
    'response.speed': 0.2,
    'response.rate': 0.1,
    'gust': 0.02,
    'stall_speed': 0.5,
    'seed': 1,
    'capture_radius': 0.3,
    'exit_when_done': True,
}


def settings(**changes):
    given = {name.replace('__', '.'): value for name, value in changes.items()}
    return sim_settings(DEFAULTS | given)


def test_parameters_make_the_plant_that_they_say():
    told = settings(
        vehicle='continuous',
        step=0.5,
        forward=15.0,
        response__speed=0.8,
        response__rate=0.3,
        max_rate=0.4,
        max_acceleration=3.0,
        wind=(1.0, -2.0, 0.0),
        gust=0.5,
        gust_time=2.0,
        gain=1.03,
        stall_speed=10.0,
        velocity_source='air',
        odom_rate=10.0,
        seed=7,
    )
    plant = told.scenario.model
    assert isinstance(plant, Plant)
    assert (plant.step, plant.forward, plant.gain, plant.stall_speed) == (0.1, 15.0, 1.03, 10.0)
    assert (plant.speed_lag, plant.rate_lag) == (0.8, 0.3)
    assert (plant.max_rate, plant.max_acceleration) == (0.4, 3.0)
    assert (plant.gusts.deviation, plant.gusts.memory, plant.gusts.seed) == (0.5, 2.0, 7)
    assert plant.velocity_source == 'air'
    np.testing.assert_array_equal(plant.blown, [1.0, -2.0])
    assert told.command_timeout == 0.75  # of the planner's steps, not of the odometry


def test_at_order_2_there_are_drag_and_gravity():
    told = settings(
        vehicle='continuous', dimension=3, translation_order=2, drag=0.2, gravity=9.81, mass=2.0
    )
    plant = told.scenario.model
    assert (plant.drag, plant.mass, plant.step) == (0.2, 2.0, 1.0)
    np.testing.assert_array_equal(plant.blown, [0.0, 0.0, -9.81])


def test_a_limit_of_the_planner_alone_is_not_the_discrete_vehicles():
    assert not isinstance(settings(max_rate=0.5, max_acceleration=1.0).scenario.model, Plant)


def test_a_vehicle_in_continuous_time_is_caught_over_dds(launch, observer):
    """It lags, in gusts, and shows its odometry at five times the rate of the planner's steps."""
    odometry = observer.listen(Odometry, 'odom')
    truth = observer.listen(DiagnosticArray, 'truth')
    launch('planner', PLANNER, domain=observer.domain)
    sim = launch(
        'sim',
        WING | {'odom_rate': 5.0, 'wait_subscribers': 2, 'max_ticks': 200},
        domain=observer.domain,
    )
    assert sim.wait() == 0, sim.output
    assert 'captured' in sim.output
    observer.until(lambda: len(truth) > 10 and len(odometry) > 10, 'odometry and truth')
    stamps = [each.header.stamp.sec + 1e-9 * each.header.stamp.nanosec for each in odometry]
    assert np.diff(np.unique(stamps)).min() == pytest.approx(0.2)  # repeated where asked again
    told = {said.key for said in truth[-1].status[0].values}
    assert {'airspeed', 'least_airspeed', 'stalls', 'wind'} <= told


def test_a_bag_tells_how_slow_a_vehicle_became(tmp_path, capsys):
    changes = [f'--set={name}={value}' for name, value in WING.items() if name != 'exit_when_done']
    assert cli.main(['demo', 'retrieval', '--out', str(tmp_path), *changes]) == 0
    (folder,) = tmp_path.glob('*/bag')
    recorded = bags.of_vehicle(folder, '', ('goal', 'odom', 'truth'))
    said = [message for topic, message in recorded if topic == 'truth']
    last = fields(said[-1])
    assert last['least_airspeed'] == min(fields(each)['least_airspeed'] for each in said)
    assert (last['stalls'] > 0) == (last['least_airspeed'] < 0.5)
    told = f'at least {last["least_airspeed"]:.2f} m/s, {last["stalls"]} stalls'
    assert told in capsys.readouterr().out
