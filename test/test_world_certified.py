# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The true minimum speed in closed loop: 500 ticks at each floor, proved or said not to be."""

from dataclasses import replace

import numpy as np
import pytest
from flying import fly
from scenarios import retrieval, retrieval_problem

from orbimpc_ros.loop.goal.forecast import forecast_named
from orbimpc_ros.loop.planner import Planner
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.problem import Floor
from orbimpc_ros.sim.vehicle import launched
from orbimpc_ros.sim.world import Rope


def scenario(rng):
    """A random rope, start and heading; never caught, so that every flight is 50 ticks long."""
    usual = retrieval()
    rope = Rope(
        np.array([5.0, 0.0]),
        np.array([0.5, 0.5]),
        rng.uniform(0.02, 0.3),
        rng.uniform(0.0, 2.0 * np.pi, size=2),
    )
    attitude = exp(rng.uniform(-np.pi, np.pi, size=1))
    start = launched(usual.model, rng.uniform(-2.0, 2.0, size=2), attitude)
    return replace(usual, start=start, rope=rope, capture_radius=1e-9, max_ticks=50)


@pytest.mark.parametrize('fraction', [np.sqrt(0.3), 1.0])
def test_ticks_are_certified(fraction):
    rng = np.random.default_rng(0)
    problem = replace(retrieval_problem(), floor=Floor('circle', fraction=fraction))
    controller = Planner(problem)
    ticks = []
    for _ in range(10):
        controller.reset()
        ticks += fly(controller, scenario(rng), forecast_named('hold')).ticks
    assert len(ticks) == 500
    assert all(tick.plan is not None for tick in ticks)
    certified = [tick for tick in ticks if tick.plan.gap <= 1e-4]
    assert len(certified) >= 495
    for tick in ticks:
        assert (tick.status == 'optimal') == (tick.plan.gap <= 1e-4)
        assert tick.plan.speed_fraction[1:].min() >= fraction - 1e-6
