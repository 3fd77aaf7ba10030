# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc demo``: planner and simulator as processes over DDS, a bag, a summary, pictures.

A run has two processes for each vehicle, in its namespace, and a recorder of all messages.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.entry import COMPILING, PACKAGES
from orbimpc_ros.ros.messages import SECOND, UNDATED, stamp_of, time_message
from orbimpc_ros.ros.process import LATCHED, LATEST, attached, qos
from orbimpc_ros.ros.topics import Topic, topics_of
from orbimpc_ros.sim.fleet import FLEETS, vehicles
from orbimpc_ros.sim.parameters import sim_settings
from orbimpc_ros.sim.vehicle import ENGINES, class_of
from orbimpc_ros.tool import history, settings
from orbimpc_ros.tool.bags import BagWriter
from orbimpc_ros.tool.files import new_folder
from orbimpc_ros.tool.history import History
from orbimpc_ros.tool.processes import Child, Processes, ProgressLine, interruptions, isolate
from orbimpc_ros.tool.settings import Values

# The clock of a fleet waits for the slowest answer: inputs must not count as stale meanwhile.
PACED = ('clock=shared', 'odom_timeout=60.0')
# Flights of a demo, by name. The paper shows the Dubins car with and without minimum speed. Its
# retrieval pursues the last seen position of the rope; a second flight intercepts the rope.
VARIANTS: dict[str, dict[str, tuple[str, ...]]] = {
    'retrieval': {'': (), 'first_pass': ('objective=intercept', 'goal_prediction=harmonic')},
    'dubins': {'no_floor': ('floor.shape=none',), 'floor': ('floor.shape=polygon',)},
}
SPIN = 0.05  # [s]
# Nodes start by themselves. The simulator waits for planner and recorder, and exits in the end.
OF_A_RUN = {'autostart': True, 'wait_subscribers': 2, 'exit_when_done': True}
QUIET, DRAIN = 0.1, 1.0  # [s] of silence that completes a bag, and longest wait for it
AGAIN = 0.2  # [s] between repetitions of a time on /clock: messages may be lost
DEPTH = 1000  # a slow disk must not cost messages
TRIGGER = 'odom'  # a lock-step simulator starts once this topic has its subscribers
HEALTH = '/diagnostics'  # on which a planner reports every second once it is configured


def run(scenario: str, vehicles: int | None, out: str, changes: Sequence[str]) -> int:
    """Fly, record, summarise and plot a scenario; return 0 only if the job was done."""
    own = dict[str, Values]()
    if scenario in FLEETS:
        shared, own = fleet(vehicles, changes, scenario)
        flights = {'': shared}
    elif vehicles is not None:
        raise BadInput.stating('--vehicles', 'not a fleet', 'give the scenario fleet or crossing')
    else:
        flights = variants(scenario, changes)
        for values in flights.values():
            if values['vehicle'] in ENGINES:
                class_of(values['vehicle'])  # raises before any process is started
    folder = new_folder(out, scenario)
    flown = dict[str, History]()
    for name, values in flights.items():
        (folder / name).mkdir(exist_ok=True)
        fly(values, folder / name, own)
        bag = folder / name / 'bag'
        flown |= {each or name: history.of_bag(bag, each) for each in own or ('',)}
    return report(folder, flights, flown)


def variants(scenario: str, changes: Sequence[str]) -> dict[str, Values]:
    """Return the parameters of each flight of a demo, by name; a single flight has an empty name.

    With ``changes`` a demo is no longer the paper's, and has a single flight.

    Raises:
        BadInput: an unknown name, or a value or combination that is not allowed.
    """
    flights = {'': tuple(changes)} if changes else VARIANTS.get(scenario, {'': ()})
    file = settings.config(f'{scenario}.yaml')
    return {name: settings.resolve(file, variant) for name, variant in flights.items()}


def fleet(
    count: int | None, changes: Sequence[str], scenario: str = 'fleet'
) -> tuple[Values, dict[str, Values]]:
    """Return the values that a fleet shares, and the values that differ by namespace.

    Args:
        count: of the vehicles; None for the scenario's default.
        changes: ``name=value``, for every vehicle; ``seed`` is that of the whole fleet.
        scenario: ``fleet`` or ``crossing``.

    Raises:
        BadInput: too many vehicles, an unknown name, or a value that is not allowed.
    """
    values = settings.resolve(settings.config(f'{scenario}.yaml'), [*PACED, *changes])
    if values['clock'] == 'lockstep':
        raise BadInput('clock', values['clock'], 'shared or wall: a fleet has one /clock')
    fixed = settings.named(changes) - {'seed'}
    drawn = vehicles(scenario, FLEETS[scenario] if count is None else count, values['seed'])
    if values['avoid']:
        values['avoid'] = tuple(f'{namespace}/plan' for namespace in drawn)
    own = {
        namespace: {name: value for name, value in each.items() if name not in fixed}
        for namespace, each in drawn.items()
    }
    return values, own


