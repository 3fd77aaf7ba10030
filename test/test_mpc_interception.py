# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Interception: catches do reach the goal, and excluded steps have no catch.

The chases and their closed-form capture times are from reference/interception.json: a Dubins
vehicle of constant airspeed and limited turn radius in wind, and a goal that moves straight on.
"""

import json
import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from problems import ORDERS, REFERENCE, floor, needs_machine_code, polled, rotation
from problems import state as state_of
from stepping import Stepped, flown, odometry, started

from orbimpc_ros.loop.compensation import Odometry, Response
from orbimpc_ros.loop.intercept import (
    AIM,
    EFFORT,
    GRAZE,
    Interception,
    catching,
    defect,
    steps_before,
)
from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import coordinates, exp, log
from orbimpc_ros.mpc.model.dynamics import trajectory_of
from orbimpc_ros.mpc.problem import (
    Approach,
    Ball,
    Box,
    Floor,
    MovingObstacle,
    Problem,
    State,
    Weights,
)
from orbimpc_ros.mpc.problem.reach import missed
from orbimpc_ros.mpc.proof.document import parsed, text_of, verified
from orbimpc_ros.mpc.solve.refute import refutation_of
from orbimpc_ros.mpc.solve.solver import Solver
from orbimpc_ros.sim.vehicle import Plant, measured

RADIUS = 3.0
WING = Problem(
    horizon=8, step=0.5, forward=15.0, floor=floor('circle', 2.0 / 3.0), max_rate=np.radians(25.0)
)


def farthest(problem):
    return Interception(problem, 2.0, Solver).farthest


def still(goal):
    """Return the arguments of a tick for a goal at rest: its positions, no deadline, its motion."""
    goal = np.array(goal)
    return np.tile(goal, (8, 1)), None, lambda times: np.tile(goal, (len(times), 1))


@pytest.mark.parametrize('order', [1, 2])
@pytest.mark.parametrize('n', [2, 3])
def test_no_inputs_cost_more_than_their_share_of_the_squared_radius(n, order):
    rng = np.random.default_rng(n)
    given = Problem(n, rotation_order=order, horizon=6, step=0.2, arrival_weight=9.0)
    problem = catching(given, RADIUS, 4)
    assert problem.horizon == 4
    start = State.at(np.zeros(n), rotation(rng, n))
    worst = 0.0
    for _ in range(200):
        half = exp(np.pi * np.eye(1 if n == 2 else 3)[0])
        turned = [start.rotation]
        for _ in range(4):
            turned.append(turned[-1] @ (half if rng.random() < 0.7 else rotation(rng, n)))
        x = np.array(turned)[1:]
        still = replace(problem, weights=replace(problem.weights, terminal=0.0))
        worst = max(worst, trajectory_of(still, start, np.zeros((4, n)), coordinates(x)).objective)
    assert 0.3 * EFFORT * RADIUS**2 < worst <= EFFORT * RADIUS**2 * (1.0 + 1e-9)


def test_what_has_to_arrive_in_time_does_not_intercept():
    for options in ({'shrinking': True}, {}):
        problem = Problem(terminal='penalty' if options else 'constraint')
        with pytest.raises(BadInput, match=r'capture_radius is 1\.0; allowed: 0 with an arrival'):
            Stepped(problem, capture_radius=1.0, **options)


def test_without_a_catch_the_weights_say_what_is_flown():
    problem = Problem(weights=Weights(1.0, 0.05, 0.0, 10.0))
    goals = np.tile([0.3, 40.0], (5, 1))
    here = odometry([0.0, 0.0], 0.0, 1.0)
    tracked = Stepped(problem).tick(here, goals)
    missed = Stepped(problem, capture_radius=0.5).tick(here, goals)
    assert np.isnan(missed.catch.time)
    assert missed.catch.bound == 6 * problem.step
    assert missed.command == tracked.command
    assert tracked.catch is None


@needs_machine_code
@pytest.mark.parametrize('bearing', [0.5, 2.8, -1.2, -2.4])
def test_a_goal_within_the_smallest_circle_is_caught_by_who_looks_beyond_the_horizon(bearing):
    goal = 15.0 * exp(np.array([bearing]))[:, 0]  # the smallest turn radius: 23 m
    wing, plant = replace(WING, discretisation='exact'), Plant(forward=15.0)
    tracking, looking = (Stepped(wing, capture_radius=2.0) for _ in range(2))
    flight, known = (2.0, plant, started(plant, 0.0, 0.8)), still(goal)
    if bearing in (0.5, -1.2):  # tracking happens to lead to the other goals
        assert not catches(tracking, *flight, lambda: known[:1], known[2])
    assert catches(looking, *flight, lambda: known, known[2])


def catches(controller, radius, plant, vehicle, given, goal):
    """Return True if a vehicle comes within a radius of a goal, at ``goal(times)``, within 25 s."""
    for _ in range(50):
        tick = controller.tick(measured(vehicle), *given())
        assert tick.plan is not None, tick.reason
        for _ in range(10):
            command = tick.command.speed_fraction, tick.command.body_rate
            vehicle = flown(plant, vehicle, *command, 0.05)
            apart = vehicle.position - goal(np.array([vehicle.time]))[0]
            if np.linalg.norm(apart) <= radius:
                return True
    return False


@needs_machine_code
@pytest.mark.parametrize('place', [(35.0, 20.0), (-10.0, 5.0)], ids=['in view', 'beyond'])
def test_a_catch_is_flown_on_where_there_is_no_time_to_look_for_one(place):
    """Without time, the last catch is continued twice, unless the goal has moved too far."""
    wing = replace(WING, discretisation='exact')

    for moved, caught in (0.5, True), (20.0, False):
        controller = Stepped(wing, capture_radius=RADIUS)
        here = odometry([0.0, 0.0], 0.0, 15.0)
        tick = controller.tick(here, *still(place))
        meant = tick.catch.time
        for k in (1, 2):
            turn, ahead = 0.1 * tick.command.body_rate[0], 1.5 * here.attitude[:, 0]
            heading = np.arctan2(*here.attitude[::-1, 0]) + turn
            here = odometry(here.position + ahead, heading, 15.0, 0.1 * k)
            goals, _, ahead = still(np.array(place) - [moved, 0.0])
            tick = controller.tick(here, goals, lambda: True, ahead)
            assert not violations(tick.problem, tick.state, tick.goals, tick.plan)
            if caught:
                assert tick.catch.time == pytest.approx(meant - 0.1 * k)
            else:
                assert np.isnan(tick.catch.time)


@needs_machine_code
@pytest.mark.parametrize('place', [(45.0, 20.0), (-10.0, 5.0)], ids=['in view', 'beyond'])
def test_the_solver_of_an_expected_catch_is_built_in_advance(place):
    controller = Stepped(replace(WING, discretisation='exact'), capture_radius=RADIUS)
    for k in range(2):  # every 0.3 s
        tick = controller.tick(odometry([4.5 * k, 0.0], 0.0, 15.0, 0.3 * k), *still(place))
    sizes, solver, sought = [], controller._solver_for, controller._interception
    expected = [(tick.catch.time - 0.3 - early) / WING.step for early in (-0.05, 0.0, 0.05)]
    ends = {np.ceil(4.0 * each) / 4.0 for each in expected} | {np.ceil(expected[1]) - 1.0}
    for built in (controller.prepare, lambda: [sought.solver(end) for end in ends]):
        sizes += [solver.cache_info().currsize]
        built()
    assert solver.cache_info().currsize == sizes[1] > sizes[0]


def test_steps_get_no_longer_where_boxes_would_be_jumped_over():
    box = Box(np.array([5.0, 5.0]), np.array([6.0, 6.0]))
    assert farthest(WING) == 32
    assert farthest(replace(WING, obstacles=(box,))) == 8
    assert farthest(replace(WING, max_rate=1.0)) == 25
    assert farthest(replace(WING, rotation_order=2, floor=Floor())) == 8


@needs_machine_code
def test_a_goal_that_can_be_caught_between_the_ends_of_steps_is_caught_sooner():
    """At 7.5 m per step, a vehicle is 1.5 m before the goal a quarter into the third step."""
    problem = replace(WING, discretisation='exact')
    goal, here = np.array([18.0 + 0.3, 0.0]), odometry([0.0, 0.0], 0.0, 15.0)
    known = {'ahead': lambda times: np.tile(goal, (len(times), 1))}

    def caught(pause, **options):
        controller = Stepped(problem, capture_radius=RADIUS)
        controller.tick(replace(here, time=-pause), np.tile(goal, (8, 1)), **options)
        return controller.tick(here, np.tile(goal, (8, 1)), **options)

    assert caught(0.1).catch.time == 1.5  # without the goal's motion in between
    # The first shorter step would end before the next tick, when its turn is already over.
    problem = replace(problem, max_rate=0.0, discretisation='euler')
    assert caught(problem.step, **known).catch.time == 1.5
    assert caught(0.1, **known).catch.time == 1.125
    problem = replace(WING, discretisation='exact')
    tick = caught(problem.step, **known)
    assert tick.catch.time == 1.125
    assert tick.catch.bound <= 1.125
    assert np.linalg.norm(tick.plan.positions[-1] - goal) <= AIM * RADIUS
    assert tick.problem.step * tick.plan.horizon == pytest.approx(1.125)


@needs_machine_code
def test_a_catch_is_flown_among_hazards_only_where_it_is_clear_of_them():
    boat = Problem(horizon=12, step=0.5, forward=3.0, max_rate=0.7)
    goals = np.tile([9.0, 0.0], (12, 1))

    def ticked(*hazards):
        controller = Stepped(boat, capture_radius=0.5, gap_tolerance=1e-3)
        controller.hazards = hazards
        return controller.tick(odometry([0.0, 0.0], 0.0, 3.0), goals)

    def disc(x, y, velocity):
        return MovingObstacle.drifting(Ball([x, y], 1.0), velocity)

    alone = ticked()
    beside = disc(4.5, 3.0, [0.0, 0.5])
    passing = ticked(beside)
    assert passing.catch == alone.catch
    np.testing.assert_array_equal(passing.plan.positions, alone.plan.positions)
    assert passing.state.hazards == (beside,)

    across = disc(4.5, -2.0, [0.0, 1.2])  # there when the catch passes
    blocked = ticked(beside, across)
    assert np.isnan(blocked.catch.time)
    assert blocked.catch.bound == alone.catch.bound
    assert 'leads through traffic' in blocked.reason
    assert blocked.plan.horizon == 12
    assert not violations(boat, blocked.state, goals, blocked.plan)
    assert violations(alone.problem, blocked.state, alone.goals, alone.plan)


@needs_machine_code
def test_a_catch_that_is_lost_by_little_is_still_flown_at():
    here, later = odometry([0.0, 0.0], 0.0, 15.0), odometry([7.5, 0.0], 0.0, 15.0, time=0.5)

    def ticked(goal, *before):
        controller = Stepped(WING, capture_radius=RADIUS)
        for seen, place in (*before, (later, goal)):
            tick = controller.tick(seen, *still(place))
        miss = np.linalg.norm(tick.plan.positions[-1] - place)
        return tick, miss

    meant = here, (15.0, 0.0)
    tick, miss = ticked((15.0, 4.0), meant)
    assert RADIUS < miss <= GRAZE * RADIUS
    assert np.isnan(tick.catch.time)
    assert tick.problem.step * tick.plan.horizon <= 1.0
    tick, miss = ticked((15.0, 4.0))  # no catch before: a loop away and back
    assert tick.catch.time > 4.0
    tick, miss = ticked((15.0, 9.0), meant)  # missed by far
    assert tick.catch.time > 4.0


@needs_machine_code
@pytest.mark.parametrize('cone', [0.0, 0.6])
def test_a_catch_through_the_middle_is_as_soon_and_turns_gently(cone):
    """The earliest catch turns at the limit, 11 deg per step, to gain only centimetres."""
    wing, goal = replace(WING, discretisation='exact'), np.array([40.0, 12.0])
    approach = Approach(cone, (1.0, 0.0)) if cone else Approach()

    def caught(centred):
        options = {'capture_radius': RADIUS, 'approach': approach, 'centred': centred}
        tick = Stepped(wing, **options).tick(odometry([0.0, 0.0], 0.0, 15.0), *still(goal))
        attitudes = tick.plan.projected
        turns = np.abs([log(a.T @ b) for a, b in pairwise(attitudes)])
        gap, way = goal - tick.plan.positions[-1], np.diff(tick.plan.positions[-2:], axis=0)[0]
        aside = abs(way[0] * gap[1] - way[1] * gap[0]) / np.linalg.norm(way)
        assert not violations(tick.problem, tick.state, tick.goals, tick.plan)
        return tick.catch, turns.max(), aside, np.linalg.norm(gap)

    (soonest, sharp, _, _), (same, gentle, aside, miss) = caught(False), caught(True)
    assert same == soonest
    assert gentle < 0.9 * sharp
    assert aside < 0.1 * RADIUS
    assert miss <= RADIUS


@needs_machine_code
def test_a_goal_is_where_the_vehicle_ends_that_flies_the_plan():
    """Wide turns within a step lead off the plan's chords: the flown arcs must meet the goal."""
    rope = Problem(horizon=5, step=1.0, forward=1.0, floor=floor('circle', 1.0))
    rope = replace(rope, discretisation='exact')
    rng, radius, far, found = np.random.default_rng(5), 0.05, 0, 0
    plant = Plant()
    for _ in range(20):
        goal = rng.uniform(1.0, 2.5) * exp(rng.uniform(-3.1, 3.1, 1))[:, 0]
        known = np.tile(goal, (5, 1)), None, lambda times, at=goal: np.tile(at, (len(times), 1))
        tick = Stepped(rope, capture_radius=radius).tick(odometry([0, 0], 0.0, 1.0), *known)
        vehicle = started(plant, 0.0, 1.0)
        step, turned = tick.problem.step, tick.plan.projected
        legs = zip(turned[:-1], turned[1:], tick.plan.speed_fraction[1:], strict=True)
        for before, after, share in legs:
            vehicle = flown(plant, vehicle, share, log(before.T @ after) / step, step)
        gap = vehicle.position - tick.plan.positions[-1]
        np.testing.assert_allclose(defect(tick.problem, tick.state, tick.plan, 0.0), gap, atol=1e-6)
        if not np.isnan(tick.catch.time):
            found, far = found + 1, far + (np.linalg.norm(gap) > radius)
            assert np.linalg.norm(vehicle.position - goal) <= radius
    assert found >= 12
    assert far > 5


