# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The other ends of the planner's topics: more sources, rivals, and who cannot hear or be heard."""

import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TwistStamped
from planners import QUICK, Bench
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from orbimpc_ros.ros.process import qos


@pytest.fixture(scope='module')
def veteran(shared):
    return Bench(*shared, QUICK)


@pytest.fixture
def flying(veteran):
    """A planner that has flown before, made to forget it."""
    assert veteran.observer.call(Trigger, '/planner/reset', Trigger.Request()).success
    return veteran


def level(bench, words):
    """Return the level at which the planner's diagnostics say something, waiting for it."""
    said = lambda: [m.status[0] for m in bench.health if words in m.status[0].message]  # noqa: E731
    bench.until(said, words)
    return said()[-1].level


def gone(bench, words):
    bench.until(lambda: words not in bench.health[-1].status[0].message, f'no more {words}')


def test_a_rival_on_the_vehicles_topic_is_warned_of(flying):
    flying.fly(1.0)
    node = flying.observer.node
    rival = node.create_publisher(TwistStamped, 'cmd_vel', qos())
    assert level(flying, '2 publishers on /cmd_vel') >= DiagnosticStatus.WARN
    node.destroy_publisher(rival)
    flying.fly(2.0)


def test_who_speaks_another_type_is_named(flying):
    node = flying.observer.node
    other = node.create_publisher(Bool, 'goal_path', qos())
    words = '/goal_path of /observer is a std_msgs/msg/Bool, not a nav_msgs/msg/Path'
    assert level(flying, words) == DiagnosticStatus.ERROR
    node.destroy_publisher(other)
    gone(flying, words)
