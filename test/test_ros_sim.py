# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The simulator as a process: injected faults, refused commands, and readers that it waits for."""

import contextlib
import math
import re
from functools import reduce

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, QuaternionStamped, TwistStamped, WrenchStamped
from harness import Observer
from lifecycle_msgs.msg import TransitionEvent
from nav_msgs.msg import Odometry, Path
from planners import FRAMES, settings
from rosgraph_msgs.msg import Clock

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import Frames, Stamp, stamp_of
from orbimpc_ros.ros.process import qos
from orbimpc_ros.sim.node import Orders
from orbimpc_ros.sim.parameters import SimSettings
from orbimpc_ros.tool.offline import OfflinePlanner, closed_loop

DISTURBED = {
    'faults.position_noise': 0.05,
    'faults.attitude_noise': 0.035,
    'faults.dropout': 0.2,
    'seed': 3,
    'capture_radius': 0.3,
    'exit_when_done': True,
}
LOCKSTEP = {
    'use_sim_time': True,
    'trigger': 'odom',
    'goal_prediction': 'harmonic',
    'floor.shape': 'polygon',
    'odom_timeout': 5.0,
    'goal_timeout': 5.0,
}


def place(message):
    position = message.pose.pose.position
    return [position.x, position.y]


@pytest.mark.parametrize(
    'faults',
    [
        {
            'faults.clock_jump': -20.0,
            'faults.clock_jump_tick': 3,
            'faults.delay': 0.3,
            'faults.reorder': 0.1,
            'faults.nan': 0.1,
            'faults.duplicate': 0.2,
        },
        {
            'faults.clock_jump': 500.0,
            'faults.clock_jump_tick': 3,
            'faults.occlusion_length': 3.0,
            'faults.occlusion_period': 6.0,
        },
    ],
)
def test_no_fault_brings_lock_step_to_a_standstill(launch, faults):
    launch('planner', LOCKSTEP)
    sim = launch('sim', DISTURBED | faults)
    assert sim.wait() == 0, sim.output
    assert 'captured' in sim.output


# --- readers that a flight waits for

WHOLE = {
    '/clock': Clock,
    'goal': PoseStamped,
    'cmd_vel': TwistStamped,
    'rotation': QuaternionStamped,
    'plan': Path,
    'tick': DiagnosticArray,
}
STEPS = 12
LONG = LOCKSTEP | {'goal_prediction': 'hold'}  # the paper's prediction, without a catch so soon


def test_whoever_is_waited_for_hears_a_flight_whole_and_a_rate_only_slows_it(launch, domain):
    """A recorder that starts late must not miss a flight of a tenth of a second.

    The vehicle flies as in this process.
    """
    launch('planner', LONG)
    asked = {
        'wait_for': 'odom, goal, cmd_vel, rotation, plan, tick',
        'max_ticks': STEPS,
        'wait_timeout': 60.0,
        'rate': 5.0,
        'exit_when_done': True,
    }
    sim = launch('sim', asked)
    with contextlib.closing(Observer(domain)) as late:
        late.until(lambda: 'waits for readers: 1 of odom (there are 0)' in sim.output, 'waiting')
        heard = {topic: late.listen(kind, topic) for topic, kind in WHOLE.items()}
        heard['odom'], sent = [], {}

        def flown(message, about):
            heard['odom'].append(message)
            sent.setdefault(stamp_of(message), about['source_timestamp'])

        late.subscribe(Odometry, 'odom', flown)
        stamps = [10**9 * k for k in range(STEPS + 1)]
        for topic, said in heard.items():
            late.until(lambda m=said: m and stamp_of(m[-1]) >= stamps[-1], topic)
            assert sorted({*map(stamp_of, said)})[: len(stamps)] == stamps, topic
    assert sim.wait() == 1
    assert 'not captured' in sim.output
    # The first step may be late, and the next one early relative to it; none is ahead of its time.
    assert sent[stamps[-1]] - sent[0] > (STEPS - 2) * 0.2e9
    planner = OfflinePlanner(settings(**{k: v for k, v in LONG.items() if k != 'use_sim_time'}))
    quick = [
        flight.vehicle.position for flight, _ in closed_loop(planner, SimSettings(max_ticks=STEPS))
    ]
    places = {stamp_of(message): place(message) for message in heard['odom']}
    np.testing.assert_allclose([places[stamp] for stamp in stamps], quick, atol=1e-9)