@needs_machine_code
@pytest.mark.parametrize('bearing', [[-1.0, 0.0, 0.0], [-0.9, 0.3, 0.3], [-0.2, 0.0, 1.0]])
def test_a_wing_in_space_turns_round_and_catches_a_goal_that_moves(bearing):
    """Right behind, behind, and above; searches end after a number of polls, not after a time."""
    response = Response(speed=0.5, rate=0.4)
    lags = {'speed_lag': response.speed, 'rate_lag': response.rate}
    plant = Plant(3, forward=15.0, max_rate=WING.max_rate, **lags)
    wing = replace(WING, dimension=3, floor=floor('circle', 0.8))
    controller = Stepped(wing, capture_radius=RADIUS, response=response)
    vehicle, drift = started(plant, 0.0, 1.0), np.array([0.0, 2.0, -1.0])

    def ahead(times):
        return 70.0 * np.array(bearing) + np.outer(times, drift)

    assert catches(controller, RADIUS, plant, vehicle, lambda: (None, polled(200), ahead), ahead)
    start, far = State.at(np.zeros(3), np.eye(3)), np.tile([900.0, 60.0, -30.0], (8, 1))
    straight = Solver(catching(wing, RADIUS, 8)).solve(start, far, None, polled(200))
    assert straight.status == 'optimal'  # by the tangent alone


