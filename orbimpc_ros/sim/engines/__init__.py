# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Engines: physics libraries that fly a vehicle on the commands that a real one takes.

An engine is a library of its own, such as JSBSim, with a vehicle and an inner loop that it has
published. The modules here set it up, pass on the commands and read the motion. They import nothing
of the rest of the package: an engine and the planner share no code.
"""

import os


class EngineFailure(Exception):
    """An engine stopped, went back in time, or returned numbers that are not finite."""


class NoStart(Exception):
    """An engine cannot begin in the state that was asked for.

    Attributes:
        culprit: the parameter that is to blame.
    """

    def __init__(self, culprit: str, why: str) -> None:
        super().__init__(why)
        self.culprit = culprit


os.environ.setdefault('MUJOCO_GL', 'disable')  # read when MuJoCo is imported: nothing is drawn
