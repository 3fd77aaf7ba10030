"""The fault matrix: every row, in the order in which they are tried."""

from __future__ import annotations

from orbimpc_ros.lab.faults import clocks, commands, files, inputs, network, parameters, plans
from orbimpc_ros.lab.faults import shutdowns as endings

GROUPS = (inputs, clocks, plans, network, commands, endings, parameters, files)
MATRIX = tuple(trial for group in GROUPS for trial in group.TRIALS)