def report(folder: Path, names: Iterable[str], flown: Mapping[str, History]) -> int:
    """Summarise flights by name, or a fleet's by namespace; draw pictures; return the exit code."""
    from orbimpc_ros.tool import plot  # its import is slow and would delay the start of nodes

    print(history.text(flown))
    clear = not any(name.startswith('/') for name in flown) or clearance(flown)
    for name in names:
        print(f'bag           {folder / name / "bag"}')
    with plot.look():
        pictures = plot.written(flown, folder)
    for name in pictures:
        label = 'picture' if name == plot.PATH else Path(name).stem
        print(f'{label:<14}{folder / name}')
    return 0 if clear and all(each.captured for each in flown.values()) else 1


def clearance(flown: Mapping[str, History]) -> bool:
    """Print the least distance of vehicles that avoid each other; return whether it suffices."""
    radius = next(iter(flown.values())).values['avoid_radius']
    if not radius:
        return True
    _, distances = history.separations(flown)
    for pair, apart in distances.items():
        if min(apart) < radius:
            print(f'COLLISION     {" and ".join(pair)} within {min(apart):.3f} m of each other')
    least = min(map(min, distances.values()), default=math.inf)
    print(f'apart         at least {least:.3f} m, {radius:g} m required')
    return least >= radius


# --- a run


def fly(values: Values, folder: Path, own: Mapping[str, Values]) -> None:
    """Run planners and simulators until these are done, and record their messages.

    Args:
        values: of every parameter.
        folder: for the bag, the parameters and the output of the processes.
        own: a fleet's values that differ between vehicles, by namespace, such as ``/uav1``.

    Raises:
        OrbimpcError: a node has failed.
        KeyboardInterrupt: a signal arrived; the bag is complete up to then.
    """
    parameters, namespaces = folder / 'parameters.yaml', tuple(own) or ('',)
    text = settings.text(values | OF_A_RUN | {'use_sim_time': values['clock'] != 'wall'}, own)
    parameters.write_text(text)
    print(f'ROS_DOMAIN_ID={isolate(folder)}, results in {folder}')
    names, notes = {f'{each}/planner'.strip('/') for each in namespaces}, {'parameters': text}
    progress, pacer = ProgressLine(values['max_ticks']), None
    with interruptions() as received, Processes() as started:

        def begun(node: str, namespace: str) -> Child:
            log = folder / f'{namespace.strip("/")}-{node}.log'.lstrip('-')
            return started.start(PACKAGES[node], parameters, log, namespace)

        planners, sims = (
            {each: begun(node, each) for each in namespaces} for node in ('planner', 'sim')
        )
        with closing(Recorder(folder / 'bag', topics_of(namespaces), notes, names)) as recorder:
            if values['clock'] == 'shared':
                pacer = Pacer(recorder, sim_settings(settings.of_sim(values)).begin, values['step'])
            while not received and (flying := [name for name in sims if sims[name].poll() is None]):
                recorder.spin(SPIN)
                if pacer is not None:
                    pacer.look(flying)
                for planner in planners.values():
                    planner.require_health()
                ticks = max(recorder.counts[f'{namespace}/tick'] for namespace in planners)
                progress.show(ticks, _progress(ticks, values, planners))
            progress.close()
            recorder.drain()
            for namespace, sim in sims.items():
                # A simulator reports the end of its flight, with or without a catch, there.
                if not received and not recorder.counts[f'{namespace}/captured']:
                    sim.require_health()
    if received:
        raise KeyboardInterrupt


def _progress(ticks: int, values: Values, planners: Mapping[str, Child]) -> str:
    """Return the progress of a flight, which may repeat late ticks; at first, of compilation."""
    if ticks:
        return f'tick {min(ticks, values["max_ticks"])} of at most {values["max_ticks"]}'
    _, compiling, rest = '\n'.join(each.output for each in planners.values()).rpartition(COMPILING)
    return compiling + rest.partition('\n')[0] if compiling else 'starting nodes'


