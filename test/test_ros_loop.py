# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Planner and simulator as two processes over DDS, and a third that watches."""

import json

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from flying import fly  # noqa: E402
from geometry_msgs.msg import PoseStamped, QuaternionStamped, TwistStamped  # noqa: E402
from nav_msgs.msg import Odometry, Path  # noqa: E402
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from scenarios import retrieval, retrieval_problem  # noqa: E402
from std_msgs.msg import Bool  # noqa: E402
from visualization_msgs.msg import MarkerArray  # noqa: E402

from orbimpc_ros.loop.goal.forecast import FORECASTS  # noqa: E402
from orbimpc_ros.loop.planner import Planner  # noqa: E402
from orbimpc_ros.ros.process import qos  # noqa: E402

TOPICS = {
    'odom': Odometry,
    'goal': PoseStamped,
    'cmd_vel': TwistStamped,
    'rotation': QuaternionStamped,
    'plan': Path,
    'plan_markers': MarkerArray,
    'world_markers': MarkerArray,
    'tick': DiagnosticArray,
    '/diagnostics': DiagnosticArray,
    '/clock': Clock,
}
ANSWERS = ('cmd_vel', 'rotation', 'plan', 'tick')
KEPT = qos(10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def ns(stamp) -> int:
    return stamp.sec * 10**9 + stamp.nanosec


def stamp(message) -> int:
    if hasattr(message, 'markers'):
        return ns(message.markers[0].header.stamp)
    return ns(message.clock if hasattr(message, 'clock') else message.header.stamp)


def once(messages) -> list:
    """The messages without those that only repeat another's stamp."""
    return list({stamp(m): m for m in reversed(messages)}.values())[::-1]


def reached(messages, last: int) -> bool:
    """Whether a message of stamp ``last`` or later was heard: topics keep no order among them."""
    return bool(messages) and stamp(messages[-1]) >= last


def values(message) -> dict:
    return {pair.key: pair.value for pair in message.status[0].values}


@pytest.fixture
def oracle():
    """The same flight, flown without ROS."""
    return fly(Planner(retrieval_problem()), retrieval(), FORECASTS['hold']())


def test_the_rope_is_caught_and_the_topics_are_as_documented(launch, observer, oracle):
    heard = {topic: observer.listen(kind, topic) for topic, kind in TOPICS.items()}
    captured, caught = (observer.listen(Bool, each, KEPT) for each in ('captured', 'caught'))
    health = observer.listen(DiagnosticArray, '/diagnostics')
    launch('planner', {}, 'retrieval')
    observer.until_connected(*ANSWERS)
    sim = launch('sim', {'exit_when_done': True, 'wait_subscribers': 2}, 'retrieval')
    observer.until(lambda: captured, 'the end of the flight')
    assert captured[0].data
    assert sim.wait() == 0, sim.output
    flown = len(oracle.ticks)
    stamps = [10**9 * k for k in range(flown + 1)]
    told = ('odom', 'goal', '/clock', *ANSWERS)
    observer.until(lambda: all(reached(heard[t], stamps[-1]) for t in told), 'the rest')
    observer.until(lambda: [each.data for each in caught] == [False, True], 'the catch')
    assert not any("not of this node's clock" in m.status[0].message for m in health)
    heard = {topic: once(messages) for topic, messages in heard.items()}
    assert [stamp(m) for m in heard['odom']] == stamps
    for topic in told:
        found = [stamp(m) for m in heard[topic] if stamp(m) <= stamps[-1]]
        assert found in (stamps, stamps[1:]), topic  # the simulator waits for odom's readers alone
    _check_frames(heard)
    _check_plans(heard)
    _check_ticks(heard)
    _check_against(oracle, heard)


def _check_frames(heard):
    for topic, frame in (('goal', 'odom'), ('rotation', 'odom'), ('plan', 'odom')):
        assert {m.header.frame_id for m in heard[topic]} == {frame}
    assert {m.header.frame_id for m in heard['cmd_vel']} == {'base_link'}
    assert {m.child_frame_id for m in heard['odom']} == {'base_link'}


def _check_plans(heard):
    measured = {stamp(m): m for m in heard['odom']}
    for plan in (m for m in heard['plan'] if stamp(m) in measured):
        odometry = measured[stamp(plan)]
        begun = ns(odometry.header.stamp)
        assert [ns(p.header.stamp) for p in plan.poses] == [begun + k * 10**9 for k in range(6)]
        assert plan.poses[0].pose.position == odometry.pose.pose.position


def _check_ticks(heard):
    for message in heard['tick'][: len(heard['odom'])]:
        told = values(message)
        assert set(told) == {
            'status', 'reason', 'objective', 'lower_bound', 'gap', 'bound_checked',
            'infeasible_checked', 'nodes', 'solve_time_ms',
            'speed_fraction', 'projection_distance', 'fallback', 'cause', 'binding', 'advanced',
            'goal_stamps', 'goal_counts', 'disturbance', 'innovation',
            'earliest_catch', 'catch_bound', 'catch_checked', 'obstacles', 'obstacles_left_out',
            'clearance', 'traffic_stamps', 'margins',
        }  # fmt: skip
        assert told['status'] == 'optimal'
        assert json.loads(told['goal_stamps']) == {'goal': stamp(message)}
        assert told['fallback'] == ''
        assert float(told['lower_bound']) <= float(told['objective'])
        assert float(told['gap']) <= 1e-4
        assert float(told['solve_time_ms']) > 0.0
        fractions = json.loads(told['speed_fraction'])
        assert len(fractions) == 6
        assert min(fractions[1:]) >= np.sqrt(0.3) - 1e-6
        margins = json.loads(told['margins'])
        assert set(margins) == {'hull', 'floor'}
        assert min(margins.values()) >= -1e-6


def _check_against(oracle, heard):
    """What went over DDS is what the loop without ROS does; quaternions round differently."""
    twists = {stamp(m): m.twist for m in heard['cmd_vel']}
    for k, tick in enumerate(oracle.ticks[1:], start=1):
        twist = twists[10**9 * k]
        assert twist.linear.x == pytest.approx(tick.command.speed_fraction, abs=1e-5)
        assert twist.angular.z == pytest.approx(tick.command.body_rate[0], abs=1e-5)
    end = heard['odom'][-1].pose.pose.position
    assert [end.x, end.y] == pytest.approx(oracle.flights[-1].vehicle.position, abs=1e-5)


def test_qos_is_as_documented(launch, observer):
    launch('planner', {}, 'retrieval')
    launch('sim', {'wait_subscribers': 9}, 'retrieval')
    node = observer.node
    outputs = ('cmd_vel', 'rotation', 'plan', 'plan_markers', 'tick', 'odom', 'goal', 'captured')
    observer.until(lambda: all(node.count_publishers(t) for t in outputs), 'publishers')
    observer.until(lambda: node.count_subscribers('goal_path'), 'subscribers')
    for topic in outputs:
        profile = node.get_publishers_info_by_topic(topic)[0].qos_profile
        assert profile.reliability == ReliabilityPolicy.RELIABLE
        kept = (
            DurabilityPolicy.TRANSIENT_LOCAL if topic == 'captured' else DurabilityPolicy.VOLATILE
        )
        assert profile.durability == kept
    for topic in ('odom', 'goal', 'goal_path'):
        for info in node.get_subscriptions_info_by_topic(topic):
            assert info.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
            assert info.qos_profile.durability == DurabilityPolicy.VOLATILE
