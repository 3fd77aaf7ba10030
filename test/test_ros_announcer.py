# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner's voice: what is said once, again later, or not at all; a line on the vehicle."""

import math

import pytest

pytest.importorskip('rclpy')

from orbimpc_ros.ros.planner.announcer import FIRST, KINDS, MANY, Announcer
from orbimpc_ros.ros.planner.summary import doubts, summary

from orbimpc_ros.mpc.problem import Floor
from orbimpc_ros.ros.parameters.planner import PLANNER, planner_settings


class Console:
    """Keeps what is said, and has a clock of its own."""

    def __init__(self):
        self.at, self.lines = 0.0, []
        self.announcer = Announcer(self, lambda: self.at)

    def info(self, text):
        self.lines.append((self.at, text))

    warning = info

    def every(self, period, until, text):
        """Warn every so many seconds, with the time in the words, and return when it was said."""
        begun = len(self.lines)
        while self.at < until:
            self.announcer.warn(text.format(self.at))
            self.at += period
        return [at for at, _ in self.lines[begun:]]


@pytest.fixture
def console():
    return Console()


def test_what_lasts_is_said_at_growing_intervals(console):
    said = console.every(0.125, 1000.0, 'odometry is {:.2f} s old')
    assert said == [0.0, 10.0, 30.0, 70.0, 150.0, 310.0, 630.0]


def test_what_comes_back_after_a_rest_is_said_at_once(console):
    console.every(0.125, 100.0, 'odometry is {:.2f} s old')
    console.at += FIRST
    assert console.every(0.125, 115.0, 'odometry is {:.2f} s old') == [110.0]


def test_what_differs_in_more_than_numbers_is_said_apart(console):
    for text in ('odometry is 0.4 s old', 'odometry is 1e-3 s old', 'uav1 is late', 'uav2 is late'):
        console.announcer.warn(text)
    assert [line for _, line in console.lines] == [
        'odometry is 0.4 s old', 'uav1 is late', 'uav2 is late',
    ]  # fmt: skip


def test_troubles_are_said_when_they_begin_and_when_they_are_over(console):
    for present in ([''], ['2 rivals'], ['3 rivals', 'deaf'], ['deaf'], ['deaf'], []):
        console.announcer.follow(present)
        console.at += 1.0
    assert [line for _, line in console.lines] == [
        '2 rivals', 'deaf', 'over: 3 rivals', 'over: deaf',
    ]  # fmt: skip


def test_a_flood_of_different_lines_is_cut_and_not_remembered(console):
    for k in range(10 * KINDS):
        console.announcer.warn(f'frame {"x" * k} refused')
        console.at += 0.01
    seconds = console.at
    assert MANY <= len(console.lines) <= MANY * (seconds + 1.0)
    assert len(console.announcer._said) <= KINDS


WING = {
    'forward': 15.0, 'floor.shape': 'circle', 'floor.fraction': 10.0 / 15.0, 'step': 0.1,
    'horizon': 10, 'max_rate': 0.4363323, 'trigger': 'odom',
}  # fmt: skip


def described(**changes):
    values = {row.name: row.default for row in PLANNER} | changes
    return planner_settings(values)


def test_one_line_says_what_vehicle_the_planner_believes_in():
    assert summary(described(**WING), simulated=True) == (
        '15 m/s, at least 10 m/s (circle), at most 25 deg/s, 0.1 s x 10, 2D, rotation order 1, '
        'translation order 1, planned at each odometry, time of /clock, '
        'goals stale after 1 s once they stream, safe command loiter'
    )
    thrust = {'translation_order': 2, 'dimension': 3, 'mass': 7.0, 'goal_timeout': -1.0}
    assert summary(described(**thrust), simulated=False) == (
        '1 m/s^2, 7 kg, 1 s x 5, 3D, rotation order 1, translation order 2, planned every step, '
        "the system's time, goals never stale, safe command stop"
    )


def test_a_stop_below_the_floor_is_told():
    told = summary(described(**WING, safe_command='stop'), simulated=False)
    assert told.endswith('safe command stop although that is below the floor')


def test_what_is_hardly_meant_is_doubted():
    def doubted(**given):
        return doubts(described(**{'step': 0.1} | given), given)

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
        return [each.split(' not given')[0] for each in doubts(described(**given), given)]

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
    found = doubts(described(**given), given)
    assert [doubt.split(':')[0] for doubt in found] == told
    assert all(doubt.endswith('half a turn takes a horizon of 15') for doubt in found)
    assert doubts(described(**given, objective='intercept'), given) == []  # it looks beyond