@needs_machine_code
def test_who_cannot_wait_catches_a_goal_that_it_passes_between_the_ends_of_steps():
    """At a constant 7.5 m per step, a goal at 11 m is 3.5 and 4 m from the ends of the step."""
    bird = replace(WING, floor=floor('circle', 1.0))
    goal, here = np.array([11.0, 0.0]), odometry([0.0, 0.0], 0.0, 15.0)
    tick = Stepped(bird, capture_radius=RADIUS).tick(here, *still(goal))
    assert 0.5 < tick.catch.time < 1.0
    assert np.linalg.norm(tick.plan.positions[-1] - goal) <= AIM * RADIUS
    blind = Stepped(bird, capture_radius=RADIUS).tick(here, np.tile(goal, (8, 1)))
    assert not blind.catch.time < 1.0  # without the goal's motion in between


# --- lower bounds of capture times

CHASES = json.loads((REFERENCE / 'interception.json').read_text())['cases']
WORDS = {known['free']['word']: known for known in CHASES}  # one per Dubins word
HEADED = [known for known in CHASES if known['prescribed']['time'] < 15.0]
NEAR = 0.1  # capture radius, in units of the distance flown in a step
REACH = 0.4
FREE = Problem(horizon=6)
BIRD = Problem(horizon=6, max_rate=0.6, floor=Floor('circle', fraction=1.0))


