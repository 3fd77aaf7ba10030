# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Markers: the plan, its thrust, floor and obstacles where they are; nothing left of before."""

import numpy as np
import pytest

from orbimpc_ros.mpc.problem import Box, Floor, Problem, State
from orbimpc_ros.mpc.solve.solver import Solver

pytest.importorskip('visualization_msgs')
from visualization_msgs.msg import Marker

from orbimpc_ros.ros import messages
from orbimpc_ros.ros.markers import plan_markers
from orbimpc_ros.ros.messages import Frames, Stamp
from orbimpc_ros.sim.outputs import world_markers
from orbimpc_ros.sim.parameters import SIM, sim_settings
from orbimpc_ros.sim.world import departure

STAMP = Stamp(1_500_000_000, Frames('odom', 'base_link'))


def solved(dimension, **changes):
    """Return a problem of five steps and its plan from the origin."""
    problem = Problem(dimension=dimension, horizon=5, forward=2.0, step=0.5, **changes)
    goal = np.full(dimension, 3.0)
    state = State.at(np.zeros(dimension), np.eye(dimension))
    return problem, Solver(problem).solve(state, np.tile(goal, (5, 1)))


def shown(array):
    """Return what is added, by namespace."""
    found = {}
    for marker in array.markers:
        if marker.action == Marker.ADD:
            found.setdefault(marker.ns, []).append(marker)
    return found


def place(vector):
    return np.array([vector.x, vector.y, vector.z])


def padded(points):
    return np.pad(points, ((0, 0), (0, 3 - points.shape[1])))


@pytest.fixture(scope='module', params=[2, 3])
def drawn(request):
    faces = {2: 4, 3: 6}[request.param]
    problem, plan = solved(request.param, floor=Floor('polygon', faces, 0.5))
    return problem, plan, plan_markers(STAMP, problem, plan)


def test_the_line_is_the_plan_and_nothing_is_left_of_before(drawn):
    _, plan, array = drawn
    first, *others = array.markers
    assert first.action == Marker.DELETEALL
    assert {marker.action for marker in others} == {Marker.ADD}
    assert len({(marker.ns, marker.id) for marker in others}) == len(others)
    for marker in array.markers:
        assert messages.nanoseconds(marker.header.stamp, '') == STAMP.nanoseconds
        assert marker.header.frame_id == 'odom'
    (line,) = shown(array)['plan']
    assert np.allclose([place(p) for p in line.points], padded(plan.positions))


def test_arrows_point_along_the_thrust_and_are_as_long_as_it_is_strong(drawn):
    problem, plan, array = drawn
    arrows = shown(array)['thrust']
    assert len(arrows) == plan.horizon + 1
    for k, arrow in enumerate(arrows):
        assert np.allclose(place(arrow.pose.position), padded(plan.positions)[k])
        q = arrow.pose.orientation
        nose = [1 - 2 * (q.y**2 + q.z**2), 2 * (q.x * q.y + q.w * q.z), 2 * (q.x * q.z - q.w * q.y)]
        assert np.allclose(nose[: problem.dimension], plan.projected[k][:, 0], atol=1e-6)
        full = 0.5 * problem.forward * problem.step
        assert arrow.scale.x == pytest.approx(max(1e-3, full * plan.speed_fraction[k]))


def test_the_floor_is_what_a_slower_step_would_reach(drawn):
    problem, plan, array = drawn
    (floor,) = shown(array)['floor']
    assert floor.type == Marker.LINE_LIST
    assert np.allclose(place(floor.pose.position), padded(plan.positions)[0])
    reach = problem.forward * problem.step * problem.floor.fraction
    corners = np.array([place(p) for p in floor.points])[:, : problem.dimension]
    assert len(corners) == {2: 8, 3: 24}[problem.dimension]
    assert np.allclose(np.abs(corners).max(axis=1), reach)


def test_obstacles_fill_their_boxes_and_without_a_floor_there_is_none():
    box = Box([1.0, -2.0], [2.0, -1.0])
    found = shown(plan_markers(STAMP, *solved(2, obstacles=(box,))))
    assert 'floor' not in found
    (cube,) = found['obstacles']
    half = 0.5 * place(cube.scale)
    assert np.allclose((place(cube.pose.position) - half)[:2], box.minimum)
    assert np.allclose((place(cube.pose.position) + half)[:2], box.maximum)


def test_the_world_shows_rope_reach_and_vehicle():
    flight = departure(sim_settings({row.name: row.default for row in SIM}).scenario)
    found = shown(world_markers(STAMP, flight))
    ball, swing = found['rope']
    assert np.allclose(place(ball.pose.position)[: len(flight.goal)], flight.goal)
    assert ball.scale.x == pytest.approx(2 * flight.scenario.capture_radius)
    assert np.allclose(place(swing.points[1]), place(ball.pose.position))
    (vehicle,) = found['vehicle']
    position = flight.vehicle.position
    assert np.allclose(place(vehicle.pose.position)[: len(position)], position)
