# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A floor that the package does not have, in one file: eastward at a share of full speed."""

import numpy as np

from orbimpc_ros.mpc.geometry.faces import Cell
from orbimpc_ros.mpc.problem.floor import Shape


class Eastward(Shape):
    """v_x >= fraction: a single half-space, which also forbids headings."""

    def cells(self, floor, dimension):
        return (Cell(np.eye(dimension)[0], floor.fraction),)
