# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Rope, capture and scenarios: geometry against brute force, and the paper's retrieval."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scenarios import dubins, retrieval, retrieval_problem, retrieved

from orbimpc_ros.loop.capture import STAY, Events, closest_approach, is_headed
from orbimpc_ros.loop.compensation import Odometry
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.problem import Approach, Ball, Box, MovingObstacle, Problem
from orbimpc_ros.sim.fleet import LEAST_RING, vehicles
from orbimpc_ros.sim.parameters import SimSettings
from orbimpc_ros.sim.vehicle import Plant
from orbimpc_ros.sim.world import departure, touched
from orbimpc_ros.tool.history import separations


def rope_at(*place):
    """Return the parameters of a goal at rest."""
    return {'rope_center': place, 'rope_amplitude': (0.0, 0.0, 0.0)}


@pytest.mark.parametrize('n', [2, 3])
def test_closest_approach_is_the_least_of_many(n):
    rng = np.random.default_rng(4)
    for draw in range(50):
        s0, s1, g0, g1 = rng.normal(size=(4, n))
        if draw == 0:
            s1, g1 = s0, g0
        distance, share = closest_approach((s0, s1), (g0, g1))
        shares = np.linspace(0.0, 1.0, 1001)[:, None]
        apart = np.linalg.norm((s0 - g0) + shares * ((s1 - g1) - (s0 - g0)), axis=1)
        assert distance <= apart.min() + 1e-12
        assert distance == pytest.approx(apart.min(), abs=5e-3)
        assert 0.0 <= share <= 1.0


def test_a_rope_swings_about_its_center():
    """It may drift as well."""
    own = {'rope_center': (5.0, 0.0), 'rope_amplitude': (0.5, 0.25), 'rope_phase': (0.0, np.pi / 2)}
    still, drift = SimSettings(**own, rope_frequency=0.1), np.array([0.3, -0.4])
    drifted = replace(still, rope_velocity=tuple(drift)).rope_at(40.0)
    np.testing.assert_allclose(drifted, still.rope_at(40.0) + 40.0 * drift)
    np.testing.assert_allclose(still.rope_at(0.0), [5.0, 0.25])
    np.testing.assert_allclose(still.rope_at(2.5), [5.5, 0.0], atol=1e-12)
    np.testing.assert_allclose(still.rope_at(10.0), still.rope_at(0.0), atol=1e-12)


@pytest.mark.parametrize('seed', [None, 1, 2])
def test_the_papers_story(seed):
    """Several near misses, then a capture at about t = 24 s; also from perturbed starts."""
    scenario = retrieval()
    if seed is not None:
        nudge = np.random.default_rng(seed).uniform(-1e-3, 1e-3, 2)
        scenario = replace(scenario, start_position=tuple(nudge))
    flights, ticks = zip(*retrieved(retrieval_problem(), scenario), strict=True)
    assert flights[-1].captured
    assert 23.0 <= flights[-1].missed_at <= 25.0
    *misses, caught = (flight.miss for flight in flights[1:])
    assert sum(miss < 0.35 for miss in misses) >= 3
    assert caught < scenario.capture_radius - 0.01
    assert min(misses) > scenario.capture_radius + 0.01
    assert all(tick.status == 'optimal' for tick in ticks)


FAR_AWAY = {'rope_center': (1e3, 1e3, 1e3)}
CUT = [
    {'step': 0.5},
    {'translation_order': 2},  # without a command it coasts
    {'failsafe_fraction': 0.5, 'failsafe_rate': 0.4},
    {'dimension': 3, 'failsafe_fraction': 0.5, 'failsafe_rate': 0.4},
    {'vehicle': 'continuous', 'step': 0.5, 'speed_lag': 0.5, 'failsafe_fraction': 0.7,
     'failsafe_rate': 0.1},
]  # fmt: skip


