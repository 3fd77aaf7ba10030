# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Make the golden bags: ``python test/golden/make.py [FOLDER]``, from seeds, without DDS.

The loop is closed without nodes, as in lock-step: the planner takes in the messages that the
simulator would publish, and the vehicle flies its commands. There is one bag per flight; then
``orbimpc replay`` must find no difference. After an intended change of the planner, the bags are
made anew.
"""

from __future__ import annotations

import argparse
import shutil
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock

from orbimpc_ros.loop.planner import Decision
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import SECOND
from orbimpc_ros.ros.parameters.planner import planner_settings
from orbimpc_ros.ros.planner.core import DISABLED
from orbimpc_ros.ros.topics import TYPES, topics_of
from orbimpc_ros.sim.parameters import sim_settings
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.bags import BagWriter, store
from orbimpc_ros.tool.offline import OfflinePlanner, closed_loop
from orbimpc_ros.tool.settings import config

FLIGHTS = {
    'retrieval': ('retrieval', ()),
    'dubins': ('dubins', ()),
    # Off the straight line, on which a half turn may go either way.
    'spacecraft': ('spacecraft', ('weights.length=0.0', 'start.velocity=[0.0, 0.6, -0.4]')),
    'obstacles': (
        'retrieval',
        (
            'obstacles=[1.5, -1.0, 2.5, 0.6, 4.0, 0.2, 5.0, 3.0, 6.5, -2.0, 7.0, 1.0]',
            'rope.center=[9.0, 0.0, 0.0]',
            'no_corner_cutting=true',
            'floor.shape=none',
            'goal_prediction=velocity',
            'rope.amplitude=[0.3, 0.3, 0.0]',
            'faults.position_noise=0.05',
            'max_ticks=29',
        ),
    ),
    'fixed_wing': ('fixed_wing', ()),
    # Up to the line: beyond it, rounding decides to which side to turn. Needs JSBSim.
    'cessna': ('cessna', ('rope.center=[350.0, 60.0, 0.0]', 'max_ticks=55')),
    'rope': ('rope', ()),  # needs MuJoCo and RotorPy
    # While the arrival is exact: the nearest arrival is known to five digits only.
    'lander': ('lander', ('max_ticks=25',)),
    'servicer': ('servicer', ('max_ticks=22',)),  # needs Basilisk
    'multirotor': ('multirotor', ('max_ticks=30', 'gap_tolerance=0.00001')),
    'disturbed': ('dubins', ('floor.shape=none', 'faults.position_noise=0.05')),
    'faulty': (
        'retrieval',
        (
            'seed=7',
            'goal_prediction=harmonic',
            'safe_command=hold_rate_zero',
            'capture_radius=0.001',
            'max_ticks=40',
            *(f'faults.{name}=0.12' for name in ('dropout', 'reorder', 'duplicate', 'nan')),
            'faults.position_noise=0.05',
            'faults.attitude_noise=0.03',
        ),
    ),
}
SOLVE_TIME_MS = 1.0  # recorded for every tick: a measured time would vary
LATER = 1000  # [ns] between messages of a tick
SWITCHED_OFF = range(20, 23)  # ticks of the faulty flight with the planner disabled


def serialised(message: object, kind: str) -> bytes:
    """Return a message in CDR, always the same bytes: DDS leaves arbitrary ones in the padding."""
    raw = serialize_message(message)
    return bytes(store().serialize_cdr(store().deserialize_cdr(raw, kind), kind))


def make(name: str, folder: Path) -> None:
    """Fly ``name`` and write its bag."""
    file, changes = FLIGHTS[name]
    values = settings.resolve(config(f'{file}.yaml'), changes)
    notes = {'parameters': settings.text(values | {'use_sim_time': True})}
    simulated = sim_settings(settings.of_sim(values))
    with closing(BagWriter(folder, topics_of(), notes)) as bag:
        planner = Recorder(values, bag, hostile=name == 'faulty')
        for _ in closed_loop(planner, simulated):
            pass


class Recorder(OfflinePlanner):
    """A planner whose messages go into a bag, as in lock-step with simulated time.

    Args:
        values: of all parameters.
        bag: for the messages.
        hostile: True to send malformed messages as well, and to disable the planner for a while.
    """

    epoch = 0

    def __init__(self, values: settings.Values, bag: BagWriter, hostile: bool) -> None:
        super().__init__(planner_settings(values))
        self.inputs.lag = self.settings.step
        self._bag, self._hostile = bag, hostile
        self._draw = np.random.default_rng(values['seed'])
        self._shown, self.said = -1, 0  # time of the clock, and of the latest message [ns]

    def hear(self, topic: str, message: object, now: float) -> None:
        """Take in a message, which may follow a malformed one."""
        self._show(now)
        if self._hostile and topic in ('odom', 'goal') and self._draw.uniform() < 0.1:
            self._hear(topic, self._malformed(message))
        self._hear(topic, message)

    def report(self, now: float) -> Decision:
        """Answer the latest odometry."""
        disabled = self._hostile and round(now / self.settings.step) in SWITCHED_OFF
        stop, at = DISABLED if disabled else None, self.stamp
        decision = self.decide(self.said / SECOND, at, stop)
        self.said += round(1e6 * SOLVE_TIME_MS)
        for topic, message in self.messages(decision, at).items():
            if topic != 'plan_markers':  # large, and derived from the plan
                self._say(topic, message)
        self.planner.sent(decision.command, at / SECOND)
        return decision

    def decide(self, *given: Any, **more: Any) -> Decision:
        """Return the decision, with the recorded solve time if there was a solve."""
        decision = super().decide(*given, **more)
        return replace(decision, solve_time_ms=SOLVE_TIME_MS * bool(decision.solve_time_ms))

    def _show(self, now: float) -> None:
        """Set the clock to a time [s]."""
        at = self.at(now).nanoseconds
        if at > self._shown:
            self._shown = self.said = at
            self._say('clock', Clock(clock=messages.time_message(at)))

    def _say(self, topic: str, message: object) -> None:
        self.said += LATER
        self._bag.write(f'/{topic}', self._shown, serialised(message, TYPES[topic]), self.said)

    def _hear(self, topic: str, message: object) -> None:
        self._say(topic, message)
        self.inputs.update(topic, message, self.said / SECOND, self._shown)

    def _malformed(self, message):
        """Return a message that must be refused, with one of the faults that validators detect."""
        wrong = type(message)(header=messages.header(self._shown, self.settings.frames.world))
        kind = self._draw.integers(4)
        if kind == 0:
            wrong.header.frame_id = 'map'
        elif kind == 1:
            wrong.header.stamp.nanosec = SECOND
        elif kind == 2:
            wrong.header.stamp.sec = -1
        else:
            pose = getattr(wrong.pose, 'pose', wrong.pose)
            pose.orientation.w = 0.5
        return wrong


if __name__ == '__main__':
    parser = argparse.ArgumentParser(description='Make the golden bags, from seeds, without DDS.')
    parser.add_argument('folder', nargs='?', type=Path, default=Path(__file__).parent)
    place = parser.parse_args().folder
    for each in FLIGHTS:
        shutil.rmtree(place / each, ignore_errors=True)
        make(each, place / each)
