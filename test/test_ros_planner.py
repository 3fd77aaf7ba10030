# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner as a process: its messages while it waits, its topics, resets and signals."""

import itertools
import signal
import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from harness import python
from nav_msgs.msg import Odometry, Path
from planners import FRAMES, QUICK, Bench, goal, moving, odometry, told
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64, UInt8MultiArray
from visualization_msgs.msg import Marker, MarkerArray

from orbimpc_ros.mpc.problem import Ball
from orbimpc_ros.mpc.proof.document import parsed, verified
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import Stamp, shown
from orbimpc_ros.ros.process import qos
from orbimpc_ros.ros.topics import NUMBERS


def test_that_nothing_is_feasible_is_published_with_its_proof(launch, observer):
    slow = {'step': 2.0, 'horizon': 2}  # leaves a second per tick, for busy machines
    asked = slow | {'terminal': 'constraint', 'publish_certificate': 'true'}
    proofs = observer.listen(UInt8MultiArray, 'certificate')
    bench = Bench(launch, observer, QUICK | asked)
    observer.until_connected('certificate')
    command = bench.fly(7.25)  # the goal is 5 m away, the reach 4 m
    assert not moving(command)
    bench.until(lambda: proofs, 'the proof')
    verdict = verified(parsed(bytes(proofs[-1].data)))
    assert verdict.holds
    assert verdict.claimed == np.inf
    assert bench.report(command)['status'] == 'infeasible'
    assert bench.report(command)['infeasible_checked'] == 'true'


def test_a_reader_that_came_too_late_hears_the_report_when_the_answer_is_repeated(launch, observer):
    """Nobody subscribed during the first tick, so that its report was not even made."""
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


@pytest.fixture(scope='module')
def bench(shared):
    """Return a planner that tests share, each with later stamps."""
    return Bench(*shared, QUICK)


def test_after_a_reset_it_flies_to_the_same_goal_and_disabled_it_is_safe(bench):
    assert moving(bench.fly(100.0))
    flown = len(bench.commands)
    kept = 'plan, estimates and inputs forgotten, but for goals by hand and bodies that last'
    assert bench.reset().message == kept
    bench.until(lambda: len(bench.commands) >= flown + 3, 'safe commands')
    assert not any(moving(command) for command in bench.commands[flown:])
    bench.until(lambda: 'reset' in {told(tick)['cause'] for tick in bench.ticks}, 'the cause')
    bench.says('waits for odometry on /odom')
    flown = len(bench.commands)

    def goes_on():
        bench.odometry.publish(odometry(1.0))  # an older stamp than before, and no further goal
        return any(map(moving, bench.commands[flown:]))

    bench.until(goes_on, 'a command to move')
    assert bench.enable(False)
    assert not moving(bench.fly(2.0))
    bench.until(lambda: told(bench.ticks[-1])['cause'] == 'disabled', 'the cause')
    bench.says('disabled')
    bench.enable(True)
    assert moving(bench.fly(3.0))


def test_a_timer_may_be_quicker_than_a_step(launch, observer):
    """With steps of ten minutes, commands still come at the timer's period."""
    bench = Bench(launch, observer, {'trigger': 'timer', 'step': 600.0, 'plan_period': 0.1,
                                     'forward': 0.01, 'odom_timeout': 60.0,
                                     'goal_timeout': 60.0})  # fmt: skip
    bench.fly(1.0)
    bench.until(lambda: sum(map(moving, bench.commands)) >= 4, 'commands by the timer')
    bench.report(bench.commands[-1])
    assert {told(tick)['fallback'] for tick in bench.ticks} == {''}


