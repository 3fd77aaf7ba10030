# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Wind, gravity and exact steps as parameters: what they add up to, and what a planner says."""

import numpy as np
import pytest

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.parameters import PLANNER, planner_settings
from orbimpc_ros.ros.planner.description import summary
from orbimpc_ros.sim.parameters import SIM, sim_settings

CRAFT = {'dimension': 3, 'translation_order': 2, 'forward': 20.0, 'gravity': 9.81}


def settings(table=PLANNER, **changes):
    make = planner_settings if table is PLANNER else sim_settings
    return make({**{row.name: row.default for row in table}, **changes})


def said(**changes):
    return summary(settings(**changes), simulated=False)


def test_wind_and_gravity_add_up_to_one_disturbance():
    made = settings(**CRAFT, wind=(0.5, 0.0, 1.0))
    np.testing.assert_allclose(made.disturbance, [0.5, 0.0, -8.81])
    assert made.safe_command == 'hover'
    planar = settings(wind=(0.3, -0.2, 7.0))
    np.testing.assert_allclose(planar.disturbance, [0.3, -0.2])
    assert not settings().disturbance.any()


def test_planner_and_simulator_take_the_same_for_wind():
    known = {**CRAFT, 'wind': (0.5, 0.0, 1.0), 'discretisation': 'exact'}
    planner, sim = settings(**known), settings(SIM, **known)
    np.testing.assert_allclose(sim.scenario.model.blown, planner.disturbance)
    assert sim.scenario.model.discretisation == planner.problem.discretisation == 'exact'


def test_the_start_up_line_says_what_moves_the_vehicle():
    assert 'wind' not in said()
    assert 'integrated exactly' not in said()
    assert 'wind (0.3, -0.2) m/s,' in said(wind=(0.3, -0.2))
    assert 'integrated exactly' in said(discretisation='exact')
    assert 'odometry through the air,' in said(velocity_source='air')
    assert 'through the air, with its slip,' in said(velocity_source='air', sideslip=True)
    assert 'gravity 9.81 m/s^2: hovers at 0.491 of its thrust' in said(**CRAFT)
    assert 'safe command hover' in said(**CRAFT)


def test_what_hardly_can_be_flown_is_said_with_its_figures():
    assert 'wind (3, 4) m/s, 5 m/s in all: too much to hold a goal' in said(wind=(3.0, 4.0))
    floored = {**CRAFT, 'floor.shape': 'circle', 'floor.fraction': 0.6}
    assert 'cannot hover, for its least thrust is 12' in said(**floored)
    assert 'stop although that is to fall' in said(**CRAFT, safe_command='stop')


def test_a_weight_that_no_thrust_carries_is_refused_with_the_figures():
    with pytest.raises(BadInput, match=r'gravity is 9\.81; allowed: below .* 9 m/s\^2'):
        settings(**{**CRAFT, 'forward': 9.0})
