# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner as a process: what it says while it waits, what it refuses, how it stops."""

import itertools
import json
import signal
import time

import numpy as np
import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from nav_msgs.msg import Odometry, Path
from planners import FRAMES, QUICK, Bench, goal, moving, odometry, told
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy
from std_msgs.msg import Bool, UInt8MultiArray
from std_srvs.srv import SetBool, Trigger

from orbimpc_ros.mpc.proof.verifier import parsed, verified
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import Stamp
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


def test_without_odometry_and_goal_nothing_moves_and_it_says_what_it_waits_for(bench):
    bench.says('waits for odometry on /odom and a goal on /goal or /goal_path')
    bench.odometry.publish(odometry(1.0))
    bench.says('waits for a goal')
    assert bench.commands == []
    assert 'waits for odometry on /odom' in bench.planner.output
    bench.goal.publish(goal(1.0))  # the odometry still waits for it, and is fresh or stale
    bench.until(lambda: 'ready' in bench.health[-1].status[0].message or bench.commands, 'a goal')


def test_malformed_messages_are_dropped_and_counted_and_the_loop_goes_on(flying):
    assert moving(flying.fly(1.0))
    bad = odometry(2.0)
    bad.pose.pose.position.x = float('nan')
    flying.odometry.publish(bad)
    assert flying.counts('refused odom: pose.position') == 1
    bad = odometry(2.0)
    bad.header.stamp.sec = -1
    flying.odometry.publish(bad)
    assert flying.counts('refused odom: header.stamp.sec') == 1
    bad = goal(2.0)
    bad.header.frame_id = 'map'
    flying.goal.publish(bad)
    assert flying.counts('refused goal: header.frame_id') == 1
    assert moving(flying.fly(3.0))


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


def test_before_which_time_nothing_catches_is_published_with_its_proof(launch, observer):
    asked = {'step': 2.0, 'objective': 'intercept', 'publish_certificate': 'true'}
    proofs = observer.listen(UInt8MultiArray, 'certificate')
    bench = Bench(launch, observer, QUICK | asked)
    observer.until_connected('certificate')
    command = bench.fly(7.25)

    def refuted():
        return [text for text in (bytes(each.data) for each in proofs) if b'"radius"' in text]

    bench.until(refuted, 'the proof')
    verdict = verified(parsed(refuted()[-1]))
    assert verdict.holds
    assert verdict.proved == float(bench.report(command)['catch_bound']) > 2.0
    assert bench.report(command)['catch_checked'] == 'true'


def test_outputs_carry_the_odometrys_stamp_and_frame(flying):
    command = flying.fly(7.25)
    assert (command.header.stamp.sec, command.header.stamp.nanosec) == (7, 250_000_000)
    assert command.header.frame_id == 'base_link'
    assert command.twist.linear.y == command.twist.linear.z == 0.0


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


def test_stale_odometry_brings_the_safe_command_again_and_again(flying):
    assert moving(flying.fly(1.0))
    flown = len(flying.commands)
    flying.until(lambda: len(flying.commands) >= flown + 3, 'safe commands')
    assert not any(moving(command) for command in flying.commands[flown:])
    flying.until(lambda: told(flying.ticks[-1])['cause'] == 'odometry', 'the cause')
    assert told(flying.ticks[-1])['fallback'] == 'safe command'
    assert 'odometry' in told(flying.ticks[-1])['reason']
    assert moving(flying.fly(2.0))  # and it goes on


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


def test_goals_typed_one_after_the_other_are_flown_to_without_a_warning(launch, observer):
    """As by ``ros2 topic pub --once /goal ...`` of a pose alone, and again of another one."""
    bench = Bench(launch, observer, QUICK | {'odom_timeout': 60.0})
    for seconds, y in enumerate((2.0, -2.0, 2.0), start=1):
        sent = PoseStamped()
        sent.pose.position.y = y
        before = len(bench.commands)

        def turned(sent=sent, before=before, seconds=seconds, y=y):
            bench.goal.publish(sent)
            bench.odometry.publish(odometry(time.time()))
            return [c for c in bench.commands[before:] if c.twist.angular.z * y > 0.0]

        bench.until(turned, 'a turn towards the goal')
    heard = len(bench.health)
    bench.until(lambda: len(bench.health) >= heard + 2, 'later diagnostics')
    assert {m.status[0].message for m in bench.health[heard:]} == {'planning'}
    assert not any(key.startswith('refused') for key in told(bench.health[-1]))


