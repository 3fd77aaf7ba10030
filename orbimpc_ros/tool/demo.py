# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc demo``: planner and simulator as processes over DDS, a bag, a summary, pictures.

A run is of vehicles, each two processes in its namespace, and of a recorder of their messages.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

from rcl_interfaces.srv import GetParameters
from rclpy.client import Client
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock

from orbimpc_ros.mpc.errors import BadInput, OrbimpcError
from orbimpc_ros.ros.entry import COMPILING, PACKAGES
from orbimpc_ros.ros.messages import SECOND, time_message
from orbimpc_ros.ros.process import LATCHED, LATEST, attached, qos
from orbimpc_ros.ros.topics import Topic, topics_of
from orbimpc_ros.sim.engine_vehicle import ENGINES, class_of
from orbimpc_ros.sim.fleet import FLEETS, separations
from orbimpc_ros.sim.parameters import sim_settings
from orbimpc_ros.tool import history, settings
from orbimpc_ros.tool.bags import BagWriter, stamp_of
from orbimpc_ros.tool.files import new_folder, shown
from orbimpc_ros.tool.history import History
from orbimpc_ros.tool.processes import Child, Processes, ProgressLine, interruptions, isolate
from orbimpc_ros.tool.settings import Values

# The clock of a fleet waits for the slowest answer, which makes nothing stale.
PACED = ('clock=shared', 'odom_timeout=60.0')
# Flights of a demo, by name. The paper shows the Dubins car with and without minimum speed; its
# retrieval, which follows the rope as last seen, has beside it one that intercepts it.
VARIANTS: dict[str, dict[str, tuple[str, ...]]] = {
    'retrieval': {'': (), 'first_pass': ('objective=intercept', 'goal_prediction=harmonic')},
    'dubins': {'no_floor': ('floor.shape=none',), 'floor': ('floor.shape=polygon',)},
}
SPIN = 0.05  # [s]
# A simulator that ends with its flight, and begins once planner and recorder hear it.
OF_A_RUN = {'exit_when_done': True, 'wait_subscribers': 2}
QUIET, LAST_WORDS = 0.1, 1.0  # [s] without a message, and at most, until the bag is complete
AGAIN = 0.2  # [s] from one message of the same time to the next; the first may be lost
PATIENCE = 120.0  # [s] for the answers to a step
STARTING = 600.0  # [s] and to the first one, before which machine code may be compiled
DEPTH = 1000  # a slow disk must not cost messages
TRIGGER = 'odom'  # a lock-step simulator starts as soon as it has its subscribers
CALL_AGAIN = 5.0  # [s] until a planner that has not answered is called again


def run(scenario: str, vehicles: int | None, out: str, changes: Sequence[str]) -> int:
    """Fly, record, sum up, draw; 0 only if the job was done."""
    flights, own = dict[str, Values](), dict[str, Values]()
    if scenario in FLEETS:
        flights[''], own = fleet(vehicles, changes, scenario)
    elif vehicles is not None:
        raise BadInput.stating('--vehicles', 'no fleet', 'give the scenario fleet or crossing')
    else:
        flights = variants(scenario, changes)
        for values in flights.values():
            if values['vehicle'] in ENGINES:
                class_of(values['vehicle'])  # raises, before anything is started
    folder = new_folder(out, scenario)
    bags = {name: folder / name / 'bag' for name in flights}
    for name, values in flights.items():
        (folder / name).mkdir(exist_ok=True)
        fly(values, folder / name, own)
    if own:
        flown = {name: history.of_bag(bags[''], name) for name in own}
    else:
        flown = {name: history.of_bag(bag) for name, bag in bags.items()}
    return report(folder, [*bags.values()], flown)


def variants(scenario: str, changes: Sequence[str]) -> dict[str, Values]:
    """Return the parameters of each flight of a demo, by name; a single one has none.

    Where what tells flights apart is set for all of them, there is one; so is a retrieval with any
    parameter of its own, which is no longer the paper's.

    Raises:
        BadInput: an unknown name, or a value or combination that is not allowed.
    """
    found = VARIANTS.get(scenario, {'': ()})
    if any(scenario == 'retrieval' or each.startswith('floor.shape=') for each in changes):
        found = {'': ()}
    file = settings.config(f'{scenario}.yaml')
    return {name: settings.resolve(file, [*changes, *variant]) for name, variant in found.items()}


