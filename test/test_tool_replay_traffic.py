# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Replays of flights among traffic: the same hazards, whatever came late."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

from pathlib import Path

from visualization_msgs.msg import Marker, MarkerArray

from orbimpc_ros.mpc.problem import Ball
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.markers import shown
from orbimpc_ros.ros.messages import SECOND, Frames, RosTime, Stamp
from orbimpc_ros.ros.parameters.planner import PLANNER, planner_settings
from orbimpc_ros.sim.vehicle import Model, launched, measured
from orbimpc_ros.tool.bags import fields
from orbimpc_ros.tool.offline import OfflinePlanner, resolved
from orbimpc_ros.tool.replay.recording import Input, RecordedTick, Recording, published
from orbimpc_ros.tool.replay.resolving import replayed

FRAMES = Frames('odom', 'base_link')
OTHER = '/uav2/plan'
MILLISECOND = 10**6


def settings():
    values = {row.name: row.default for row in PLANNER}
    given = {'avoid': ('/uav1/plan', OTHER), 'avoid_radius': 0.5, 'horizon': 2, 'trigger': 'odom'}
    return planner_settings({**values, **given})


def seen(second, place):
    head = messages.header(second * SECOND, 'odom')
    return MarkerArray(markers=[shown(Marker(header=head), Ball(np.array(place), 0.4))])


def inputs(second):
    """Return what comes with a second's odometry, in the order in which it is sent."""
    stamp = Stamp(second * SECOND, FRAMES)
    vehicle = launched(Model(), np.array([0.5 * second, 0.0]), np.eye(2))
    away = [np.array([3.0 - 0.5 * k, -1.5]) for k in range(4)]
    found = {
        'obstacles': seen(second, (0.5 * second + 1.5, 1.6 - 0.3 * second)),
        OTHER: messages.goal_path_message(stamp, 1.0, away),
        'goal': messages.goal_message(stamp, np.array([9.0, 0.0])),
        'odom': messages.odometry_message(stamp, measured(vehicle)),
    }
    sent = second * SECOND
    return [Input(t, sent, sent + k * MILLISECOND, m) for k, (t, m) in enumerate(found.items())]


def flown(late):
    """Return a recording of three ticks, and the clearance of each.

    What is ``late`` was sent before one and heard after.
    """
    planner = OfflinePlanner(settings(), '/uav1/planner', resolved(settings(), '/uav1'))
    told, answers, pending, clearances = [], [], [], []
    for second in range(1, 4):
        for each in inputs(second):
            told.append(each)
            if each.topic in late:
                pending.append(each)
            else:
                planner.inputs.update(
                    each.topic, each.message, each.sent / SECOND, RosTime(each.sent)
                )
        sent = second * SECOND + 50 * MILLISECOND
        answer = planner.plan(sent / SECOND, 0.0, 1.0)
        planner.went_out(sent / SECOND)
        answers.append(RecordedTick(second * SECOND, sent, published(answer)))
        clearances.append(fields(answer['tick'])['clearance'])
        for each in pending:
            planner.inputs.update(each.topic, each.message, each.sent / SECOND, RosTime(each.sent))
        pending.clear()
    return Recording(Path('none'), '/uav1', tuple(told), tuple(answers)), clearances


@pytest.mark.parametrize('late', [(), ('obstacles',), (OTHER,)], ids=['none', 'markers', 'plans'])
def test_the_commands_are_those_that_were_given(late):
    recording, clearances = flown(late)
    ticks = replayed(recording, settings(), simulated=False)
    for again, clearance in zip(ticks, clearances, strict=True):
        now, then = published(again.messages), again.recorded.answer
        assert again.refusals == ()
        assert now['traffic_stamps'] == then['traffic_stamps']
        assert (now['speed'], now['status']) == (then['speed'], then['status'])
        np.testing.assert_array_equal(now['body_rate'], then['body_rate'])
        found = fields(again.messages['tick'])['clearance']
        assert found == pytest.approx(clearance, nan_ok=True)


def test_what_was_heard_late_makes_a_difference():
    """Else the tests above would pass without the stamps on ``tick``."""
    assert flown(())[1] != flown(('obstacles',))[1]
