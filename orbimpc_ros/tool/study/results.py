# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The rows of a study in a file, a line for each flight, and the processes that fly them."""

from __future__ import annotations

import asyncio
import json
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from orbimpc_ros.mpc.errors import BadInput, OrbimpcError
from orbimpc_ros.tool.study.flights import Job, Row, flown

PATIENCE = 5.0  # [s] for a scheduler to answer, and for its first worker
GLANCE = 0.2  # [s] between looks whether somebody asked to stop
Key = tuple[str, int]


class FlightFailure(OrbimpcError):
    """A flight ended with an error instead of a result."""


class Results:
    """The file of a study: what is studied in its first line, a flight in each further one.

    Args:
        file: to begin, or to go on with.
        about: what all rows depend on, in JSON's types.
        resumed: whether to go on with it.

    Raises:
        BadInput: the file is of another study, damaged, or there already.
    """

    def __init__(self, file: Path, about: dict[str, Any], *, resumed: bool) -> None:
        if file.exists() != resumed:
            there = 'no study to go on with' if resumed else 'a study already'
            raise BadInput(str(file), there, 'another -o DIR' if resumed else '--resume')
        self.file = file
        self.rows = self._kept(about) if resumed else {}
        lines = [about, *self.rows.values()]  # without a line that was cut off
        self._write('w', ''.join(json.dumps(each) + '\n' for each in lines))

    def add(self, row: Row) -> None:
        """Take a flight in, at once."""
        self.rows[_key(row)] = row
        self._write('a', json.dumps(row) + '\n')

    def _write(self, mode: str, text: str) -> None:
        with self.file.open(mode) as out:
            out.write(text)

    def _kept(self, about: dict[str, Any]) -> dict[Key, Row]:
        try:
            whole = self.file.read_text().rpartition('\n')[0]
            head, *rows = map(json.loads, whole.splitlines())
            kept = {_key(row): row for row in rows}
        except (KeyError, TypeError, ValueError, RecursionError):
            raise BadInput(str(self.file), 'damaged', 'the results of a study') from None
        differ = [name for name in about if head.get(name) != json.loads(json.dumps(about[name]))]
        if differ:
            raise BadInput(str(self.file), f'a study with other {", ".join(differ)}', 'the same')
        return kept


def _key(row: Row) -> Key:
    return row['controller'], row['index']


def each_flown(pool: Executor, jobs: Sequence[Job], going: Callable[[], bool]) -> Iterator[Row]:
    """Yield the rows of flights as they come in, as long as ``going()``.

    Raises:
        FlightFailure: a flight ended with an error, or its process did.
    """
    pending: set[Future[Row]] = {pool.submit(flown, job) for job in jobs}
    try:
        while pending and going():
            done, pending = wait(pending, GLANCE, FIRST_COMPLETED)
            for future in done:
                try:
                    row = future.result()
                except OrbimpcError:
                    raise
                except Exception as error:  # whatever a worker, or the way to it, came to
                    raise FlightFailure(
                        f'a flight failed: {type(error).__name__}: {error}'
                    ) from error
                yield row
    finally:
        for future in pending:
            future.cancel()


@contextmanager
def workers(cluster: str | None, count: int | None) -> Iterator[Executor]:
    """Give what flies: so many processes of this machine, or the workers of a Dask cluster.

    Args:
        cluster: address of a running scheduler, such as ``tcp://host:8786``; None for this machine.
        count: processes on this machine; by default one per core.

    Raises:
        BadInput: no scheduler answers, or it has no workers.
    """
    if cluster is None:
        context = multiprocessing.get_context('spawn')
        threads = dict.fromkeys(('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS'), '1')
        os.environ.update(threads)  # a process a core leaves none for more threads
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
