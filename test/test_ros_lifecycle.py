# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Planner and simulator as managed nodes: real processes and services, and failing transitions."""

import itertools
import json
from types import SimpleNamespace

import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from nav_msgs.msg import Odometry
from planners import QUICK, Bench, goal, moving, odometry, told
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.process import Managed

CONFIGURE, ACTIVATE = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE
DEACTIVATE, CLEANUP = Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP


def change_state(observer, node, **asked):
    """Request a transition from a node; return True if it was made."""
    request = ChangeState.Request(transition=Transition(**asked))
    return observer.call(ChangeState, f'/{node}/change_state', request).success


class Manager(Bench):
    """A planner, its inputs, and its manager, which uses transition ids as Nav2's does."""

    def __init__(self, launch, observer, parameters):
        self.times = (0.1 * k for k in itertools.count(1))
        # Never stale, even on a busy machine: only the manager may stop it.
        patient = {'odom_timeout': 60.0, 'goal_timeout': 60.0}
        super().__init__(launch, observer, QUICK | patient | parameters)

    def change(self, number):
        return change_state(self.observer, 'planner', id=number)

    @property
    def state(self):
        response = self.observer.call(GetState, '/planner/get_state', GetState.Request())
        return response.current_state.label

    def feed_until(self, happened, what):
        """Send fresh inputs until a condition holds, with pauses for other callbacks."""
        seen = itertools.count()

        def fed():
            if next(seen) % 3 == 0:
                now = next(self.times)
                self.goal.publish(goal(now))
                self.odometry.publish(odometry(now))
            return happened()

        self.until(fed, what)

    def move(self):
        before = len(self.commands)
        self.feed_until(lambda: any(map(moving, self.commands[before:])), 'a command to move')

    def commands_of(self, messages):
        """Return the commands received while ``messages`` inputs are sent, and soon afterwards."""
        before = len(self.commands)
        sent = itertools.count()
        self.feed_until(lambda: next(sent) > messages, 'the inputs taken in')
        heard = len(self.health)
        self.until(lambda: len(self.health) >= heard + 2, 'later diagnostics')
        return self.commands[before:]

    def says(self, words):
        """Wait until the planner's latest diagnostics contain ``words``."""
        self.until(lambda: self.health and words in self.health[-1].status[0].message, words)


@pytest.fixture(scope='module')
def manager(shared):
    managed = Manager(*shared, {})
    managed.move()
    return managed


@pytest.fixture
def active(manager):
    """An active planner, whatever state the previous test left it in."""
    steps = {'unconfigured': (CONFIGURE, ACTIVATE), 'inactive': (ACTIVATE,), 'active': ()}
    for number in steps[manager.state]:
        assert manager.change(number)
    return manager


def test_deactivated_it_is_safe_once_and_silent_and_activated_again_it_starts_afresh(active):
    active.move()
    assert active.change(DEACTIVATE)
    active.says('inactive')
    active.observer.until(lambda: not moving(active.commands[-1]), 'the safe command')
    assert moving(active.commands[-2])
    assert active.commands_of(20) == []
    assert active.reset().success
    assert active.enable(False)
    assert active.enable(True)
    assert active.commands_of(5) == []
    assert active.change(ACTIVATE)
    active.says('waits for odometry on /odom and a goal on /goal or /goal_path')
    assert not moving(active.commands[-1])  # still the safe command
    active.move()


def test_cleaned_up_it_has_no_topics_and_takes_on_what_has_changed(active):
    active.move()
    assert active.change(DEACTIVATE)
    assert active.change(CLEANUP)
    node = active.observer.node
    for topic in ('cmd_vel', 'tick', 'plan'):
        active.observer.until(lambda t=topic: not node.count_publishers(t), 'silence')
    active.observer.until(lambda: not node.count_subscribers('odom'), 'deafness')
    request = SetParameters.Request(
        parameters=[
            Parameter(name, value=value).to_parameter_msg()
            for name, value in {'forward': 0.25, 'mass': -1.0}.items()
        ]
    )
    answer = active.observer.call(SetParameters, '/planner/set_parameters', request)
    assert [each.successful for each in answer.results] == [True, False]
    assert active.change(CONFIGURE)
    assert active.change(ACTIVATE)
    active.move()
    assert 0.0 < active.commands[-1].twist.linear.x <= 0.25 + 1e-9
    assert 'from now on 0.25 m/s' in active.planner.output


@pytest.mark.parametrize(
    ('asked', 'said'),
    [
        ({'id': CONFIGURE}, 'transition 1 is not possible while active; allowed: '),
        ({'label': 'fly'}, 'fly is not possible while active'),
    ],
)
def test_a_transition_that_is_not_possible_is_refused_in_a_line_and_it_flies_on(
    active, asked, said
):
    for _ in range(6):  # so many failures of a callback would end the node
        assert not change_state(active.observer, 'planner', **asked)
    assert said in active.planner.output
    assert active.state == 'active'
    active.move()


@pytest.mark.parametrize('executor', ['wait_set', 'events'])
def test_left_alone_it_waits_to_be_managed_and_shut_down_it_is_silent_for_good(
    executor, launch, observer
):
    if executor == 'events':
        pytest.importorskip('rclpy.experimental.events_executor')
    manager = Manager(launch, observer, {'autostart': False, 'executor': executor})
    assert manager.state == 'unconfigured'
    assert observer.node.count_publishers('cmd_vel') == 0
    assert not manager.change(ACTIVATE)
    assert manager.change(CONFIGURE)
    assert manager.state == 'inactive'
    assert manager.commands_of(10) == []
    assert manager.change(ACTIVATE)
    manager.move()
    assert manager.change(Transition.TRANSITION_ACTIVE_SHUTDOWN)
    observer.until(lambda: not moving(manager.commands[-1]), 'the safe command')
    assert manager.state == 'finalized'
    observer.until(lambda: not observer.node.count_publishers('cmd_vel'), 'silence')
    assert manager.planner.poll() is None
    assert manager.planner.stop() == 0, manager.planner.output


