# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Problems: what is refused with which message, files, the discrete model, units and weights."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from plans import assembled
from problems import CASES, ORDERS, disturbed, floor, goals, weights

from orbimpc_ros.loop.compensation import Odometry
from orbimpc_ros.loop.goal.motion import GoalTrajectory, Route
from orbimpc_ros.loop.planner import Planner, Snapshot
from orbimpc_ros.mpc.arrays import frozen
from orbimpc_ros.mpc.check import violations
from orbimpc_ros.mpc.errors import BadInput, Infeasible, SolverFailure
from orbimpc_ros.mpc.geometry.rotations import coordinates
from orbimpc_ros.mpc.model.dynamics import Condensed, trajectory_of
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
from orbimpc_ros.mpc.problem.case import case_of
from orbimpc_ros.mpc.problem.problem import weighed
from orbimpc_ros.mpc.problem.reach import constraints_in_force, decided
from orbimpc_ros.mpc.solve.solver import Solver, Units

STILL, GOALS = State.at([0.0, 0.0], np.eye(2)), np.zeros((5, 2))
WORDS = [['left', 0.0]] * 5
DISC = Ball([3.0, 1.0], 0.5)
DRIFTING = MovingObstacle.drifting(DISC, [0.0, 1.0])
MOVED = [[0.0, 0.0], [1.0, 0.0]]


@pytest.mark.parametrize('shown', [np.asarray, memoryview, partial(np.broadcast_to, shape=2)])
def test_what_its_owner_may_change_is_copied(shown):
    owned = np.array([1.0, 2.0])
    kept = frozen(shown(owned), (2,), 'x')
    owned[0] = 5.0
    assert kept.tolist() == [1.0, 2.0]
    assert frozen(kept, (2,), 'x') is kept


def asked(*others, coasting=False, **given):
    return Solver(Problem(**given), coasting=coasting).solve(STILL, *others)


def stepped(goal, n=2):
    measured = Odometry(0.0, np.zeros(n), np.eye(n), np.zeros(n), np.zeros(1))
    return Planner(Problem()).step(Snapshot(measured, goal))


def directed(cone=0.3, direction=(1.0, 0.0)):
    return Problem(approach=Approach(cone, direction))


def tracked(times, shifts=MOVED):
    return MovingObstacle(DISC, np.array(times), np.array(shifts))


# Values that a field of a class refuses by its own name, whatever the others are.
VALUES = {
    (Problem, ''): {
        'dimension': [4, True],
        'rotation_order': [3],
        'translation_order': [0],
        'horizon': [0, 2.0],
        'step': [0.0, 1e-300, np.nan, 10**400],
        'forward': [1e-300, -1.0, 'fast'],
        'terminal': ['maybe'],
        'discretisation': ['eular', 'held'],
        'weights': [{'position': 1.0}],
        'floor': ['circle'],
        'obstacles': [[DISC], (([0, 0], [1, 1]),), (DISC,) * 65],
        'max_rate': [4.0, -0.1],
        'max_acceleration': [-1.0],
        'tilt': [0.2],
        'glide_slope': [0.6],
    },
    (Weights, 'weights.'): {'input': [-1.0], 'position': [np.inf]},
    (Floor, 'floor.'): {'shape': ['square']},
    (directed, 'approach.'): {
        'cone': [1.6, -0.1, np.inf],
        'direction': [(1.0, 0.0, 0.0), (0.0, 0.0), (np.nan, 1.0)],
    },
    (partial(replace, DRIFTING), 'obstacles.'): {'unsure': [-1.0], 'reserve': [-0.1]},
    (partial(State.at, np.zeros(2), np.eye(2)), 'state.'): {
        'velocity': [[1.0]],
        'attitude': [2 * np.eye(2), 1e300 * np.eye(2)],
        'coasted': [np.zeros((2, 2))],
        'disturbance': [[1.0]],
        'hazards': [[DRIFTING], (DISC,), 65 * (DRIFTING,)],
    },
    (partial(Planner, Problem()), ''): {
        'safe': ['circle', 'hover'],
        'velocity_source': ['aer'],
        'disturbance': [np.zeros(3)],
        'odom_timeout': [0.0, np.nan],
    },
}


