# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The controller: commands reproduce plans, and what happens when there is no plan."""

from dataclasses import replace

import numpy as np
import pytest
from problems import ORDERS
from scenarios import model_of
from stepping import Stepped, odometry

from orbimpc_ros.loop.compensation import Compensator
from orbimpc_ros.loop.goal.motion import GoalTrajectory
from orbimpc_ros.loop.state import Odometry
from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.errors import SolverFailure
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.plan import Command
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.solve.solver import Solver
from orbimpc_ros.sim.vehicle import advance, launched, measured


def test_second_order_state_carries_thrust_velocity_and_coasted_attitude():
    problem = Problem(3, 2, 2, step=0.5)
    attitude = exp(np.array([0.2, -0.4, 0.9]))
    compensator, rate = Compensator(problem), np.array([0.1, 0.2, -0.3])
    compensator.history.add(Command(0.25, np.zeros(3), np.eye(3)))
    state = compensator.state(replace(odometry(np.zeros(3), attitude, 2.0), body_rate=rate))
    assert np.allclose(state['rotation'], 0.25 * attitude)
    assert np.allclose(state['velocity'], 2.0 * attitude[:, 0])
    assert np.allclose(state['coasted'], attitude @ exp(np.array([0.05, 0.1, -0.15])))


@pytest.mark.parametrize('orders', ORDERS)
def test_every_model_flies_to_its_goal_in_closed_loop(orders):
    n = orders['dimension']
    problem = Problem(**orders, horizon=8, step=0.5)
    controller = Stepped(problem)
    goal = np.array([2.0, 1.5, -1.0])[:n]
    model = model_of(problem)
    vehicle = launched(model, np.zeros(n), np.eye(n), fraction=0.0)
    for _ in range(60):
        tick = controller.tick(measured(vehicle), np.tile(goal, (8, 1)))
        # At the goal an interior point is too inaccurate for its bound to be worth much.
        there = not COMPILED and tick.plan.objective < 1e-6
        assert tick.status == 'optimal' or there, tick.reason
        vehicle = advance(model, vehicle, tick.command.speed_fraction, tick.command.body_rate)
    assert np.linalg.norm(vehicle.position - goal) < 0.1


def test_a_plan_that_fails_its_check_is_not_flown(monkeypatch):
    controller = Stepped(Problem())
    honest, first = Solver._assembled, iter([True])

    def corrupted(self, *args, **kwargs):
        plan = honest(self, *args, **kwargs)
        return replace(plan, positions=plan.positions + 1e-3) if next(first, False) else plan

    monkeypatch.setattr(Solver, '_assembled', corrupted)
    tick = controller.tick(odometry(), np.tile([9.0, 3.0], (5, 1)))
    assert tick.status == 'feasible'
    assert 'positions differ' in tick.reason
    heading = tick.plan.rotations[1:, :, 0]  # straight to the goal: what takes no search stands in
    np.testing.assert_allclose(heading, np.tile([3.0, 1.0], (5, 1)) / np.sqrt(10.0))
    assert violations(controller.problem, tick.state, tick.goals, tick.plan) == []


def test_a_shrinking_horizon_arrives_and_then_stops():
    problem = Problem(horizon=6, terminal='constraint')
    controller = Stepped(problem, shrinking=True)
    goal = np.array([3.0, 2.0])
    model = model_of(problem)
    vehicle = launched(model, np.zeros(2), np.eye(2))
    for k in range(6):
        assert len(controller.ends(float(k))) == 6 - k
        tick = controller.tick(measured(vehicle), np.tile(goal, (6 - k, 1)))
        assert tick.plan is not None, tick.reason
        vehicle = advance(model, vehicle, tick.command.speed_fraction, tick.command.body_rate)
    assert np.linalg.norm(vehicle.position - goal) < 1e-6
    after = controller.tick(measured(vehicle), np.zeros((0, 2)))
    assert after.command.speed_fraction == 0.0
    assert 'run out' in after.reason
    controller.reset()
    assert len(controller.ends(0.0)) == 6


def arriving():
    """A controller that has set off to (3, 2), with five steps left."""
    controller = Stepped(Problem(horizon=6, terminal='constraint'), shrinking=True)
    controller.tick(odometry(), np.tile([3.0, 2.0], (6, 1)))
    return controller