@pytest.mark.parametrize('own', CUT)
def test_a_command_that_ends_within_a_step_is_a_shorter_step_and_one_of_the_failsafe(own):
    start = {'start_fraction': 0.9, 'start_velocity': (1.0, 1.0, 1.0)}
    flight = departure(replace(retrieval(), **own, **start, **FAR_AWAY))
    model = flight.settings.model
    held, rate = 0.2 * model.step, np.full(model.rates, 0.3)
    obeyed = model.flown(flight.vehicle, held, 0.6, rate)[-1]
    lagging, (safe, turn) = isinstance(model, Plant), flight.settings.failsafe
    released = obeyed if lagging else replace(obeyed, fraction=safe)
    end = model.flown(released, model.step - held, safe, turn)[-1]
    after = flight.after(0.6, rate, held)
    for name in ('position', 'velocity', 'attitude', 'fraction', 'time'):
        np.testing.assert_allclose(getattr(after.vehicle, name), getattr(end, name), atol=1e-12)
    assert after.ticks == flight.ticks + 1
    whole, exactly = (flight.after(0.6, rate, time) for time in (np.inf, model.step))
    np.testing.assert_array_equal(exactly.vehicle.position, whole.vehicle.position)
    never = flight.after(0.6, rate, -1.0)
    assert np.any(never.vehicle.position) == bool(lagging or safe or model.translation_order == 2)


def test_a_rope_caught_before_the_vehicle_stops_is_caught():
    near = replace(retrieval(), **rope_at(0.2, 0.05), capture_radius=0.1)
    caught = departure(near).after(1.0, np.zeros(1), 0.5)
    assert caught.captured
    assert caught.missed_at == pytest.approx(0.2)
    assert not departure(near).after(1.0, np.zeros(1), 0.05).captured


@pytest.mark.parametrize('n', [2, 3])
def test_a_vehicle_that_cannot_stand_circles_without_a_command(n):
    rate = 2.0 * np.pi / (16 * 0.5)  # a circle in 16 steps
    own = {'dimension': n, 'forward': 15.0, 'step': 0.5, 'start_fraction': 0.7}
    safe = {'failsafe_fraction': 0.7, 'failsafe_rate': rate}
    flight = departure(replace(retrieval(), **own, **safe, **FAR_AWAY))
    for _ in range(16):
        flight = flight.after(0.0, np.zeros(1 if n == 2 else 3), 0.0)
        assert flight.speed == pytest.approx(0.7 * 15.0)
    np.testing.assert_allclose(flight.vehicle.position, np.zeros(n), atol=1e-9)
    np.testing.assert_allclose(flight.vehicle.attitude, np.eye(n), atol=1e-9)


def test_who_is_headed_elsewhere_has_not_caught_the_goal():
    ahead = replace(retrieval(), **rope_at(1.0, 0.0), capture_radius=0.3)
    caught = departure(ahead).after(1.0, np.zeros(1))
    assert caught.captured
    for direction, done in (((1.0, 0.0), True), ((1.0, 1.0), False), ((-1.0, 0.0), False)):
        coned = replace(ahead, approach_cone=0.5, approach_direction=direction)
        flown = departure(coned).after(1.0, np.zeros(1))
        assert flown.near
        assert flown.captured == done
    # The heading at the closest approach is one between those at the ends.
    ends, cone = (np.array([1.0, 0.0]), np.array([0.0, 1.0])), Approach(0.1, (3.0, 3.0))
    assert [is_headed(cone, ends, share) for share in (0.0, 0.5, 1.0)] == [False, True, False]
    assert [is_headed(any_axis, ends, 0.5) for any_axis in (Approach(), Approach(0.1))] == [1, 0]


# --- arrivals

AHEAD = replace(dubins(), **rope_at(3.0, 0.0), max_ticks=3, arrival_radius=0.1)


@pytest.mark.parametrize(
    ('changes', 'fractions', 'captured'),
    [
        ({}, [1.0, 1.0, 1.0], True),
        ({}, [1.0, 0.95, 0.5], True),  # 0.05 m off
        ({}, [1.0, 0.5, 0.0], False),  # too far away
        ({'arrival_speed': 0.4}, [1.0, 1.0, 0.5], False),  # too fast
        ({'arrival_speed': 0.4}, [1.0, 1.0, 0.3], True),
        (rope_at(1.0, 0.0), [1.0], False),  # at the goal, but not at the end
    ],
)
def test_an_arrival_is_judged_at_the_end_alone_by_place_and_speed(changes, fractions, captured):
    flight = departure(replace(AHEAD, **changes))
    for fraction in fractions:
        flight = flight.after(fraction, np.zeros(1))
    assert flight.captured == captured
    assert flight.over == (len(fractions) == 3)
    assert flight.speed == pytest.approx(fractions[-1])


# --- contacts with boxes and balls, and distances within fleets


def still(*bodies):
    return [MovingObstacle.drifting(body, np.zeros(body.dimension)) for body in bodies]


def box(rng, n):
    low = rng.uniform(-1.0, 1.0, n)
    return Box(low, low + rng.uniform(0.1, 1.5, n))


