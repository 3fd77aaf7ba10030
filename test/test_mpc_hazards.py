# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Balls and moving obstacles: their tracks and margins, and plans that avoid them."""

import math
from dataclasses import replace

import numpy as np
import pytest
from plans import assembled, straight
from problems import COMPILED, needs_machine_code, polled
from stepping import Stepped, odometry

from orbimpc_ros.loop.compensation import Odometry
from orbimpc_ros.loop.fallback import clear_instead, is_clear
from orbimpc_ros.loop.traffic import (
    FORGOTTEN,
    AgentTrajectory,
    Distance,
    ObservedBody,
    ObservedTraffic,
    ObstacleTracker,
    clearance,
    nearest,
    reserving,
    silence,
)
from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.clearance import clearances
from orbimpc_ros.mpc.errors import Infeasible, SolverFailure
from orbimpc_ros.mpc.plan import UNPROVED, assemble
from orbimpc_ros.mpc.problem import (
    MAX_HAZARDS,
    Ball,
    Box,
    Floor,
    MovingObstacle,
    Problem,
    State,
    Weights,
)
from orbimpc_ros.mpc.problem.traffic import traffic_of
from orbimpc_ros.mpc.solve.solver import Solver, Task, Units


def test_what_may_be_faster_counts_as_larger_until_it_is_seen_again():
    disc = replace(still([6.0, 0.0], 1.0), reserve=0.4, unsure=1.5)
    start = State.at([0.0, 0.0], np.eye(2), hazards=(disc,))
    boat = Problem(horizon=8, step=0.5, forward=3.0)
    kept = traffic_of(boat, start).kept[0]
    np.testing.assert_allclose(kept, [0.0, 0.85, 1.7, 2.55, 0.4, 0.4, 0.4, 0.4])
    units = Units.of(boat)
    assert units.state(start).hazards[0].unsure * units.length / units.time == pytest.approx(1.5)


# --- plans among balls and moving obstacles


def flown(problem, plan, times):
    """Return a plan's positions at times, integrated independently from its headings."""
    h, exact = problem.step, problem.discretisation == 'exact'
    found = []
    for t in times:
        k = min(int(t / h), problem.horizon - 1)
        tau = t - k * h
        z, after = (problem.forward * plan.rotations[i, :, 0] for i in (k, k + 1))
        place, velocity = plan.positions[k], plan.velocities[k]
        change = (after - z) / h if exact else 0.0 * z
        if problem.translation_order == 1:
            found.append(place + tau * z + tau**2 / 2.0 * change)
        elif exact:
            found.append(place + tau * velocity + tau**2 / 2.0 * z + tau**3 / 6.0 * change)
        else:
            found.append(place + tau * velocity)
    return np.array(found)


def crossing(rng, n, count):
    """Return moving balls in the way of a vehicle that flies along x from the origin."""
    hazards = []
    while len(hazards) < count:
        centre = np.concatenate([rng.uniform(1.5, 5.0, 1), rng.uniform(-1.5, 1.5, n - 1)])
        radius = rng.uniform(0.3, 0.8)
        if np.linalg.norm(centre) > radius + 1.2:
            velocity = rng.uniform(-0.4, 0.4, n)
            hazards.append(MovingObstacle.drifting(Ball(centre, radius), velocity))
    return tuple(hazards)


MODELS = [
    {},
    {'discretisation': 'exact'},
    {'translation_order': 2},
    {'translation_order': 2, 'discretisation': 'exact'},
    {'max_rate': 1.5, 'floor': Floor('circle')},
    {'floor': Floor('circle')},
    {'dimension': 3, 'weights': Weights(input=0.0)},
    {'dimension': 3, 'weights': Weights(input=0.0), 'floor': Floor('circle')},
]


