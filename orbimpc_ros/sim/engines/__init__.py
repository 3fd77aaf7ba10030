# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Physics that nobody here wrote: engines that fly a vehicle on the commands that a real one takes.

An engine is a library of its own, such as JSBSim, with a vehicle and an inner loop that it has
published. What is here sets it up, tells it what is commanded, and reads what became of it. Nothing
here knows of a planner: nothing of the rest of the package is imported.
"""

import os


class EngineFailure(Exception):
    """An engine did what no vehicle can: it stopped, went back in time, or lost its numbers."""


class NoStart(Exception):
    """An engine cannot begin so.

    Attributes:
        culprit: the parameter that is to blame.
    """

    def __init__(self, culprit: str, why: str) -> None:
        super().__init__(why)
        self.culprit = culprit


os.environ.setdefault('MUJOCO_GL', 'egl')  # read when MuJoCo is imported: it needs no display