def test_a_managed_simulator_stands_still_and_flies_again(launch, observer):
    clock, seen = observer.listen(Clock, '/clock'), observer.listen(Odometry, 'odom')
    captured = observer.listen(Bool, 'captured')
    # Never stale, even on a busy machine: stale inputs would be flown differently.
    launch('planner', {'trigger': 'odom', 'odom_timeout': 60.0, 'goal_timeout': 60.0})
    launch('sim', {'autostart': False, 'max_ticks': 3})

    def reset():
        return observer.call(Trigger, '/sim/reset', Trigger.Request()).success

    assert change_state(observer, 'sim', id=CONFIGURE)
    assert reset()
    assert clock == seen == []
    assert change_state(observer, 'sim', id=ACTIVATE)
    observer.until(lambda: captured, 'the end')
    assert reset()
    observer.until(lambda: len({m.header.stamp.sec for m in seen}) >= 8, 'the second flight')
    observer.until(lambda: len(captured) >= 3, 'its end')
    assert change_state(observer, 'sim', id=DEACTIVATE)
    assert change_state(observer, 'sim', id=ACTIVATE)
    observer.until(lambda: len({m.header.stamp.sec for m in seen}) >= 12, 'the third flight')
    places = {m.header.stamp.sec: m.pose.pose.position.x for m in seen}
    assert list(places) == list(range(12))  # time continues
    flown = list(places.values())
    assert flown[4:] == pytest.approx(flown[:4] * 2, abs=1e-9)


class Worker(Managed):
    """A node that fails in selected transitions."""

    kind, specs, settings_of = 'worker', (), lambda _node, _: SimpleNamespace(autostart=True)
    failing = ()  # or errors, by hook

    def _do(self, what):
        if what in self.failing:
            raise self.failing[what]

    def configure(self):
        self.create_publisher(Bool, 'work', 1)
        self.every(1.0, lambda: None)
        self.create_service(Trigger, '~/ask', lambda _request, response: response)
        self.create_subscription(Bool, 'heard', lambda _message: None, 1)
        self._do('configure')

    def activate(self):
        self._do('activate')

    def safe(self, _reason):
        self._do('deactivate')


@pytest.fixture
def worker(domain, default_context):
    default_context.init(domain_id=domain)
    node = Worker()
    yield node
    node.destroy_node()


def endpoints(node):
    return {each.topic_name for each in node.publishers} & {'/work'}


def state(node):
    return node._state_machine.current_state[1]


class Panic(BaseException):
    """Raised like the panics of libraries written in Rust: not an Exception."""


@pytest.mark.parametrize('error', [BadInput('step', 0.0, 'above 0'), ValueError('no'), Panic('no')])
@pytest.mark.parametrize('where', ['configure', 'activate'])
def test_a_start_that_fails_raises_what_failed(worker, where, error):
    worker.failing = {where: error}
    with pytest.raises(type(error)):
        worker.begin()
    assert not worker.active
    refused = where == 'activate' and isinstance(error, BadInput)
    assert state(worker) == ('inactive' if refused else 'unconfigured')
    assert bool(endpoints(worker)) == refused


def test_an_end_that_fails_leaves_it_silent_and_unconfigured(worker):
    worker.begin()
    worker.failing = {'deactivate': ValueError('no')}
    worker.trigger_deactivate()
    assert (state(worker), worker.active, endpoints(worker)) == ('unconfigured', False, set())
    worker.failing = {}
    worker.begin()
    assert worker.active


def test_a_failure_is_said_in_a_line_and_answered(worker, capfd):
    worker.failing = {'configure': ValueError('the solver is missing')}
    request = ChangeState.Request(transition=Transition(id=CONFIGURE))
    answer = worker._service_change_state.callback(request, ChangeState.Response())
    assert not answer.success
    assert 'configure failed: ValueError: the solver is missing' in capfd.readouterr().err


def test_a_mode_that_changes_while_it_is_inactive_is_known_when_it_is_activated(launch, observer):
    manager = Manager(launch, observer, {'gated': True})
    mode = observer.node.create_publisher(Bool, 'engaged', 1)
    observer.until(mode.get_subscription_count, 'the planner listening')

    def engaged(taken):
        mode.publish(Bool(data=taken))
        return manager.health and told(manager.health[-1])['engaged'] == json.dumps(taken)

    manager.feed_until(lambda: engaged(True) and any(map(moving, manager.commands)), 'commands')
    assert manager.change(DEACTIVATE)
    observer.until(lambda: engaged(False), 'the mode')
    assert manager.change(ACTIVATE)
    manager.feed_until(lambda: 'planning' in manager.health[-1].status[0].message, 'plans')
    assert manager.commands_of(10) == []


def test_work_waits_until_it_is_active(worker):
    heard = []
    hear = worker.at_work(heard.append)
    hear('before')
    worker.begin()
    hear('meanwhile')
    worker.trigger_deactivate()
    hear('after')
    assert heard == ['meanwhile']
