# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Simulated time that stands still under a planner on its timer."""

import pytest

pytest.importorskip('rclpy')

from planners import Bench, goal, moving, odometry, told
from rosgraph_msgs.msg import Clock

from orbimpc_ros.ros import messages
from orbimpc_ros.ros.process import qos


def test_a_timer_whose_clock_stands_still_is_noticed(launch, observer):
    clock = observer.node.create_publisher(Clock, '/clock', qos())
    patient = {'trigger': 'timer', 'step': 0.1, 'odom_timeout': 0.5, 'goal_timeout': 60.0}
    bench = Bench(launch, observer, patient | {'use_sim_time': True})
    observer.until(clock.get_subscription_count, 'the planner listening to time')
    at = 0.0

    def told_of_later(by, time_moves):
        nonlocal at
        at += by
        if time_moves:
            clock.publish(Clock(clock=messages.time_message(round(at * 1e9))))
        bench.odometry.publish(odometry(at))
        bench.goal.publish(goal(at))
        return [told(m)['reason'] for m in bench.ticks]

    bench.until(lambda: told_of_later(0.01, True) and moving(bench.commands[-1]), 'a plan')
    words = 'the clock has stood still for'  # while odometry, not much ahead of it, stays fresh
    bench.until(lambda: any(words in reason for reason in told_of_later(1e-4, False)), words)
    assert not moving(bench.commands[-1])
