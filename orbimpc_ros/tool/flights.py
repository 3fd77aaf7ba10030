# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The flights of a study: planner and vehicle in one process, a row of results for each.

The rows are saved in a file, a line for each flight, so that an interrupted study can resume.
"""

from __future__ import annotations

import asyncio
import json
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from orbimpc_ros.loop.planner import Decision
from orbimpc_ros.mpc.errors import BadInput, OrbimpcError
from orbimpc_ros.mpc.outcome import Fallback, Status
from orbimpc_ros.ros.parameters.planner import planner_settings
from orbimpc_ros.sim.engines import EngineFailure
from orbimpc_ros.sim.parameters import sim_settings
from orbimpc_ros.sim.world import Flight
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.offline import OfflinePlanner, closed_loop

Row = dict[str, Any]
Key = tuple[str, int]  # controller, and number of a flight
Job = tuple[str, str, int, settings.Values, float]  # arguments of :func:`flown`
PATIENCE = 5.0  # [s] for a scheduler to answer, and for its first worker
GLANCE = 0.2  # [s] between checks for a signal
OURS = 'orbitope'  # this package's controller
BASELINES = 'benchmarks.baselines'  # a folder of the repository, which is not installed


def flown(
    study: str, controller: str, index: int, values: settings.Values, margin: float = 0.0
) -> Row:
    """Fly and return the row of a flight.

    Args:
        study: its name, by which baselines find their tuned parameters.
        controller: :data:`OURS`, or the name of a baseline.
        index: of the flight.
        values: of all parameters, drawn ones included.
        margin: added to the reported radii of bodies in the traffic [m].

    Returns:
        ``controller`` and ``index``; ``caught``, ``time`` to the catch [s] (None without one),
        ``touched`` (whether it ended in a collision), ``failed`` (error of an engine, if any); the
        numbers of ``ticks``, of ``optimal`` and of ``unplanned`` (fallback) ones; ``p50_ms`` and
        ``longest_ms``, the processor time of a tick; and the row of :func:`_of_way`.
    """
    simulated, given = sim_settings(settings.of_sim(values)), planner_settings(values)
    pilot: Any = None  # this package's planner
    if controller != OURS:
        pilot = baselines().baseline_named(controller, given, study)
    # Ticks are measured in processor time, because other processes may load the machine.
    planner = OfflinePlanner(given, clock=time.thread_time, planner=pilot)
    way, ticks, failed = list[Flight](), list[Decision](), ''
    try:
        for flight, decision in closed_loop(planner, simulated, margin):
            way.append(flight)
            if flight.over or flight.touched:
                break
            if decision is not None:
                ticks.append(decision)
            if controller != OURS:
                pilot.steer(flight)
    except EngineFailure as error:
        failed = str(error)
    spent = [decision.solve_time_ms for decision in ticks] or [0.0]
    return {
        'controller': controller,
        'index': index,
        'caught': flight.captured,
        'time': flight.missed_at if flight.captured else None,
        'touched': bool(flight.touched),
        'failed': failed,
        'ticks': len(ticks),
        'optimal': sum(decision.status is Status.OPTIMAL for decision in ticks),
        'unplanned': sum(decision.fallback is not Fallback.NONE for decision in ticks),
        'p50_ms': float(np.median(spent)),
        'longest_ms': max(spent),
        **_of_way(way),
    }


def baselines() -> Any:
    """Return the package of the baselines.

    Raises:
        BadInput: the package is not run from a clone of the repository.
    """
    try:
        return import_module(BASELINES)
    except ModuleNotFoundError:
        missing = f'{BASELINES} is missing'
        raise BadInput.stating('--controllers', missing, 'run it from a clone') from None


def _of_way(way: Sequence[Flight]) -> Row:
    """Return the results on the trajectory of a flight.

    The ``closest`` distance to the goal [m] and ``stalls``; of an arrival, the final distance
    ``missed`` [m] and ``speed`` [m/s]; of a vehicle in an engine, its least ``airspeed`` [m/s] and
    the largest magnitude of each quantity that the engine reports, such as its ``bank`` [rad].
    """
    last = way[-1]
    row = {'closest': min(flight.miss for flight in way), 'stalls': last.stalls}
    if last.settings.finish == 'arrival':
        row |= {'missed': last.distance, 'speed': last.speed}
    if last.vehicle.engine is not None:
        row['airspeed'] = last.least_airspeed
        trail = (vehicle.facts for flight in way for vehicle in flight.trail if not vehicle.caught)
        for name, value in chain.from_iterable(facts.items() for facts in trail):
            row[name] = max(row.get(name, 0.0), abs(value))
    return row


# --- the file of a study: its specification in the first line, a flight in each further one


def rows_of(file: Path, about: dict[str, Any], *, resumed: bool) -> dict[Key, Row]:
    """Return the rows in a study's file, which is created or resumed.

    Args:
        file: of the study; a truncated last line is removed.
        about: specification of the study, in JSON's types.
        resumed: whether the file is resumed.

    Raises:
        BadInput: the file is of another study, is damaged, is missing, or exists already.
    """
    if file.exists() != resumed:
        there = 'no study to continue' if resumed else 'a study already'
        raise BadInput(str(file), there, 'another -o DIR' if resumed else '--resume')
    kept: dict[Key, Row] = {}
    if resumed:
        try:
            whole = file.read_text().rpartition('\n')[0]
            head, *rows = map(json.loads, whole.splitlines())
            differ = [n for n in about if head.get(n) != json.loads(json.dumps(about[n]))]
            kept = {(row['controller'], row['index']): row for row in rows}
        except (AttributeError, KeyError, TypeError, ValueError, RecursionError):
            raise BadInput(str(file), 'damaged', 'the results of a study') from None
        if differ:
            raise BadInput(str(file), f'a study with other {", ".join(differ)}', 'the same')
    file.write_text(''.join(json.dumps(each) + '\n' for each in (about, *kept.values())))
    return kept


# --- many flights


def each_flown(pool: Executor, jobs: Sequence[Job], going: Callable[[], bool]) -> Iterator[Row]:
    """Yield the rows of flights as they are completed, as long as ``going()``.

    Raises:
        OrbimpcError: a flight ended with an error, or its process did.
    """
    pending: set[Future[Row]] = {pool.submit(flown, *job) for job in jobs}
    try:
        while pending and going():
            done, pending = wait(pending, GLANCE, FIRST_COMPLETED)
            for future in done:
                yield future.result()
    except OrbimpcError:
        raise
    except Exception as error:  # any error of a worker or of its connection
        raise OrbimpcError(f'a flight failed: {type(error).__name__}: {error}') from error
    finally:
        for future in pending:
            future.cancel()


@contextmanager
def workers(cluster: str | None, count: int | None) -> Iterator[Executor]:
    """Yield an executor: processes on this machine, or the workers of a Dask cluster.

    Args:
        cluster: address of a running scheduler, such as ``tcp://host:8786``; None for this machine.
        count: processes on this machine; by default one per core.

    Raises:
        BadInput: no scheduler answers, or it has no workers.
    """
    if cluster is None:
        context = multiprocessing.get_context('spawn')
        threads = dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS'), '1')
        os.environ.update(threads)  # processes take all cores: threads would compete
        deaf = signal.signal, (signal.SIGINT, signal.SIG_IGN)
        with ProcessPoolExecutor(count, context, *deaf) as pool:
            yield pool
        return
    import distributed

    try:
        client = distributed.Client(cluster, timeout=PATIENCE)
        client.wait_for_workers(1, timeout=PATIENCE)
    except (OSError, asyncio.TimeoutError, TypeError, ValueError) as error:
        tried = f'{cluster} ({type(error).__name__})'
        raise BadInput('--cluster', tried, 'the address of a scheduler with workers') from None
    with client:
        yield client.get_executor(pure=False)