class Pacer:
    """The clock of a fleet in lock-step: it advances when every vehicle has its command.

    On a machine that is too slow for real time the flight takes longer, but no command is missed.
    A simulator whose planner does not answer gives up by itself, and the others fly on.

    Args:
        recorder: of the fleet.
        begin: of the flight [s].
        step: by which the clock advances [s].
    """

    def __init__(self, recorder: Recorder, begin: float, step: float) -> None:
        self._latest, self._now, self._step = recorder.latest, begin, step
        self._clock = recorder.node.create_publisher(Clock, '/clock', DEPTH)
        recorder.node.create_timer(AGAIN, self._tell)
        self._tell()

    def look(self, flying: Sequence[str]) -> None:
        """Advance by a step if the vehicles of these namespaces have answered the last one."""
        stamps = [self._latest.get(f'{name}/cmd_vel', -math.inf) for name in flying]
        if min(stamps) >= (self._now - 0.5 * self._step) * SECOND:  # more than rounding errors
            self._now += self._step
            self._tell()

    def _tell(self) -> None:
        self._clock.publish(Clock(clock=time_message(round(self._now * SECOND))))


# --- the bag: serialised messages as they arrive, under their own stamps


class Recorder:
    """A node that records messages in a bag.

    A message is recorded under its own stamp, so that the bag plays at the speed of the run
    however fast that was simulated. A message without a stamp is recorded under the previous
    stamp, or dropped before the first one. The time of sending is recorded, too, and gives the
    order of events.

    The recorder subscribes to the planners' health after all else, and to odometry once it has
    heard it from each of them. DDS announces endpoints in the order of creation: a planner that is
    heard has discovered all subscriptions before this one, and a simulator that waits for the last
    one finds the recorder complete.

    Args:
        folder: of the bag, created.
        topics: to record.
        notes: stored in the bag's metadata.
        planners: names of the nodes that must discover the recorder before that.

    Attributes:
        node: that records.
        counts: number of messages recorded, by topic.
        latest: stamp of the last message of a topic [ns].
    """

    def __init__(
        self,
        folder: Path,
        topics: Sequence[Topic],
        notes: dict[str, str],
        planners: Iterable[str],
    ) -> None:
        self.latest: dict[str, int] = {}
        self._now = UNDATED  # the last stamp [ns]
        self._bag = BagWriter(folder, topics, notes)
        self.counts = self._bag.counts
        self._stack = ExitStack()
        self.node, self._executor = self._stack.enter_context(
            attached('recorder', enable_rosout=False, start_parameter_services=False)
        )
        self._held = [topic for topic in topics if topic.name.rpartition('/')[2] == TRIGGER]
        for topic in sorted(topics, key=lambda topic: topic.name == HEALTH):
            if topic not in self._held:
                self._listen(topic)
        self._unmet = set(planners)
        self._meet()

    def _meet(self, *nodes: str) -> None:
        """Note which nodes have been heard; after all planners, subscribe to odometry, too."""
        self._unmet.difference_update(nodes)
        while self._held and not self._unmet:
            self._listen(self._held.pop())

    def _listen(self, topic: Topic) -> None:
        profile = qos(DEPTH, durability=(LATCHED if topic.latched else LATEST).durability)
        take: Any = partial(self._take, topic)  # rclpy also passes the message's info
        self.node.create_subscription(topic.message, topic.name, take, profile, raw=True)

    def _take(self, topic: Topic, data: bytes, about: dict[str, Any]) -> None:
        message = deserialize_message(data, topic.message)
        if topic.name == HEALTH:
            self._meet(*(each.name.partition(':')[0] for each in message.status))
        own = stamp_of(message)
        self.latest[topic.name] = own
        self._now = self._now if own == UNDATED else own
        if self._now != UNDATED:
            self._bag.write(topic.name, self._now, data, about['source_timestamp'])

    def spin(self, seconds: float) -> None:
        """Record one message, if one arrives within this time."""
        self._executor.spin_once(timeout_sec=seconds)

    def drain(self) -> None:
        """Record the last messages, until there is silence, but not for long."""
        heard, last = -1, time.monotonic()
        end = last + DRAIN
        while (now := time.monotonic()) < min(end, last + QUIET):
            if sum(self.counts.values()) != heard:
                last, heard = now, sum(self.counts.values())
            self.spin(QUIET / 4)

    def close(self) -> None:
        """Stop recording and finish the bag; the node ends even if the disk is full."""
        with self._stack:
            self._bag.close()
