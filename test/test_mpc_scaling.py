# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Weights as integrals: the same problem at any step and speed, and the same job done."""

import math
from dataclasses import replace

import numpy as np
import pytest
from continuous import Craft, at_rest, flown
from problems import ORDERS, weights
from stepping import Stepped

from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.model.trajectory import trajectory_of
from orbimpc_ros.mpc.problem import Problem, State, Weights
from orbimpc_ros.mpc.problem.case import case_of
from orbimpc_ros.mpc.problem.scaling import weighed
from orbimpc_ros.mpc.problem.units import Units


@pytest.mark.parametrize('orders', ORDERS)
@pytest.mark.parametrize(('step', 'forward'), [(0.05, 1.0), (0.2, 50.0), (3.0, 0.1)])
def test_problems_that_differ_in_step_and_speed_are_one_in_natural_units(orders, step, forward):
    rng = np.random.default_rng(1)
    unit = Problem(**orders, weights=weights(rng))
    other = replace(unit, step=step, forward=forward)
    natural, again = (Units.of(weighed(problem, 'time')).problem for problem in (unit, other))
    for name in ('position', 'input', 'length', 'terminal'):
        one, two = getattr(natural.weights, name), getattr(again.weights, name)
        assert two == pytest.approx(one, rel=1e-12)


@pytest.mark.parametrize('orders', ORDERS)
def test_a_finer_step_resolves_the_same_integrals(orders):
    """The cost of one smooth motion, sampled: its differences halve with the step."""
    costs = [_cost(orders, steps) for steps in (40, 80, 160, 320)]
    apart = np.abs(np.diff(costs))
    np.testing.assert_allclose(apart[1:] / apart[:-1], 0.5, atol=0.12)
    assert apart[-1] < 0.01 * costs[-1]


def _cost(orders, steps, lasts=10.0):
    problem = Problem(**orders, horizon=steps, step=lasts / steps, forward=2.0)
    problem = weighed(replace(problem, weights=Weights(1.0, 0.5, 0.3, 2.0)), 'time')
    n, times = problem.dimension, np.linspace(0.0, lasts, steps + 1)
    rotations = np.tile(np.eye(n), (steps + 1, 1, 1))
    c, s = np.cos(0.2 * times), np.sin(0.2 * times)
    rotations[:, :2, :2] = np.moveaxis(np.array([[c, -s], [s, c]]), 2, 0)
    rotations *= (0.8 + 0.1 * np.sin(times))[:, None, None]
    rate = (rotations[1] - rotations[0]) / problem.step
    start = State.at(np.zeros(n), rotations[0], rotation_rate=rate)
    goals = np.outer(times[1:], np.linspace(1.0, -0.5, n))
    return trajectory_of(problem, start, goals, coordinates(rotations[1:])).cost


def test_the_paper_means_sums():
    problem = Problem(step=0.2, forward=3.0)
    assert weighed(problem, 'paper') is problem


def test_a_scaling_that_there_is_not_is_refused():
    with pytest.raises(BadInput, match=r'weights\.scaling is space; allowed: paper \| time'):
        weighed(Problem(), 'space')


def test_a_case_may_state_what_its_weights_mean():
    plain = {
        'dimension': 2, 'rotation_order': 1, 'translation_order': 1, 'horizon': 5, 'step': 0.5,
        'forward': 2.0, 'weights': {'position': 1.0, 'input': 0.05, 'terminal': 10.0},
        'state': {'position': [0.0, 0.0], 'rotation': [[1.0, 0.0], [0.0, 1.0]]},
        'goal': [3.0, 1.0],
    }  # fmt: skip
    timed = {**plain, 'weights': {**plain['weights'], 'scaling': 'time'}}
    assert case_of(timed).problem == weighed(case_of(plain).problem, 'time')


def caught_after(scaling, step, speed, seed, patience=15.0, fine=0.05):
    """When a planner with default weights catches a swinging rope [s]; infinity if never."""
    rng = np.random.default_rng(seed)
    phase, frequency = rng.uniform(0.0, 2.0 * np.pi, 2), rng.uniform(0.07, 0.15)
    middle = speed * (np.array([5.0, 0.0]) + rng.uniform(-1.0, 1.0, 2))

    def rope(times):
        swing = np.sin(2.0 * np.pi * frequency * np.asarray(times)[..., None] + phase)
        return middle + 0.5 * speed * swing

    plant, problem = Craft(speed), weighed(Problem(step=step, forward=speed), scaling)
    controller, time = Stepped(problem), 0.0
    motion = at_rest(2, rng.uniform(-np.pi, np.pi), 1.0, plant)
    while time < patience:
        measured = Odometry(
            time, motion.position, motion.attitude, motion.attitude.T @ motion.velocity, motion.rate
        )
        command = controller.tick(measured, rope(time + step * np.arange(1, 6))).command
        for _ in range(round(step / fine)):
            before = motion.position - rope(time)
            motion = flown(plant, motion, command.speed_fraction, command.body_rate, fine, fine)
            time += fine
            moved = motion.position - rope(time) - before
            share = np.clip(-(before @ moved) / max(moved @ moved, 1e-12), 0.0, 1.0)
            if np.linalg.norm(before + share * moved) <= 0.2 * speed:
                return time
    return math.inf


def test_the_default_weights_do_the_job_at_any_step_and_speed():
    """A swinging rope is caught as soon at 0.05 s as at 0.2 s, and at 50 m/s as at 1 m/s."""
    seeds = range(8)
    times = {
        case: np.array([caught_after('time', *case, seed) for seed in seeds])
        for case in ((0.2, 1.0), (0.05, 1.0), (0.2, 50.0))
    }
    assert all(np.isfinite(each).all() for each in times.values())
    np.testing.assert_allclose(times[0.2, 50.0], times[0.2, 1.0], atol=1e-6)
    assert np.median(times[0.05, 1.0]) == pytest.approx(np.median(times[0.2, 1.0]), rel=0.1)
