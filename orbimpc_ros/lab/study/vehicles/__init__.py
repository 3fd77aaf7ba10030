# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Studies of vehicles as they are: continuous time, lags, limits and wind, over many seeds.

A scenario is a file of data. Every pilot flies it behind the planner's own path from messages to
commands: the same forecast of the goal, the same estimate of the wind, the same compensation of
lags. What differs is how a state and a forecast become a command.
"""
