# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A controller: closed loops, arrivals, and fallbacks without a plan or a goal."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from plans import START, assembled
from problems import ORDERS, floor
from scenarios import model_of
from stepping import Stepped, launched, odometry

from orbimpc_ros.loop.compensation import Odometry
from orbimpc_ros.loop.fallback import safe_command
from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.errors import Infeasible, SolverFailure
from orbimpc_ros.mpc.geometry.rotations import coordinates, exp
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.outcome import Cause, Reason
from orbimpc_ros.mpc.plan import shifted
from orbimpc_ros.mpc.problem import Box, Floor, Problem, State
from orbimpc_ros.mpc.problem.reach import clamp_goal
from orbimpc_ros.mpc.solve import arrivals, program
from orbimpc_ros.mpc.solve.solver import Solver
from orbimpc_ros.mpc.solve.stand_ins import in_time, turning
from orbimpc_ros.sim.vehicle import measured


@pytest.mark.parametrize(
    ('error', 'status'), [(Infeasible('walled in'), 'infeasible'), (SolverFailure('no'), 'failed')]
)
@pytest.mark.parametrize(
    ('horizon', 'period', 'stand_ins'),
    [(1, 1.0, 0), (2, 1.0, 1), (3, 1.0, 2), (5, 1.0, 2), (5, 0.1, 2)],
)
def test_without_a_plan_the_one_before_serves_twice_and_never_past_its_horizon(
    monkeypatch, horizon, period, stand_ins, error, status
):
    controller, goals = Stepped(Problem(horizon=horizon)), np.tile([9.0, 0.0], (horizon, 1))
    first = controller.tick(odometry(), goals)
    monkeypatch.setattr(Solver, 'solve', Mock(side_effect=error))
    ahead = [odometry((k * period, 0.0), time=k * period) for k in (1, 2, 3, 4)]
    ticks = [controller.tick(seen, goals) for seen in ahead]
    assert {(tick.status, tick.reason) for tick in ticks} == {(status, str(error))}
    fallbacks = ['shifted plan'] * stand_ins + ['safe command'] * (4 - stand_ins)
    assert [tick.fallback for tick in ticks] == fallbacks
    for tick in ticks[:stand_ins]:  # straight ahead, to the accuracy of an interior-point method
        np.testing.assert_allclose(tick.plan.rotations, first.plan.rotations, atol=2e-3)
    assert (ticks[-1].plan, ticks[-1].command.speed_fraction) == (None, 0.0)


def test_without_a_goal_the_last_plan_is_held_and_then_the_vehicle_stops():
    controller, goals = Stepped(Problem()), np.tile([9.0, 3.0], (5, 1))
    before = controller.hold(odometry())
    assert (before.fallback, before.command.speed_fraction) == ('safe command', 0.0)
    controller.tick(odometry(), goals)
    here = odometry((1.0, 0.1), 0.3, time=1.0)
    ticks = [controller.hold(here) for _ in range(4)]
    assert [t.fallback for t in ticks] == ['shifted plan'] * 2 + ['safe command'] * 2
    assert all((t.status, t.reason) == ('failed', 'there is no goal') for t in ticks)
    held = ticks[0]
    assert violations(controller.problem, held.state, held.goals, held.plan) == []
    again = controller.tick(here, goals)
    assert (again.status, again.fallback) == ('optimal', '')


# --- remaining steps of a plan

BEHIND = np.tile([-3.0, 2.0], (5, 1))


