# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A vehicle that the package does not have, in one file: thrust against drag."""

import numpy as np

from orbimpc_ros.mpc.model.translation import Translation

DRAG = 3  # its translation_order
KEPT = 0.8  # of the velocity, after a step


class Drag(Translation):
    """s_{k+1} = s_k + h p_k and p_{k+1} = 0.8 p_k + h z R_k e1."""

    inertial = True

    def transition(self, step):
        return np.array([[1.0, step], [0.0, KEPT]])

    def push(self, step, forward):
        return np.array([0.0, step * forward])