@pytest.mark.parametrize('model', MODELS)
def test_a_solver_takes_states_with_any_number_of_hazards_in_turn(model):
    rng, tolerance = np.random.default_rng(9), 0.02
    problem = Problem(horizon=5, step=0.6, forward=1.8, **model)
    n, solver = problem.dimension, Solver(problem, gap_tolerance=tolerance)
    goals = np.tile(np.eye(n)[0] * 6.0, (problem.horizon, 1))
    for count in (2, 0, 3, 1):
        start = State.at(np.zeros(n), np.eye(n), hazards=crossing(rng, n, count))
        fresh = Solver(problem, gap_tolerance=tolerance)
        plan, anew = (each.solve(start, goals) for each in (solver, fresh))
        assert violations(problem, start, goals, plan) == []
        assert plan.objective == pytest.approx(anew.objective, rel=2e-3)
    far = (still(np.full(n, -9.0), 1.0),)
    alone, aside = (solver.solve(replace(start, hazards=each), goals) for each in ((), far))
    assert aside.objective == pytest.approx(alone.objective, rel=2e-3)
    assert aside.proof.nodes <= 1 or not COMPILED  # a body out of the way takes no search


@pytest.mark.parametrize('model', MODELS)
def test_plans_stay_clear_at_all_times(model):
    rng = np.random.default_rng(21)
    problem = Problem(horizon=5, step=0.6, forward=1.8, **model)
    n, planner, plans = problem.dimension, Solver(problem, gap_tolerance=0.05), 0
    moments = np.linspace(0.0, problem.horizon * problem.step, 601)
    goals = np.tile(np.eye(n)[0] * 6.0, (problem.horizon, 1))
    for _ in range(3):
        hazards = crossing(rng, n, 2)
        start = State.at(np.zeros(n), 0.6 * np.eye(n), hazards=hazards)
        try:
            plan = planner.solve(start, goals, None, polled(400))
        except (Infeasible, SolverFailure):
            continue
        plans += 1
        assert plan.lower_bound <= plan.objective * (1.0 + 1e-9)
        for each in hazards:
            away = flown(problem, plan, moments) - each.body.centre - each.moved(moments)
            assert np.linalg.norm(away, axis=1).min() >= each.body.radius - 1e-5
    assert plans >= 2


def still(centre, radius):
    """Return a ball at rest."""
    return MovingObstacle.drifting(Ball(centre, radius), np.zeros(len(centre)))


def dashing(far):
    """Return a ball next to the path that darts in between two steps, and back."""
    shifts = [[0.0, 0.0], [0.0, 0.0], [0.0, -far], [0.0, 0.0]]
    return MovingObstacle(Ball([1.5, 1.5], 0.3), [0.0, 1.0, 1.5, 2.0], shifts)


@pytest.mark.parametrize(
    ('hazard', 'hit'),
    [
        (still([2.0, 0.0], 0.2), True),  # at the end of a step
        (still([2.0, 2e-9], 1e-9), False),
        (still([1.5, 0.0], 0.2), True),  # only between the ends of a step
        (still([1.5, 2e-9], 1e-9), False),
        (dashing(1.5), True),
        (dashing(1.1), False),
    ],
)
def test_a_plan_that_hits_is_refused(hazard, hit):
    problem = Problem(horizon=3)
    start, goals, plan = straight(problem, np.ones(3))
    found = violations(problem, replace(start, hazards=(hazard,)), goals, plan)
    assert [each.partition(' violated')[0] for each in found] == ['hazard 0'] * hit
    if not hazard.shifts.any():
        static = replace(problem, obstacles=(hazard.body,))
        assert bool(violations(static, start, goals, plan)) is hit


def test_a_plan_has_one_face_between_it_and_a_moving_box_in_each_step():
    """A step has one side: the straight path, left of the box and then above it, is not a plan."""
    box = MovingObstacle.drifting(Box([1.5, -9.0], [9.0, 1.2]), np.array([0.0, -1.0]))
    problem, ahead = Problem(horizon=3), np.array([1.0, 0.0])
    state, goals = State.at(0.0 * ahead, np.eye(2), hazards=(box,)), np.outer([1, 2, 3], ahead)
    rounded = assembled(problem, state, goals, np.tile(ahead, (3, 1)))
    assert 'hazard 0 violated' in violations(problem, state, goals, rounded)[0]
    assert rounded.objective < 1e-9
    plan = Solver(problem).solve(state, goals)
    assert violations(problem, state, goals, plan) == []
    assert plan.lower_bound > 1e-3


