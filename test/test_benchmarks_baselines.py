# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The baseline controllers, and the studies that they fly: laws, traffic, margins, deadlines."""

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.baselines import BASELINES, baseline_named
from benchmarks.baselines.baseline import Baseline, Sight
from orbimpc_ros.mpc.plan import Command
from orbimpc_ros.mpc.problem import Ball, MovingObstacle, State
from orbimpc_ros.ros.messages import SECOND
from orbimpc_ros.ros.parameters.planner import planner_settings
from orbimpc_ros.sim.parameters import sim_settings
from orbimpc_ros.tool import offline, settings
from orbimpc_ros.tool.offline import OfflinePlanner, closed_loop, flown
from orbimpc_ros.tool.study import draws_of

STEERING = [name for name in BASELINES if name != 'waypoint']
SETTINGS = {
    name: planner_settings(draws_of(name).values)
    for name in ('crossing', 'fixed_wing', 'fixed_wing_cone')
}
BOAT = SETTINGS['crossing']


def made(name, study='fixed_wing', **tuned):
    return BASELINES[name](SETTINGS[study], tuned)


def seeing(*hazards, goal=(25.0, 0.0), velocity=(0.0, 0.0), wind=(0.0, 0.0)):
    """Return the sight of a vehicle at the origin heading along x; the goal moves straight on."""
    state = replace(State.at(np.zeros(2), np.eye(2)), hazards=hazards)

    def ahead(times):
        return np.array(goal) + np.multiply.outer(np.asarray(times), np.array(velocity))

    return Sight(0.0, state, ahead, np.array(wind))


# --- laws


@pytest.mark.parametrize('name', STEERING)
@pytest.mark.parametrize('side', [1.0, -1.0])
def test_baselines_turn_to_the_side_of_the_goal(name, side):
    command = made(name).steered(seeing(goal=(30.0, side * 40.0)))
    assert side * command.body_rate[0] > 0.05
    assert 0.5 < command.speed_fraction <= 1.0


# --- traffic


def disc(x, y, velocity=(0.0, 0.0), radius=2.0):
    return MovingObstacle.drifting(Ball(np.array([x, y]), radius), np.array(velocity))


@pytest.mark.parametrize('name', STEERING)
@pytest.mark.parametrize('side', [1.0, -1.0])
def test_baselines_steer_clear_of_what_is_in_the_way(name, side):
    command = baseline_named(name, BOAT, '').steered(seeing(disc(8.0, -0.4 * side)))
    assert side * command.body_rate[0] > 0.02 or command.speed_fraction < 0.7


# --- flown in the planner's place


class Listener(Baseline):
    """Flies straight on at full speed and records its inputs."""

    wanted = None

    def __init__(self, known):
        super().__init__(known, {})
        self.seen, self.late = [], []

    def steered(self, sight):
        self.seen.append(sight)
        return Command(1.0, np.zeros(1), sight.state.attitude)

    def step(self, snapshot, now=None, late=None):
        self.late.append(late())
        return super().step(snapshot, now, late)


def flown_on(values, steps, clock=None):
    """Return a baseline that has flown the first steps of a flight."""
    known = planner_settings(values)
    pilot = Listener(known)
    planner = OfflinePlanner(known, clock=clock, planner=pilot)
    loop = closed_loop(planner, sim_settings(settings.of_sim(values)))
    assert len(list(itertools.islice(loop, steps))) == steps
    return pilot


def test_baselines_get_bodies_larger_by_the_margin_and_their_motion():
    values = draws_of('crossing').of(4, 0)
    pilot = flown_on(values, 3)
    time, state, *_ = pilot.seen[-1]
    drawn = np.array(values['traffic']).reshape(-1, 5)
    centres, velocities, radii = drawn[:, :2], drawn[:, 2:4], drawn[:, 4]
    assert sorted(each.body.radius for each in state.hazards) == pytest.approx(sorted(radii + 0.3))
    for each in state.hazards:
        own = int(np.argmin(np.abs(radii + 0.3 - each.body.radius)))
        now = time - OfflinePlanner.epoch / SECOND
        np.testing.assert_allclose(
            each.body.centre, centres[own] + now * velocities[own], atol=1e-4
        )
        np.testing.assert_allclose(each.moved(np.ones(1))[0], velocities[own], atol=1e-4)


@pytest.mark.parametrize(('hurry', 'late'), [(0.0, False), (1.0, True)])
def test_deadlines_go_by_the_given_clock(hurry, late):
    ticks = itertools.count()
    pilot = flown_on(draws_of('fixed_wing').values, 1, lambda: hurry * next(ticks))
    assert pilot.late == [late]


def test_a_flight_ends_where_it_touches(monkeypatch):
    straight = ('traffic=[9.0, 0.0, 0.0, 0.0, 2.0]', 'start.orientation=[0.0, 0.0, 0.0, 1.0]')
    given = SimpleNamespace(baseline_named=lambda _name, known, _study: Listener(known))
    monkeypatch.setattr(offline, 'baselines', lambda: given)
    draws = draws_of('crossing', straight)
    found = flown('crossing', 'straight', 0, draws.of(4, 0))
    assert found['touched']
    assert not found['caught']
    assert found['time'] is None
    assert found['ticks'] < 10