@pytest.mark.parametrize('n', [2, 3])
def test_a_way_touches_what_its_points_are_in(n):
    """Boxes at rest and a ball that moves, as looking often finds them."""
    rng, shares, hits = np.random.default_rng([71, n]), np.linspace(0.0, 1.0, 4001)[:, None], 0
    for _ in range(300):
        begin, end, place, velocity = rng.uniform(-2.0, 2.0, (4, n))
        axis = rng.integers(n)  # without motion along it
        end[axis] = begin[axis]
        start, stop = np.cumsum(rng.uniform(0.1, 2.0, 2))
        ball = MovingObstacle.drifting(Ball(place, rng.uniform(0.1, 1.5)), velocity)
        bodies = [*still(*(box(rng, n) for _ in range(3))), ball]
        way, times = begin + shares * (end - begin), start + shares[:, 0] * (stop - start)
        deepest = [each.body.depth(way - each.moved(times)).max() for each in bodies]
        sampled = {k for k, depth in enumerate(deepest) if depth > 0.0}
        found = touched(bodies, (begin, end), (start, stop))
        assert sampled <= found
        # A corner or a ball may be met between two samples.
        assert all(deepest[k] > -1e-3 for k in found - sampled)
        hits += len(found)
    assert hits > 40


def test_along_a_face_and_at_a_standstill():
    unit = Box(np.zeros(3), np.ones(3))
    along, inside, outside = np.array([[0.2, 0.5, 1.0], [0.8, 0.5, 1.0]]), 0.5, 1.5
    assert not touched(still(unit), along, (0.0, 1.0))
    assert touched(still(unit), [np.full(3, inside)] * 2, (0.0, 1.0)) == {0}
    assert not touched(still(unit), [np.full(3, outside)] * 2, (0.0, 1.0))


@pytest.mark.parametrize('order', [1, 2])
def test_what_a_plan_may_lead_inside_is_no_touch(order):
    """Past a moving ball and along a wall, inside by the tolerance of plans, and by more."""
    own = {'translation_order': order, 'step': 0.5, 'forward': 4.0, 'start_velocity': (4.0, 0.0)}
    unit = Problem(2, 1, order, step=0.5, forward=4.0).maps.unit
    for depth, allowed in ((0.9e-6 * unit, True), (1.1e-6 * unit, False)):
        ball, wall = (1.0, 0.3 - depth, -1.0, 0.0, 0.3), (0.5, -1.0, 1.5, depth)
        for bodies in ({'given_traffic': ball}, {'obstacles': wall}):
            flight = departure(replace(retrieval(), **own, **bodies))
            assert (flight.after(1.0, np.zeros(1)).touched == frozenset()) is allowed


def test_who_touches_traffic_has_not_caught_anything():
    """One ball crosses the path between the ends of a step, another one comes too late."""
    crossing_by, late = (0.5, 5.0, 0.0, -10.0, 0.2), (0.5, 50.0, 0.0, -10.0, 0.2)
    for traffic, numbers in ((crossing_by, {0}), (late, set()), (late + crossing_by, {1})):
        scenario = replace(retrieval(), given_traffic=traffic, capture_radius=1e6)
        flight = departure(scenario).after(1.0, np.zeros(1)).after(1.0, np.zeros(1))
        assert flight.touched == numbers  # although a step ago
        assert flight.captured == (not numbers)


def test_a_crossing_leads_from_a_ring_through_its_middle():
    fleet = [*vehicles('crossing', 8, 3).values()]
    places = np.array([each['start.position'][:2] for each in fleet])
    for each, place in zip(fleet, places, strict=True):
        goal = np.array(each['rope.center'][:2])
        assert not any((*each['rope.amplitude'], each['rope.frequency']))
        assert np.linalg.norm(place) > LEAST_RING - 1.0
        assert np.linalg.norm(0.5 * (place + goal)) < 1.0
        way = goal - place
        *_, z, w = each['start.orientation']
        assert 2.0 * math.atan2(z, w) == pytest.approx(math.atan2(way[1], way[0]))
    apart = np.linalg.norm(places[:, None] - places, axis=-1)
    assert apart[~np.eye(8, dtype=bool)].min() > 1.5
    assert vehicles('crossing', 8, 3) == vehicles('crossing', 8, 3)
    with pytest.raises(BadInput, match='vehicles'):
        vehicles('crossing', 65)


