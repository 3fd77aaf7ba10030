# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""What planner and simulator ask of DDS; that they fly as they do without it, the demos show."""

import pytest

pytest.importorskip('rclpy')

from rclpy.qos import DurabilityPolicy, ReliabilityPolicy


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