def fleet(
    count: int | None, changes: Sequence[str], scenario: str = 'fleet'
) -> tuple[Values, dict[str, Values]]:
    """Return the values that a fleet shares, and by namespace those that differ.

    Args:
        count: of the vehicles; None for as many as the scenario is made for.
        changes: ``name=value``, for every vehicle; ``seed`` is that of the whole fleet.
        scenario: ``fleet`` or ``crossing``.

    Raises:
        BadInput: too many vehicles, an unknown name, or a value that is not allowed.
    """
    file = settings.config(f'{scenario}.yaml')
    values = settings.resolve(file, [*PACED, *changes])
    if values['clock'] == 'lockstep':
        raise BadInput('clock', values['clock'], 'shared or wall: a fleet has one /clock')
    given = {change.partition('=')[0] for change in changes} - {'seed'}
    draw, usual = FLEETS[scenario]
    drawn = draw(usual if count is None else count, values['seed'])
    if values['avoid']:
        values['avoid'] = tuple(f'{namespace}/plan' for namespace in drawn)
    own = {
        namespace: {name: value for name, value in each.items() if name not in given}
        for namespace, each in drawn.items()
    }
    return values, own


def report(folder: Path, paths: Sequence[Path], flown: Mapping[str, History]) -> int:
    """Sum up the flights of a demo, draw pictures, and return the exit code.

    Args:
        folder: takes the pictures.
        paths: of the bags.
        flown: the flights, by name; those of a fleet by namespace.
    """
    from orbimpc_ros.tool import plot  # matplotlib takes time that the start of nodes has not

    clear = True
    if any(name.startswith('/') for name in flown):
        print(history.of_fleet(flown))
        clear = clearance(flown)
    else:
        for name, each in flown.items():
            print(f'{name}:\n{history.text(each)}' if name else history.text(each))
    for path in paths:
        print(f'bag           {shown(path)}')
    with plot.look():
        pictures = plot.written(flown, folder)
    for name in pictures:
        label = 'picture' if name == plot.PATH else Path(name).stem
        print(f'{label:<14}{shown(folder / name)}')
    return 0 if clear and all(each.captured for each in flown.values()) else 1


def clearance(flown: Mapping[str, History]) -> bool:
    """Print how close vehicles that avoid each other came; return whether that is far enough."""
    radius = next(iter(flown.values())).values['avoid_radius']
    if not radius:
        return True
    _, found = separations({name: (each.times, each.positions) for name, each in flown.items()})
    for pair, apart in found.items():
        if min(apart) < radius:
            print(f'COLLISION     {" and ".join(pair)} within {min(apart):.3f} m of each other')
    least = min(map(min, found.values()), default=math.inf)
    print(f'apart         at least {least:.3f} m, {radius:g} m asked for')
    return least >= radius


# --- a run


def fly(values: Values, folder: Path, own: Mapping[str, Values] = {}) -> None:
    """Run planners and simulators until these are done, and record their messages.

    Args:
        values: of every parameter.
        folder: takes the bag, the parameters and what the processes print.
        own: of a fleet: values that differ from one namespace, such as ``/uav1``, to another.

    Raises:
        OrbimpcError: a node has failed.
        KeyboardInterrupt: somebody asked to stop; the bag is complete up to then.
    """
    parameters, namespaces = folder / 'parameters.yaml', tuple(own) or ('',)
    simulated = values['clock'] != 'wall'
    text = settings.text(values | OF_A_RUN | {'use_sim_time': simulated}, own)
    parameters.write_text(text)
    print(f'ROS_DOMAIN_ID={isolate(folder)}, results in {shown(folder)}')
    planners, notes = [f'{each}/planner' for each in namespaces], {'parameters': text}
    with interruptions() as received:
        with Processes() as started:
            nodes: dict[str, dict[str, Child]] = {'planner': {}, 'sim': {}}
            for namespace, node in itertools.product(namespaces, nodes):
                log = folder / f'{namespace.strip("/")}-{node}.log'.lstrip('-')
                known = PACKAGES[node], parameters, log
                nodes[node][namespace] = started.start(*known, namespace=namespace)
            bag = Recorder(folder / 'bag', topics_of(namespaces), notes, planners)
            with closing(bag) as recorder:
                _watch(nodes, recorder, received, values)
        if received:
            raise KeyboardInterrupt