@pytest.mark.parametrize(
    ('velocity', 'told'), [([0.0, 0.0], 'the goal is inside of hazard 1'), ([-1.0, 0.0], '')]
)
def test_a_goal_inside_of_what_stays_there_is_told_of(velocity, told):
    controller = Stepped(Problem(horizon=3), gap_tolerance=0.05)
    around = MovingObstacle.drifting(Ball([4.0, 0.0], 1.0), velocity)
    controller.hazards = (still([0.0, 9.0], 1.0), around)
    tick = controller.tick(odometry(speed=0.0), np.tile([4.5, 0.0], (3, 1)))
    assert tick.plan is not None
    assert tick.reason == told


# --- reserves: clearance beyond the margin


def test_a_reserve_counts_later_in_a_plan():
    problem = Problem(horizon=6, step=0.5, forward=1.0)
    disc = MovingObstacle.drifting(Ball([3.0, 0.2], 0.5), [-0.2, 0.0])
    goals = np.tile([4.0, 0.0], (6, 1))

    def apart(reserve):
        start = State.at([0.0, 0.0], np.eye(2), hazards=(replace(disc, reserve=reserve),))
        plan = Solver(problem, gap_tolerance=1e-3).solve(start, goals)
        assert violations(problem, start, goals, plan) == []
        away = plan.positions - disc.body.centre - disc.moved(0.5 * np.arange(7))
        return plan, np.linalg.norm(away, axis=1) - 0.5

    bare, grazing = apart(0.0)
    _, wary = apart(0.4)
    shares = 0.4 * np.minimum(np.arange(6) / 4, 1.0)
    assert (wary[:-1] >= shares - 1e-6).all()  # at the starts of steps
    assert (wary[1:] >= shares - 1e-6).all()  # and at their ends
    assert (grazing[1:] < shares - 0.01).any()
    asked = State.at([0.0, 0.0], np.eye(2), hazards=(replace(disc, reserve=0.4),))
    assert 'hazard 0 violated' in violations(problem, asked, goals, bare)[0]


def test_a_reserve_is_given_up_where_no_plan_keeps_it():
    """The goal is 0.2 m from both discs: no plan that keeps 0.4 m away arrives."""
    problem = Problem(horizon=6, step=0.5, forward=1.0, terminal='constraint')
    controller = Stepped(problem, gap_tolerance=0.01, reserve=0.4)
    controller.hazards = tuple(still([2.5, 0.7 * side], 0.5) for side in (-1.0, 1.0))
    goals = np.tile([2.5, 0.0], (6, 1))
    tick = controller.tick(odometry(speed=0.0), goals)
    assert tick.status == 'optimal'
    assert [each.reserve for each in tick.state.hazards] == [0.0, 0.0]
    tick = controller.tick(odometry(tick.plan.positions[1], 0.0, 0.0, 0.5), goals)
    assert tick.status == 'optimal'
    assert [each.reserve for each in tick.state.hazards] == pytest.approx([0.4 / 3.0] * 2)


def test_boxes_are_kept_clear_of_with_the_reserve_too():
    box, goals = Box([1.0, -1.0], [2.0, 0.3]), np.tile([3.0, 0.0], (8, 1))
    problem = Problem(horizon=8, step=0.5, forward=1.0, obstacles=(box,))
    wary, bare = (
        Stepped(problem, gap_tolerance=0.01, reserve=reserve).tick(odometry(), goals).plan
        for reserve in (0.3, 0.0)
    )
    assert box.depth(wary.positions[4:]).max() <= -0.3 + 1e-6
    assert box.depth(bare.positions[4:]).max() > -0.1


def test_as_much_of_a_reserve_counts_as_the_plan_before_keeps():
    problem = Problem(horizon=6, step=0.5, forward=1.0)
    asides = 0.65, -0.8, 1.5  # the path passes the discs at 0.15, 0.3 and 1 m
    hazards = tuple(still([2.5, y], 0.5) for y in asides)
    start, goals = State.at([0.0, 0.0], np.eye(2)), np.tile([3.0, 0.0], (6, 1))
    plan = Solver(problem).solve(start, goals)
    beside = replace(start, hazards=hazards)
    for previous, kept in (plan, [0.0, 0.2, 0.6]), (None, [0.0] * 3):
        wary = reserving(Task(problem, beside, goals, previous=previous, pace=0.5), 0.6)
        found = [[hazard.reserve for hazard in each.state.hazards] for each in wary]
        np.testing.assert_allclose(found, [[0.6] * 3, kept])