@pytest.mark.parametrize('share', [0.2, 0.5, 0.9])
@pytest.mark.parametrize('rate', [0.0, 0.3])
@pytest.mark.parametrize('off', [-0.05, 0.0, 0.05])
def test_the_rest_of_a_plan_is_legal_and_leads_where_the_plan_did(share, rate, off):
    """Headings on the chord of a turn would be below the floor, and turn fastest in its middle."""
    problem = Problem(floor=floor('circle', 0.9), max_rate=rate, discretisation='exact')
    plan = Solver(problem).solve(START, BEHIND)
    angles = np.unwrap(np.arctan2(plan.rotations[:, 1, 0], plan.rotations[:, 0, 0]))
    knots = share + np.arange(1, 6)
    here = State.at([share, 0.0], exp(np.array([share * angles[1] + off])))
    rest = assembled(problem, here, BEHIND, shifted(problem, here, plan, knots))
    assert violations(problem, here, BEHIND, rest) == []
    assert rest.speed_fraction[1:].min() >= 0.9 - 1e-9
    turned = np.unwrap(np.arctan2(rest.rotations[1:, 1, 0], rest.rotations[1:, 0, 0]))
    np.testing.assert_allclose(turned, np.interp(knots, np.arange(6), angles), atol=0.06)
    whole = shifted(problem, START, plan, np.arange(1.0, 6.0))
    np.testing.assert_allclose(whole, coordinates(plan.rotations[1:]), atol=1e-9)


@pytest.mark.parametrize('speed', [0.3, 1.0])
def test_the_rest_of_a_plan_in_space_keeps_the_floor_and_is_in_the_hull(speed):
    problem = Problem(3, floor=floor('circle', 0.3))
    start, goals = State.at(np.zeros(3), speed * np.eye(3)), np.zeros((5, 3))
    turns = np.array([exp(np.array([0.0, 0.1 * k, 0.0])) for k in range(1, 6)])
    plan = assembled(problem, start, goals, coordinates(speed * turns))
    rest = assembled(problem, start, goals, shifted(problem, start, plan, 0.5 + np.arange(1, 6)))
    assert violations(problem, start, goals, rest) == []
    assert rest.speed_fraction[1:] == pytest.approx(speed, rel=2e-3)


# --- without a goal, and with a goal out of reach


def test_a_held_plan_is_checked_from_the_new_state():
    wall = Box([0.5, -9.0], [60.0, 9.0])
    controller = Stepped(Problem(obstacles=(wall,)))
    controller.tick(odometry(speed=0.1), np.tile([0.0, 3.0], (5, 1)))
    inside = controller.hold(odometry((30.0, 0.0), speed=0.1))
    assert inside.fallback == 'safe command'


def test_a_shrinking_horizon_without_a_goal_ends_in_time():
    controller = Stepped(Problem(horizon=3), shrinking=True)
    controller.tick(odometry(), np.tile([3.0, 2.0], (3, 1)))
    fallbacks = [controller.hold(odometry()).fallback for _ in range(3)]
    assert fallbacks == ['shifted plan', 'shifted plan', 'safe command']


def test_the_solver_that_a_shrinking_horizon_takes_next_is_built_in_advance():
    controller = Stepped(Problem(horizon=3), shrinking=True)
    for k in range(3):
        built = controller._solver_for.cache_info().currsize
        tick = controller.tick(odometry((float(k), 0.0)), np.tile([3.0, 2.0], (3 - k, 1)))
        assert tick.problem.horizon == 3 - k
        assert controller._solver_for.cache_info().currsize == built
        controller.prepare()


def test_a_goal_beyond_all_reach_is_clamped_and_reported_unless_it_is_proved_infeasible():
    start, within = State.at([1.0, 2.0], np.eye(2)), np.tile([301.0, 402.0], (5, 1))
    goals = np.tile([1.0 + 3e6, 2.0 + 4e6], (5, 1))
    assert clamp_goal(Problem(), start, within) == (within, '')
    assert clamp_goal(Problem(terminal='constraint'), start, goals) == (goals, '')
    near, told = clamp_goal(Problem(), start, goals)
    np.testing.assert_allclose(near, within)
    assert told == 'the goal is 5e+06 m away: planned to 500 m towards it'
    tick = Stepped(Problem()).tick(odometry((1.0, 2.0)), goals)
    assert (tick.status, tick.fallback, tick.reason) == ('optimal', '', told)
    heading = tick.plan.positions[-1] - tick.plan.positions[1]
    np.testing.assert_allclose(heading / np.linalg.norm(heading), [0.6, 0.8], atol=1e-2)