def jumping(rng):
    """Return goals at random distances, shape (6, 2), so that early ones may be easier to catch."""
    far = rng.uniform(0.0, 1.6, 6) * np.arange(1, 7)
    angles = rng.uniform(-1.5, 1.5, 6)
    return far[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])


def hunted(problem, goals, **given):
    """Return the catch and the state of a first tick from the origin along x at full speed."""
    tick = Stepped(problem, capture_radius=REACH, **given).tick(odometry(), goals)
    return tick.catch, tick.state


def excluded(catch):
    return steps_before(catch.bound, catch.sought.problem.step)


# --- closed forms


def catch(chase, step, horizon, approach=None, *, between=False):
    """Return the catch of a controller's first tick, at ends of steps or ``between`` them."""
    speed, start = chase['airspeed'], chase['start']
    problem = Problem(
        horizon=horizon, step=step, forward=speed, floor=floor('circle', 1.0),
        max_rate=speed / chase['turn_radius'], discretisation='exact',
    )  # fmt: skip
    known = {'disturbance': np.array(chase['wind']), 'velocity_source': 'air'}
    controller = Stepped(problem, capture_radius=NEAR * step * speed, approach=approach, **known)
    attitude, along = exp(np.array([start['heading']])), np.array([speed, 0.0])
    odometry = Odometry(0.0, np.array(start['position']), attitude, along, np.zeros(1))

    def ahead(times):
        moved = np.outer(times, chase['target']['velocity'])
        return np.array(chase['target']['position']) + moved

    goals = ahead(step * np.arange(1, horizon + 1))
    return controller.tick(odometry, goals, None, ahead if between else None).catch


