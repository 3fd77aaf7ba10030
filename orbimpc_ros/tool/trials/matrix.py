"""The fault matrix: every row, in the order in which they are tried."""

from __future__ import annotations

from orbimpc_ros.tool.trials import inputs

MATRIX = (*inputs.TRIALS,)
