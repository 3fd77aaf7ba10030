# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Simulated time that jumps or stands still under a live planner."""

import pytest

pytest.importorskip('rclpy')

from planners import QUICK, Bench, goal, moving, odometry, told
from rosgraph_msgs.msg import Clock

from orbimpc_ros.ros import messages
from orbimpc_ros.ros.process import qos


def safe_again(bench, after, reason):
    """Wait for safe commands after the first so many commands, and for their reason on tick."""
    bench.until(lambda: len(bench.commands) >= after + 3, 'safe commands')
    bench.until(lambda: any(reason in told(m)['reason'] for m in bench.ticks), reason)
    assert not any(moving(command) for command in bench.commands[after + 1 :])


class Simulated(Bench):
    """A planner whose time this test makes, too."""

    def __init__(self, launch, observer):
        self.clock = observer.node.create_publisher(Clock, '/clock', qos())
        super().__init__(launch, observer, QUICK | {'use_sim_time': True})
        observer.until(self.clock.get_subscription_count, 'the planner listening to time')

    def tell(self, seconds):
        self.clock.publish(Clock(clock=messages.time_message(round(seconds * 1e9))))


def test_time_that_jumps_or_stands_still_brings_the_safe_command(launch, observer):
    bench = Simulated(launch, observer)
    assert moving(bench.fly(100.0))
    for seconds, jump in ((90.0, 'jumped by -10 s'), (500.0, 'jumped by 4')):
        flown, words = len(bench.commands), f'starting afresh: the clock {jump}'
        bench.until(lambda s=seconds, w=words: bench.tell(s) or w in bench.planner.output, words)
        bench.until(lambda n=flown: len(bench.commands) >= n + 2, 'safe commands')
        assert not any(map(moving, bench.commands[-2:]))
        assert moving(bench.fly(seconds + 0.1))
    safe_again(bench, len(bench.commands), 'odometry is')  # and now it stands still
    bench.odometry.publish(odometry(505.0))
    assert bench.counts('refused odom: future stamp') >= 1


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