def test_vehicles_are_apart_as_looking_often_finds_them():
    rng = np.random.default_rng(92)
    for _ in range(30):
        tracks = [
            (np.cumsum(rng.uniform(0.1, 1.0, 6)), rng.uniform(-5.0, 5.0, (6, 2))) for _ in range(3)
        ]
        least = math.inf
        for i in range(3):
            for j in range(i):
                (ones, here), (others, there) = tracks[i], tracks[j]
                times = np.linspace(max(ones[0], others[0]), min(ones[-1], others[-1]), 20001)
                apart = [
                    np.interp(times, ones, a) - np.interp(times, others, b)
                    for a, b in zip(here.T, there.T, strict=True)
                ]
                least = min(least, np.hypot(*apart).min())
        known = (SimpleNamespace(times=times, positions=way) for times, way in tracks)
        times, found = separations(dict(enumerate(known)))
        assert found.keys() == {(0, 1), (0, 2), (1, 2)}
        assert {len(each) for each in found.values()} == {len(times) - 1}
        assert least - 0.01 < min(map(min, found.values())) <= least + 1e-9
    straight = np.array([0.0, 2.0])
    ways = {
        'a': SimpleNamespace(times=straight, positions=np.array([[-1.0, 0.3], [1.0, 0.3]])),
        'b': SimpleNamespace(times=straight, positions=np.array([[0.0, -1.0], [0.0, 1.0]])),
    }
    assert separations(ways)[1] == {('a', 'b'): pytest.approx(0.3 / math.sqrt(2.0))}
    ways['b'].times = straight + 3.0
    assert np.isinf(separations(ways)[1]['a', 'b']).all()


# --- events: captures, arrivals, and new goals

RADIUS, PATIENCE = 0.2, 1.5


def moving(time, x, turned=0.0):
    cosine, sine = np.cos(turned), np.sin(turned)
    attitude = np.array([[cosine, -sine], [sine, cosine]])
    return Odometry(time, np.array([x, 0.0]), attitude, np.zeros(2), np.zeros(1))


def noted(events, *places, goal=(0.0, 0.0), step=0.5, **given):
    """Return ``caught`` and ``arrived`` after measurements at places x, one per step."""
    for k, x in enumerate(places):
        events.note(moving(step * k, x), np.array(goal), RADIUS, PATIENCE, **given)
    return events.caught, events.arrived


STAYS = round(STAY / 0.5) * (0.1,)


@pytest.mark.parametrize(
    ('places', 'step', 'events'),
    [
        ((-1.0, 1.0), 0.5, (True, False)),  # passed between measurements
        ((-1.0, -0.3), 0.5, (False, False)),
        ((-1.0, 1.0), 2.0 * PATIENCE, (False, False)),  # too few measurements to tell
        ((0.1, 0.1), 2.0 * PATIENCE, (True, False)),
        (STAYS, 0.5, (True, False)),
        ((*STAYS, 0.1), 0.5, (True, True)),  # it stays long enough
        ((*STAYS, 0.1, 0.3), 0.5, (True, False)),
    ],
)
def test_what_is_passed_is_caught_and_where_it_stays_is_reached(places, step, events):
    assert noted(Events(), *places, step=step) == events


@pytest.mark.parametrize(('turned', 'caught'), [(0.0, True), (0.5, True), (0.7, False)])
def test_a_catch_is_within_the_cone_of_approach(turned, caught):
    events = Events()
    cone = Approach(0.6, (1.0, 0.0))
    for time, x in ((0.0, -1.0), (0.5, 1.0)):
        events.note(moving(time, x, turned), np.zeros(2), RADIUS, PATIENCE, cone)
    assert events.caught == caught


@pytest.mark.parametrize(
    ('goals', 'streams', 'new'),
    [
        ([(1.0, 0.0), (2.0, 0.0)], False, True),  # sent by hand
        ([(1.0, 0.0), (1.0, 0.0)], False, False),  # the same, repeated
        ([(1.0, 0.0), (1.1, 0.0), (1.2, 0.0)], True, False),  # a moving goal
        ([(1.0, 0.0), (1.0, 0.0), (4.0, 0.0)], True, True),  # a new goal, after one at rest
    ],
)
def test_which_goal_is_a_new_one(goals, streams, new):
    events = Events()
    for goal in goals[:-1]:
        events.send(np.array(goal), streams=streams)
    events.caught = True
    events.send(np.array(goals[-1]), streams=streams)
    assert events.caught != new
