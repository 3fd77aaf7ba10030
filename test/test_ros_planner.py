"""The planner as a process: what it says while it waits, what it refuses, how it stops."""

import json
import math
import signal
import time

import numpy as np
import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger

from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import Frames, Stamp
from orbimpc_ros.ros.process import qos
from orbimpc_ros.world.vehicle import Model, launched

FRAMES = Frames('odom', 'base_link')
QUICK = {'trigger': 'odom', 'step': 0.1, 'odom_timeout': 0.8}


def odometry(seconds, model=None):
    model = model or Model()
    vehicle = launched(model, np.zeros(2), np.eye(2))
    return messages.odometry_message(Stamp(round(seconds * 1e9), FRAMES), vehicle)


def goal(seconds):
    return messages.goal_message(Stamp(round(seconds * 1e9), FRAMES), np.array([5.0, 0.0]))


def told(message):
    return {pair.key: pair.value for pair in message.status[0].values}


def moving(message):
    twist = message.twist
    return twist.linear.x != 0.0 or twist.angular.z != 0.0


class Bench:
    """A planner with its inputs in this test's hands."""

    def __init__(self, launch, observer, parameters, planner='planner'):
        self.observer = observer
        self.commands = observer.listen(TwistStamped, 'cmd_vel')
        self.ticks = observer.listen(DiagnosticArray, 'tick')
        self.health = observer.listen(DiagnosticArray, '/diagnostics')
        node = observer.node
        self.odometry = node.create_publisher(Odometry, 'odom', qos())
        self.goal = node.create_publisher(PoseStamped, 'goal', qos())
        self.planner = launch(planner, parameters)
        observer.until_connected('cmd_vel', 'tick', '/diagnostics')
        for publisher in (self.odometry, self.goal):
            observer.until(publisher.get_subscription_count, 'the planner listening')

    def until(self, *arguments):
        self.observer.until(*arguments)

    def says(self, words):
        """Wait until the planner's diagnostics say something."""
        self.until(lambda: any(words in m.status[0].message for m in self.health), words)

    def counts(self, what):
        """Wait until the planner's diagnostics count something."""
        self.until(lambda: self.health and what in told(self.health[-1]), what)
        return int(told(self.health[-1])[what])

    def fly(self, seconds):
        """Return the command for odometry of that stamp, sent again until it is answered."""
        sent = [odometry(seconds), goal(seconds)]
        before, again = len(self.commands), -math.inf

        def answer():
            nonlocal again
            if time.monotonic() > again:  # best effort: lost while they were connecting
                again = time.monotonic() + 0.3
                self.goal.publish(sent[1])
                self.odometry.publish(sent[0])
            later = self.commands[before:]
            return [c for c in later if c.header.stamp == sent[0].header.stamp]

        self.until(answer, 'a command')
        return answer()[0]

    def fly_now(self):
        """Send what is measured now until that moves the vehicle."""
        before, sent = len(self.commands), -math.inf

        def moved():
            nonlocal sent
            if time.time() - sent > 0.1:
                sent = time.time()
                self.goal.publish(goal(sent))
                self.odometry.publish(odometry(sent))
            return any(map(moving, self.commands[before:]))

        self.until(moved, 'a command')


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
    bench.says('waits for odometry on odom and a goal')
    bench.odometry.publish(odometry(1.0))
    bench.says('waits for a goal')
    assert bench.commands == []
    assert 'waits for odometry on odom' in bench.planner.output
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


def test_outputs_carry_the_odometrys_stamp_and_frame(flying):
    command = flying.fly(7.25)
    assert (command.header.stamp.sec, command.header.stamp.nanosec) == (7, 250_000_000)
    assert command.header.frame_id == 'base_link'
    assert command.twist.linear.y == command.twist.linear.z == 0.0


def test_stale_odometry_brings_the_safe_command_again_and_again(flying):
    assert moving(flying.fly(1.0))
    flown = len(flying.commands)
    flying.until(lambda: len(flying.commands) >= flown + 3, 'safe commands')
    assert not any(moving(command) for command in flying.commands[flown:])
    assert told(flying.ticks[-1])['fallback'] == 'safe command'
    assert 'odometry' in told(flying.ticks[-1])['reason']
    assert moving(flying.fly(2.0))  # and it goes on


def test_disabled_means_the_safe_command_again_and_again(flying):
    assert moving(flying.fly(1.0))
    response = flying.observer.call(SetBool, '/planner/enable', SetBool.Request(data=False))
    assert response.success
    assert not moving(flying.fly(2.0))
    flying.says('disabled')
    flying.observer.call(SetBool, '/planner/enable', SetBool.Request(data=True))
    assert moving(flying.fly(3.0))


def test_reset_forgets_the_inputs_and_is_safe_until_they_are_there_again(flying):
    flying.fly(100.0)
    flown = len(flying.commands)
    assert flying.observer.call(Trigger, '/planner/reset', Trigger.Request()).success
    flying.until(lambda: len(flying.commands) >= flown + 3, 'safe commands')
    assert not any(moving(command) for command in flying.commands[flown:])
    flying.until(lambda: 'waits for' in flying.health[-1].status[0].message, 'waiting')
    assert moving(flying.fly(1.0))  # an older stamp than before


def test_a_timer_plans_without_new_odometry(launch, observer):
    bench = Bench(launch, observer, {'trigger': 'timer', 'step': 0.1, 'odom_timeout': 20.0,
                                     'goal_timeout': 20.0})  # fmt: skip
    bench.fly(1.0)
    bench.until(lambda: sum(map(moving, bench.commands)) >= 3, 'commands by the timer')


