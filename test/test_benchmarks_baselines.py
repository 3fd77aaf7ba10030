# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The controllers to compare with, and the studies that they fly: laws, traffic, cones, tuning."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2, or pip install orbimpc_ros[ros]')


from benchmarks.baselines import BASELINES, baseline_named, tuned_of
from benchmarks.baselines.baseline import Baseline, Sight
from benchmarks.baselines.guidance import crabbed, sidestepped
from orbimpc_ros.mpc.problem import Ball, MovingObstacle, State
from orbimpc_ros.ros.messages import SECOND
from orbimpc_ros.ros.parameters import planner_settings
from orbimpc_ros.sim.faults import NO_FAULTS, View
from orbimpc_ros.sim.parameters import sim_settings
from orbimpc_ros.sim.world import departure
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.offline import EPOCH, aboard, closed_loop
from orbimpc_ros.tool.study import flights
from orbimpc_ros.tool.study.draws import draws_of
from orbimpc_ros.tool.study.flights import Job, flown

STEERING = [name for name in BASELINES if name != 'waypoint']
SETTINGS = {
    name: planner_settings(draws_of(name).values)
    for name in ('crossing', 'fixed_wing', 'fixed_wing_cone')
}
BOAT = SETTINGS['crossing']


def made(name, study='fixed_wing', **tuned):
    return baseline_named(name, SETTINGS[study], '', tuned)


def seeing(*hazards, goal=(25.0, 0.0), velocity=(0.0, 0.0), wind=(0.0, 0.0)):
    """The sight of a vehicle at the origin that is headed along x; the goal moves straight on."""
    state = replace(State.at(np.zeros(2), np.eye(2)), hazards=hazards)

    def ahead(times):
        return np.array(goal) + np.multiply.outer(np.asarray(times), np.array(velocity))

    return Sight(0.0, state, ahead(0.5 * np.arange(1, 13)), ahead, np.array(wind))


# --- laws


@pytest.mark.parametrize('name', STEERING)
@pytest.mark.parametrize('side', [1.0, -1.0])
def test_baselines_turn_to_the_side_of_the_goal(name, side):
    fraction, rate = made(name).steered(seeing(goal=(30.0, side * 40.0)))
    assert side * rate > 0.05
    assert 0.5 < fraction <= 1.0


def test_the_lead_is_where_both_are_at_the_same_time():
    there = seeing(goal=(60.0, 0.0), wind=(0.0, 2.0), velocity=(0.0, 7.0))
    course, fraction = made('lead')._meeting(there)
    flown = 15.0 * fraction * np.array([math.cos(course), math.sin(course)]) + [0.0, 2.0]
    closing = flown - [0.0, 7.0]
    assert closing[1] == pytest.approx(0.0, abs=0.3)
    assert closing[0] > 5.0


def test_proportional_navigation_holds_a_course_on_which_nothing_turns():
    def rate(velocity):
        return made('proportional').steered(seeing(goal=(60.0, 0.0), velocity=velocity))[1]

    assert rate((3.0, 0.0)) == pytest.approx(0.0, abs=1e-12)
    assert rate((0.0, 4.0)) > 0.0


def test_a_crabbed_course_leads_along_the_way():
    wind, way = np.array([-2.0, 4.0]), np.array([3.0, 1.0])
    course = crabbed(way, 12.0, wind)
    over_ground = 12.0 * np.array([math.cos(course), math.sin(course)]) + wind
    assert over_ground[0] * way[1] - over_ground[1] * way[0] == pytest.approx(0.0, abs=1e-9)
    assert over_ground @ way > 0.0


def test_goals_with_a_cone_of_approach_are_approached_from_behind():
    baseline = made('lead', 'fixed_wing_cone', behind=10.0)

    def aim(goal):
        return baseline._led(seeing(goal=goal)).goals[0]

    far = 10.0 * baseline.problem.step * baseline.problem.forward
    np.testing.assert_allclose(aim((-40.0, 0.0)), [-40.0 - far, 0.0])  # it is ahead of the goal
    np.testing.assert_allclose(aim((10.0, 40.0)), [10.0 - far, 40.0])  # or beside it
    np.testing.assert_allclose(aim((60.0, 8.0)), [30.0, 8.0])  # lined up: on to the line
    np.testing.assert_allclose(made('lead')._led(seeing(goal=(-40.0, 0.0))).goals[0], [-40.0, 0.0])


# --- traffic


def disc(x, y, velocity=(0.0, 0.0), radius=2.0):
    return MovingObstacle.drifting(Ball(np.array([x, y]), radius), np.array(velocity))


def test_a_sidestep_is_the_least_detour_that_is_clear():
    wanted = (0.0, 1.0)

    def stepped(*hazards):
        return sidestepped(seeing(*hazards), BOAT.problem, wanted, 0.2, 8.0)

    assert stepped(disc(8.0, 15.0)) == wanted
    heading, share = stepped(disc(9.0, -0.5))
    assert 0.1 < heading < 0.8  # past the nearer side
    assert share == 1.0
    assert stepped(disc(9.0, 0.5))[0] == pytest.approx(-heading)
    assert stepped(disc(9.0, -9.0, velocity=(0.0, 3.0)))[0] != 0.0  # it will be there
    assert stepped(disc(9.0, 9.0, velocity=(0.0, 3.0))) == wanted  # it was
    wall = [disc(5.0, y) for y in np.arange(-12.0, 13.0, 3.0)]
    assert stepped(*wall)[1] < 1.0 or abs(stepped(*wall)[0]) > 1.5