# --- fallbacks for plans that do not keep the vehicle clear

BOAT = Problem(horizon=8, step=0.5, forward=3.0, max_rate=0.7, discretisation='exact')
FAR = np.tile([20.0, 0.0], (8, 1))


def meeting(away):
    """Return a slow boat that heads along x towards an approaching disc ``away`` metres ahead."""
    disc = MovingObstacle.drifting(Ball([away, 0.0], 1.0), [-0.5, 0.0])
    return State.at([0.0, 0.0], 0.3 * np.eye(2), hazards=(disc,))


def swerving(angles, speeds):
    """Return a plan with these headings [rad] and fractions of full speed."""
    headings = np.array(speeds)[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    start = meeting(9.0)
    known = {'projection': 'thrust_aligned', 'proof': UNPROVED}
    return assemble(BOAT, start, FAR, headings, **known)


def test_a_turn_that_is_cut_does_not_keep_clear():
    """60 degrees in a step at a low speed are a short chord, but take three steps to turn."""
    speeds = [0.3, 0.4, 0.6, 0.9, 1.0, 1.0, 1.0, 1.0]
    plan = swerving(np.radians([-60.0] * 8), speeds)
    start = meeting(2.5)
    assert violations(BOAT, start, FAR, plan) == []
    task = Task(BOAT, start, FAR)
    assert not is_clear(task, plan)
    able = swerving(np.radians([-20.0, -40.0] + [-60.0] * 6), speeds)
    assert is_clear(replace(task, state=meeting(4.0)), able)
    floored = replace(BOAT, floor=Floor('circle', fraction=0.2))  # limits the angle: none is cut
    assert is_clear(replace(task, problem=floored), plan)

    instead = clear_instead(task, plan)
    assert is_clear(task, instead)
    assert violations(BOAT, start, FAR, instead) == []
    assert instead.lower_bound == plan.lower_bound


def test_the_clearest_way_is_flown_where_none_is_clear():
    """The disc around the vehicle is too large to leave within the horizon."""
    controller = Stepped(BOAT)
    controller.hazards = (still([9.0, 1.0], 30.0),)
    tick = controller.tick(odometry(), FAR)
    assert tick.status in ('infeasible', 'failed')
    assert tick.fallback == 'clearest way'
    assert 'm inside a hazard' in tick.reason
    assert violations(BOAT, replace(tick.state, hazards=()), FAR, tick.plan) == []
    away = np.linalg.norm(tick.plan.positions - [9.0, 1.0], axis=1)
    assert away[-1] > away[0] + 2.0  # backwards, out of it
    assert controller.tick(odometry(time=0.5), FAR).command.body_rate != 0.0


@pytest.mark.parametrize(
    ('model', 'place', 'speed', 'size', 'leaves'),
    [
        (MODELS[1], -1.2, 0.0, 3.0, True), (MODELS[3], -1.2, 0.0, 3.0, True),
        (MODELS[3], -2.8, 3.0, 3.0, True), (MODELS[1], -1.2, 0.0, 20.0, False),
    ],
)  # fmt: skip
def test_a_box_that_holds_a_vehicle_is_left_where_it_can_be(model, place, speed, size, leaves):
    """No plan is outside of it from there, but it may be left as a hazard may."""
    box = Box([-size, -size], [size, size])
    planner = Stepped(Problem(horizon=8, step=0.5, forward=2.0, obstacles=(box,), **model))
    place, velocity = place * np.eye(2)[0], speed * np.eye(2)[0]
    attitude, told = np.eye(2), []
    for k in range(8):
        seen = Odometry(0.5 * k, place, attitude, attitude.T @ velocity, np.zeros(1))
        tick = planner.tick(seen, np.tile([9.0, 9.0], (8, 1)))
        told.append(tick.fallback)
        if tick.plan is None:
            break
        flown = tick.plan
        place, attitude, velocity = flown.positions[1], flown.projected[1], flown.velocities[1]
    if leaves:
        count = told.count('clearest way')
        assert told == ['clearest way'] * count + [''] * (8 - count)
        assert 0 < count < 8
    else:
        assert told == ['safe command']


# --- starts inside a margin


@needs_machine_code
@pytest.mark.parametrize('model', MODELS[:2])
@pytest.mark.parametrize('hull', [Ball([0.0, 0.0], 1.5), Box([-1.4, -1.5], [1.5, 1.4])])
def test_who_is_inside_of_a_margin_leaves_by_a_short_way(model, hull):
    problem = Problem(horizon=8, step=0.5, forward=2.0, **model)
    start = State.at(
        [-0.6, 0.4], 0.6 * np.eye(2), hazards=(MovingObstacle.drifting(hull, [0.0, 0.0]),)
    )
    goals = np.tile([6.0, 0.0], (8, 1))
    plan = Solver(problem).solve(start, goals, None, polled(600))
    assert violations(problem, start, goals, plan) == []
    depth = hull.depth(plan.positions)
    assert depth[0] > 0.5
    assert depth[-1] <= 1e-6
    gone = np.flatnonzero(depth <= 1e-6)[0]
    assert (depth[gone:] <= 1e-6).all()  # and stays out
    shut = replace(start, hazards=(still([0.0, 0.0], 40.0),))
    with pytest.raises((Infeasible, SolverFailure)):  # too deep inside to leave
        Solver(problem).solve(shut, goals, None, polled(600))


BOUND = {'horizon': 8, 'step': 0.5, 'forward': 2.0}


@needs_machine_code
@pytest.mark.parametrize(
    ('given', 'velocity', 'disc'),
    [
        (BOUND, None, still([1.3, 0.1], 0.4)),  # s_1 is in the disc
        (BOUND, None, still([0.55, -0.45], 0.5)),  # the path to it crosses the disc
        ({'horizon': 6, 'translation_order': 2}, [4.0, 0.0], still([4.0, 0.0], 0.8)),
    ],
)
def test_who_is_bound_to_enter_a_margin_leaves_it_again(given, velocity, disc):
    """The present velocity alone decides the path to s_1, or thrust adds too little to stop."""
    problem = Problem(**given)
    start = State.at([0.0, 0.0], np.eye(2), velocity=velocity, hazards=(disc,))
    goals = np.tile([10.0, 0.0], (problem.horizon, 1))
    plan = Solver(problem).solve(start, goals)
    assert violations(problem, start, goals, plan) == []
    first = np.linspace(plan.positions[0], plan.positions[1], 5)
    assert disc.body.depth(first).max() > 1e-3
    assert (disc.body.depth(plan.positions[2:]) <= 1e-6).all()


def test_who_is_only_where_a_track_may_stray_gets_no_nearer_to_it():
    """The margin is relaxed as if inside, but a vehicle that stays put is still hit in step 2."""
    ball, bends = Ball([0.0, 0.0], 1.0), np.array([0.0, -0.2, 0.0, 0.2, 0.0, 0.0])
    wavering = MovingObstacle(ball, 0.5 * np.arange(6), np.column_stack([bends, 0.0 * bends]))
    problem = Problem(horizon=3)
    state = State.at([1.15, 0.0], np.zeros((2, 2)), attitude=np.eye(2), hazards=(wavering,))
    for speed, met in ((0.0, True), (1.0, False)):
        x, known = np.tile([speed, 0.0], (3, 1)), (problem, state, np.zeros((3, 2)))
        plan = assemble(*known, x, projection='thrust_aligned', proof=UNPROVED)
        assert (clearances(problem, state, plan)['hazard 0'] < 0.0) == met


FASTEST = 50.0
NEAR = Distance(1.0, 0.5)


def moved(bodies, at, unseen=0.0):
    return ObservedTraffic(bodies.current(at), unseen=unseen).hazards(at)


def disc(x, y, radius=0.5):
    return Ball(np.array([x, y]), radius)


def seen(time, body, name='a/0', lifetime=math.inf):
    return ObservedBody(name, time, body, lifetime)


def at(hazard, time):
    """Return the centre of a hazard at a time after its start."""
    return hazard.body.centre + hazard.moved(np.array([time]))[0]


# --- bodies


def test_a_body_seen_once_stands_and_seen_twice_goes_on():
    bodies = ObstacleTracker()
    bodies.see(seen(1.0, disc(0.0, 0.0)), FASTEST)
    (still,) = moved(bodies, 3.0)
    np.testing.assert_allclose(at(still, 5.0), [0.0, 0.0])
    assert still.unsure == 0.0
    assert moved(bodies, 3.0, 1.5)[0].unsure == 1.5
    bodies.see(seen(2.0, disc(1.0, -2.0)), FASTEST)
    assert moved(bodies, 3.0, 1.5)[0].unsure == 0.0
    (moving,) = moved(bodies, 3.0)
    np.testing.assert_allclose(at(moving, 0.0), [2.0, -4.0])
    np.testing.assert_allclose(at(moving, 2.0), [4.0, -8.0])


@pytest.mark.parametrize('seed', range(5))
def test_an_even_motion_is_found_whatever_the_stamps(seed):
    rng = np.random.default_rng([71, seed])
    start, velocity = rng.uniform(-5.0, 5.0, (2, 3))
    bodies, stamps = ObstacleTracker(), np.cumsum(rng.uniform(0.01, 1.0, 6))
    for time in stamps:
        place = start + time * velocity
        bodies.see(seen(time, Box(place - 1.0, place + np.array([1.0, 2.0, 3.0]))), FASTEST)
    (hazard,) = moved(bodies, stamps[-1] + 0.7)
    expected = start + (stamps[-1] + 3.7) * velocity
    np.testing.assert_allclose(at(hazard, 3.0) - [0.0, 0.5, 1.0], expected, atol=1e-9)
    np.testing.assert_allclose(hazard.body.maximum - hazard.body.minimum, [2.0, 3.0, 4.0])


# --- tracks


def test_a_track_is_followed_from_any_time_and_beyond_both_ends():
    times, points = np.array([1.0, 2.0, 4.0]), np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 4.0]])
    for begin in (0.0, 1.0, 1.5, 2.0, 3.0, 4.0, 7.0):
        hazard = AgentTrajectory(1.0, times, points).hazards(begin, NEAR)[0]
        for time, expected in (
            (0.0, [-1.0, 0.0]),
            (1.25, [0.25, 0.0]),
            (2.0, [1.0, 0.0]),
            (3.0, [1.0, 2.0]),
            (9.0, [1.0, 14.0]),
        ):
            if time >= begin:
                np.testing.assert_allclose(at(hazard, time - begin), expected, atol=1e-12)
    alone = AgentTrajectory(1.0, times[:1], points[1:2]).hazards(3.0, NEAR)[0]
    np.testing.assert_allclose(at(alone, 5.0), [1.0, 0.0])