@pytest.mark.parametrize(
    ('make', 'culprit'),
    [
        *(
            (partial(make, **{name: value}), prefix + name)
            for (make, prefix), fields in VALUES.items()
            for name, values in fields.items()
            for value in values
        ),
        (lambda: Problem(obstacles=(Box([0, 0, 0], [1, 1, 1]),)), 'obstacles.min'),
        (lambda: Problem(floor=Floor('polygon', 4, 0.8)), 'floor.fraction'),
        (lambda: Problem(dimension=3, floor=Floor('polygon', 6, 0.6)), 'floor.fraction'),
        (lambda: Problem(dimension=3, floor=Floor('polygon', 4, 0.5)), 'floor.faces'),
        (lambda: Floor('polygon', 2, 0.4), 'floor.faces'),
        *((lambda f=f: Floor('circle', 4, f), 'floor.fraction') for f in (0.0, 1.1)),
        *((lambda y=y: Box([0.0, 0.0], [1.0, y]), 'obstacles.max') for y in (0.0, 10**400)),
        (lambda: Box([0.0, np.nan], [1.0, 1.0]), 'obstacles.min'),
        *((lambda s=s: State.at(s, np.eye(2)), 'state.position') for s in ([0.0], [0.0, np.nan])),
        *(
            (lambda r=r: State.at([0.0, 0.0], r), 'state.rotation')
            for r in (np.eye(3), 1.1 * np.eye(2), np.ones((2, 2)))
        ),
        (lambda: State.at([0.0] * 3, np.diag([1.0, 1.0, -1.0])), 'state.rotation'),
        *((lambda p=p: Route(np.array(p)), 'goal_path') for p in (MOVED[:1], 2 * MOVED[:1])),
        (lambda: GoalTrajectory(np.array([1.0, 1.0]), np.zeros((2, 2))), 'goal_path stamps'),
        *((lambda g=g: asked(g), 'goals') for g in (GOALS[1:], GOALS * np.nan, WORDS)),
        *((lambda g=g: stepped(g), 'goal') for g in (GOALS[1:], GOALS.ravel(), WORDS)),
        (lambda: stepped(GOALS, 3), 'odometry.position'),
        (lambda: Planner(Problem(3), sideslip=True), 'sideslip'),
        (lambda: asked(np.zeros((5, 3)), dimension=3), 'state.position'),
        *((lambda g=g: asked(GOALS, g), 'guess') for g in (GOALS[1:], WORDS)),
        (lambda: asked(GOALS, rotation_order=2, coasting=True), 'state.coasted'),
        (lambda: asked(GOALS, weights=Weights(attitude=1.0)), 'state.wanted'),
        (lambda: Solver(Problem(), projection='near'), 'projection'),
        (lambda: Solver(Problem(), gap_tolerance=np.nan), 'gap_tolerance'),
        (lambda: Problem(3, 1, 1, tilt=0.2), 'tilt'),
        *((lambda tilt=tilt: Problem(3, 1, 2, tilt=tilt), 'tilt') for tilt in (-0.1, 1.6)),
        (lambda: Problem(3, glide_slope=1.6), 'glide_slope'),
        (lambda: Problem(translation_order=2, max_acceleration=1.0), 'max_acceleration'),
        (lambda: weighed(Problem(), 'space'), 'weights.scaling'),
        (lambda: State.at([0.0] * 3, np.eye(3), hazards=(DRIFTING,)), 'state.hazards'),
        (lambda: Problem(obstacles=(Ball([1.0, 2.0, 3.0], 1.0),)), 'obstacles.centre'),
        *((lambda c=c: Ball(c, 1.0), 'obstacles.centre') for c in (np.eye(2), [[1.0], [1.0, 2.0]])),
        (lambda: tracked([0.0], [[0.0, 0.0]]), 'obstacles.times'),
        *((lambda b=b: tracked(b), 'obstacles.times') for b in ([0, 0], [0.5, 1], [0, np.nan])),
        (lambda: tracked([0.0, 1.0], [[1.0, 0.0], [1.0, 0.0]]), 'obstacles.shifts'),
        (lambda: tracked([0.0, 1.0], [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), 'obstacles.shifts'),
        *(
            (lambda radius=radius: Ball(np.zeros(2), radius), 'obstacles.radius')
            for radius in (0.0, -1.0, np.nan, np.inf)
        ),
    ],
)
def test_refused_with_the_culprit_named_in_one_line(make, culprit):
    with pytest.raises(BadInput) as caught, np.errstate(over='raise'):  # a warning is a line, too
        make()
    assert caught.value.culprit == culprit
    assert 'allowed: ' in str(caught.value)
    assert '\n' not in str(caught.value)


# --- files

CASE = {
    'dimension': 2, 'rotation_order': 1, 'translation_order': 1, 'horizon': 3, 'step': 0.5,
    'forward': 4.0, 'weights': {'position': 1.0, 'attitude': 2.0}, 'goal': [4, 0],
    'state': {'position': [0, 0], 'rotation': [[1, 0], [0, 1]]},
    'goal_attitude': [[0.0, -1.0], [1.0, 0.0]],
}  # fmt: skip
BALL = {'centre': [2.0, 0.0], 'radius': 0.5}
BOX = {'min': [0, 3], 'max': [1, 4]}


def test_files_state_limits_obstacles_and_what_is_wanted():
    named = [{**BALL, 'velocity': [0.0, -0.2]},
             {**BOX, 'times': [0, 1, 3], 'shifts': [[0, 0], [0, 1], [2, 1]]}]  # fmt: skip
    limits = {'max_acceleration': 2.0, 'approach': {'cone': 0.3, 'direction': [0.0, 1.0]}}
    problem, state, _ = case_of(
        {**CASE, **limits, 'obstacles': [BALL, BOX], 'hazards': named}
    ).parts
    ball, box = Ball([2.0, 0.0], 0.5), Box([0.0, 3.0], [1.0, 4.0])
    assert problem.obstacles == (ball, box)
    track = MovingObstacle(box, [0.0, 1.0, 3.0], [[0.0, 0.0], [0.0, 1.0], [2.0, 1.0]])
    assert state.hazards == (MovingObstacle.drifting(ball, [0.0, -0.2]), track)
    assert problem.speed_change == 0.25
    assert problem.approach == Approach(0.3, (0.0, 1.0))
    assert 'approach.cone 0.3' in constraints_in_force(problem, state)
    assert problem.weights.attitude == 2.0
    np.testing.assert_array_equal(state.wanted, CASE['goal_attitude'])
    assert case_of(CASE).state.hazards == ()


def test_files_state_the_cones_of_a_descent():
    flat = {name: value for name, value in CASE.items() if name != 'goal_attitude'}
    lander = {
        **flat, 'dimension': 3, 'translation_order': 2, 'tilt': 0.2, 'glide_slope': 0.6,
        'weights': {'terminal': 1.0}, 'goal': [0, 0, 0],
        'state': {'position': [0, 0, 9], 'rotation': np.eye(3).tolist()},
    }  # fmt: skip
    problem, state, _ = case_of(lander).parts
    assert constraints_in_force(problem, state) == ['tilt 0.2', 'glide_slope 0.6']


# --- what makes a problem infeasible


def blamed(problem, start, goals):
    with pytest.raises(Infeasible) as caught:
        Solver(problem).solve(start, goals)
    return str(caught.value)


AHEAD, FAR = Box([0.5, -1.0], [4.0, 1.0]), Box([9.0, 9.0], [10.0, 10.0])
WINDY = State.at([0.0, 0.0], np.eye(2), velocity=[0.0, 0.0], disturbance=[0.0, -0.5])


@pytest.mark.parametrize('order', [1, 2])
@pytest.mark.parametrize(
    ('given', 'start', 'goal', 'words'),
    [
        ({'obstacles': (FAR, AHEAD)}, replace(STILL, velocity=np.eye(2)[0]), [0.0, 0.0],
         'obstacle 1 contains s_1'),
        ({'terminal': 'constraint'}, WINDY, [0.0, 9.0], 'beyond what 5 steps can reach'),
    ],
)  # fmt: skip
def test_what_the_state_or_the_wind_decides_is_blamed(order, given, start, goal, words):
    problem = Problem(translation_order=order, **given)
    assert words in blamed(problem, start, np.tile(goal, (5, 1)))


def test_a_box_that_the_wind_drives_into_is_blamed():
    problem, goals = Problem(obstacles=(Box([0.5, 0.5], [1.5, 1.5]),)), np.zeros((5, 2))
    assert 'obstacle 0 contains s_1' in blamed(
        problem, replace(STILL, disturbance=np.eye(2)[1]), goals
    )
    assert Solver(problem).solve(STILL, goals).status == 'optimal'


@pytest.mark.parametrize('order', [1, 2])
def test_a_box_around_the_vehicle_is_left_only_where_it_is_a_hazard(order):
    around = Box([-0.7, -9.0], [9.0, 9.0])
    free = Problem(translation_order=order, horizon=8)
    start, goals = replace(STILL, position=np.array([0.9, 0.0])), np.zeros((8, 2))
    message = blamed(replace(free, obstacles=(around,)), start, goals)
    assert message.startswith('obstacle 0 contains s_1, ')
    hazard = MovingObstacle.drifting(around, np.zeros(2))
    plan = Solver(free).solve(replace(start, hazards=(hazard,)), goals)
    assert plan.positions[-1, 0] <= -0.7 + 1e-6


def test_constraints_that_only_together_leave_no_way():
    """At nearly constant speed and almost straight, five steps overshoot a goal 2 m ahead."""
    problem = Problem(terminal='constraint', floor=floor('circle', 0.95), max_rate=0.1, horizon=5)
    message = blamed(problem, STILL, np.tile([2.0, 0.0], (5, 1)))
    assert 'terminal: constraint' in message
    assert 'circle floor of 0.95' in message
    assert 'max_rate 0.1' in message


# --- the discrete model

MODELS = [{**orders, 'discretisation': how} for orders in ORDERS for how in ('euler', 'exact')]
MODELS += [{**each, 'discretisation': 'held'} for each in ORDERS if each['translation_order'] == 2]
SPEEDS = [(0.02, 0.1), (0.7, 3.0), (2.0, 1000.0)]


@pytest.mark.parametrize('model', MODELS)
def test_rollouts_and_maps_are_the_steps_of_the_model(model):
    """Compared with the check's rollouts, which the convex optima verify independently."""
    rng = np.random.default_rng([*map(ord, str(model))])
    problem = Problem(**model, horizon=6, step=rng.uniform(0.1, 2), forward=1.7)
    start, targets = disturbed(rng, problem), goals(rng, problem)
    x = rng.uniform(-1, 1, size=(6, 2 if problem.dimension == 2 else 9))
    flown = trajectory_of(problem, start, targets, x)
    plan = assembled(problem, start, targets, x)
    assert not [each for each in violations(problem, start, targets, plan) if 'differ' in each]
    mapped = decided(problem, start)[0][1:]
    mapped += problem.maps.reach[:, 1:] @ flown.rotations[1:, :, 0]
    np.testing.assert_allclose(mapped, flown.positions[1:], atol=1e-11)
    assert np.allclose(coordinates(flown.rotations[1:]), x)


# --- units and weights


@pytest.mark.parametrize('orders', ORDERS)
@pytest.mark.parametrize(('step', 'forward'), SPEEDS)
def test_natural_units_have_steps_of_one_and_a_hessian_of_one(orders, step, forward):
    rng = np.random.default_rng(3)
    problem = Problem(**orders, step=step, forward=forward, weights=weights(rng))
    units = Units.of(problem)
    assert (units.problem.step, units.problem.forward) == (1.0, 1.0)
    diagonal = np.diag(Condensed(units.problem).hessian)
    assert max(diagonal.max(), units.problem.weights.length) == pytest.approx(1.0)
    unit = Problem(**orders, weights=problem.weights)
    natural, again = (Units.of(weighed(each, 'time')).problem for each in (unit, problem))
    for name in ('position', 'input', 'length', 'terminal'):
        one, two = getattr(natural.weights, name), getattr(again.weights, name)
        assert two == pytest.approx(one, rel=1e-12)


def test_the_paper_means_sums_and_the_weight_of_the_attitude_has_no_unit():
    problem = Problem(step=0.1, forward=30.0, weights=Weights(attitude=4.0))
    assert weighed(problem, 'paper') is problem
    assert weighed(problem, 'time').weights.attitude == 4.0
    plain = {**CASES['uav_hull_1'], 'step': 0.5, 'forward': 2.0}  # a case may state what is meant
    timed = {**plain, 'weights': {**plain['weights'], 'scaling': 'time'}}
    assert case_of(timed).problem == weighed(case_of(plain).problem, 'time')


@pytest.mark.filterwarnings('ignore:overflow', 'ignore:invalid', 'ignore:divide')
def test_far_too_large_numbers_are_a_failure_and_no_error_of_arithmetic():
    storm = State.at(np.zeros(2), np.eye(2), disturbance=[1e200, 0.0])
    circle = Floor('circle', fraction=0.5)
    with pytest.raises(SolverFailure):
        Solver(Problem(floor=circle)).solve(storm, GOALS)
    with pytest.raises(SolverFailure):  # there is no path in a plane either
        Solver(Problem(3, floor=circle, max_rate=1.0)).solve(
            State.at(np.zeros(3), np.eye(3)), np.full((5, 3), 1.7e308), None, lambda: True
        )