@pytest.mark.parametrize('name', STEERING)
@pytest.mark.parametrize('side', [1.0, -1.0])
def test_baselines_steer_clear_of_what_is_in_the_way(name, side):
    fraction, rate = baseline_named(name, BOAT, '').steered(seeing(disc(8.0, -0.4 * side)))
    assert side * rate > 0.02 or fraction < 0.7


def discs(name, index, seed=4):
    """Centres, velocities and radii of the bodies in a flight's traffic."""
    drawn = np.array(draws_of(name).of(seed, index)['traffic']).reshape(-1, 5)
    return drawn[:, :2], drawn[:, 2:4], drawn[:, 4]


def test_a_crossing_draws_bodies_that_come_through_and_start_clear_of_the_boat():
    ways = []
    for index in range(20):
        centres, velocities, radii = discs('crossing', index)
        assert len(radii) == 8
        assert (np.linalg.norm(centres, axis=1) > 3.0 + radii).all()
        times = np.linspace(2.0, 11.0, 200)[:, None, None]
        on_the_way = np.abs((centres + times * velocities)[..., 1]) <= 3.0
        assert on_the_way.any(axis=0).all()
        ways.append(velocities[0])
    assert np.linalg.norm(np.mean(ways, axis=0)) < 0.6  # from all sides


def test_gates_are_walls_with_a_gap():
    for index in range(10):
        centres, velocities, radii = discs('gates', index)
        assert not velocities.any()
        for x in (8.0, 17.0):
            wall = np.sort(centres[centres[:, 0] == x, 1])
            assert len(wall) == 4
            assert 3.0 <= wall[2] - wall[1] - 2.0 * radii[0] <= 4.0
            assert np.diff(wall)[[0, 2]] == pytest.approx(2.0 * radii[0])  # they touch


# --- flown in the planner's place


class Listener(Baseline):
    """Flies straight on at full speed and remembers its inputs."""

    def __init__(self, known):
        super().__init__(known, {})
        self.seen, self.late = [], []

    def steered(self, sight):
        self.seen.append(sight)
        return 1.0, 0.0

    def step(self, snapshot, now=None, late=None):
        self.late.append(late())
        return super().step(snapshot, now, late)


def flown_on(planner, values, steps, margin=0.0):
    """Fly the first steps of a flight."""
    flight = departure(sim_settings(settings.of_sim(values)).scenario)
    loop = closed_loop(planner, flight, View(NO_FAULTS, 0, 1.0), np.inf, 0, margin)
    assert len(list(itertools.islice(loop, steps))) == steps


def test_baselines_get_bodies_larger_by_the_margin_and_their_motion():
    mission, pilots = draws_of('crossing'), []
    values = mission.of(4, 0)
    planner = aboard(values, pilot=lambda known: pilots.append(Listener(known)) or pilots[0])
    flown_on(planner, values, 3, mission.margin)
    sight = pilots[0].seen[-1]
    centres, velocities, radii = discs('crossing', 0)
    assert sorted(each.body.radius for each in sight.hazards) == pytest.approx(sorted(radii + 0.3))
    for each in sight.hazards:
        own = int(np.argmin(np.abs(radii + 0.3 - each.body.radius)))
        now = sight.time - EPOCH / SECOND
        np.testing.assert_allclose(
            each.body.centre, centres[own] + now * velocities[own], atol=1e-4
        )
        np.testing.assert_allclose(each.moved(np.ones(1))[0], velocities[own], atol=1e-4)


@pytest.mark.parametrize(('hurry', 'late'), [(0.0, False), (1.0, True)])
def test_deadlines_go_by_the_given_clock(hurry, late):
    mission, pilots, ticks = draws_of('fixed_wing'), [], itertools.count()
    planner = aboard(
        mission.values,
        pilot=lambda known: pilots.append(Listener(known)) or pilots[0],
        clock=lambda: hurry * next(ticks),
    )
    flown_on(planner, mission.values, 1)
    assert pilots[0].late == [late]


def test_a_flight_ends_where_it_touches(monkeypatch):
    straight = ('traffic=[9.0, 0.0, 0.0, 0.0, 2.0]', 'start.orientation=[0.0, 0.0, 0.0, 1.0]')
    monkeypatch.setattr(flights, '_pilot', lambda job, known: Listener(known))
    draws = draws_of('crossing', straight)
    found = flown(Job('crossing', 'straight', 0, draws.of(4, 0), draws.margin))
    assert found['touched']
    assert not found['caught']
    assert found['time'] is None
    assert found['ticks'] < 10


# --- tuning


@pytest.mark.parametrize('study', ['crossing', 'fixed_wing_cone', 'gates', 'retrieval_small'])
def test_tuned_numbers_are_known_to_the_baselines(study):
    assert tuned_of(study)
    for name, numbers in tuned_of(study).items():
        assert set(numbers) <= set(BASELINES[name].TUNABLE)
