# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A continuous vehicle with a floor and a rate limit, flown by the planner: never beyond them."""

import functools

import numpy as np
import pytest

QUICK = 6  # flights with steps that are few
TICKS = 300  # of 0.2 s: a minute


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


def test_each_limit_is_judged(flights):
    flight = flights.draw(1, 0)
    full, turning = flight.parameters['forward'], flight.parameters['max_rate']

    def found(speed, rate):
        return list(flights.beyond(flight, speed, rate))

    assert found(flight.least, turning) == found(full, -turning) == []
    assert found(flight.least * (1.0 - 2e-6), 0.0) == ['below the floor']
    assert found(full * (1.0 + 2e-6), 0.0) == ['above full speed']
    assert found(full, -turning * (1.0 + 2e-6)) == ['beyond max_rate']
    assert found(np.nan, 0.0) == found(full, np.inf)[:1] == ['not finite']


WING = {
    'trigger': 'odom',
    'step': 0.2,
    'horizon': 8,
    'forward': 15.0,
    'floor.shape': 'circle',
    'floor.fraction': 0.65,
    'max_rate': 0.4,
    'deadline': 0.02,
    'safe_command': 'loiter',
}


class FixedWing:
    """A wing that reaches less speed than is commanded, in wind, with a planner over DDS."""

    def __init__(self, flights, launch, observer):
        from airframe import Airframe, Motion, flown, over_ground
        from geometry_msgs.msg import TwistStamped
        from planners import FRAMES, Bench

        from orbimpc_ros.ros.messages import Stamp, goal_message

        self.bench = Bench(launch, observer, WING)
        self.flight = flights.AirFlight(WING, None, None, None, (0.0, 0.0), 60.0)
        frame = Airframe(0.8, 0.2, 0.92, np.array([-3.0, 1.0]), 1.5, 0.6)
        self._start, self._kind = Motion(0.0, 0.0, 0.0, 13.0, 0.0), TwistStamped

        def messages(k, motion):
            stamp = Stamp(round((1.0 + 0.2 * k) * 1e9), FRAMES)
            seen = flights.odometry_message(stamp, motion, over_ground(frame, motion))
            return goal_message(stamp, np.array([120.0, 60.0])), seen

        def moved(motion, command):
            return flown(frame, motion, command.twist.linear.x, command.twist.angular.z, 0.2)

        self._messages, self._moved = messages, moved

    def fly(self, first, last):
        """Fly from one tick to another, each command from the odometry before it."""
        motion = self._start
        for k in range(first, last):
            motion = self._moved(motion, self._answer(*self._messages(k, motion)))
        self._start = motion

    def _answer(self, goal, odometry):
        """The command with an odometry message's stamp; best effort may lose what asks for it."""
        bench, before, asked = self.bench, len(self.bench.commands), 0

        def answered():
            nonlocal asked
            if asked % 20 == 0:
                bench.goal.publish(goal)
                bench.odometry.publish(odometry)
            asked += 1
            stamps = [each.header.stamp for each in bench.commands[before:]]
            return odometry.header.stamp in stamps

        bench.until(answered, 'a command')
        stamps = [each.header.stamp for each in bench.commands[before:]]
        return bench.commands[before + stamps.index(odometry.header.stamp)]


@pytest.fixture
def wing(flights, launch, observer):
    return FixedWing(flights, launch, observer)


def test_over_dds_a_wing_is_never_commanded_below_its_floor(flights, wing):
    """A minute, with a planner that is reset and disabled on the way and stopped at the end."""
    from std_srvs.srv import SetBool, Trigger

    call = wing.bench.observer.call
    wing.fly(0, TICKS // 3)
    assert call(Trigger, '/planner/reset', Trigger.Request()).success
    wing.fly(TICKS // 3, 2 * TICKS // 3)
    assert call(SetBool, '/planner/enable', SetBool.Request(data=False)).success
    wing.fly(2 * TICKS // 3, 2 * TICKS // 3 + 5)
    assert call(SetBool, '/planner/enable', SetBool.Request(data=True)).success
    wing.fly(2 * TICKS // 3 + 5, TICKS)
    said = len(wing.bench.commands)
    assert wing.bench.planner.stop() == 0
    wing.bench.until(lambda: len(wing.bench.commands) > said, 'the last command')
    commands = [(each.twist.linear.x, each.twist.angular.z) for each in wing.bench.commands]
    assert len(commands) > TICKS
    bad = [(*c, *flights.beyond(wing.flight, *c)) for c in commands]
    assert not [each for each in bad if len(each) > 2]
