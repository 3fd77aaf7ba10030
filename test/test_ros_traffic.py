# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A live planner among bodies and other vehicles, over DDS."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

from nav_msgs.msg import Path
from planners import QUICK, Bench, told
from visualization_msgs.msg import Marker, MarkerArray

from orbimpc_ros.mpc.problem import Ball
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.markers import shown
from orbimpc_ros.ros.messages import Frames, Stamp
from orbimpc_ros.ros.process import qos

OTHER = '/uav2/plan'
FRAMES = Frames('odom', 'base_link')


@pytest.fixture
def bench(launch, observer):
    return Bench(launch, observer, QUICK | {'avoid': ['/plan', OTHER], 'avoid_radius': 0.5})


def body(seconds, place=(0.3, 0.6)):
    head = messages.header(round(seconds * 1e9), 'odom')
    return MarkerArray(markers=[shown(Marker(header=head), Ball(np.array(place), 0.2))])


def planned_with(bench, count, seconds):
    """Answer odometry until a tick was planned with so many hazards."""
    stamps = iter(np.arange(seconds, seconds + 60.0, 0.05))

    def done():
        bench.fly(float(next(stamps)))
        return bench.ticks and told(bench.ticks[-1])['obstacles'] == str(count)

    bench.until(done, f'{count} hazards')


def test_bodies_and_plans_are_planned_with_and_who_is_not_heard_is_told_of(bench, observer):
    bench.fly(1.0)
    bench.says(f'nothing heard on {OTHER}: not avoided')
    markers = observer.node.create_publisher(MarkerArray, 'obstacles', qos(10))
    plans = observer.node.create_publisher(Path, OTHER, qos())
    for each in (markers, plans):
        observer.until(each.get_subscription_count, 'the planner listening')
    markers.publish(body(1.0))
    planned_with(bench, 1, 1.1)
    now = bench.ticks[-1].header.stamp.sec + 1.0
    places = [np.array([0.1 * k, -0.9]) for k in range(5)]
    plans.publish(messages.goal_path_message(Stamp(round(now * 1e9), FRAMES), 0.1, places))
    planned_with(bench, 2, now)
    bench.fly(now + 100.0)
    bench.says('is silent: no longer avoided')
    plans.publish(messages.goal_path_message(Stamp(round(now * 1e9) + 10**11, FRAMES), 0.1, places))
    bench.fly(now + 101.0)
    bench.says('is silent: avoided wherever it may have stopped')
    markers.publish(body(1.0, (5.0, 5.0)))
    assert bench.counts('refused obstacles: stale stamp') == 1