def test_thrust_is_a_force_at_translation_order_2(launch, observer):
    forces = observer.listen(WrenchStamped, 'cmd_thrust')
    bench = Bench(launch, observer, {**QUICK, 'translation_order': 2, 'mass': 3.0, 'forward': 2.0})
    observer.until_connected('cmd_thrust')
    command = bench.fly(1.0)
    bench.until(lambda: forces, 'a force')
    assert command.twist.linear.x == 0.0
    assert forces[0].header.stamp == command.header.stamp
    bench.until(lambda: bench.ticks, 'a tick')
    fraction = json.loads(told(bench.ticks[0])['speed_fraction'])[1]
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


def safe_again(bench, after, reason):
    """Wait for safe commands after the first so many commands, and for their reason on tick."""
    bench.until(lambda: len(bench.commands) >= after + 3, 'safe commands')
    bench.until(lambda: any(reason in told(m)['reason'] for m in bench.ticks), reason)
    assert not any(moving(command) for command in bench.commands[after + 1 :])


def level(bench, words):
    """Return the level at which the planner's diagnostics say something, waiting for it."""
    said = lambda: [m.status[0] for m in bench.health if words in m.status[0].message]  # noqa: E731
    bench.until(said, words)
    return said()[-1].level


def gone(bench, words):
    bench.until(lambda: words not in bench.health[-1].status[0].message, f'no more {words}')


def test_two_sources_of_odometry_bring_the_safe_command(flying):
    assert moving(flying.fly(1.0))
    node = flying.observer.node
    other = node.create_publisher(Odometry, 'odom', qos())
    words = '2 publishers on odom'
    assert level(flying, words) == DiagnosticStatus.ERROR
    assert not moving(flying.fly(2.0))
    flying.until(lambda: any(words in told(m)['reason'] for m in flying.ticks), words)
    node.destroy_publisher(other)
    gone(flying, words)
    assert moving(flying.fly(3.0))


def test_a_rival_on_the_vehicles_topic_is_warned_of(flying):
    flying.fly(1.0)
    node = flying.observer.node
    rival = node.create_publisher(TwistStamped, 'cmd_vel', qos())
    assert level(flying, '2 publishers on cmd_vel') >= DiagnosticStatus.WARN
    node.destroy_publisher(rival)
    flying.fly(2.0)


def test_who_cannot_hear_us_for_qos_is_named_with_the_policy(flying):
    node, kept = flying.observer.node, qos(1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    deaf = node.create_subscription(TwistStamped, 'cmd_vel', lambda _message: None, kept)
    words = '/cmd_vel of /observer does not match: Volatile publisher and transient local'
    assert level(flying, words) == DiagnosticStatus.ERROR
    node.destroy_subscription(deaf)
    gone(flying, words)


def test_who_speaks_another_type_is_named(flying):
    node = flying.observer.node
    other = node.create_publisher(Bool, 'goal_path', qos())
    words = '/goal_path of /observer is a std_msgs/msg/Bool, not a nav_msgs/msg/Path'
    assert level(flying, words) == DiagnosticStatus.ERROR
    node.destroy_publisher(other)
    gone(flying, words)


def test_stamps_from_the_future_and_from_long_ago_move_nothing(flying):
    flying.fly_now()
    flying.odometry.publish(odometry(time.time() + 10.0))
    assert flying.counts('refused odom: future stamp') >= 1
    flying.until(lambda: not moving(flying.commands[-1]), 'the safe command')
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


class Simulated(Bench):
    """A planner whose time this test makes, too."""

    def __init__(self, launch, observer):
        self.clock = observer.node.create_publisher(Clock, '/clock', qos())
        super().__init__(launch, observer, QUICK | {'use_sim_time': True})
        observer.until(self.clock.get_subscription_count, 'the planner listening to time')

    def fly(self, seconds):
        self.tell(seconds)
        return super().fly(seconds)

    def tell(self, seconds):
        self.clock.publish(Clock(clock=messages.time_message(round(seconds * 1e9))))


def test_time_that_jumps_or_stands_still_brings_the_safe_command(launch, observer):
    bench = Simulated(launch, observer)
    assert moving(bench.fly(100.0))
    for seconds, jump in ((90.0, 'jumped by -10 s'), (500.0, 'jumped by 4')):
        flown, words = len(bench.commands), f'starting afresh: the clock {jump}'
        bench.until(lambda s=seconds, w=words: bench.tell(s) or w in bench.planner.output, words)
        bench.until(lambda n=flown: len(bench.commands) >= n + 2, 'safe commands')
        assert not any(map(moving, bench.commands[-2:]))
        assert moving(bench.fly(seconds + 0.1))
    safe_again(bench, len(bench.commands), 'odometry is')  # and now it stands still
    bench.odometry.publish(odometry(505.0))
    assert bench.counts('refused odom: future stamp') >= 1


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
    launch('planner', {'trigger': 'odom'})
    launch('sim', {'max_ticks': 3})
    observer.until(lambda: captured, 'the end')
    assert observer.call(Trigger, '/sim/reset', Trigger.Request()).success
    observer.until(lambda: len(captured) >= 3, 'the end again')
    # Topics keep no order among each other: the last odometry may come after the end is told.
    observer.until(lambda: len({m.header.stamp.sec for m in seen}) >= 8, 'the last odometry')
    places = {m.header.stamp.sec: m.pose.pose.position.x for m in seen}
    assert list(places) == list(range(8))  # time goes on
    flown = list(places.values())
    assert flown[4:] == pytest.approx(flown[:4], abs=1e-9)
