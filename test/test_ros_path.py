# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The path of a command through the package: from odometry to ``cmd_vel`` in few files."""

import sys
import time
from itertools import groupby
from operator import le
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import planners
import pytest
from geometry_msgs.msg import PoseStamped
from harness import PATIENCE, ROOT
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.executors import SingleThreadedExecutor
from rclpy.publisher import Publisher
from visualization_msgs.msg import MarkerArray

from orbimpc_ros.loop.planner import Planner
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.planner import node as planner_node
from orbimpc_ros.ros.planner.core import planner_of
from orbimpc_ros.ros.planner.node import EndpointMonitor, PlannerNode

PACKAGE = ROOT / 'orbimpc_ros'
# From odometry to its command, in the retrieval: files on the path, calls from one file to another,
# and the calls among them to a file passed before.
FILES, HOPS, RETURNS = 18, 42, 25


class Trace:
    """A profiler that records the file of each call from odometry to ``cmd_vel``."""

    def __init__(self):
        self._current, self.complete = [], None

    def __call__(self, frame, event, argument):
        if event != 'call' or self.complete is not None:
            return
        file = Path(frame.f_code.co_filename)
        caller = frame.f_back.f_code.co_filename if frame.f_back else ''
        if file.is_relative_to(PACKAGE):
            if '/rclpy/' in caller:
                self._current = []  # a new callback
            self._current.append(file.relative_to(PACKAGE).as_posix())
        elif frame.f_code is Publisher.publish.__code__:
            topic = frame.f_locals['self'].topic_name
            if topic.endswith('/cmd_vel'):
                self.complete = list(self._current)


@pytest.fixture
def unconfigured(domain, default_context):
    """The planner's node in this process, with the parameters of the retrieval."""
    file = ROOT / 'config' / 'retrieval.yaml'
    words = ['planner', '--ros-args', '--params-file', str(file), '-p', 'use_sim_time:=false']
    default_context.init(words, domain_id=domain)
    node = PlannerNode()
    yield node
    node.destroy_node()


@pytest.fixture
def planner(unconfigured):
    """The planner's node, configured and active, and its executor."""
    node, executor = unconfigured, SingleThreadedExecutor(context=unconfigured.context)
    node.begin()
    executor.add_node(node)
    yield node, executor
    executor.shutdown()


def message(topic):
    """Return a message stamped now: odometry at the origin, or a goal ahead."""
    now = time.time()
    return planners.goal(now, y=0.5) if topic == 'goal' else planners.odometry(now)


def hear(node, topic):
    node._hear(topic, message(topic))


def spin_until(executor, happened):
    end = time.monotonic() + PATIENCE
    while not happened():
        assert time.monotonic() < end, 'in vain'
        executor.spin_once(timeout_sec=0.1)


def calls_on_the_way(executor, goal, odometry):
    """Return the file of each call from odometry to its command, in order.

    ``goal`` and ``odometry`` are publishers, kept: a second one per topic would be a rival.
    """
    trace = Trace()

    def answered():  # repeated, as the first may be lost in discovery
        # The goal's stamp is older, so that odometry does not wait for one.
        goal.publish(message('goal'))
        odometry.publish(message('odom'))
        return trace.complete

    sys.setprofile(trace)
    try:
        spin_until(executor, answered)
    finally:
        sys.setprofile(None)
    return trace.complete


def test_a_command_passes_few_files(planner):
    node, executor = planner
    goal = node.create_publisher(PoseStamped, 'goal', 1)
    odometry = node.create_publisher(Odometry, 'odom', 1)
    calls_on_the_way(executor, goal, odometry)  # the first call fills caches
    calls = calls_on_the_way(executor, goal, odometry)
    way = [file for file, _ in groupby(calls)]
    assert way[0] == 'ros/process.py'  # the guard of every callback
    files, hops = len(set(way)), len(way) - 1
    found = files, hops, hops + 1 - files
    assert all(map(le, found, (FILES, HOPS, RETURNS))), f'{found}\n' + '\n'.join(way)