def test_a_simulator_says_for_whom_it_has_waited_in_vain(launch):
    alone = launch('sim', {'wait_timeout': 0.5})
    unheard = launch('sim', {'wait_timeout': 0.5, 'wait_subscribers': 3})
    for sim, said in ((alone, 'subscribers of odom: 1 '), (unheard, 'subscribers of odom: 3 ')):
        assert sim.wait() == 1, sim.output
        assert re.search(rf'waited \d+ s in vain for {said}\(there are 0\)', sim.output)


def test_the_time_that_a_planner_takes_to_be_configured_is_not_counted(launch, observer):
    """The first start compiles for minutes on a slow computer."""
    observer.node.create_publisher(TwistStamped, 'cmd_vel', qos())
    observer.node.create_publisher(TransitionEvent, '~/transition_event', qos())
    sim = launch('sim', {'wait_timeout': 3.0})
    awaited = f'waits for {observer.node.get_fully_qualified_name()} to be configured'
    observer.until(lambda: awaited in sim.output, 'the simulator to say so')
    observer.spin(4.0)
    observer.listen(PoseStamped, 'goal')
    assert sim.wait() == 1
    assert re.search(r'waited \d+ s in vain for subscribers of odom', sim.output)


def test_lock_step_with_a_planner_on_a_timer_ends_and_says_why(launch, observer):
    observer.listen(TwistStamped, 'cmd_vel')
    # Its period is longer than the simulator's step: otherwise it might keep up by chance.
    launch('planner', LOCKSTEP | {'trigger': 'timer', 'step': 10.0})
    observer.until_connected('cmd_vel')
    sim = launch('sim', {'wait_timeout': 5.0})
    assert sim.wait() == 1, sim.output
    assert 'in vain for an answer to the odometry on cmd_vel' in sim.output
    assert 'trigger: odom' in sim.output


# --- accepted and refused commands


def test_bad_commands_are_refused_counted_and_not_flown(launch, observer):
    odometry = observer.listen(Odometry, 'odom')
    diagnostics = observer.listen(DiagnosticArray, '/diagnostics')
    publisher = observer.node.create_publisher(TwistStamped, 'cmd_vel', qos())
    launch('sim', {'clock': 'wall', 'max_ticks': 10_000, 'step': 0.1})
    observer.until(publisher.get_subscription_count, 'the simulator')
    bad = [(math.nan, 0.0), (1.5, 0.0), (-0.5, 0.0), (1.0, 40.0), (1.0, math.inf)]

    fields = ('twist.linear', 'twist.linear.x', 'twist.angular', 'header.stamp')
    wanted = {f'refused cmd_vel: {field}' for field in fields}

    def counted():
        for speed, rate in bad:
            publisher.publish(twist(speed, rate, stamp=0))
        publisher.publish(twist(1.0, 0.0, stamp=2**31 * 10**9 - 1))
        told = [each for m in diagnostics for each in m.status if each.name == 'sim: flight']
        complained = any(s.level == DiagnosticStatus.ERROR and 'refused' in s.message for s in told)
        return complained and wanted <= {pair.key for each in told for pair in each.values}

    observer.until(counted, 'each count')
    observer.until(lambda: len(odometry) > 5, 'odometry')
    assert all(place(each) == [0.0, 0.0] for each in odometry)


NOW = 5_000_000_000  # [ns]
STEPPED = SimSettings(forward=2.0, step=0.5)
PUSHED = SimSettings(translation_order=2, forward=2.0, mass=3.0)


