# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""How an engine fails; a module to itself, for whoever reports it without flying anything."""


class EngineFailure(Exception):
    """An engine did what no vehicle can: it stopped, went back in time, or lost its numbers."""