def test_that_a_goal_is_caught_and_then_reached_is_told_until_there_is_another(launch, observer):
    kept = qos(10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    bench = Bench(launch, observer, QUICK | {'capture_radius': 0.3})
    heard = {name: observer.listen(Bool, name, kept) for name in ('arrived', 'caught')}
    seconds = 1.0

    def fly(x, to, until):
        """Be at a place, with the goal at another, each measurement once the last is answered."""
        sent = goal(seconds)
        sent.pose.position.x = to

        def flown():
            nonlocal seconds
            placed = odometry(seconds)
            seconds += 0.5 * any(c.header.stamp == placed.header.stamp for c in bench.commands)
            placed.pose.pose.position.x = x
            bench.goal.publish(sent)  # again: under load the first may be lost
            bench.odometry.publish(placed)
            return [m.data for m in heard['caught']] + [m.data for m in heard['arrived']] == until

        bench.until(flown, f'{until} at {x}')

    observer.until(lambda: all(heard.values()), 'that nothing has happened yet')
    fly(0.0, 5.0, [False, False])
    fly(4.8, 5.0, [False, True, False, True])
    fly(4.8, 9.0, [False, True, False, False, True, False])
    late = observer.node.create_subscription(Bool, 'caught', (told_late := []).append, kept)
    observer.until(lambda: told_late, 'what is kept for whoever comes later')
    assert not told_late[0].data
    observer.node.destroy_subscription(late)


def test_a_timer_plans_without_new_odometry(launch, observer):
    bench = Bench(launch, observer, {'trigger': 'timer', 'step': 0.1, 'odom_timeout': 20.0,
                                     'goal_timeout': 20.0})  # fmt: skip
    bench.fly(1.0)
    bench.until(lambda: sum(map(moving, bench.commands)) >= 3, 'commands by the timer')


def test_a_timer_may_be_quicker_than_a_step(launch, observer):
    """With steps of ten minutes, commands come at all."""
    bench = Bench(launch, observer, {'trigger': 'timer', 'step': 600.0, 'plan_period': 0.1,
                                     'forward': 0.01, 'odom_timeout': 60.0,
                                     'goal_timeout': 60.0})  # fmt: skip
    bench.fly(1.0)
    bench.until(lambda: sum(map(moving, bench.commands)) >= 4, 'commands by the timer')
    bench.report(bench.commands[-1])
    assert {told(tick)['fallback'] for tick in bench.ticks} == {''}


@pytest.mark.parametrize('order', [1, 2])
def test_a_dry_run_plans_and_reports_and_commands_nothing(launch, observer, order):
    node, ticks = observer.node, observer.listen(DiagnosticArray, 'tick')
    plans = observer.listen(Path, 'plan')
    senders = [node.create_publisher(Odometry, 'odom', qos())]
    senders.append(node.create_publisher(PoseStamped, 'goal', qos()))
    planner = launch('planner', QUICK | {'dry_run': True, 'translation_order': order})
    observer.until_connected('tick', 'plan')
    stamps = (0.1 * k for k in itertools.count(1))

    def reported():
        now = next(stamps)
        for sender, message in zip(senders, (odometry(now), goal(now)), strict=True):
            sender.publish(message)
        return len(plans) >= 3 and len(ticks) >= 3

    observer.until(reported, 'plans')
    assert told(ticks[-1])['status'] == 'optimal'
    for topic in ('cmd_vel', 'cmd_thrust', 'rotation'):
        assert node.count_publishers(topic) == 0
    assert planner.stop() == 0
    assert 'commands nothing: a dry run' in planner.output


def test_thrust_is_a_force_at_translation_order_2(launch, observer):
    forces = observer.listen(WrenchStamped, 'cmd_thrust')
    bench = Bench(launch, observer, {**QUICK, 'translation_order': 2, 'mass': 3.0, 'forward': 2.0})
    observer.until_connected('cmd_thrust')
    command = bench.fly(1.0)
    bench.until(lambda: forces, 'a force')
    assert command.twist.linear.x == 0.0
    assert forces[0].header.stamp == command.header.stamp
    fraction = json.loads(bench.report(command)['speed_fraction'])[1]
    assert forces[0].wrench.force.x == pytest.approx(3.0 * 2.0 * fraction)
    assert fraction > 0.1


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_with_safe_commands_and_code_0(bench, number):
    assert moving(bench.fly(1.0))
    bench.planner.tell(number)
    assert bench.planner.wait() == 0, bench.planner.output
    bench.until(lambda: len(bench.commands) >= 4, 'three safe commands')
    assert not any(moving(command) for command in bench.commands[-3:])
    assert 'Traceback' not in bench.planner.output


def test_stamps_from_the_future_and_from_long_ago_move_nothing(flying):
    flying.fly_now()
    stale = time.time() + QUICK['odom_timeout']
    flying.until(lambda: time.time() > stale)  # until then, what is on its way may be answered
    flying.odometry.publish(odometry(time.time() + 10.0))
    assert flying.counts('refused odom: future stamp') >= 1  # all before it has been taken in
    flying.until(lambda: not any(map(moving, flying.commands[-5:])), 'the safe command')
    flown, since = len(flying.commands), time.monotonic()

    def late():
        flying.goal.publish(goal(time.time() - 5.0))
        flying.odometry.publish(odometry(time.time() - 5.0))
        return time.monotonic() - since > 1.0

    flying.until(late)
    assert not any(map(moving, flying.commands[flown:]))
    assert told(flying.ticks[-1])['reason'].startswith('odometry is ')
    flying.fly_now()


def test_a_goal_that_is_lost_holds_the_plan_for_two_ticks_and_then_stops(launch, observer):
    bench = Bench(launch, observer, QUICK | {'goal_timeout': 1.0})
    bench.fly_now()
    begun, sent = len(bench.ticks), 0.0

    def fallbacks():
        nonlocal sent
        if time.time() - sent > 0.05:
            sent = time.time()
            bench.odometry.publish(odometry(sent))
        lost = [told(m) for m in bench.ticks[begun:] if 'the goal is' in told(m)['reason']]
        return [each['fallback'] for each in lost]

    bench.until(lambda: 'safe command' in fallbacks(), 'the safe command')
    told_first = fallbacks()
    held = told_first[: told_first.index('safe command')]
    assert held == len(held) * ['shifted plan']
    assert len(held) <= 2


def test_each_safe_command_is_what_it_is_called(flying):
    expected = {
        'hold_rate_zero': (1.0, False),
        'loiter': (1.0, True),
        'stop': (0.0, False),
    }
    for seconds, (kind, (speed, turns)) in enumerate(expected.items()):
        value = Parameter('safe_command', value=kind).to_parameter_msg()
        request = SetParametersAtomically.Request(parameters=[value])
        name = '/planner/set_parameters_atomically'
        assert flying.observer.call(SetParametersAtomically, name, request).result.successful
        flown = flying.fly(10.0 + seconds)
        assert flown.twist.linear.x == pytest.approx(1.0, abs=1e-3)
        count = len(flying.commands)
        flying.until(lambda n=count: len(flying.commands) >= n + 2, 'safe commands')
        safe = flying.commands[-1].twist
        assert safe.linear.x == pytest.approx(speed, abs=1e-3)
        assert (safe.angular.z != 0.0) == turns


def test_in_real_time_the_vehicle_stops_when_commands_do(launch, observer):
    seen = observer.listen(Odometry, 'odom')
    speeds = lambda: [m.twist.twist.linear.x for m in seen]  # noqa: E731
    commands = observer.node.create_publisher(TwistStamped, 'cmd_vel', qos())
    launch('sim', {'clock': 'wall', 'step': 0.05, 'max_ticks': 1000})
    observer.until_connected('odom')
    observer.until(commands.get_subscription_count, 'the simulator listening')
    commands.publish(messages.twist_message(Stamp(0, FRAMES), 0.5, np.zeros(1)))
    observer.until(lambda: 0.5 in speeds(), 'the commanded speed')
    observer.until(lambda: speeds()[-1] == 0.0, 'a stop')
    commands.publish(messages.twist_message(Stamp(1, FRAMES), 0.75, np.zeros(1)))
    observer.until(lambda: speeds()[-1] == 0.75, 'the commanded speed again')


def test_a_flight_without_capture_ends_with_code_1(launch):
    launch('planner', {'trigger': 'odom'})
    sim = launch('sim', {'max_ticks': 3, 'exit_when_done': True})
    assert sim.wait() == 1, sim.output
    assert 'not captured' in sim.output


def test_the_simulator_flies_again_after_a_reset(launch, observer):
    captured = observer.listen(Bool, 'captured')
    seen = observer.listen(Odometry, 'odom')
    # However long a busy machine takes: what is too old would be flown differently.
    launch('planner', {'trigger': 'odom', 'odom_timeout': 60.0, 'goal_timeout': 60.0})
    launch('sim', {'max_ticks': 3, 'wait_for': 'odom, captured'})
    observer.until(lambda: captured, 'the end')
    assert observer.call(Trigger, '/sim/reset', Trigger.Request()).success
    observer.until(lambda: len(captured) >= 3, 'the end again')
    # Topics keep no order among each other: the last odometry may come after the end is told.
    observer.until(lambda: len({m.header.stamp.sec for m in seen}) >= 8, 'the last odometry')
    places = {m.header.stamp.sec: m.pose.pose.position.x for m in seen}
    assert list(places) == list(range(8))  # time goes on
    flown = list(places.values())
    assert flown[4:] == pytest.approx(flown[:4], abs=1e-9)