def at(stamp=NOW):
    return Stamp(stamp, FRAMES)


def twist(speed, rate, stamp=NOW):
    return messages.twist_message(at(stamp), speed, np.atleast_1d(rate))


@pytest.mark.parametrize('axis', ['x', 'z'])
def test_orders_are_of_a_twist_alone_or_with_the_force_of_its_stamp(axis):
    """Speed and force are along the thrust axis."""
    frames, rate = Frames('odom', 'base_link', axis), np.array([0.1, -0.2, 0.3])
    first, later = Stamp(NOW, frames), Stamp(NOW + 1, frames)
    message = messages.twist_message(first, 1.0, rate)
    assert getattr(message.twist.linear, axis) == 1.0
    orders = Orders(SimSettings(dimension=3, forward=2.0, thrust_axis=axis))
    order = orders.take('cmd_vel', message, NOW)
    assert order.fraction == pytest.approx(0.5)
    np.testing.assert_allclose(order.body_rate, rate, atol=1e-15)
    for speed, turn in ((0.0, 0.0), (2.0, math.pi), (-1e-4, -math.pi)):  # up to the limits
        again = messages.twist_message(first, speed, turn * np.eye(3)[1])
        assert orders.take('cmd_vel', again, NOW).fraction == pytest.approx(speed / 2.0)
    assert orders.take('cmd_thrust', messages.wrench_message(first, 1.0), NOW) is None
    with pytest.raises(BadInput, match=rf'twist\.linear\.{axis}'):
        orders.take('cmd_vel', messages.twist_message(first, 2.1, rate), NOW)
    own = {'dimension': 3, 'translation_order': 2, 'forward': 2.0, 'mass': 3.0}
    pushed = Orders(SimSettings(**own, thrust_axis=axis))
    force = messages.wrench_message(later, 3.0)
    assert getattr(force.wrench.force, axis) == 3.0
    assert pushed.take('cmd_vel', messages.twist_message(first, 0.0, -rate), NOW) is None
    assert pushed.take('cmd_thrust', force, NOW) is None
    order = pushed.take('cmd_vel', messages.twist_message(later, 0.0, rate), NOW)
    assert order.stamp == NOW + 1
    assert order.fraction == pytest.approx(0.5)
    np.testing.assert_allclose(order.body_rate, rate, atol=1e-15)


def force(newtons, stamp=NOW):
    return messages.wrench_message(at(stamp), newtons)


def malformed(message, path):
    """Return a message with one number set to NaN."""
    *way, last = path.split('.')
    setattr(reduce(getattr, way, message), last, math.nan)
    return message


REFUSED = [
    *((STEPPED, twist(speed, 0.0), 'twist.linear.x') for speed in (2.1, -0.1)),
    (STEPPED, twist(math.nan, 0.0), 'twist.linear'),
    *((STEPPED, twist(1.0, rate), 'twist.angular') for rate in (6.3, -6.3, math.inf)),
    (STEPPED, twist(1.0, 0.0, NOW + 1_100_000_000), 'header.stamp'),
    (PUSHED, malformed(TwistStamped(), 'twist.angular.z'), 'twist.angular'),
    *((PUSHED, force(each), 'wrench.force.x') for each in (6.1, -0.1)),
    (PUSHED, force(1.0, 2 * NOW), 'header.stamp'),
    (PUSHED, malformed(WrenchStamped(), 'wrench.torque.y'), 'wrench.torque'),
]


@pytest.mark.parametrize(('vehicle', 'message', 'culprit'), REFUSED)
def test_what_is_malformed_or_beyond_the_vehicle_is_refused(vehicle, message, culprit):
    orders = Orders(vehicle)
    topic = 'cmd_thrust' if isinstance(message, WrenchStamped) else 'cmd_vel'
    with pytest.raises(BadInput, match=re.escape(culprit)):
        orders.take(topic, message, NOW)
