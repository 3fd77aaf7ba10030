# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Random and degenerate problems: only commands that passed the check are sent.

``make test`` draws 600 ticks, ``make questions`` (with ``ORBIMPC_LONG=1``) 5,000.
"""

import os

import numpy as np
import pytest
from problems import box, floor, polled, rotation, weights
from stepping import Stepped

from orbimpc_ros.loop.compensation import Odometry
from orbimpc_ros.loop.fallback import may_stop
from orbimpc_ros.mpc.check import flaw, violations
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.problem import Problem, Weights

PROBLEMS, QUESTIONS = (500, 10) if os.environ.get('ORBIMPC_LONG') else (60, 10)
SIZES = (0.0, 1e-300, 1e-9, 1.0, 1e3, 1e7)
NODES = 30  # polls of the clock until a search is out of time


def drawn_problem(rng):
    """Return a small problem, sometimes with extreme weights, steps, speeds and limits."""
    n = int(rng.choice([2, 2, 2, 3]))
    step = float(rng.choice([1e-3, 0.1, 1.0, 30.0]))
    extreme = Weights(*rng.choice([0.0, 1e-9, 1.0, 1e6], size=4))
    shapes = ('none', 'none', 'circle', 'polygon')
    return Problem(
        dimension=n,
        rotation_order=int(rng.choice([1, 1, 2])),
        translation_order=int(rng.choice([1, 1, 2])),
        horizon=int(rng.integers(1, 6)),
        step=step,
        forward=float(rng.choice([1e-6, 0.3, 1.0, 1e3])),
        weights=extreme if rng.random() < 0.3 else weights(rng),
        terminal=str(rng.choice(['penalty', 'penalty', 'constraint'])),
        floor=floor(str(rng.choice(shapes)), 0.5, 4 if n == 2 else 6),
        max_rate=float(rng.choice([0.0, 0.0, 0.1, 1.0])) / step,
        obstacles=tuple(box(rng, n, rng.normal(size=n)) for _ in range(rng.choice([0, 0, 0, 1]))),
    )


def drawn_odometry(rng, problem):
    n, rates = problem.dimension, 1 if problem.dimension == 2 else 3
    return Odometry(
        float(rng.uniform(0.0, 2e9)),
        rng.choice(SIZES) * rng.normal(size=n),
        rotation(rng, n),
        rng.choice(SIZES) * rng.normal(size=n),
        rng.choice(SIZES[:5]) * rng.normal(size=rates),
    )


def drawn_goals(rng, problem, odometry):
    """Return goals near or far, all equal or all different, or at the vehicle."""
    shape = (problem.horizon, problem.dimension)
    away = rng.choice(SIZES) * rng.normal(size=shape[1])
    spread = rng.choice([0.0, 0.0, 1.0]) * rng.normal(size=shape)
    return odometry.position * rng.choice([0.0, 1.0]) + away + spread


def answered(controller, rng):
    problem = controller.problem
    odometry = drawn_odometry(rng, problem)
    if rng.random() < 0.1:
        return controller.hold(odometry)
    return controller.tick(odometry, drawn_goals(rng, problem, odometry), polled(NODES))


@pytest.mark.parametrize('part', range(4))
def test_only_what_was_checked_is_commanded(part):
    rng = np.random.default_rng(part)
    planned = 0
    for _ in range(PROBLEMS // 4):
        try:
            controller = Stepped(drawn_problem(rng))
        except BadInput:  # for example a floor that contradicts a limit
            continue
        for _ in range(QUESTIONS):
            tick = answered(controller, rng)
            stopping = tick.plan is None and may_stop('auto', controller.problem)
            assert flaw(controller.problem, tick.command, stopping=stopping) == '', tick
            if tick.plan is None:
                assert tick.fallback == 'safe command'
                assert tick.reason
                continue
            planned += 1
            assert violations(tick.problem, tick.state, tick.goals, tick.plan) == []
    assert planned > PROBLEMS // 4
