# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The soak: memory and gaps of one planner for a long time at 20 Hz, on odometry at 1 kHz."""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.faults.harness import Fixtures, Harness
from benchmarks.faults.processes import flooded
from benchmarks.machine import resident, uncollected
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.outcome import Fallback
from orbimpc_ros.tool.run.progress import ProgressLine

STEP = 0.05  # [s]
ODOMETRY = 1000.0  # [Hz]
WARM_UP = 120.0  # [s] until memory counts
MAX_GROWTH = 2.0  # [MiB]
MAX_GAP = 2.0  # periods between ticks
STOPS = 0.01  # of the ticks: odometry itself pauses on a busy machine, and stops are right then
LONGEST = 24 * 60.0  # [min]
MEBIBYTE = 2.0**20


@dataclass(frozen=True)
class Soak:
    """The result of a soak.

    Attributes:
        memory: resident, second by second after the warm-up [MiB].
        ticks: their times [s].
        unsafe: commands that should never have been sent.
        stopped: reasons of the ticks at which the vehicle was stopped.
    """

    memory: tuple[float, ...]
    ticks: tuple[float, ...]
    unsafe: int
    stopped: tuple[str, ...] = ()

    @property
    def growth(self) -> float:
        """Return the growth of the memory beyond its size after the warm-up [MiB]."""
        return max(self.memory) - self.memory[0] if self.memory else 0.0

    @property
    def gap(self) -> float:
        """Return the longest time between ticks, in periods."""
        return float(np.diff(self.ticks).max()) / STEP

    @property
    def ok(self) -> bool:
        """Return whether nothing grew, was missed or was unsafe."""
        calm = not self.unsafe and len(self.stopped) <= STOPS * len(self.ticks)
        return calm and self.growth < MAX_GROWTH and self.gap <= MAX_GAP

    def __str__(self) -> str:
        counted = Counter(self.stopped)
        reasons = ', '.join(f'{n} x {why}' for why, n in counted.items()) or 'never'
        memory = f'{self.memory[0]:.1f} MiB after the warm-up' if self.memory else 'not settled'
        return (
            f'ticks        {len(self.ticks)}\nunsafe       {self.unsafe}\nstopped      {reasons}\n'
            f'memory       {memory}, grown by {self.growth:.2f} MiB (< {MAX_GROWTH:g})\n'
            f'longest gap  {self.gap:.2f} periods (<= {MAX_GAP:g})'
        )


def soaked(minutes: float, executor: str) -> int:
    """Soak a planner on an executor, print the result, and return the exit code."""
    if not 0.0 < minutes <= LONGEST:
        raise BadInput('--soak', minutes, f'minutes, above 0 and at most {LONGEST:g}')
    with (
        tempfile.TemporaryDirectory() as folder,
        Fixtures(Path(folder), executor) as fixtures,
        fixtures.harness({'step': STEP}) as harness,
        uncollected(),
    ):
        harness.until_planned()
        with flooded(harness, ODOMETRY):
            harness.until_planned()
            result = _soak(harness, 60.0 * minutes)
    print(result)
    return 0 if result.ok else 1


def _soak(harness: Harness, seconds: float) -> Soak:
    begin, memory, progress = time.monotonic(), list[float](), ProgressLine(round(seconds))
    while (elapsed := time.monotonic() - begin) < seconds:
        harness.spin(1.0)
        if elapsed >= min(WARM_UP, 0.5 * seconds):
            memory.append(resident(harness.planner.pid) / MEBIBYTE)
        progress.show(round(elapsed), f'{elapsed / 60.0:.1f} min')
    progress.close()
    ticks = [each for each in harness.monitor.ticks if each.at >= begin]
    stopped = (t.message for t in ticks if t.values['fallback'] == Fallback.SAFE_COMMAND)
    unsafe = harness.monitor.broken(begin)
    return Soak(tuple(memory), tuple(each.at for each in ticks), unsafe, tuple(stopped))
