# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Golden bags through the real planner process over DDS: what is flown is what is replayed."""

import time
from importlib import import_module

import pytest
from bags import GOLDEN

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from nav_msgs.msg import Odometry, Path
from rcl_interfaces.srv import GetParameters
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

from orbimpc_ros.ros.process import qos
from orbimpc_ros.tool import bags, settings
from orbimpc_ros.tool.replay.difference import Tolerances, comparisons
from orbimpc_ros.tool.replay.recording import published, recording_of, stamp_of

INPUTS = {'/clock': Clock, '/goal': PoseStamped, '/goal_path': Path, '/odom': Odometry}
AGAIN, ATTEMPTS = 2.0, 10  # [s] without an answer, after which to ask again
LATE = 0.45  # of a step, half of which is the deadline: cut short by it on a busy machine
OUTPUTS = {'cmd_vel': TwistStamped, 'cmd_thrust': WrenchStamped, 'tick': DiagnosticArray}


class Player:
    """Plays a bag's inputs in the order in which they were sent, answer by answer."""

    def __init__(self, observer, path):
        self.observer, self.path = observer, path
        self.recording = recording_of(path)
        self.publishers = {
            topic: observer.node.create_publisher(kind, topic, qos(100))
            for topic, kind in INPUTS.items()
        }
        self.service = observer.node.create_client(GetParameters, '/planner/get_parameters')
        self.heard = {topic: observer.listen(kind, topic) for topic, kind in OUTPUTS.items()}

    def meet(self):
        self.observer.until_connected('cmd_vel')
        for topic in ('/goal', '/odom'):
            connected = self.publishers[topic].get_subscription_count
            self.observer.until(lambda count=connected: count() > 0, topic)
        self.observer.until(self.service.service_is_ready, 'the planner')

    def play(self, before=lambda answer: None):
        inputs = sorted((m for m in bags.raw(self.path) if m.topic in INPUTS), key=lambda m: m.sent)
        for recorded in self.recording.answers:
            before(recorded)
            due = [each for each in inputs if each.sent <= recorded.sent]
            inputs = inputs[len(due) :]
            for _ in range(ATTEMPTS):
                self.say(due)
                # First messages may be lost in discovery; asked again, a planner says it again.
                if self.soon_answered(recorded):
                    break
            else:
                pytest.fail(f'no answer to {recorded.stamp}')

    def say(self, messages):
        """Publish messages, each once the one before has been taken in: the queues hold one."""
        for each in messages:
            message = deserialize_message(each.data, INPUTS[each.topic])
            self.publishers[each.topic].publish(message)
            taken = self.service.call_async(GetParameters.Request())
            self.observer.until(taken.done, 'the planner')

    def soon_answered(self, recorded):
        end = time.monotonic() + AGAIN
        self.observer.until(lambda: self.answered(recorded) or time.monotonic() > end)
        return self.answered(recorded)

    def answered(self, recorded):
        wanted = [name for name in OUTPUTS if name in recorded.messages]
        return all(any(stamp_of(m) == recorded.stamp for m in self.heard[name]) for name in wanted)

    @property
    def in_time(self):
        """Return, tick by tick, whether it was answered before its deadline."""
        late = 1e3 * LATE * settings.of_bag(self.path)['step']  # [ms]
        return [now.solve_time_ms < late for _, now in self.compared()]

    def compared(self):
        for recorded in self.recording.answers:
            told = {
                name: next(m for m in self.heard[name] if stamp_of(m) == recorded.stamp)
                for name in OUTPUTS
                if name in recorded.messages
            }
            yield recorded.answer, published(told)

    def differences(self):
        """Return where ticks differ that were in time."""
        found, in_time = [], self.in_time
        for tick, (then, now) in enumerate(self.compared()):
            if not in_time[tick]:
                continue
            # Quaternions that went through a vehicle of another process round differently.
            found += [
                each
                for each in comparisons(tick, 0.0, then, now, Tolerances())
                if each.quantity in ('speed', 'body_rate', 'force') and each.differs
            ]
        return [str(each) for each in found]


@pytest.fixture
def planner(launch, tmp_path):
    """Return a function that starts the planner with the parameters of a bag."""

    def start(path):
        file = tmp_path / 'parameters.yaml'
        file.write_text(bags.notes(path)['parameters'])
        values = settings.of_bag(path)
        assert values['trigger'] == 'odom'
        return launch('planner', {'use_sim_time': True}, str(file.with_suffix('')))

    return start


@pytest.mark.parametrize('name', ['retrieval', 'spacecraft'])
def test_a_bag_flies_over_dds_as_it_is_replayed(planner, observer, name):
    player = Player(observer, GOLDEN / name)
    planner(GOLDEN / name)
    player.meet()
    player.play()
    assert any(player.in_time)
    assert player.differences() == []


def test_a_faulty_bag_flies_over_dds_as_it_is_replayed(planner, observer):
    """Losses, repetitions, NaN, wrong frames and stamps: every accepted odometry is answered."""
    player = Player(observer, GOLDEN / 'faulty')
    planner(GOLDEN / 'faulty')
    player.meet()
    enabled = {'now': True}

    def switch(recorded):
        wanted = recorded.answer.reason != 'disabled'
        if wanted != enabled['now']:
            observer.call(SetBool, '/planner/enable', SetBool.Request(data=wanted))
            enabled['now'] = wanted

    player.play(switch)
    assert player.differences() == []


def test_the_interface_names_the_types():
    from orbimpc_ros.tool.topics import TYPES

    for topic, kind in {**INPUTS, **OUTPUTS}.items():
        package, _, name = TYPES[topic.strip('/')].split('/')
        assert getattr(import_module(f'{package}.msg'), name) is kind
