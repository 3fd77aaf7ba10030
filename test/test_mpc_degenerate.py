# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Random and degenerate problems: whatever is asked, only what was checked is commanded.

Six hundred in ``make test``; ``ORBIMPC_LONG=1 pytest test/test_mpc_degenerate.py``
asks 5,000.
"""

import os

import numpy as np
import pytest
from problems import box, floor, rotation, weights
from stepping import Stepped

from orbimpc_ros.loop.fallback import may_stop
from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.command import flaw
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.plan import UNPROVED, assemble
from orbimpc_ros.mpc.problem import Floor, Problem, State, Weights
from orbimpc_ros.mpc.solve.solver import Solver

PROBLEMS, QUESTIONS = (500, 10) if os.environ.get('ORBIMPC_LONG') else (60, 10)
SIZES = (0.0, 1e-300, 1e-9, 1.0, 1e3, 1e7)
NODES = 30  # after which a search is told that time is up


def drawn_problem(rng):
    """A small problem with extreme weights, steps, speeds and limits now and then."""
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
        floor=floor(str(rng.choice(shapes)) if n == 2 else 'none', 0.5),
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
    """Near or far, all the same or all different, or where the vehicle is."""
    shape = (problem.horizon, problem.dimension)
    away = rng.choice(SIZES) * rng.normal(size=shape[1])
    spread = rng.choice([0.0, 0.0, 1.0]) * rng.normal(size=shape)
    return odometry.position * rng.choice([0.0, 1.0]) + away + spread


def answered(controller, rng):
    problem = controller.problem
    odometry = drawn_odometry(rng, problem)
    if rng.random() < 0.1:
        return controller.hold(odometry)
    polls = iter(range(NODES))
    goals = drawn_goals(rng, problem, odometry)
    return controller.tick(odometry, goals, lambda: next(polls, None) is None)


@pytest.mark.parametrize('part', range(4))
def test_only_what_was_checked_is_commanded(part):
    rng = np.random.default_rng(part)
    planned = 0
    for _ in range(PROBLEMS // 4):
        try:
            controller = Stepped(drawn_problem(rng))
        except BadInput:  # for instance a floor that does not fit a limit
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


def test_a_weight_on_length_that_outweighs_all_else_does_not_spoil_the_bound():
    """Unbounded, a coasted rotation would be 1e8 times as long: no figure of that is left."""
    rotation = [
        [0.07081339095005246, 0.06715735392560883, 0.8841061665483011],
        [-0.32100037486417493, 0.8286980610227368, -0.03723765899035961],
        [-0.82650625118754, -0.31609772812175296, 0.09021088225403938],
    ]
    coasted = [
        [0.03614407082068102, 0.009307163356267025, 0.9993032486961949],
        [-0.5112100034764192, 0.8593918639414916, 0.010486016250635919],
        [-0.8586954864736097, -0.5112328245539687, 0.035819835404731236],
    ]
    problem = Problem(
        dimension=3, rotation_order=2, translation_order=2, horizon=4, step=0.13943825440983537,
        forward=0.12546035886396842, discretisation='exact',
        weights=Weights(
            0.0018832162636413445, 38.59690335154518, 40487.55242022235, 0.0021805357101551373
        ),
        floor=Floor('circle', fraction=0.9901949753461717),
    )  # fmt: skip
    velocity = [-0.0020949927713406814, 0.006558673205210863, -0.008750258908422608]
    start = State.at(np.zeros(3), rotation, velocity=velocity, coasted=coasted)
    goals = np.array(
        [
            [0.001106762695751365, -0.0010479085575356472, -0.0006756264532223969],
            [0.0028375060824887203, -0.0005850025040774398, 4.3566616941854357e-05],
            [0.005435976608079463, 0.000807071166167541, 0.0013598740711962525],
            [0.0045558696322359005, -0.0013397069751169975, 0.0008795560604939225],
        ]
    )
    plan = Solver(problem, coasting=True).solve(start, goals)
    held = np.tile(0.9902 * np.array(coasted), (4, 1, 1))  # legal, and not even good
    known = problem, start, goals
    other = assemble(*known, coordinates(held), projection='thrust_aligned', proof=UNPROVED)
    assert violations(*known, other) == []
    assert plan.lower_bound <= other.objective * (1.0 + 1e-6)
    assert plan.objective <= other.objective * (1.0 + 1e-6)