@needs_machine_code
@pytest.mark.parametrize('chase', WORDS.values(), ids=WORDS)
def test_the_earliest_catch_is_at_the_first_step_that_ends_after_the_closed_form(chase):
    time = chase['free']['time']
    step = next(step for step in (0.2, 0.4, 0.8) if time < 29.0 * step)
    found = catch(chase, step, 30)
    sooner = 2.0 * NEAR * step  # most that the radius saves, if the goal moves along
    assert time - sooner <= found.time <= time + 1.5 * step
    assert time - step <= found.bound <= found.time


@needs_machine_code
@pytest.mark.parametrize('chase', HEADED, ids=lambda chase: chase['prescribed']['word'])
def test_a_catch_in_a_cone_is_no_later_than_the_closed_form_of_its_axis(chase):
    step, given = 0.8, chase['prescribed']
    axis = (math.cos(given['heading']), math.sin(given['heading']))
    found = catch(chase, step, 20, Approach(0.2, axis))
    assert chase['free']['time'] - step <= found.bound <= found.time
    assert found.time <= given['time'] + 1.5 * step


@needs_machine_code
@pytest.mark.parametrize('chase', [known for known in CHASES if known['free']['time'] < 5.5])
def test_a_catch_between_ends_of_steps_is_at_the_time_of_the_closed_form(chase):
    """Within 2 %, if the goal's motion between the ends of steps is given."""
    time, found = chase['free']['time'], catch(chase, 0.2, 30, between=True)
    assert time - 0.2 <= found.bound <= found.time
    assert found.time == pytest.approx(time, rel=0.02)