# --- other vehicles


def heard(time=0.0, step=0.2, count=6, speed=1.0):
    times = time + step * np.arange(count)
    return AgentTrajectory(time, times, np.column_stack([speed * (times - time), 0.0 * times]))


def test_a_vehicle_flies_its_plan_and_then_on_at_the_distance_asked_for():
    (hazard,) = heard().hazards(0.3, NEAR)
    assert hazard.body.radius == 1.0
    np.testing.assert_allclose(at(hazard, 0.0), [0.3, 0.0])
    np.testing.assert_allclose(at(hazard, 10.0), [10.3, 0.0], atol=1e-9)
    assert silence('/b/plan', heard(), 0.3 - 0.5) == ''


@pytest.mark.parametrize('seed', range(10))
def test_who_is_silent_is_covered_flying_on_and_stopped_anywhere_since(seed):
    rng = np.random.default_rng([72, seed])
    times = np.cumsum(rng.uniform(0.1, 0.4, 6))
    course = AgentTrajectory(times[0], times, np.cumsum(rng.uniform(-1.0, 1.0, (6, 2)), axis=0))
    now = times[0] + rng.uniform(0.5001, 0.5 + FORGOTTEN)
    on, stopped = course.hazards(now, NEAR)
    (flown,) = course.hazards(times[0], NEAR)
    np.testing.assert_allclose(at(on, 1.0), at(flown, now + 1.0 - times[0]), atol=1e-9)
    for moment in np.linspace(0.0, now - times[0], 200):
        for later in (0.0, 30.0):  # anywhere it may have stopped, at the required distance
            apart = np.linalg.norm(at(stopped, later) - at(flown, moment))
            assert apart + NEAR.radius <= stopped.body.radius + 1e-9
    assert 'may have stopped' in silence('/b/plan', course, now - 0.5)


