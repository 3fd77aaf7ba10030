# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Crossing vehicles in lock-step, without nodes, keep the required distance.

``ORBIMPC_SEEDS=1000:1100 pytest test/test_ros_crossing.py`` flies other crossings.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from problems import seeds

from orbimpc_ros.loop.goal.motion import GoalObservation
from orbimpc_ros.mpc.plan import stop
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.ros.parameters.planner import planner_settings
from orbimpc_ros.ros.planner.outputs import obeyed
from orbimpc_ros.sim.parameters import sim_settings
from orbimpc_ros.sim.vehicle import measured
from orbimpc_ros.sim.world import departure
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.bags import fields
from orbimpc_ros.tool.demo import fleet
from orbimpc_ros.tool.history import separations
from orbimpc_ros.tool.offline import OfflinePlanner

SHORT = ('horizon=4', 'gap_tolerance=0.05', 'max_ticks=15')  # until after the middle of the ring
RADIUS = 1.0


def crossing(count, seed, changes=()):
    """Return the parameters of a crossing's vehicles, by namespace."""
    values, own = fleet(count, [*changes, f'seed={seed}'], 'crossing')
    return {name: values | each for name, each in own.items()}


def flown(values):
    """Fly a crossing; return the least distance of any two vehicles [m], and the fallbacks.

    Planners answer one after the other and receive each other's plans.
    """
    flights = {n: departure(sim_settings(settings.of_sim(v))) for n, v in values.items()}
    planners = {n: OfflinePlanner(planner_settings(v), f'{n}/planner') for n, v in values.items()}
    tracks, fallbacks = {name: [flight] for name, flight in flights.items()}, []
    for _ in range(min(each.settings.max_ticks for each in flights.values())):
        for name, flight in flights.items():
            planner, now = planners[name], flight.vehicle.time
            planner.sense(now, GoalObservation(now, flight.goal))
            planner.sense(now, measured(flight.vehicle))
            decision = planner.report(now)
            said, command = planner.messages(decision, planner.stamp), decision.command
            for other in planners.values():
                if 'plan' in said and f'{name}/plan' in other.inputs.others:
                    other.hear(f'{name}/plan', said['plan'], now)
            flights[name] = flight.after(command.speed_fraction, command.body_rate)
            tracks[name].append(flights[name])
            fallbacks.append(fields(said['tick'])['fallback'])
    places = {}
    for name, each in tracks.items():
        times, way = zip(*((f.vehicle.time, f.vehicle.position) for f in each), strict=True)
        places[name] = SimpleNamespace(times=np.array(times), positions=np.array(way))
    return min(map(min, separations(places)[1].values())), fallbacks


@pytest.mark.parametrize('seed', seeds(5))
def test_three_vehicles_keep_their_distance_in_the_middle_of_the_ring(seed):
    apart, fallbacks = flown(crossing(3, seed, SHORT))
    assert RADIUS <= apart <= RADIUS + 0.1  # and keep no more distance than necessary
    assert not any(fallbacks)


def test_without_plans_to_avoid_they_would_not():
    assert flown(crossing(3, 5, (*SHORT, 'avoid=[]')))[0] < 0.9 * RADIUS


def test_who_has_no_plan_says_where_its_safe_command_leads():
    problem = Problem(horizon=3)
    state = State.at(np.array([1.0, 2.0]), 0.5 * np.eye(2), attitude=np.eye(2))
    led = obeyed(problem, state, stop(np.eye(2)))
    # In the model this step is still flown at the old speed.
    expected = [[1.0, 2.0], [1.5, 2.0], [1.5, 2.0], [1.5, 2.0]]
    np.testing.assert_allclose([place for place, _ in led], expected)


def test_a_fleet_is_told_its_own_plans_alone():
    own = crossing(3, 5)
    assert {each['avoid'] for each in own.values()} == {('/uav1/plan', '/uav2/plan', '/uav3/plan')}