# --- refutations of single steps


@needs_machine_code
@pytest.mark.parametrize(
    'problem', [FREE, BIRD, replace(BIRD, floor=Floor('circle', fraction=0.5))]
)
@pytest.mark.parametrize('seed', range(3))
def test_each_step_that_is_excluded_is_refuted_exactly(problem, seed):
    catch, _ = hunted(problem, jumping(np.random.default_rng([seed, 79])))
    count = excluded(catch)
    if count:
        made = refutation_of(catch.sought, count)
        verdict = verified(parsed(text_of(made).encode()))
        assert verdict.holds
        assert verdict.proved == (count + 1) * problem.step


# --- bounds that are checked again


@needs_machine_code
@pytest.mark.parametrize('problem', [FREE, BIRD])
def test_bounds_that_plans_and_distances_prove_are_counted_again(problem):
    catches = [hunted(problem, jumping(np.random.default_rng([s, 80])))[0] for s in range(10)]
    assert all(catch.checked for catch in catches)
    assert sum(map(excluded, catches)) > 5


@needs_machine_code
def test_a_bound_that_rests_on_a_step_that_is_the_methods_word_is_its_word(monkeypatch):
    goals = np.tile([3.9, 0.0], (6, 1))
    behind = np.vstack([goals[:2], [[0.0, 1.0]], goals[3:]])  # out of reach for a wing
    assert [hunted(FREE, goals)[0].checked, hunted(BIRD, behind)[0].checked] == [True, True]
    unproved = lambda *_, **__: -np.inf  # noqa: E731
    monkeypatch.setattr('orbimpc_ros.mpc.solve.solver.Verifier.bound', unproved)
    assert hunted(FREE, goals)[0].checked  # proved by distances alone
    word, _ = hunted(BIRD, behind)
    assert excluded(word) == 3
    assert not word.checked


@needs_machine_code
def test_what_no_turn_leads_to_is_the_methods_word():
    coned = Approach(0.2, (-1.0, 0.0))
    catch, _ = hunted(BIRD, np.tile([1.0, 0.0], (6, 1)), approach=coned)
    assert excluded(catch) > 1
    assert not catch.checked


# --- positions that no headings reach


MOTIONS = [{**orders, 'discretisation': how} for orders in ORDERS for how in ('euler', 'exact')]


@pytest.mark.parametrize('given', MOTIONS)
def test_straight_flights_end_at_the_rim_of_what_headings_lead_to(given):
    rng = np.random.default_rng([*map(ord, str(given))])
    problem = Problem(horizon=5, step=0.6, forward=1.7, **given)
    n, radius = problem.dimension, 0.3
    start = replace(state_of(rng, problem), disturbance=0.2 * rng.normal(size=n))
    way = rotation(rng, n)
    ahead = trajectory_of(problem, start, np.zeros((5, n)), coordinates(np.tile(way, (5, 1, 1))))
    back = trajectory_of(problem, start, np.zeros((5, n)), coordinates(np.tile(-way, (5, 1, 1))))
    middle = 0.5 * (ahead.positions + back.positions)[1:]
    rim = ahead.positions[1:] - middle
    away = np.linalg.norm(rim, axis=1, keepdims=True)
    outward = np.divide(rim, away, out=np.tile(way[:, 0], (5, 1)), where=away > 0.0)
    for beyond, outside in ((-1e-9, False), (1e-9, True)):
        goals = middle + (away + radius + beyond) * outward
        assert missed(problem, start, goals, radius).tolist() == 5 * [outside]