@pytest.mark.parametrize('period', [0.1, 0.25, 0.3, 1.0])
def test_a_shrinking_horizon_ends_when_it_ended_before(period):
    """Its steps are never longer than a step, and become fewer."""
    controller = Stepped(Problem(horizon=4), shrinking=True)
    time, counts = 7.0, []
    while time < 10.95:
        ends = controller.ends(time)
        assert ends[-1] == pytest.approx(11.0)
        assert np.diff([time, *ends]).max() <= 1.0 + 1e-9
        counts.append(len(ends))
        controller.tick(odometry(speed=0.0, time=time), np.tile([3.0, 1.0], (len(ends), 1)))
        time += period
    assert counts[0] == 4
    assert counts[-1] == 1
    assert sorted(counts, reverse=True) == counts


@pytest.mark.parametrize(
    ('begun', 'told'),
    [
        (False, 'beyond what 6 steps can reach'),
        (True, 'the goal has jumped by 27.1 m, the nearest plan misses by'),
    ],
)
def test_a_goal_out_of_reach_is_not_flown_at_softly(begun, told):
    controller = arriving()
    if not begun:
        controller.reset()
    far = np.tile([30.0, 0.0], (6 - begun, 1))
    tick = controller.tick(odometry((1.0 * begun, 0.0), time=1.0 * begun), far)
    assert (tick.status, tick.fallback) == ('infeasible', 'safe command')
    assert told in tick.reason


def test_carried_far_away_under_way_a_vehicle_still_comes_as_near_as_it_can():
    controller = arriving()
    tick = controller.tick(odometry((0.0, -6.0), time=1.0), np.tile([3.0, 2.0], (5, 1)))
    assert (tick.status, tick.fallback) == ('infeasible', 'soft arrival')
    away = np.array([3.0, 8.0])
    # One step along x as it was measured, then four straight to the goal.
    nearest = np.linalg.norm(away - [1.0, 0.0]) - 4.0
    assert np.linalg.norm(tick.plan.positions[-1] - [3.0, 2.0]) == pytest.approx(nearest, abs=1e-2)


def test_a_search_that_fails_under_way_leaves_the_nearest_arrival(monkeypatch):
    controller, solve = arriving(), Solver.solve

    def fails(self, *arguments):
        if self.problem.terminal == 'constraint':
            raise SolverFailure('a test wants it')
        return solve(self, *arguments)

    monkeypatch.setattr(Solver, 'solve', fails)
    carried = odometry((1.0, 0.6), time=1.0)  # so that the shifted plan does not arrive
    tick = controller.tick(carried, np.tile([3.0, 2.0], (5, 1)))
    assert (tick.status, tick.fallback) == ('failed', 'soft arrival')
    assert 'a test wants it' in tick.reason


def test_another_controller_goes_on_from_what_this_one_remembers():
    first = arriving()
    second = Stepped(replace(first.problem, max_rate=1.5), shrinking=True)
    second.continue_from(first)
    assert len(second.ends(1.0)) == len(first.ends(1.0)) == 5


def test_a_trajectory_is_interpolated_and_its_ends_are_held():
    path = GoalTrajectory(np.array([0.0, 2.0]), np.array([[0.0, 0.0], [2.0, 4.0]]))
    assert np.allclose(path.at(np.array([-1.0, 1.0, 5.0])), [[0, 0], [1, 2], [2, 4]])


@pytest.mark.parametrize(('band', 'drift'), [(0.2, 0.0), (0.0, -0.3), (0.0, 0.0)])
def test_a_rover_in_a_dead_band_or_a_drift_gets_under_way(band, drift):
    controller = Stepped(Problem(step=0.1, forward=1.5, max_rate=1.0))
    position, heading, speed, least = np.zeros(2), 0.0, 0.0, np.inf
    commanded = [0.0]
    for k in range(80):
        attitude = exp(np.array([heading]))
        seen = Odometry(0.1 * k, position, attitude, np.array([speed + drift, 0.0]), np.zeros(1))
        command = controller.tick(seen, np.tile([5.0, 1.0], (5, 1))).command
        commanded.append(1.5 * command.speed_fraction)
        speed = commanded[-1] if commanded[-1] >= band else 0.0
        heading += 0.1 * command.body_rate[0]
        position = position + 0.1 * (speed + drift) * exp(np.array([heading]))[:, 0]
        least = min(least, float(np.linalg.norm(position - [5.0, 1.0])))
    assert least < 0.15
    # What the limit allows, at any measured speed: R e1 moves by 2 sin(0.05) in a step.
    assert np.max(np.abs(np.diff(commanded))) <= 1.5 * 2.0 * np.sin(0.05) * (1.0 + 1e-6)