@pytest.mark.parametrize('translation', [1, 2])
@pytest.mark.parametrize(('dimension', 'shape'), [(2, 'polygon'), (2, 'circle'), (3, 'polygon')])
def test_a_vehicle_at_rest_is_told_at_least_its_floor(dimension, shape, translation):
    """A limit on the body rate limits turns, not how fast a vehicle speeds up."""
    faces = 6 if dimension == 3 else 4
    limits = {'floor': Floor(shape, faces, 0.5), 'max_rate': 1.5}
    problem = Problem(dimension, translation_order=translation, step=0.1, **limits)
    goals = np.tile(np.arange(1.0, dimension + 1.0), (5, 1))
    tick = Stepped(problem).tick(odometry((0.0,) * dimension, speed=0.0), goals)
    assert tick.fallback == ''
    assert tick.command.speed_fraction >= 0.5
    assert violations(problem, tick.state, tick.goals, tick.plan) == []


@pytest.mark.parametrize('shape', ['polygon', 'circle'])
@pytest.mark.parametrize('share', [0.0, 0.4, 0.92])
def test_a_vehicle_that_never_gets_as_fast_as_it_is_told_is_not_braked(shape, share):
    """Measured at a fraction of its speed, a vehicle is commanded full speed again."""
    problem = Problem(step=0.1, horizon=10, forward=15.0, floor=floor(shape, 0.6), max_rate=0.44)
    controller, goals = Stepped(problem), np.tile([200.0, 5.0], (10, 1))
    speed = 15.0
    for k in range(10):
        tick = controller.tick(odometry((1.5 * k, 0.0), speed=share * speed, time=0.1 * k), goals)
        speed = problem.forward * tick.command.speed_fraction
        assert speed == pytest.approx(15.0, rel=1e-3)


@pytest.mark.parametrize('shape', ['polygon', 'circle'])
@pytest.mark.parametrize('rate', [0.3, 1.2, 1.5, 3.0])
def test_the_first_turn_is_an_angle_at_any_speed(shape, rate):
    """A vehicle turns to a goal behind it at the rate allowed, whatever its measured speed."""
    problem = Problem(floor=floor(shape, 0.5), max_rate=rate, horizon=4)
    controller, goals = Stepped(problem), np.tile([-9.0, 1.0], (4, 1))
    for speed in (0.0, 0.3, 0.7, 1.0):
        tick = controller.tick(odometry(speed=speed), goals)
        assert tick.fallback == ''
        turned = float(tick.command.body_rate[0])
        assert abs(turned) <= rate + 1e-9
        if rate < 1.4:
            heading = tick.plan.rotations[1, :, 0]
            assert np.arctan2(heading[1], heading[0]) == pytest.approx(turned, abs=1e-6)


def test_no_plan_leads_into_an_obstacle_that_cannot_be_turned_away_from():
    wall = Box([0.3, -9.0], [9.0, 9.0])
    problem = Problem(step=0.2, floor=floor('polygon', 0.5), max_rate=1.0, obstacles=(wall,))
    tick = Stepped(problem).tick(odometry(speed=0.0), np.tile([9.0, 0.0], (5, 1)))
    assert (tick.status, tick.fallback) == ('infeasible', 'safe command')


@pytest.mark.parametrize(
    ('speed', 'told'), [(1.2, 'taken as 1 m/s'), (-0.3, 'taken as 0 m/s'), (1.02, ''), (-0.02, '')]
)
def test_a_speed_that_the_model_does_not_know_is_told(speed, told):
    tick = Stepped(Problem()).tick(odometry(speed=speed), np.tile([3.0, 1.0], (5, 1)))
    assert tick.status == 'optimal'
    assert tick.reason.endswith(told) if told else tick.reason == ''


# --- safe commands under gravity

UP = exp(np.array([0.0, -0.5 * np.pi, 0.0]))  # the thrust axis points up
WEIGHT = np.array([0.0, 0.0, -9.81])


@pytest.mark.parametrize('tilt', [0.0, 0.5, 1.0])
def test_hovering_leaves_no_acceleration_along_the_weight(tilt):
    problem = Problem(3, 1, 2, forward=20.0)
    attitude = UP @ exp(np.array([0.0, 0.0, tilt]))
    command = safe_command('hover', problem, attitude, 0.0, WEIGHT)
    thrust = 20.0 * command.speed_fraction * attitude[:, 0]
    assert thrust[2] == pytest.approx(9.81)
    assert not command.body_rate.any()