def test_the_room_of_a_silent_vehicle_grows_at_half_its_speed():
    radii = [heard(speed=2.0).hazards(time, NEAR)[1].body.radius for time in (1.0, 2.0, 3.0)]
    np.testing.assert_allclose(radii, [2.0, 3.0, 4.0])


def test_a_silent_vehicle_is_forgotten_in_the_end_and_one_never_heard_is_told_of():
    course = heard()
    assert len(course.hazards(0.5 + FORGOTTEN, NEAR)) == 2
    assert course.hazards(0.5 + FORGOTTEN + 0.01, NEAR) == []
    assert 'no longer avoided' in silence('/b/plan', course, FORGOTTEN + 0.01)
    assert 'nothing heard' in silence('/b/plan', None, -0.5)


# --- selection of relevant hazards


def brute(problem, hazard, speed, blown):
    """Return True if a body and a vehicle's reachable set meet, by dense sampling."""
    times = np.linspace(0.0, problem.horizon * problem.step, 2001)
    fastest, order = problem.forward + blown, problem.translation_order
    reach = fastest * times if order == 1 else speed * times + 0.5 * fastest * times**2
    return bool((hazard.body.depth(-hazard.moved(times)) >= -reach).any())


@pytest.mark.parametrize('order', [1, 2])
def test_no_hazard_that_can_be_met_is_left_out(order):
    problem = Problem(horizon=6, step=0.5, translation_order=order)
    rng = np.random.default_rng([73, order])
    for _ in range(200):
        body = disc(*rng.uniform(-12.0, 12.0, 2), rng.uniform(0.1, 2.0))
        hazard = MovingObstacle.drifting(body, rng.uniform(-3.0, 3.0, 2))
        blown = rng.uniform(0.0, 1.0)
        used, left_out = nearest(problem, odometry(), np.array([0.0, blown]), [hazard])
        assert left_out == 0
        if brute(problem, hazard, 1.0, blown):
            assert used == (hazard,)


