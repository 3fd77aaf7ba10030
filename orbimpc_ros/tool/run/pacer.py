# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The clock of a fleet in lock-step: it goes on when every vehicle has its command.

On a machine that is too slow for real time the flight takes longer, and no vehicle flies blind.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.ros.messages import SECOND
from orbimpc_ros.tool.run.recorder import Recorder

AGAIN = 0.2  # [s] from one message of the same time to the next; the first may be lost
PATIENCE = 120.0  # [s] for the answers to a step
STARTING = 600.0  # [s] and to the first one, before which machine code may be compiled


class Pacer:
    """Publishes /clock, from what a recorder hears.

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
