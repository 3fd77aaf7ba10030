# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner on the console and on /diagnostics: what it says, once, and what it does then."""

import itertools
import signal
import textwrap
import time

import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Twist, TwistStamped
from harness import python
from planners import QUICK, Bench, told
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64

from orbimpc_ros.ros import messages
from orbimpc_ros.ros.planner.outputs import NUMBERS
from orbimpc_ros.ros.process import qos

WING = QUICK | {
    'forward': 15.0, 'floor.shape': 'circle', 'floor.fraction': 0.6666666667,
    'horizon': 10, 'max_rate': 0.4363323,
}  # fmt: skip


def said(bench, words):
    """Wait until the console has it; return how often."""
    bench.until(lambda: words in bench.planner.output, words)
    return bench.planner.output.count(words)


def level(bench, words):
    """Return the level at which the diagnostics say something, waiting for it."""
    bench.says(words)
    return [m.status[0].level for m in bench.health if words in m.status[0].message][-1]


def test_who_else_is_there_is_said_when_it_comes_and_when_it_goes(launch, observer):
    bench, node = Bench(launch, observer, QUICK), observer.node
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


@pytest.mark.parametrize('trigger', ['odom', 'timer'])
def test_simulated_time_that_never_starts_is_said(launch, observer, trigger):
    clock = observer.node.create_publisher(Clock, '/clock', qos())
    bench = Bench(launch, observer, QUICK | {'trigger': trigger, 'use_sim_time': True})
    words = 'use_sim_time is true, and nothing has come on /clock for'
    assert level(bench, words) == DiagnosticStatus.WARN
    assert said(bench, words) == 1
    assert 'time of /clock' in bench.planner.output

    def started():
        clock.publish(Clock(clock=messages.time_message(time.monotonic_ns())))
        return f'over: {words}' in bench.planner.output

    bench.until(started, 'the end of it')


def test_the_vehicle_believed_in_is_said_at_the_start(launch, observer):
    bench = Bench(launch, observer, WING | {'max_rate': 25.0, 'floor.faces': 8})
    assert said(bench, '15 m/s, at least 10 m/s (circle), at most 1432 deg/s, 0.1 s x 10') == 1
    assert said(bench, 'max_rate is 25 rad/s, 1432 deg/s: 0.4363 rad/s if 25 deg/s is meant') == 1
    assert said(bench, 'floor.faces is 8 and floor.shape circle: it has no effect') == 1


def test_numbers_come_on_topics_of_their_own(launch, observer):
    heard = {name: observer.listen(Float64, f'/planner/{name}') for name in NUMBERS}
    bench = Bench(launch, observer, QUICK)
    observer.until_connected(*(f'/planner/{name}' for name in NUMBERS))
    stamps = itertools.count(10)
    bench.until(lambda: bench.fly(0.1 * next(stamps)) and all(heard.values()), 'numbers')
    assert heard['distance'][-1].data == pytest.approx(5.0)
    cost = heard['objective'][-1].data

    def on_a_tick():  # topics reach a subscriber in any order
        return any(float(told(tick)['objective']) == cost for tick in bench.ticks)

    bench.until(on_a_tick, 'the tick of that cost')
    assert heard['lower_bound'][-1].data <= heard['objective'][-1].data
    assert 0.0 <= heard['gap'][-1].data <= 1.0
    assert heard['solve_time'][-1].data > 0.0


@pytest.fixture
def script(tmp_path):
    def write(text):
        file = tmp_path / 'script.py'
        file.write_text(textwrap.dedent(text))
        return file

    return write


def test_a_first_start_says_that_it_compiles_and_ends_at_a_signal(
    launch, observer, tmp_path, monkeypatch
):
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path / 'empty'))
    planner = launch('planner', {'floor.shape': 'circle'})
    words = 'compiling machine code, only once: function 1, 0 s'
    observer.until(lambda: words in planner.output, words)
    planner.tell(signal.SIGINT)
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


BLOCKED = """
    import sys, time
    from orbimpc_ros.mpc.errors import BadInput
    from orbimpc_ros.ros import process
    from orbimpc_ros.ros.lifecycle import Managed

    class Blocked(Managed):
        def begin(self):
            self.declare_parameter('executor', 'wait_set')
            print('begins', flush=True)
            if {refused}:
                raise BadInput('mass', 0, '1')

        def destroy_node(self):
            time.sleep(1000.0)

    process.LAST_RESORT = 1.0
    sys.exit(process.run(lambda: Blocked('blocked')))
"""


@pytest.mark.parametrize('refused', [False, True])
def test_a_node_that_hangs_at_its_end_is_ended_and_says_where(launch, observer, script, refused):
    node = launch(script(BLOCKED.format(refused=refused)))
    observer.until(lambda: 'begins' in node.output, 'its begin')
    if not refused:
        node.tell(signal.SIGTERM)
    assert node.wait() == 1
    assert 'in destroy_node' in node.output


def test_who_has_commanded_nothing_leaves_without_a_command(launch, observer):
    bench = Bench(launch, observer, QUICK)
    bench.says('waits for')
    bench.planner.tell(signal.SIGINT)
    assert bench.planner.wait() == 0
    own = observer.node.create_publisher(TwistStamped, 'cmd_vel', qos())
    bench.until(own.get_subscription_count, 'this test')
    own.publish(TwistStamped())
    bench.until(lambda: bench.commands, 'whatever was commanded')
    assert bench.commands == [TwistStamped()]  # what came before would be before it
