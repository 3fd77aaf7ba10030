# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Studies in traffic and with cones of approach: what is drawn and told, and who does what."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2, or pip install orbimpc_ros[ros]')

from benchmarks.baselines import baseline_named
from benchmarks.baselines.baseline import Baseline, Sight, depths
from benchmarks.baselines.sidestep import sidestepped
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.problem import Ball, Box, MovingObstacle, State
from orbimpc_ros.ros.messages import SECOND
from orbimpc_ros.ros.parameters import planner_settings
from orbimpc_ros.sim.parameters import sim_settings
from orbimpc_ros.sim.world import departure
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.offline import EPOCH, aboard, tell
from orbimpc_ros.tool.study import flights
from orbimpc_ros.tool.study.draws import draws_of
from orbimpc_ros.tool.study.flights import Job, flown

BOAT = planner_settings(draws_of('crossing').values)
SPEED = BOAT.problem.forward


def discs(name, index, seed=4):
    """Centres, velocities and radii of what a flight meets."""
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


class Listener(Baseline):
    """Flies straight on at full speed and remembers what it saw."""

    def __init__(self, known):
        super().__init__(known, {})
        self.seen, self.late = [], []

    def steered(self, sight):
        self.seen.append(sight)
        return 1.0, 0.0

    def step(self, snapshot, now=None, late=None):
        self.late.append(late())
        return super().step(snapshot, now, late)


def test_pilots_are_told_of_bodies_by_the_margin_larger_and_learn_how_they_move():
    mission, made = draws_of('crossing'), []
    values = mission.of(4, 0)
    planner = aboard(values, pilot=lambda known: made.append(Listener(known)) or made[0])
    flight = departure(sim_settings(settings.of_sim(values)).scenario)
    for _ in range(3):
        tell(planner, flight, 0, mission.margin)
        command = planner.report(flight.vehicle.time).decision.command
        flight = flight.after(command.speed_fraction, command.body_rate)
    sight = made[0].seen[-1]
    centres, velocities, radii = discs('crossing', 0)
    assert sorted(each.body.radius for each in sight.hazards) == pytest.approx(sorted(radii + 0.3))
    for each in sight.hazards:
        own = int(np.argmin(np.abs(radii + 0.3 - each.body.radius)))
        now = sight.time - EPOCH / SECOND
        np.testing.assert_allclose(
            each.body.centre, centres[own] + now * velocities[own], atol=1e-4
        )
        np.testing.assert_allclose(each.moved(np.ones(1))[0], velocities[own], atol=1e-4)


def test_deadlines_go_by_the_clock_that_is_given():
    mission = draws_of('fixed_wing')
    flight = departure(sim_settings(settings.of_sim(mission.values)).scenario)
    for hurry, late in ((0.0, False), (1.0, True)):
        made, ticks = [], itertools.count()
        planner = aboard(
            mission.values,
            pilot=lambda known, made=made: made.append(Listener(known)) or made[0],
            clock=lambda ticks=ticks, hurry=hurry: hurry * next(ticks),
        )
        tell(planner, flight, 0)
        planner.report(flight.vehicle.time)
        assert made[0].late == [late]


def test_a_flight_ends_where_it_touches(monkeypatch):
    straight = ('traffic=[9.0, 0.0, 0.0, 0.0, 2.0]', 'start.orientation=[0.0, 0.0, 0.0, 1.0]')
    monkeypatch.setattr(flights, '_pilot', lambda job, known: Listener(known))
    draws = draws_of('crossing', straight)
    found = flown(Job('crossing', 'straight', 0, draws.of(4, 0), draws.margin))
    assert found['touched']
    assert not found['caught']
    assert found['time'] is None
    assert found['ticks'] < 10


def seeing(*hazards, goal=(25.0, 0.0), heading=0.0, steps=12):
    """The sight of a boat at the origin, at full speed, of a goal that stands."""
    attitude = exp(np.array([heading]))
    state = replace(State.at(np.zeros(2), attitude), hazards=hazards)

    def ahead(times):
        return np.tile(goal, (len(np.atleast_1d(times)), 1))

    return Sight(0.0, state, ahead(np.ones(steps)), ahead, np.zeros(2))


def disc(x, y, velocity=(0.0, 0.0), radius=2.0):
    return MovingObstacle.drifting(Ball(np.array([x, y]), radius), np.array(velocity))