def _watch(
    nodes: Mapping[str, Mapping[str, Child]],
    recorder: Recorder,
    received: Sequence[int],
    values: Values,
) -> None:
    """Record until the simulators are done or somebody asks to stop."""
    planners, sims = nodes['planner'], nodes['sim']
    progress, pacer = ProgressLine(values['max_ticks']), None
    if values['clock'] == 'shared':
        pacer = Pacer(recorder, sim_settings(settings.of_sim(values)).begin, values['step'])
    while not received:
        flying = [namespace for namespace, sim in sims.items() if sim.running]
        if not flying:
            break
        recorder.spin(SPIN)
        if pacer is not None:
            pacer.look(flying)
        for planner in planners.values():
            planner.require_health()
        ticks = max(recorder.counts[f'{namespace}/tick'] for namespace in planners)
        done = f', {len(sims) - len(flying)} of {len(sims)} done' if len(sims) > 1 else ''
        progress.show(ticks, _flown(ticks, values) + done if ticks else _starting(planners))
    progress.close()
    recorder.drain(QUIET, LAST_WORDS)
    for namespace, sim in sims.items():
        # A simulator that has come to its end reports it, whether it caught anything or not.
        if not received and not recorder.counts[f'{namespace}/captured']:
            sim.require_health()


def _flown(ticks: int, values: Values) -> str:
    time = ticks / values['odom_rate'] if values['odom_rate'] else ticks * values['step']
    return f'tick {ticks} of at most {values["max_ticks"]}, t = {time:.0f} s'


def _starting(planners: Mapping[str, Child]) -> str:
    """Return what planners that have not answered yet are at: the last that they report of it."""
    printed = (each.output.splitlines() for each in planners.values())
    lines = [line for each in printed for line in each if COMPILING in line]
    return f'{COMPILING}{lines[-1].rpartition(COMPILING)[2]}' if lines else 'the nodes start'


class Pacer:
    """The clock of a fleet in lock-step: it goes on when every vehicle has its command.

    On a machine that is too slow for real time the flight takes longer, and no vehicle flies blind.

    Args:
        recorder: of the fleet.
        begin: of the flight [s].
        step: from one time to the next [s].
    """

    def __init__(self, recorder: Recorder, begin: float, step: float) -> None:
        self._recorder, self._begin, self._step = recorder, begin, step
        self._count, self._since, self._sent = 0, time.monotonic(), 0.0

    def look(self, flying: Sequence[str]) -> None:
        """Go on a step if the vehicles of these namespaces have answered the last one.

        Raises:
            OrbimpcError: one of them has not for too long.
        """
        now, wall = round((self._begin + self._count * self._step) * SECOND), time.monotonic()
        early = now - 0.5 * self._step * SECOND  # rounding is less
        answers = {name: self._recorder.latest.get(f'{name}/cmd_vel', -math.inf) for name in flying}
        silent = [name for name, stamp in answers.items() if stamp < early]
        if not silent:
            self._count, self._since, self._sent = self._count + 1, wall, 0.0
        elif wall - self._since > (PATIENCE if self._count else STARTING):
            raise OrbimpcError(f'{", ".join(silent)}: no command for {wall - self._since:.0f} s')
        if wall - self._sent > AGAIN:
            self._sent = wall
            self._recorder.publish_clock(self._begin + self._count * self._step)


# --- the bag: messages byte by byte as they come, under the stamps they carry


