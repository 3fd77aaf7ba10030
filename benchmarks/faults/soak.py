# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The soak: memory and gaps of one planner for a long time at 20 Hz, on odometry at 1 kHz."""

from __future__ import annotations

import itertools
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks import collector
from benchmarks.faults.flood import Pause, excused, pauses
from benchmarks.faults.harness import Fixtures, Harness
from benchmarks.faults.network import flooded
from benchmarks.machine import resident
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.outcome import Fallback
from orbimpc_ros.tool.run.progress import ProgressLine

STEP = 0.05  # [s]
ODOMETRY = 1000.0  # [Hz]
WARM_UP = 2.0  # [min] until memory counts
LOOK = 1.0  # [s] between looks at the memory
MAX_GROWTH = 2.0  # [MiB]
MAX_GAP = 2.0  # periods between ticks
AFTER = 2.0 * STEP  # [s] a pause of odometry may be felt
LONGEST = 24 * 60.0  # [min]
MEBIBYTE = 2.0**20


@dataclass(frozen=True)
class Soak:
    """The result of a soak.

    Attributes:
        memory: resident, look by look after the warm-up [MiB].
        ticks: when they were heard [s].
        unsafe: commands that should never have been sent.
        stopped: when and why the vehicle was stopped [s], tick by tick.
        pauses: of odometry at its source.
    """

    memory: tuple[float, ...]
    ticks: tuple[float, ...]
    unsafe: int
    stopped: tuple[tuple[float, str], ...]
    pauses: tuple[Pause, ...] = ()

    @property
    def growth(self) -> float:
        """Return the growth of the memory beyond its size after the warm-up [MiB]."""
        return max(self.memory) - self.memory[0] if self.memory else 0.0

    @property
    def gaps(self) -> list[float]:
        """Return the times between ticks, in periods, the longest first."""
        pairs = itertools.pairwise(self.ticks)
        return sorted(((b - a) / STEP for a, b in pairs), reverse=True)

    @property
    def excused(self) -> int:
        """Return how many of the stops were right: there was no odometry at its very source."""
        return sum(excused(at, self.pauses, AFTER) for at, _ in self.stopped)

    @property
    def ok(self) -> bool:
        """Return whether nothing grew, was missed or was unsafe."""
        calm = not self.unsafe and self.excused == len(self.stopped)
        return calm and self.growth < MAX_GROWTH and self.gaps[0] <= MAX_GAP

    def __str__(self) -> str:
        gaps = self.gaps
        missed = sum(gap > MAX_GAP for gap in gaps)
        counted = Counter(why for _, why in self.stopped)
        reasons = ', '.join(f'{n} x {why}' for why, n in counted.items()) or 'never'
        paused = max((end - begin for begin, end in self.pauses), default=0.0)
        memory = f'{self.memory[0]:.1f} MiB after the warm-up' if self.memory else 'not settled'
        return '\n'.join(
            (
                f'ticks         {len(self.ticks)}',
                f'unsafe        {self.unsafe}',
                f'stopped       {reasons}',
                f'odometry      {len(self.pauses)} pauses at its source, longest {paused:.2f} s: '
                f'behind {self.excused} of {len(self.stopped)} stops',
                f'memory        {memory}, grown by {self.growth:.2f} MiB (< {MAX_GROWTH:g})',
                f'longest gaps  {", ".join(f"{gap:.2f}" for gap in gaps[:3])} periods '
                f'(<= {MAX_GAP:g}), {missed} beyond',
            )
        )


def soaked(minutes: float, executor: str) -> int:
    """Soak a planner on an executor, print the result, and return the exit code."""
    if not 0.0 < minutes <= LONGEST:
        raise BadInput('--soak', minutes, f'minutes, above 0 and at most {LONGEST:g}')
    with (
        tempfile.TemporaryDirectory() as folder,
        Fixtures(Path(folder), executor) as fixtures,
        fixtures.harness({'step': STEP}) as harness,
        collector.paused(),
    ):
        result = _soak(harness, 60.0 * minutes)
    print(result)
    return 0 if result.ok else 1


def _soak(harness: Harness, seconds: float) -> Soak:
    harness.until_planned()
    with flooded(harness, ODOMETRY) as log:
        harness.until_planned()
        begin, memory = time.monotonic(), []
        warm = begin + min(60.0 * WARM_UP, 0.5 * seconds)
        progress = ProgressLine(round(seconds))
        while (elapsed := time.monotonic() - begin) < seconds:
            harness.spin(LOOK)
            if time.monotonic() >= warm:
                memory.append(resident(harness.planner.pid) / MEBIBYTE)
            shown = f', {memory[-1]:.1f} MiB' if memory else ''
            progress.show(round(elapsed), f'{elapsed / 60.0:.1f} min{shown}')
        progress.close()
        return _result(harness, begin, memory, pauses(log))


def _result(
    harness: Harness, begin: float, memory: Sequence[float], paused: Sequence[Pause]
) -> Soak:
    ticks = [each for each in harness.monitor.ticks if each.at >= begin]
    stopped = tuple(
        (each.at, each.message)
        for each in ticks
        if each.values['fallback'] == Fallback.SAFE_COMMAND
    )
    times = tuple(each.at for each in ticks)
    return Soak(tuple(memory), times, harness.monitor.broken(begin), stopped, tuple(paused))