def test_depths_are_those_of_the_deepest_body_at_each_time():
    rng, times = np.random.default_rng(5), np.array([0.0, 0.7, 2.0])
    corner = rng.uniform(-1.0, 1.0, 2)
    bodies = Ball(rng.normal(size=2), 1.5), Box(corner, corner + 1.0)
    hazards = [MovingObstacle.drifting(body, rng.normal(size=2)) for body in bodies]
    paths = rng.normal(scale=2.0, size=(30, 3, 2))
    found = depths(hazards, paths, times)
    for m, k in itertools.product(range(30), range(3)):
        each = [
            hazard.body.depth((paths[m, k] - hazard.moved(times[k : k + 1])[0])[None])[0]
            for hazard in hazards
        ]
        assert found[m, k] == pytest.approx(max(each))


def test_a_sidestep_is_the_least_detour_that_is_clear():
    wanted = (0.0, 1.0)

    def stepped(*hazards):
        return sidestepped(seeing(*hazards), BOAT.problem, wanted, 0.2, 8.0)

    assert stepped() == wanted
    assert stepped(disc(8.0, 15.0)) == wanted
    heading, share = stepped(disc(9.0, -0.5))
    assert 0.1 < heading < 0.8  # past the nearer side
    assert share == 1.0
    assert stepped(disc(9.0, 0.5))[0] == pytest.approx(-heading)
    assert stepped(disc(9.0, -9.0, velocity=(0.0, 3.0)))[0] != 0.0  # it will be there
    assert stepped(disc(9.0, 9.0, velocity=(0.0, 3.0))) == wanted  # it was
    wall = [disc(5.0, y) for y in np.arange(-12.0, 13.0, 3.0)]
    assert stepped(*wall)[1] < 1.0 or abs(stepped(*wall)[0]) > 1.5


@pytest.mark.parametrize('name', ['pursuit', 'lead', 'proportional', 'sampling'])
def test_baselines_steer_clear_of_what_is_in_the_way(name):
    for side in (1.0, -1.0):
        baseline = baseline_named(name, BOAT, '')
        for _ in range(6):  # some improve from tick to tick
            fraction, rate = baseline.steered(seeing(disc(8.0, -0.4 * side)))
        assert side * rate > 0.02 or fraction < 0.7


@pytest.mark.parametrize(('name', 'most'), [('linearised', 0.5), ('nonlinear', 0.02)])
def test_programs_keep_out_of_balls_that_move(name, most):
    """One to first order, from tick to tick, the other one to the end of its step."""
    if name == 'nonlinear':
        pytest.importorskip('casadi')
    program, body = baseline_named(name, BOAT, '')._program, disc(9.0, -1.5, velocity=(0.0, 0.3))
    times, found = BOAT.problem.step * np.arange(1, 13), np.tile([1.0, 0.0], (12, 1))
    program.shifted = lambda state: found
    deepest = []
    for sight in (seeing(), seeing(body)):
        for _ in range(6):
            plan = program.plan(sight.state, sight.goals)
            found = plan.rotations[1:, :, 0]
        deepest.append(depths([body], plan.positions[None, 1:], times).max())
    assert deepest[0] > 1.0
    assert deepest[1] < most


def test_programs_take_no_boxes_that_move():
    box = MovingObstacle.drifting(Box(np.ones(2), 2.0 * np.ones(2)), np.zeros(2))
    with pytest.raises(BadInput, match='balls for a baseline'):
        baseline_named('linearised', BOAT, '').steered(seeing(box))


def test_goals_with_a_cone_of_approach_are_come_to_from_behind():
    known = planner_settings(draws_of('fixed_wing_cone').values)
    baseline = baseline_named('lead', known, '', {'behind': 10.0})

    def aim(goal):
        return baseline._led(seeing(goal=goal)).goals[0]

    far = 10.0 * known.problem.step * known.problem.forward
    np.testing.assert_allclose(aim((-40.0, 0.0)), [-40.0 - far, 0.0])  # it is ahead of the goal
    np.testing.assert_allclose(aim((10.0, 40.0)), [10.0 - far, 40.0])  # or beside it
    np.testing.assert_allclose(aim((60.0, 8.0)), [30.0, 8.0])  # lined up: on to the line
    other = baseline_named('lead', planner_settings(draws_of('fixed_wing').values), '')
    np.testing.assert_allclose(other._led(seeing(goal=(-40.0, 0.0))).goals[0], [-40.0, 0.0])


def test_samples_count_a_catch_only_inside_the_cone():
    known = planner_settings(draws_of('fixed_wing_cone').values)
    baseline, straight = baseline_named('sampling', known, ''), np.tile([1.0, 0.0], (1, 12, 1))
    costs = [
        float(baseline._costs(seeing(goal=goal, heading=heading), straight)[0])
        for goal, heading in (((40.0, 0.0), 0.0), ((0.0, 40.0), 0.5 * math.pi))
    ]
    assert costs[1] - costs[0] > 5.0  # as many steps as are left after the catch