def test_a_timer_whose_clock_never_starts_or_stands_still_is_noticed(launch, observer):
    clock = observer.node.create_publisher(Clock, '/clock', qos())
    patient = {'trigger': 'timer', 'step': 0.1, 'odom_timeout': 0.5, 'goal_timeout': 60.0}
    bench = Bench(launch, observer, patient | {'use_sim_time': True})
    observer.until(clock.get_subscription_count, 'the planner listening to time')
    untimed = 'use_sim_time is true, and nothing has come on /clock for'
    assert level(bench, untimed) == DiagnosticStatus.WARN
    assert 'time of /clock' in bench.planner.output
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
    assert said(bench, f'over: {untimed}') == 1
    words = 'the clock has stood still for'  # odometry, stamped little later, stays fresh
    bench.until(lambda: any(words in reason for reason in told_of_later(1e-4, False)), words)
    assert not moving(bench.commands[-1])


def test_odometry_sent_again_is_answered_though_its_goal_came_late(launch, observer):
    """Simulated time stands still for a simulator whose first goal was lost in discovery."""
    clock = observer.node.create_publisher(Clock, '/clock', qos())
    bench = Bench(launch, observer, QUICK | {'use_sim_time': True, 'odom_timeout': 0.2})
    observer.until(clock.get_subscription_count, 'the planner listening to time')

    def sent(publisher, message):
        clock.publish(Clock(clock=messages.time_message(10**9)))
        publisher.publish(message)

    def waits():
        sent(bench.odometry, odometry(1.0))
        return any('waits for a goal' in m.status[0].message for m in bench.health)

    bench.until(waits, 'odometry')
    time.sleep(0.5)  # longer than odometry is fresh

    def refused_again():
        sent(bench.goal, goal(1.0))
        return 'refused goal: duplicate stamp' in told(bench.health[-1])

    bench.until(refused_again, 'a goal')
    assert not bench.commands
    bench.until(lambda: sent(bench.odometry, odometry(1.0)) or bench.commands, 'a command')
    assert moving(bench.commands[0])


# --- among obstacles and other vehicles


OTHER = '/uav2/plan'


def planned_with(crowded, count, seconds):
    """Send odometry until a tick has been planned with ``count`` hazards."""
    stamps = iter(np.arange(seconds, seconds + 60.0, 0.05))

    def done():
        crowded.fly(float(next(stamps)))
        return crowded.ticks and told(crowded.ticks[-1])['obstacles'] == str(count)

    crowded.until(done, f'{count} hazards')


def test_bodies_and_plans_are_planned_with_and_who_is_not_heard_is_told_of(launch, observer):
    crowded = Bench(launch, observer, QUICK | {'avoid': ['/plan', OTHER], 'avoid_radius': 0.5})
    crowded.fly(1.0)
    crowded.says(f'nothing heard on {OTHER}: not avoided')
    markers = observer.node.create_publisher(MarkerArray, 'obstacles', qos(10))
    plans = observer.node.create_publisher(Path, OTHER, qos())
    for each in (markers, plans):
        observer.until(each.get_subscription_count, 'the planner listening')
    marker = Marker(header=messages.header(10**9, 'odom'))
    markers.publish(MarkerArray(markers=[shown(marker, Ball(np.array([0.3, 0.6]), 0.2))]))
    planned_with(crowded, 1, 1.1)
    now = crowded.ticks[-1].header.stamp.sec + 1.0
    places = [np.array([0.1 * k, -0.9]) for k in range(5)]
    plans.publish(
        messages.path_message(Stamp(round(now * 1e9), FRAMES), 0.1, map(messages.pose, places))
    )
    planned_with(crowded, 2, now)


# --- the console and /diagnostics: each message once, with its level and its consequences


def said(bench, words):
    """Wait until the console shows ``words``; return how often it does."""
    bench.until(lambda: words in bench.planner.output, words)
    return bench.planner.output.count(words)


def level(bench, words):
    """Wait until the diagnostics contain ``words``; return their level."""
    bench.says(words)
    return [m.status[0].level for m in bench.health if words in m.status[0].message][-1]