def test_what_tilts_too_far_to_be_carried_is_thrust_least_astray():
    problem = Problem(3, 1, 2, forward=12.0)
    for tilt in np.linspace(0.7, np.pi, 9):
        attitude = UP @ exp(np.array([0.0, 0.0, tilt]))
        command = safe_command('hover', problem, attitude, 0.0, WEIGHT)
        left = [
            np.linalg.norm(12.0 * share * attitude[:, 0] + WEIGHT)
            for share in (command.speed_fraction, *np.linspace(0.0, 1.0, 101))
        ]
        assert left[0] <= min(left) + 1e-9
    assert safe_command('hover', problem, UP, 0.0).speed_fraction == 0.0  # no weight to carry


def test_a_vehicle_without_plans_hovers_above_its_least_thrust():
    problem = Problem(3, 1, 2, forward=20.0, floor=Floor('circle', fraction=0.6))
    controller = Stepped(problem, safe='hover', disturbance=WEIGHT)
    tick = controller.safe(UP, Reason(Cause.ODOMETRY, 'lost'))
    assert tick.command.speed_fraction == 0.6
    free = Stepped(replace(problem, floor=Floor()), safe='hover', disturbance=WEIGHT)
    command = free.safe(UP, Reason(Cause.ODOMETRY, 'lost')).command
    assert command.speed_fraction == pytest.approx(9.81 / 20.0)
    blown = Stepped(problem, safe='hover', disturbance=2.1 * WEIGHT)  # by more than full thrust
    assert blown.safe(UP, Reason(Cause.ODOMETRY, 'lost')).command.speed_fraction == 1.0


# --- closed loops and arrivals


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
        # At the goal an interior-point method is too inaccurate for a tight bound.
        there = not COMPILED and tick.plan.objective < 1e-6
        assert tick.status == 'optimal' or there, tick.reason
        given = tick.command.speed_fraction, tick.command.body_rate
        (vehicle,) = model.flown(vehicle, model.step, *given)
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
    heading = tick.plan.rotations[1:, :, 0]  # straight to the goal: the fallback without a search
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
        given = tick.command.speed_fraction, tick.command.body_rate
        (vehicle,) = model.flown(vehicle, model.step, *given)
    assert np.linalg.norm(vehicle.position - goal) < 1e-6
    after = controller.tick(measured(vehicle), np.zeros((0, 2)))
    assert after.command.speed_fraction == 0.0
    assert 'run out' in after.reason
    controller.start_afresh(wind=True)
    assert len(controller.ends(0.0)) == 6


def arriving():
    """Return a controller on its way to (3, 2), with five steps left."""
    controller = Stepped(Problem(horizon=6, terminal='constraint'), shrinking=True)
    controller.tick(odometry(), np.tile([3.0, 2.0], (6, 1)))
    return controller


@pytest.mark.parametrize('period', [0.1, 0.25, 0.3, 1.0])
def test_a_shrinking_horizon_ends_when_it_ended_before(period):
    """Steps are never longer than ``step``, and their number decreases."""
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
        controller.start_afresh(wind=True)
    far = np.tile([30.0, 0.0], (6 - begun, 1))
    tick = controller.tick(odometry((1.0 * begun, 0.0), time=1.0 * begun), far)
    assert (tick.status, tick.fallback) == ('infeasible', 'safe command')
    assert told in tick.reason


def test_carried_far_away_under_way_a_vehicle_still_comes_as_near_as_it_can():
    controller = arriving()
    tick = controller.tick(odometry((0.0, -6.0), time=1.0), np.tile([3.0, 2.0], (5, 1)))
    assert (tick.status, tick.fallback) == ('infeasible', 'soft arrival')
    away = np.array([3.0, 8.0])
    # One step along x as measured, then four straight to the goal.
    nearest = np.linalg.norm(away - [1.0, 0.0]) - 4.0
    assert np.linalg.norm(tick.plan.positions[-1] - [3.0, 2.0]) == pytest.approx(nearest, abs=1e-2)


