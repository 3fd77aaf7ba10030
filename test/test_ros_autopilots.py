# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Planners on the topics of autopilots, with the QoS, the rates and the frames that these have."""

import math
import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped
from nav_msgs.msg import Odometry
from planners import told
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool

from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.firmware import TOPICS
from orbimpc_ros.ros.messages import header

BEST_EFFORT = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
RATE = 30.0  # [Hz] of the autopilot's messages
FRAMES = {'ardupilot': 'base_link', 'mavros': 'map', 'rover': 'odom'}  # of poses
GOAL = np.array([3.0, 1.0])


class Autopilot:
    """A vehicle in the plane under an autopilot: it tells its state, and does as it is told."""

    def __init__(self, name, launch, observer, **parameters):
        self.observer, self.frame, topics = observer, FRAMES[name], TOPICS[name]
        node, self.halves = observer.node, 'pose' in topics
        kinds = {'pose': PoseStamped, 'twist': TwistStamped} if self.halves else {'odom': Odometry}
        self.said = {
            topic: node.create_publisher(kind, topics.get(topic, topic), BEST_EFFORT)
            for topic, kind in kinds.items()
        }
        self.goal = node.create_publisher(PoseStamped, 'goal', 1)
        self.switch = node.create_publisher(Bool, 'engaged', 1)
        self.commands = observer.listen(TwistStamped, topics.get('cmd_vel', 'cmd_vel'))
        self.ticks = observer.listen(DiagnosticArray, 'tick')
        self.health = observer.listen(DiagnosticArray, '/diagnostics')
        self.planner = launch('planner', parameters, name, remapped=dict(topics))
        observer.until_connected('tick')
        self.position, self.heading, self.speed = np.zeros(2), 2.0, 0.5
        self.at = time.time()

    def fly_until(self, happened, what, *, engaged=lambda now: True):
        """Fly until something has happened; ``engaged`` says when it takes commands."""

        def step():
            now = time.time()
            if now - self.at >= 1.0 / RATE:
                self._move(now - self.at)
                self.at = now
                self._tell(now)
                self.switch.publish(Bool(data=engaged(now)))
            return happened()

        self.observer.until(step, what)

    def _move(self, seconds):
        if self.commands:
            twist = self.commands[-1].twist
            self.speed = twist.linear.x
            self.heading += seconds * twist.angular.z
        self.position = self.position + seconds * self.velocity

    @property
    def velocity(self):
        return self.speed * np.array([math.cos(self.heading), math.sin(self.heading)])

    def _tell(self, now):
        stamp, turned = round(now * 1e9), exp(np.array([0.0, 0.0, self.heading]))
        place = messages.pose(np.append(self.position, 10.0), turned)
        head = header(stamp, self.frame)
        in_world = messages.vector(np.append(self.velocity, 0.0))
        in_body = messages.vector(np.array([self.speed, 0.0, 0.0]))
        if self.halves:  # ArduPilot: one frame for both, a velocity of the world
            twist = TwistStamped(header=head)
            twist.twist.linear = in_world
            self.said['twist'].publish(twist)
            self.said['pose'].publish(PoseStamped(header=head, pose=place))
        else:
            odometry = Odometry(header=head, child_frame_id='base_link')
            odometry.pose.pose = place
            odometry.twist.twist.linear = in_body
            self.said['odom'].publish(odometry)
        goal = messages.pose(np.append(GOAL, 0.0), np.eye(3))
        self.goal.publish(PoseStamped(header=head, pose=goal))

    @property
    def arrived(self):
        return np.linalg.norm(self.position - GOAL) < 0.5


@pytest.mark.parametrize('name', FRAMES)
def test_a_vehicle_under_an_autopilot_arrives(name, launch, observer):
    autopilot = Autopilot(name, launch, observer)
    autopilot.fly_until(lambda: autopilot.arrived, 'arrival')
    assert {command.header.frame_id for command in autopilot.commands} == {'base_link'}
    assert told(autopilot.ticks[-1])['status'] in ('optimal', 'feasible')
    assert autopilot.planner.stop() == 0
    assert 'velocity_frame' not in autopilot.planner.output


def test_an_autopilot_that_is_not_engaged_is_told_nothing(launch, observer):
    autopilot = Autopilot('ardupilot', launch, observer)
    autopilot.fly_until(lambda: len(autopilot.ticks) > 10, 'plans', engaged=lambda now: False)
    assert not autopilot.commands
    autopilot.fly_until(lambda: len(autopilot.commands) > 5, 'commands')
    until = len(autopilot.ticks) + 20
    autopilot.fly_until(lambda: len(autopilot.ticks) > until, 'plans', engaged=lambda now: False)
    before = len(autopilot.commands)
    autopilot.fly_until(
        lambda: len(autopilot.ticks) > until + 20, 'plans', engaged=lambda now: False
    )
    assert len(autopilot.commands) == before
    assert autopilot.planner.stop() == 0
    topic = TOPICS['ardupilot']['cmd_vel']
    observer.until(lambda: not observer.node.count_publishers(topic), 'its end')
    assert len(autopilot.commands) == before  # nor at the end
    for words in ('engaged: commands', 'not engaged: silent'):
        assert words in autopilot.planner.output