def test_what_is_believed_in_is_said_and_who_else_comes_and_goes(launch, observer):
    given = QUICK | {'forward': 15.0, 'max_rate': 25.0, 'floor.faces': 8}
    bench, node = Bench(launch, observer, given), observer.node
    assert said(bench, '15 m/s, at most 1432 deg/s, 0.1 s x 5') == 1
    for doubt in ('max_rate is 25 rad/s, 1432 deg/s: 0.4363', 'floor.faces 8 has no effect with'):
        assert said(bench, doubt) == 1
    rival = node.create_publisher(TwistStamped, 'cmd_vel', qos())
    assert said(bench, '2 publishers on /cmd_vel: the vehicle hears them all') == 1
    assert level(bench, '2 publishers on /cmd_vel') >= DiagnosticStatus.WARN
    node.destroy_publisher(rival)
    assert said(bench, 'over: 2 publishers on /cmd_vel') == 1
    other = node.create_publisher(Twist, 'goal_path', qos())
    mismatch = '/goal_path of /observer is a geometry_msgs/msg/Twist, not a nav_msgs/msg/Path'
    assert said(bench, mismatch) == 1
    assert level(bench, mismatch) == DiagnosticStatus.ERROR
    node.destroy_publisher(other)
    assert said(bench, 'over: /goal_path of /observer is a') == 1


def test_numbers_come_on_topics_of_their_own(bench):
    observer = bench.observer
    heard = {name: observer.listen(Float64, f'/planner/{name}') for name in NUMBERS}
    observer.until_connected(*(f'/planner/{name}' for name in NUMBERS))
    stamps = itertools.count(1010)
    bench.until(lambda: bench.fly(0.1 * next(stamps)) and all(heard.values()), 'numbers')
    assert heard['distance'][-1].data == pytest.approx(5.0)
    cost = heard['objective'][-1].data

    def on_a_tick():  # messages of different topics come in any order
        return any(float(told(tick)['objective']) == cost for tick in bench.ticks)

    bench.until(on_a_tick, 'the tick of that cost')
    assert heard['lower_bound'][-1].data <= heard['objective'][-1].data
    assert 0.0 <= heard['gap'][-1].data <= 1.0
    assert any(each.data > 0.0 for each in heard['solve_time'])  # 0 for a safe command


def test_a_first_start_says_that_it_compiles_and_ends_at_a_signal(
    launch, observer, tmp_path, monkeypatch
):
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path / 'empty'))
    planner = launch('planner', {'floor.shape': 'circle'})
    words = 'compiling machine code, only once: function 1, 0 s'
    observer.until(lambda: words in planner.output, words)
    planner.send_signal(signal.SIGINT)
    assert planner.wait() == 0
    assert 'Traceback' not in planner.output


IN_A_CALLBACK = """
    import ctypes, os, signal, sys
    from orbimpc_ros.ros.entry import leave_at_signals

    def kill():
        os.kill(os.getpid(), signal.{signal})

    leave_at_signals()
    ctypes.CFUNCTYPE(None)(kill)()  # as LLVM calls back: exceptions are dropped there
    sys.exit('it went on')
"""


@pytest.mark.parametrize('name', ['SIGINT', 'SIGTERM'])
def test_a_signal_in_a_callback_of_native_code_ends_a_start(name):
    done = python(IN_A_CALLBACK.format(signal=name))
    assert (done.returncode, done.stdout, done.stderr) == (0, '', '')


def test_who_has_commanded_nothing_leaves_without_a_command(launch, observer):
    bench = Bench(launch, observer, QUICK)
    bench.says('waits for')
    bench.planner.send_signal(signal.SIGINT)
    assert bench.planner.wait() == 0
    own = observer.node.create_publisher(TwistStamped, 'cmd_vel', qos())
    bench.until(own.get_subscription_count, 'this test')
    own.publish(TwistStamped())
    bench.until(lambda: bench.commands, 'whatever was commanded')
    assert bench.commands == [TwistStamped()]  # an earlier command would come first