def test_what_is_watched_waits_for_commands_and_not_the_other_way_round(planner, monkeypatch):
    node, _ = planner
    shown, done = [100.0], []
    monkeypatch.setattr(node, 'steady_now', lambda: shown[0])
    for owner, name in ((node._core.planner, 'sent'), (node._monitor, 'look')):
        plain = getattr(owner, name)
        monkeypatch.setattr(
            owner, name, lambda *a, _plain=plain, _name=name: done.append(_name) or _plain(*a)
        )
    hear(node, 'goal')
    for later in (0.0, 0.02, 0.04):  # odometry every 20 ms; monitoring every 50 ms
        shown[0] = 100.0 + later
        hear(node, 'odom')
    assert done == ['sent', 'look', 'sent', 'sent', 'look']


def test_what_a_tick_made_in_too_long_a_time_is_not_flown(planner, monkeypatch):
    (node, _), sent, reports, shown, durations = planner, [], [], [100.0], [0.0, 1000.0, 0.0, 0.0]
    step = node._core.planner.step

    def lasting(*inputs):
        decision = step(*inputs)
        shown[0] += durations.pop(0)
        return decision

    monkeypatch.setattr(node, 'steady_now', lambda: shown[0])
    monkeypatch.setattr(node._core, '_clock', lambda: shown[0])
    monkeypatch.setattr(node._core.planner, 'step', lasting)
    monkeypatch.setattr(node._core.planner, 'sent', lambda command, _at: sent.append(command))
    for _ in range(3):
        hear(node, 'goal')
        hear(node, 'odom')
        reports.append(node._decision)
    assert [each.command for each in reports] == sent
    assert [each.fallback for each in reports] == ['', 'safe command', '']
    assert reports[1].reason.startswith('odometry is')


def test_a_planner_can_be_seen_before_it_compiles_and_listens_only_then(unconfigured, monkeypatch):
    node, seen = unconfigured, []

    def compiled(settings):
        seen.extend(each.topic_name for each in (*node.publishers, *node.subscriptions))
        return planner_of(settings)

    monkeypatch.setattr(planner_node, 'planner_of', compiled)
    node.begin()
    assert '/cmd_vel' in seen
    assert not {'/odom', '/goal'}.intersection(seen)


def test_who_may_tell_of_obstacles_has_the_planner_get_ready(planner, monkeypatch):
    """It prepares when a publisher appears, as the first message is often in flight by then."""
    (node, executor), ready = planner, []
    monkeypatch.setattr(Planner, 'expect_hazards', lambda _: ready.append(True))
    executor.spin_once(timeout_sec=0.1)
    assert not ready
    node.create_publisher(MarkerArray, 'obstacles', 1)
    spin_until(executor, lambda: ready)


def test_a_warning_beside_a_plan_leaves_the_plan_a_normal_condition(planner, capfd):
    node, _ = planner
    for topic in ('goal', 'odom'):
        hear(node, topic)
    node._refusal, node._refused_at = 'odd', node.steady_now()
    node._show_changes()
    node._enabled = False  # the plan ends
    node._show_changes()
    assert 'over: planning' not in capfd.readouterr().err


def test_a_path_is_reached_at_its_end_and_another_path_or_activation_begins_anew(planner):
    node, _ = planner
    for places, reached in (([(0, 0), (9, 0)], False), ([(9, 0), (0, 0)], True)):
        poses = [PoseStamped(pose=messages.pose(np.array(place))) for place in places]
        node._hear(
            'goal_path', PathMessage(header=messages.header(time.time_ns(), 'odom'), poses=poses)
        )
        assert not node._events.caught
        hear(node, 'odom')
        assert node._events.caught == node._shown['caught'] == reached
        assert node._core.look_for(node._events) == 0.0  # the distance from the path
    node.trigger_deactivate()
    node.trigger_activate()
    assert node._shown == {'arrived': False, 'caught': False}


def test_either_half_of_odometry_has_one_source():
    counts = {'pose': 1, 'twist': 2}
    ends = [SimpleNamespace(topic_name=name) for name in counts]
    graph = SimpleNamespace(count_publishers=counts.get, publishers=[], subscriptions=ends)
    graph.get_publishers_info_by_topic = graph.get_subscriptions_info_by_topic = lambda _: []
    monitor = EndpointMonitor(graph, ends, [])
    monitor.look()
    assert monitor.sources == '2 publishers on twist, of which only one can be right'