def test_a_search_that_fails_under_way_leaves_the_nearest_arrival_in_the_same_time(monkeypatch):
    controller, solve, limits, never = arriving(), Solver.solve, [], bool

    def fails(self, state, goals, guess, out_of_time):
        limits.append(out_of_time)
        if self.problem.terminal == 'constraint':
            raise SolverFailure('a test wants it')
        return solve(self, state, goals, guess, out_of_time)

    monkeypatch.setattr(Solver, 'solve', fails)
    carried = odometry((1.0, 0.6), time=1.0)  # off course, so that the shifted plan does not arrive
    tick = controller.tick(carried, np.tile([3.0, 2.0], (5, 1)), never)
    assert (tick.status, tick.fallback) == ('failed', 'soft arrival')
    assert 'a test wants it' in tick.reason
    assert limits == [never, never]


def test_another_controller_goes_on_from_what_this_one_remembers():
    first = arriving()
    second = Stepped(replace(first.problem, max_rate=1.5), shrinking=True)
    second.continue_from(first)
    assert len(second.ends(1.0)) == len(first.ends(1.0)) == 5


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
    # The limit at any measured speed: R e1 moves by at most 2 sin(0.05) per step.
    assert np.max(np.abs(np.diff(commanded))) <= 1.5 * 2.0 * np.sin(0.05) * (1.0 + 1e-6)


def flown_at_random(rng, dimension, horizon):
    """Return a problem of a wing with an arrival, and the goal that a legal path of it reaches."""
    problem = Problem(
        dimension=dimension,
        horizon=horizon,
        terminal='constraint',
        max_rate=rng.uniform(0.2, 1.2),
        floor=Floor('circle', fraction=rng.uniform(0.3, 0.95)),
    )
    attitude, way = np.eye(dimension), np.zeros(dimension)
    heading = attitude[:, 0]
    axes = rng.normal(size=(horizon, 3 if dimension == 3 else 1))
    for turn in problem.max_rate * axes / np.linalg.norm(axes, axis=1, keepdims=True):
        way = way + heading
        attitude = attitude @ exp(rng.uniform(0.9, 1.0) * turn)
        heading = rng.uniform(problem.floor.fraction, 1.0) * attitude[:, 0]
    return problem, way


@pytest.mark.parametrize(('dimension', 'tried', 'share'), [(2, 422, 0.8), (3, 372, 0.7)])
def test_arcs_that_arrive_keep_floor_and_turn_rate_and_most_of_them_do(dimension, tried, share):
    arrived = 0
    for seed in range(30):
        rng = np.random.default_rng([31, dimension, seed])
        problem, goal = flown_at_random(rng, dimension, int(rng.integers(3, 7)))
        state = State.at(np.zeros(dimension), np.eye(dimension))
        goals = np.tile(goal, (problem.horizon, 1))
        for arc in turning(problem, state, goals):
            if arc is not None:
                arrived += 1
                plan = assembled(problem, state, goals, arc)
                assert not violations(problem, state, goals, plan)
    assert arrived >= share * tried


def counted(monkeypatch, module, name):
    """Return the list to which each call of a function of a module adds its arguments."""
    calls, real = [], getattr(module, name)
    monkeypatch.setattr(module, name, lambda *given: calls.append(given) or real(*given))
    return calls


def test_after_the_deadline_an_arc_is_corrected_a_few_times_only(monkeypatch):
    problem = Problem(horizon=6, terminal='constraint', floor=Floor('circle', fraction=0.9))
    state, goals = State.at(np.zeros(2), np.eye(2)), np.tile([-2.0, 0.5], (6, 1))
    corrected = counted(monkeypatch, arrivals, '_bent')
    assert list(in_time(turning(problem, state, goals), lambda: True)) == []
    assert len(corrected) < 10


def test_after_the_deadline_one_program_at_most_limits_changes_of_speed(monkeypatch):
    limits = {'max_acceleration': 0.01, 'terminal': 'constraint'}
    problem, goals = Problem(horizon=4, **limits), np.tile([2.0, 0.0], (4, 1))
    solved = counted(monkeypatch, program, 'run')
    with pytest.raises(SolverFailure):
        Solver(problem).solve(State.at(np.zeros(2), 0.1 * np.eye(2)), goals, None, lambda: True)
    assert len(solved) == 2  # the first one is without the limit
