# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner as a process: what it says while it waits, what it publishes, how it begins again."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped
from nav_msgs.msg import Odometry
from planners import QUICK, Bench, goal, moving, odometry, told
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from std_msgs.msg import UInt8MultiArray
from std_srvs.srv import SetBool, Trigger

from orbimpc_ros.mpc.proof.document import verified
from orbimpc_ros.mpc.proof.reading import parsed
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.process import qos


@pytest.fixture
def bench(launch, observer):
    return Bench(launch, observer, QUICK)


@pytest.fixture(scope='module')
def veteran(shared):
    return Bench(*shared, QUICK)


@pytest.fixture
def flying(veteran):
    """A planner that has flown before, made to forget it."""
    call = veteran.observer.call
    assert call(SetBool, '/planner/enable', SetBool.Request(data=True)).success
    assert call(Trigger, '/planner/reset', Trigger.Request()).success
    return veteran


def test_that_nothing_is_feasible_is_published_with_its_proof(launch, observer):
    slow = {'step': 2.0, 'horizon': 2}  # with a second for a tick, however busy the machine is
    asked = slow | {'terminal': 'constraint', 'publish_certificate': 'true'}
    proofs = observer.listen(UInt8MultiArray, 'certificate')
    bench = Bench(launch, observer, QUICK | asked)
    observer.until_connected('certificate')
    command = bench.fly(7.25)  # the goal is 5 m away, and 4 m are in reach
    assert not moving(command)
    bench.until(lambda: proofs, 'the proof')
    verdict = verified(parsed(bytes(proofs[-1].data)))
    assert verdict.holds
    assert verdict.claimed == np.inf
    assert bench.report(command)['status'] == 'infeasible'
    assert bench.report(command)['infeasible_checked'] == 'true'


def test_a_reader_that_came_too_late_hears_the_report_when_the_answer_is_repeated(launch, observer):
    """Nobody heard the first tick, so its report was not even made."""
    commands = observer.listen(TwistStamped, 'cmd_vel')
    sources = [observer.node.create_publisher(kind, topic, qos())
               for kind, topic in ((Odometry, 'odom'), (PoseStamped, 'goal'))]  # fmt: skip
    launch('planner', {'trigger': 'odom', 'odom_timeout': 1e3, 'goal_timeout': 1e3})
    observer.until_connected('cmd_vel')

    def asked_for(heard):
        for source, message in zip(sources, (odometry(1.0), goal(1.0)), strict=True):
            source.publish(message)
        return heard

    observer.until(lambda: asked_for(commands), 'a command')
    ticks = observer.listen(DiagnosticArray, 'tick')
    observer.until(lambda: asked_for(ticks), 'its report')
    assert ticks[0].header.stamp == commands[0].header.stamp
    assert told(ticks[0])['status'] == 'optimal'


def test_disabled_means_the_safe_command_again_and_again(flying):
    assert moving(flying.fly(1.0))
    response = flying.observer.call(SetBool, '/planner/enable', SetBool.Request(data=False))
    assert response.success
    assert not moving(flying.fly(2.0))
    flying.until(lambda: told(flying.ticks[-1])['cause'] == 'disabled', 'the cause')
    flying.says('disabled')
    flying.observer.call(SetBool, '/planner/enable', SetBool.Request(data=True))
    assert moving(flying.fly(3.0))


def test_after_a_reset_it_flies_to_the_same_goal_as_soon_as_there_is_odometry(bench):
    bench.fly(100.0)
    flown = len(bench.commands)
    answer = bench.observer.call(Trigger, '/planner/reset', Trigger.Request())
    assert answer.message == 'plan, estimates and inputs forgotten, but for a goal sent by hand'
    bench.until(lambda: len(bench.commands) >= flown + 3, 'safe commands')
    assert not any(moving(command) for command in bench.commands[flown:])
    bench.until(lambda: 'reset' in {told(tick)['cause'] for tick in bench.ticks}, 'the cause')
    bench.says('waits for odometry on /odom')
    flown = len(bench.commands)

    def goes_on():
        bench.odometry.publish(odometry(1.0))  # an older stamp than before, and no goal again
        return any(map(moving, bench.commands[flown:]))

    bench.until(goes_on, 'a command to move')


def test_a_timer_may_be_quicker_than_a_step(launch, observer):
    """With steps of ten minutes, commands come at all."""
    bench = Bench(launch, observer, {'trigger': 'timer', 'step': 600.0, 'plan_period': 0.1,
                                     'forward': 0.01, 'odom_timeout': 60.0,
                                     'goal_timeout': 60.0})  # fmt: skip
    bench.fly(1.0)
    bench.until(lambda: sum(map(moving, bench.commands)) >= 4, 'commands by the timer')
    bench.report(bench.commands[-1])
    assert {told(tick)['fallback'] for tick in bench.ticks} == {''}


def test_a_flight_without_capture_ends_with_code_1(launch):
    launch('planner', {'trigger': 'odom'})
    sim = launch('sim', {'max_ticks': 3, 'exit_when_done': True})
    assert sim.wait() == 1, sim.output
    assert 'not captured' in sim.output


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
