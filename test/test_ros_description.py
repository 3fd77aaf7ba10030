# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The start-up line on the vehicle, and what is doubtful about it."""

import math

import pytest

pytest.importorskip('rclpy')

from planners import settings

from orbimpc_ros.mpc.problem import Floor
from orbimpc_ros.ros.planner.description import doubts, summary

WING = {
    'forward': 15.0, 'floor.shape': 'circle', 'floor.fraction': 10.0 / 15.0, 'step': 0.1,
    'horizon': 10, 'max_rate': 0.4363323, 'trigger': 'odom',
}  # fmt: skip


HOVERING = {'dimension': 3, 'translation_order': 2, 'forward': 20.0, 'gravity': 9.81}
LANDER = {**HOVERING, 'forward': 3.6, 'gravity': 1.62, 'tilt': 0.2618, 'glide_slope': 0.8727}
FLOORED = {**HOVERING, 'floor.shape': 'circle', 'floor.fraction': 0.6}
AIR = {'velocity_source': 'air'}


@pytest.mark.parametrize(
    ('changes', 'words', 'others'),
    [
        ({}, '', 'wind'),
        ({}, '', 'integrated exactly'),
        ({'wind': (0.3, -0.2)}, 'wind (0.3, -0.2) m/s,', ''),
        ({'wind': (3.0, 4.0)}, 'wind (3, 4) m/s, 5 m/s in all: too much to hold a goal', ''),
        ({'discretisation': 'exact'}, 'integrated exactly', ''),
        (AIR, 'odometry through the air,', ''),
        ({**AIR, 'sideslip': True}, 'through the air, with its slip,', ''),
        (HOVERING, 'gravity 9.81 m/s^2: hovers at 0.491 of its thrust', ''),
        (HOVERING, 'safe command hover', ''),
        (FLOORED, 'cannot hover, for its least thrust is 12', ''),
        ({**HOVERING, 'safe_command': 'stop'}, 'stop although that is to fall', ''),
        ({**WING, 'safe_command': 'stop'}, 'stop although that is below the floor', ''),
        ({**HOVERING, 'thrust_axis': 'z', 'hover_thrust': 0.4}, 'told as 0.4 on thrust', ''),
        (LANDER, 'tilted by at most 15 deg', 'to hold a goal takes'),
        (LANDER, 'above a glide slope of 50 deg', ''),
        (
            {**LANDER, 'wind': (0.6, 0.0, 0.0)},
            'takes a tilt of 20.32 deg: more than is allowed',
            '',
        ),
        ({**LANDER, 'tilt': 0.0}, '', 'tilted'),
    ],
)
def test_the_start_up_line_says_what_moves_the_vehicle(changes, words, others):
    line = summary(settings(**changes), simulated=False)
    assert words in line
    assert not others or others not in line


def test_what_is_hardly_meant_is_doubted():
    def doubted(**given):
        return doubts(settings(**{'step': 0.1} | given), given)

    assert doubted(max_rate=25.0) == [
        'max_rate is 25 rad/s, 1432 deg/s: 0.4363 rad/s if 25 deg/s is meant'
    ]
    assert doubted(max_rate=3.0) == []
    assert doubted(**{'approach.cone': 0.5}) == [
        'approach.cone is 0.5 and objective track: it has no effect'
    ]
    assert doubted(**{'approach.cone': 0.5, 'objective': 'intercept'}) == []
    assert doubted(**{'floor.fraction': 0.9}) == [
        'floor.fraction is 0.9 and floor.shape none: it has no effect'
    ]
    assert doubted(**{'floor.faces': 8, 'floor.shape': 'circle'}) == [
        'floor.faces is 8 and floor.shape circle: it has no effect'
    ]
    assert doubted(**{'floor.fraction': Floor().fraction}) == []  # a file of all defaults
    assert doubted(**{'floor.faces': 8, 'floor.shape': 'polygon'}) == []


def test_what_only_the_vehicles_maker_knows_is_asked_for():
    def doubted(**given):
        return [each.split(' not given')[0] for each in doubts(settings(**given), given)]

    thrust = {'translation_order': 2, 'dimension': 3, 'thrust_axis': 'z'}
    assert doubted(**thrust) == ['max_rate is']
    for known in (3.84, 0.0):
        assert doubted(**thrust, max_rate=known, step=0.1) == []
    torque = {'translation_order': 2, 'dimension': 3, 'rotation_order': 2}
    assert doubted(**torque) == ['response.speed and response.rate are']
    for known in (0.0, 0.001):
        assert doubted(**torque, **{'response.rate': known}) == []


@pytest.mark.parametrize(
    ('horizon', 'shape', 'told'),
    [
        (10, 'circle', ['a horizon of 5 s turns by 125 deg at most']),
        (10, 'none', []),
        (15, 'circle', []),
    ],
)
def test_a_horizon_too_short_to_turn_round_is_doubted(horizon, shape, told):
    given = {'step': 0.5, 'horizon': horizon, 'max_rate': math.radians(25.0), 'floor.shape': shape}
    found = doubts(settings(**given), given)
    assert [doubt.split(':')[0] for doubt in found] == told
    assert all(doubt.endswith('half a turn takes a horizon of 15') for doubt in found)
    assert doubts(settings(**given, objective='intercept'), given) == []  # it looks beyond
