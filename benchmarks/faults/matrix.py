# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The fault matrix: every row, in the order in which they are tried."""

from __future__ import annotations

from benchmarks.faults import (
    inputs,
    network,
    parameters,
    plans,
    shutdowns,
    vehicle,
)

GROUPS = (inputs, vehicle, plans, network, shutdowns, parameters)
MATRIX = tuple(each for group in GROUPS for each in group.FAULT_CASES)
