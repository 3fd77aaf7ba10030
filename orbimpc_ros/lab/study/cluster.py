# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The workers that fly: processes on this machine, or those of a Dask cluster."""

from __future__ import annotations

import asyncio
import logging
import os
import queue
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from orbimpc_ros.lab.study.trial import Row, flown
from orbimpc_ros.mpc.arrays import whole
from orbimpc_ros.mpc.errors import BadInput, OrbimpcError

if TYPE_CHECKING:
    from distributed import Client

    from orbimpc_ros.lab.study.design import Study

MOST_WORKERS = 1024
PATIENCE = 5.0  # [s] for a scheduler to answer, and for its first worker
GLANCE = 0.1  # [s] between looks whether somebody asked to stop


class RunFailure(OrbimpcError):
    """A run ended with an error instead of a result."""


@contextmanager
def client_of(address: str | None, workers: int | None) -> Iterator[Client]:
    """Give a client of a cluster: the one at an address, or one of this machine's cores.

    Args:
        address: of a running scheduler, such as ``tcp://host:8786``; None for this machine.
        workers: processes on this machine, of one thread each; None for one a core.

    Raises:
        BadInput: nobody answers at the address, or it has no workers.
    """
    if address is None:
        with _local(_workers(workers)) as client:
            yield client
    elif workers is not None:
        raise BadInput('--workers', workers, 'only without --scheduler, which has its own')
    else:
        with _remote(address) as client:
            yield client


def _workers(asked: int | None) -> int:
    cores = len(os.sched_getaffinity(0))
    return cores if asked is None else whole(asked, '--workers', 1, MOST_WORKERS)


@contextmanager
def _local(workers: int) -> Iterator[Client]:
    import distributed

    with _deaf():  # Ctrl-C is for the tool, which then stops its workers in order
        # Dask starts its workers with one thread for each numerical library.
        cluster = distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            dashboard_address=':0',  # any free port
            silence_logs=logging.CRITICAL,
        )
    with cluster, distributed.Client(cluster) as client:
        yield client


@contextmanager
def _deaf() -> Iterator[None]:
    """Ignore SIGINT; processes that begin meanwhile go on ignoring it."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _remote(address: str) -> Iterator[Client]:
    import distributed

    logging.getLogger('distributed').setLevel(logging.CRITICAL)
    try:
        client = distributed.Client(address, timeout=PATIENCE)
    except (OSError, ValueError, TypeError, asyncio.TimeoutError) as error:
        tried = f'{address} ({type(error).__name__})'
        raise BadInput('--scheduler', tried, 'the address of a scheduler that answers') from None
    with client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except (TimeoutError, asyncio.TimeoutError):
            raise BadInput('--scheduler', address, 'a scheduler that has workers') from None
        yield client


def each_flown(
    client: Client,
    study: Study,
    chunks: Sequence[Sequence[int]],
    going: Callable[[], bool],
) -> Iterator[list[Row]]:
    """Yield the rows of chunks of runs as they come in, as long as ``going()``.

    Raises:
        RunFailure: a worker failed.
    """
    done: queue.Queue[Any] = queue.Queue()
    futures = [client.submit(flown, study, chunk, pure=False) for chunk in chunks]
    for future in futures:
        future.add_done_callback(done.put)
    left = len(futures)
    while left and going():
        try:
            future = done.get(timeout=GLANCE)
        except queue.Empty:
            continue
        left -= 1
        yield _result(future)
    client.cancel([future for future in futures if not future.done()])


def _result(future: Any) -> list[Row]:
    try:
        return future.result()
    except Exception as error:  # whatever a worker, or the way to it, came to
        raise RunFailure(f'a run failed: {type(error).__name__}: {error}') from error