class Recorder:
    """A node that writes what it hears into a bag.

    A message goes under the stamp it carries, so that the bag plays at the speed of the run
    however fast that was simulated; one without a stamp goes under the last stamp before it, and
    before the first one is left out. The time of sending is kept, too, for the order in which
    things happened.

    Odometry is subscribed to once every planner has answered a call. DDS announces endpoints in
    the order of their creation: a planner that knows the last one knows every subscription, and
    a simulator that waits for the subscription to odometry finds the recorder complete.

    Args:
        folder: of the bag, created.
        topics: to record.
        notes: kept in the bag's metadata.
        planners: nodes that must know the recorder before odometry is asked for.

    Attributes:
        counts: messages recorded, by topic.
        latest: stamp of the last message of a topic [ns].
    """

    def __init__(
        self,
        folder: Path,
        topics: Sequence[Topic],
        notes: dict[str, str],
        planners: Sequence[str] = ('/planner',),
    ) -> None:
        self.latest: dict[str, int] = {}
        self._now: int | None = None  # the last stamp [ns]
        self._bag = BagWriter(folder, topics, notes)
        self.counts = self._bag.counts
        self._stack = ExitStack()
        self._node, self._executor = self._stack.enter_context(
            attached('recorder', enable_rosout=False, start_parameter_services=False)
        )
        self._held = [topic for topic in topics if topic.name.rpartition('/')[2] == TRIGGER]
        for topic in topics:
            if topic not in self._held:
                self._listen(topic)
        self._unmet = {name: self._client(name) for name in planners}
        self._clock: Any = None
        self._called = dict.fromkeys(planners, -math.inf)  # when, on the steady clock [s]

    def _client(self, planner: str) -> Client:
        """Return a client of a service that every node has."""
        return self._node.create_client(GetParameters, f'{planner}/get_parameters')

    def _meet(self) -> None:
        """Call planners that have not answered yet; when all have, listen to odometry too.

        One that is being configured answers when that is done. Who begins again has lost the call.
        """
        now = time.monotonic()
        for name, client in self._unmet.items():
            if now - self._called[name] >= CALL_AGAIN and client.service_is_ready():
                self._called[name] = now
                answer = client.call_async(GetParameters.Request())
                answer.add_done_callback(lambda _, name=name: self._unmet.pop(name, None))
        while self._held and not self._unmet:
            self._listen(self._held.pop())

    def _listen(self, topic: Topic) -> None:
        profile = qos(DEPTH, durability=(LATCHED if topic.latched else LATEST).durability)
        take: Any = self._taking(topic)  # rclpy also gives what is known about the message
        self._node.create_subscription(topic.message, topic.name, take, profile, raw=True)

    def _taking(self, topic: Topic) -> Callable[[bytes, dict[str, Any]], None]:
        def take(data: bytes, about: dict[str, Any]) -> None:
            own = stamp_of(deserialize_message(data, topic.message))
            self.latest[topic.name] = own or 0
            self._now = self._now if own is None else own
            if self._now is not None:
                self._bag.write(topic.name, self._now, data, about['source_timestamp'])

        return take

    def publish_clock(self, seconds: float) -> None:
        """Publish a time on /clock, for nodes that have no simulator of their own to do so."""
        if self._clock is None:
            self._clock = self._node.create_publisher(Clock, '/clock', DEPTH)
        self._clock.publish(Clock(clock=time_message(round(seconds * SECOND))))

    def spin(self, seconds: float) -> None:
        """Record for a while, or until something has come."""
        self._meet()
        self._executor.spin_once(timeout_sec=seconds)

    def drain(self, quiet: float, limit: float) -> None:
        """Record on until nothing has come for ``quiet`` seconds, ``limit`` seconds at most."""
        last = time.monotonic()
        end, heard = last + limit, sum(self.counts.values())
        while time.monotonic() < min(end, last + quiet):
            self.spin(quiet / 4)
            if sum(self.counts.values()) != heard:
                last, heard = time.monotonic(), sum(self.counts.values())

    def close(self) -> None:
        """Stop recording and finish the bag; the node ends even if the disk is full."""
        with self._stack:
            self._bag.close()
