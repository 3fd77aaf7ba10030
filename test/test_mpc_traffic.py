# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""What moves around a vehicle: bodies seen again, plans of others, and which of them matter."""

import math

import numpy as np
import pytest
from stepping import odometry

from orbimpc_ros.loop.traffic import (
    FORGOTTEN,
    AgentTrajectory,
    Bodies,
    Distance,
    ObservedBody,
    Traffic,
    along,
    centre,
    clearance,
    nearest,
    silence,
)
from orbimpc_ros.mpc.problem import MAX_HAZARDS, Ball, Box, MovingObstacle, Problem, State

FASTEST = 50.0
NEAR = Distance(1.0, 0.5)


def moved(bodies, at, unseen=0.0):
    return Traffic(bodies.current(at), unseen=unseen).hazards(at)


def disc(x, y, radius=0.5):
    return Ball(np.array([x, y]), radius)


def seen(time, body, name='a/0', lifetime=math.inf):
    return ObservedBody(name, time, body, lifetime)


def at(hazard, time):
    """Return where a hazard's middle is at a time of its own."""
    return centre(hazard.body) + hazard.moved(np.array([time]))[0]


# --- bodies


def test_a_body_seen_once_stands_and_seen_twice_goes_on():
    bodies = Bodies()
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
    bodies, stamps = Bodies(), np.cumsum(rng.uniform(0.01, 1.0, 6))
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
        hazard = along(disc(7.0, 7.0), times, points, begin)
        for time, expected in (
            (0.0, [-1.0, 0.0]),
            (1.25, [0.25, 0.0]),
            (2.0, [1.0, 0.0]),
            (3.0, [1.0, 2.0]),
            (9.0, [1.0, 14.0]),
        ):
            if time >= begin:
                np.testing.assert_allclose(at(hazard, time - begin), expected, atol=1e-12)
    alone = along(disc(0.0, 0.0), times[:1], points[1:2], 3.0)
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
    flown = along(disc(0.0, 0.0), course.times, course.positions, times[0])
    np.testing.assert_allclose(at(on, 1.0), at(flown, now + 1.0 - times[0]), atol=1e-9)
    for moment in np.linspace(0.0, now - times[0], 200):
        for later in (0.0, 30.0):  # wherever it stopped, it stays, with room for both
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


# --- which of them matter


def brute(problem, hazard, speed, blown):
    """Return whether a body and the reach of a vehicle meet, by looking often."""
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
    assert nearest(Problem(), odometry(), None, [away]) == ((), 0)
    assert len(nearest(Problem(), odometry(), None, [away], horizons=6.0)[0]) == 1


def test_of_too_many_the_nearest_count():
    crowd = [MovingObstacle.drifting(disc(2.0 + 0.02 * k, 0.0), np.zeros(2)) for k in range(100)]
    shuffled = [crowd[k] for k in np.random.default_rng(74).permutation(100)]
    used, left_out = nearest(Problem(), odometry(), None, shuffled)
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
