# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A run: vehicles, each two processes in its namespace, and a bag of their messages over DDS."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.ros.entry import COMPILING, PACKAGES
from orbimpc_ros.ros.messages import SECOND
from orbimpc_ros.sim.parameters import sim_settings
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.files import shown
from orbimpc_ros.tool.run import discovery
from orbimpc_ros.tool.run.processes import Interruptions, Process
from orbimpc_ros.tool.run.progress import ProgressLine
from orbimpc_ros.tool.run.recorder import Recorder
from orbimpc_ros.tool.settings import Values
from orbimpc_ros.tool.topics import topics_of

SPIN = 0.05  # [s]
# A simulator that ends with its flight, and begins once planner and recorder hear it.
OF_A_RUN = {'exit_when_done': True, 'wait_subscribers': 2}
QUIET, LAST_WORDS = 0.1, 1.0  # [s] without a message, and at most, until the bag is complete
AGAIN = 0.2  # [s] from one message of the same time to the next; the first may be lost
PATIENCE = 120.0  # [s] for the answers to a step
STARTING = 600.0  # [s] and to the first one, before which machine code may be compiled


@dataclass(frozen=True)
class VehicleProcesses:
    """A vehicle that flies: its namespace and its two processes."""

    namespace: str
    planner: Process
    sim: Process


def fly(values: Values, folder: Path, own: Mapping[str, Values] = settings.EMPTY) -> None:
    """Run planners and simulators until these are done, and record their messages.

    Args:
        values: of every parameter.
        folder: takes the bag, the parameters and what the processes print.
        own: of a fleet: values that differ from one namespace, such as ``/uav1``, to another.

    Raises:
        ProcessFailure: a node has failed.
        KeyboardInterrupt: somebody asked to stop; the bag is complete up to then.
    """
    parameters, namespaces = folder / 'parameters.yaml', tuple(own) or ('',)
    simulated = values['clock'] != 'wall'
    text = settings.text(values | OF_A_RUN | {'use_sim_time': simulated}, own)
    parameters.write_text(text)
    print(f'ROS_DOMAIN_ID={discovery.isolate(folder)}, results in {shown(folder)}')
    planners, notes = [f'{each}/planner' for each in namespaces], {'parameters': text}
    with Interruptions() as interruptions:
        with (
            _vehicles(namespaces, parameters, folder) as vehicles,
            closing(Recorder(folder / 'bag', topics_of(namespaces), notes, planners)) as recorder,
        ):
            _watch(vehicles, recorder, interruptions, values)
        if interruptions.requested:
            raise KeyboardInterrupt


@contextmanager
def _vehicles(
    namespaces: tuple[str, ...], parameters: Path, folder: Path
) -> Iterator[tuple[VehicleProcesses, ...]]:
    started: list[Process] = []

    def start(node: str, namespace: str) -> Process:
        log = folder / f'{namespace.strip("/")}-{node}.log'.lstrip('-')
        process = Process(PACKAGES[node], parameters, log, namespace=namespace)
        started.append(process)
        return process

    try:
        yield tuple(
            VehicleProcesses(namespace, start('planner', namespace), start('sim', namespace))
            for namespace in namespaces
        )
    finally:
        for process in started:  # all at once: each takes its time
            if process.running:
                process.tell(signal.SIGINT)
        for process in started:
            process.stop()


def _watch(
    vehicles: tuple[VehicleProcesses, ...],
    recorder: Recorder,
    interruptions: Interruptions,
    values: Values,
) -> None:
    """Record until the simulators are done or somebody asks to stop."""
    progress, pacer = ProgressLine(values['max_ticks']), None
    if values['clock'] == 'shared':
        pacer = Pacer(recorder, sim_settings(settings.of_sim(values)).begin, values['step'])
    while any(each.sim.running for each in vehicles) and not interruptions.requested:
        recorder.spin(SPIN)
        if pacer is not None:
            pacer.look([each.namespace for each in vehicles if each.sim.running])
        for each in vehicles:
            each.planner.require_health()
        _show(progress, vehicles, recorder, values)
    progress.close()
    recorder.drain(QUIET, LAST_WORDS)
    for each in vehicles:
        # A simulator that has come to its end reports it, whether it caught anything or not.
        if not interruptions.requested and not recorder.counts[f'{each.namespace}/captured']:
            each.sim.require_health()


def _show(
    progress: ProgressLine,
    vehicles: tuple[VehicleProcesses, ...],
    recorder: Recorder,
    values: Values,
) -> None:
    ticks = max(recorder.counts[f'{each.namespace}/tick'] for each in vehicles)
    time = ticks / values['odom_rate'] if values['odom_rate'] else ticks * values['step']
    text = f'tick {ticks} of at most {values["max_ticks"]}, t = {time:.0f} s'
    if not ticks:
        text = _starting([each.planner for each in vehicles])
    elif len(vehicles) > 1:
        done = sum(not each.sim.running for each in vehicles)
        text += f', {done} of {len(vehicles)} done'
    progress.show(ticks, text)


def _starting(planners: list[Process]) -> str:
    """Return what planners that have not answered yet are at: the last that they report of it."""
    lines = [line for each in planners for line in each.output.splitlines() if COMPILING in line]
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
