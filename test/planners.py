# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Inputs of planners under test, and a live planner with its inputs published by a test."""

from __future__ import annotations

import math
import time
from types import SimpleNamespace

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, Transform, TransformStamped, TwistStamped
from nav_msgs.msg import Odometry
from std_srvs.srv import SetBool, Trigger
from stepping import launched

from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import SECOND, Frames, Stamp
from orbimpc_ros.ros.parameters.planner import PLANNER, planner_settings
from orbimpc_ros.ros.parameters.spec import completed
from orbimpc_ros.ros.process import qos
from orbimpc_ros.sim.vehicle import Model, measured

FRAMES = Frames('odom', 'base_link')
UNHEARD = 0.3  # [s] the same for a first goal: less than odometry may wait for it
LOST = 10.0  # [s] without an answer before inputs are sent again: a busy planner may need a second
QUICK = {'trigger': 'odom', 'step': 0.1, 'odom_timeout': 0.8}


def settings(**given):
    """Return the planner settings for these parameters, by exact names or as keywords."""
    return planner_settings(completed(PLANNER, given))


def stamp(seconds):
    return Stamp(round(seconds * 1e9), FRAMES)


def odometry(seconds, position=(0.0, 0.0)):
    vehicle = launched(Model(), np.array(position), np.eye(2))
    return messages.odometry_message(stamp(seconds), measured(vehicle))


def goal(seconds, x=5.0, y=0.0):
    return messages.goal_message(stamp(seconds), np.array([x, y]))


def tf(seconds, parent, child, place, yaw=0.0):
    """Return a message of one transform, with the fields of a tf2_msgs/TFMessage."""
    turned = messages.quaternion(exp(np.array([0.0, 0.0, yaw])))
    transform = Transform(translation=messages.vector(np.array(place)), rotation=turned)
    head = messages.header(round(seconds * SECOND), parent)
    one = TransformStamped(header=head, child_frame_id=child, transform=transform)
    return SimpleNamespace(transforms=[one])


def told(message):
    return {pair.key: pair.value for pair in message.status[0].values}


def moving(message):
    twist = message.twist
    return twist.linear.x != 0.0 or twist.angular.z != 0.0


class Bench:
    """A live planner whose inputs the test publishes."""

    def __init__(self, launch, observer, parameters, planner='planner'):
        self.observer = observer
        self.commands = observer.listen(TwistStamped, 'cmd_vel')
        self.ticks = observer.listen(DiagnosticArray, 'tick')
        self.health = observer.listen(DiagnosticArray, '/diagnostics')
        node = observer.node
        self.odometry = node.create_publisher(Odometry, 'odom', qos())
        self.goal = node.create_publisher(PoseStamped, 'goal', qos())
        self.planner = launch(planner, parameters)
        if parameters.get('autostart', True):
            observer.until_connected('cmd_vel', 'tick', '/diagnostics')
            for publisher in (self.odometry, self.goal):
                observer.until(publisher.get_subscription_count, 'the planner listening')

    def enable(self, on):
        call, request = self.observer.call, SetBool.Request(data=on)
        return call(SetBool, '/planner/enable', request).success

    def reset(self):
        return self.observer.call(Trigger, '/planner/reset', Trigger.Request())

    def until(self, *arguments):
        self.observer.until(*arguments)

    def says(self, words):
        """Wait until a message of the planner's diagnostics contains ``words``."""
        self.until(lambda: any(words in m.status[0].message for m in self.health), words)

    def counts(self, what):
        """Wait until the planner's diagnostics have a counter; return its value."""
        self.until(lambda: self.health and what in told(self.health[-1]), what)
        return int(told(self.health[-1])[what])

    def report(self, command):
        """Wait for the tick of a command, which may arrive after it; return its values."""

        def reports():
            return [told(m) for m in self.ticks if m.header.stamp == command.header.stamp]

        self.until(reports, 'the tick of a command')
        return reports()[0]

    def fly(self, seconds):
        """Send odometry and goal of a stamp, again if lost; return the command for them.

        Odometry sent twice is answered twice, and the second answer arrives at an unexpected time.
        But odometry whose goal is lost would become stale: before the first command, the goal is
        sent again soon.
        """
        sent = [odometry(seconds), goal(seconds)]
        before, again, soon = len(self.commands), -math.inf, -math.inf

        def answer():
            nonlocal again, soon
            if time.monotonic() > (again if self.commands else soon):
                soon = time.monotonic() + UNHEARD
                self.goal.publish(sent[1])
            if time.monotonic() > again:  # best effort: may be lost during discovery
                again = time.monotonic() + LOST
                self.odometry.publish(sent[0])
            later = self.commands[before:]
            return [c for c in later if c.header.stamp == sent[0].header.stamp]

        self.until(answer, 'a command')
        return answer()[0]