def test_what_cannot_be_met_is_no_concern():
    away = MovingObstacle.drifting(disc(15.0, 0.0), np.array([0.5, 0.0]))
    assert nearest(Problem(), odometry(), np.zeros(2), [away]) == ((), 0)
    assert len(nearest(Problem(), odometry(), np.zeros(2), [away], horizons=6.0)[0]) == 1


def test_of_too_many_the_nearest_count():
    crowd = [MovingObstacle.drifting(disc(2.0 + 0.02 * k, 0.0), np.zeros(2)) for k in range(100)]
    shuffled = [crowd[k] for k in np.random.default_rng(74).permutation(100)]
    used, left_out = nearest(Problem(), odometry(), np.zeros(2), shuffled)
    assert left_out == 100 - MAX_HAZARDS
    assert set(used) == set(crowd[:MAX_HAZARDS])


def test_the_clearance_is_the_least_over_steps_and_obstacles():
    problem = Problem(horizon=2, obstacles=(Box(np.array([0.0, 5.0]), np.array([1.0, 6.0])),))
    crossing = MovingObstacle.drifting(disc(2.0, 2.0), np.array([0.0, -1.0]))
    state = State.at(np.zeros(2), np.eye(2), hazards=(crossing,))
    positions = np.array([[0.0, 0.0], [1.0, 0.0], [1.5, 0.0]])
    assert clearance(problem, state, positions) == pytest.approx(0.0)
    alone = State.at(np.zeros(2), np.eye(2))
    assert clearance(problem, alone, positions) == pytest.approx(5.0)
    assert clearance(Problem(horizon=2), alone, positions) == math.inf
