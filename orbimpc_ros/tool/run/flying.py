# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A run: vehicles, each two processes in its namespace, and a bag of their messages over DDS."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path

from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.ros.entry import COMPILING, PACKAGES
from orbimpc_ros.ros.messages import SECOND
from orbimpc_ros.ros.topics import topics_of
from orbimpc_ros.sim.parameters import sim_settings
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.files import shown
from orbimpc_ros.tool.run.processes import Process, Processes, interruptions, isolate
from orbimpc_ros.tool.run.progress import ProgressLine
from orbimpc_ros.tool.run.recorder import Recorder
from orbimpc_ros.tool.settings import Values

SPIN = 0.05  # [s]
# A simulator that ends with its flight, and begins once planner and recorder hear it.
OF_A_RUN = {'exit_when_done': True, 'wait_subscribers': 2}
QUIET, LAST_WORDS = 0.1, 1.0  # [s] without a message, and at most, until the bag is complete
AGAIN = 0.2  # [s] from one message of the same time to the next; the first may be lost
PATIENCE = 120.0  # [s] for the answers to a step
STARTING = 600.0  # [s] and to the first one, before which machine code may be compiled


def fly(values: Values, folder: Path, own: Mapping[str, Values] = settings.EMPTY) -> None:
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
            nodes: dict[str, dict[str, Process]] = {'planner': {}, 'sim': {}}
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
    nodes: Mapping[str, Mapping[str, Process]],
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


def _starting(planners: Mapping[str, Process]) -> str:
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
