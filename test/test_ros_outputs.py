# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Outputs of a planner: topics by its settings, thrust, reports with prices, lines and markers."""

import json
import math

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticStatus
from harness import ROOT
from planners import settings
from planners import told as values_of
from scenarios import retrieval
from stepping import Stepped
from visualization_msgs.msg import Marker

from orbimpc_ros.mpc.outcome import Cause, Reason
from orbimpc_ros.mpc.plan import Command
from orbimpc_ros.mpc.problem import Box, Floor, Problem, State
from orbimpc_ros.mpc.solve.solver import Solver
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import Frames, Stamp, header, health_message, plan_markers
from orbimpc_ros.ros.planner.outputs import (
    doubts,
    outputs,
    prices,
    report_messages,
    summary,
    values,
)
from orbimpc_ros.sim.outputs import world_markers
from orbimpc_ros.sim.parameters import SimSettings
from orbimpc_ros.sim.vehicle import measured
from orbimpc_ros.sim.world import departure

CRAFT = {
    'dimension': 3,
    'translation_order': 2,
    'thrust_axis': 'z',
    'forward': 16.35,  # it hovers at 0.6 of full thrust
    'gravity': 9.81,
    'mass': 1.5,
}
STAMP = Stamp(7, Frames('odom', 'base_link', 'z'))


def told(fraction, **given):
    command = Command(fraction, np.array([0.1, 0.2, 0.3]), np.eye(3))
    return dict(messages.command_messages(settings(**CRAFT, **given), STAMP, command))


def test_topics_follow_from_what_the_vehicle_takes():
    reports = {'plan', 'plan_markers', 'tick'}
    drive = {*reports, 'cmd_vel', 'rotation'}
    assert set(outputs(settings(publish_certificate=True))) == {*drive, 'certificate'}
    assert set(outputs(settings())) == drive
    assert set(outputs(settings(**CRAFT))) == {*drive, 'cmd_thrust'}
    assert set(outputs(settings(**CRAFT, hover_thrust=0.4))) == {*drive, 'cmd_thrust', 'thrust'}
    assert set(outputs(settings(**CRAFT, hover_thrust=0.4, dry_run=True))) == reports


@pytest.mark.parametrize('hover', [0.25, 0.4, 0.6])
def test_thrust_is_the_share_at_hover_when_it_carries_the_weight_and_in_proportion(hover):
    found = told(0.6, hover_thrust=hover)
    assert found['thrust'].vector.z == pytest.approx(hover)
    assert found['cmd_thrust'].wrench.force.z == pytest.approx(1.5 * 9.81)
    assert found['thrust'].header == found['cmd_thrust'].header == header(7, 'base_link')
    assert told(0.3, hover_thrust=hover)['thrust'].vector.z == pytest.approx(0.5 * hover)
    assert told(1.0, hover_thrust=hover)['thrust'].vector.z <= 1.0
    assert 'thrust' not in told(0.6)


# --- reports

FLOORED = Problem(floor=Floor('circle', fraction=0.5))


def tick(planner, goal, horizon=5):
    """Return the decision of a planner at the start of a retrieval, for a goal at rest."""
    odometry = measured(departure(retrieval()).vehicle)
    return planner.tick(odometry, np.tile(goal, (horizon, 1)))


def ticked(decision):
    """Return the values on ``tick`` for a decision."""
    ((_, message),) = report_messages(settings(), STAMP, decision, '/planner', ['tick'])
    return values_of(message)


@pytest.mark.parametrize(
    ('node', 'name', 'vehicle'),
    [('/planner', 'planner', 'none'), ('/uav1/planner', 'uav1/planner', 'uav1')],
)
def test_a_status_is_named_as_diagnostic_updater_names_it(node, name, vehicle):
    (told,) = health_message(0, node, 'condition', DiagnosticStatus.OK, 'ready', {}).status
    assert (told.name, told.hardware_id) == (f'{name}: condition', vehicle)


def test_margins_on_tick_are_those_of_the_plan_and_none_without_one():
    decision = tick(Stepped(FLOORED), [4.0, 1.0])
    told = ticked(decision)
    margins = json.loads(told['margins'])
    fractions = decision.plan.speed_fraction[1:]
    assert margins['floor'] == pytest.approx(fractions.min() - 0.5)
    assert margins['hull'] == pytest.approx(1.0 - fractions.max(), abs=1e-6)
    safe = Stepped(FLOORED).safe(np.eye(2), Reason(Cause.ODOMETRY, 'odometry is old'))
    assert values(safe)['margins'] == {}


def test_the_aggregators_configuration_finds_every_status():
    text = (ROOT / 'config' / 'diagnostics' / 'aggregator.yaml').read_text()
    analyzers = yaml.safe_load(text)['analyzers']['ros__parameters']['orbimpc']['analyzers']
    starts = [start for each in analyzers.values() for start in each['contains']]
    for task in ('condition', 'flight'):
        name = f'uav1/{"sim" if task == "flight" else "planner"}: {task}'
        assert any(start in name for start in starts), name
    assert {each['type'] for each in analyzers.values()} == {
        'diagnostic_aggregator/GenericAnalyzer'
    }


# --- prices

FAR = [99.0, 0.0]


def test_full_speed_binds_on_the_way_to_a_far_goal_and_is_on_tick_as_json():
    decision = tick(Stepped(Problem()), FAR)
    assert list(prices(decision)) == ['hull@1', 'hull@2', 'hull@3', 'hull@4']
    told = ticked(decision)
    assert json.loads(told['binding']) == pytest.approx(prices(decision))


def test_plans_that_only_stand_in_or_are_too_long_to_be_priced_in_time_have_no_prices():
    assert prices(tick(Stepped(Problem(horizon=61)), FAR, 61)) == {}
    planner = Stepped(Problem(horizon=5, terminal='constraint'))
    assert tick(planner, [4.0, 0.0]).fallback == ''
    decision = tick(planner, [50.0, 0.0])
    assert decision.fallback
    assert prices(decision) == {}


def test_a_shrinking_horizon_is_priced_as_what_is_left_of_it():
    planner = Stepped(Problem(), shrinking=True)
    for left in (5, 4, 3):
        assert list(prices(tick(planner, FAR, left))) == [f'hull@{k}' for k in range(1, left)]


# --- the start-up line on the vehicle, and warnings on doubtful settings


HOVERING = {'dimension': 3, 'translation_order': 2, 'forward': 20.0, 'gravity': 9.81}
LANDER = {**HOVERING, 'forward': 3.6, 'gravity': 1.62, 'tilt': 0.2618, 'glide_slope': 0.8727}
STOPPED = {'floor.shape': 'circle', 'floor.fraction': 0.6, 'safe_command': 'stop'}
WING = {**STOPPED, 'wind': (3.0, 4.0), 'velocity_source': 'air', 'sideslip': True,
        'discretisation': 'exact', 'goal_timeout': -1.0}  # fmt: skip
STEPS = ', 1 s x 5, 3D, rotation order 1, translation order 2, planned every step, system time, '
STEPS += 'goals stale after 1.5 s once they stream, safe command '


@pytest.mark.parametrize(
    ('changes', 'line'),
    [
        (WING, '1 m/s, at least 0.6 m/s (circle), wind (3, 4) m/s, 5 m/s in all: too much to stay '
         'at a goal, odometry through the air, with sideslip, 1 s x 5, integrated exactly, 2D, '
         'rotation order 1, translation order 1, planned every step, system time, goals never '
         'stale, safe command stop although that is below the floor'),
        ({**HOVERING, 'thrust_axis': 'z', 'hover_thrust': 0.4},
         '20 m/s^2, 1 kg, gravity 9.81 m/s^2: hovers at 0.491 of its thrust, sent as 0.4 on thrust'
         f'{STEPS}hover'),
        ({**HOVERING, **STOPPED},
         '20 m/s^2, 1 kg, at least 12 m/s^2 (circle), gravity 9.81 m/s^2: cannot hover: its least '
         f'thrust is 12{STEPS}stop although the vehicle then falls'),
        ({**LANDER, 'wind': (0.6, 0.0, 0.0)},
         '3.6 m/s^2, 1 kg, tilted by at most 15 deg, above a glide slope of 50 deg, gravity 1.62 '
         'm/s^2: hovers at 0.45 of its thrust, wind (0.6, 0, 0) m/s^2, staying at a goal takes a '
         f'tilt of 20.32 deg: more than allowed{STEPS}hover'),
    ],
)  # fmt: skip
def test_the_start_up_line_says_what_moves_the_vehicle(changes, line):
    assert summary(settings(**changes), simulated=False) == line


THRUST = {'translation_order': 2, 'dimension': 3, 'thrust_axis': 'z'}
TORQUE = {'translation_order': 2, 'dimension': 3, 'rotation_order': 2}
CIRCLING = {'step': 0.5, 'max_rate': math.radians(25.0), 'floor.shape': 'circle'}
EFFECT = 'has no effect with'
DOUBTS = [
    ({'max_rate': 25.0}, 'max_rate is 25 rad/s, 1432 deg/s: 0.4363 rad/s if 25 deg/s is meant'),
    ({'max_rate': 3.0}, ''),
    ({'approach.cone': 0.5}, f'approach.cone 0.5 {EFFECT} objective track'),
    ({'approach.cone': 0.5, 'objective': 'intercept'}, ''),
    ({'floor.fraction': 0.9}, f'floor.fraction 0.9 {EFFECT} floor.shape none'),
    (CIRCLING | {'horizon': 15, 'floor.faces': 8},
     f'floor.faces 8 {EFFECT} floor.shape circle'),
    ({'floor.fraction': Floor().fraction}, ''),  # as in a file of all defaults
    ({'floor.faces': 8, 'floor.shape': 'polygon'}, ''),
    # Values that only the vehicle's maker knows are asked for.
    (THRUST, 'max_rate is not given'),
    *((THRUST | {'max_rate': known}, '') for known in (3.84, 0.0)),
    (TORQUE, 'response.speed and response.rate are not given'),
    *((TORQUE | {'response.rate': known}, '') for known in (0.0, 0.001)),
    # A horizon may be too short to turn round; interception looks beyond it.
    (CIRCLING | {'horizon': 10}, 'within 5 s of horizon the vehicle turns by at most 125 deg'),
    (CIRCLING | {'horizon': 10}, 'half a turn takes a horizon of 15'),
    (CIRCLING | {'horizon': 10, 'max_rate': 5e-324}, 'takes a horizon of 3.141593e+300'),
    (CIRCLING | {'horizon': 15}, ''),
    (CIRCLING | {'horizon': 10, 'floor.shape': 'none'}, ''),
    (CIRCLING | {'horizon': 10, 'objective': 'intercept'}, ''),
]  # fmt: skip


@pytest.mark.parametrize(('given', 'doubt'), DOUBTS)
def test_what_is_hardly_meant_is_doubted(given, doubt):
    found = doubts(settings(**{'step': 0.1} | given), given)
    assert [doubt in each for each in found] == [True] * bool(doubt)


# --- markers: the plan, thrust, floor and obstacles in place, and no leftovers


AT = Stamp(1_500_000_000, Frames('odom', 'base_link'))


def solved(dimension, **changes):
    """Return a problem of five steps and its plan from the origin."""
    problem = Problem(dimension=dimension, horizon=5, forward=2.0, step=0.5, **changes)
    goal = np.full(dimension, 3.0)
    state = State.at(np.zeros(dimension), np.eye(dimension))
    return problem, Solver(problem).solve(state, np.tile(goal, (5, 1)))


def shown(array):
    """Return the added markers, by namespace."""
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
    return problem, plan, plan_markers(AT, problem, plan)


def test_the_line_is_the_plan_and_nothing_is_left_of_before(drawn):
    _, plan, array = drawn
    first, *others = array.markers
    assert first.action == Marker.DELETEALL
    assert {marker.action for marker in others} == {Marker.ADD}
    assert len({(marker.ns, marker.id) for marker in others}) == len(others)
    for marker in array.markers:
        assert messages.nanoseconds(marker.header.stamp, '') == AT.nanoseconds
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
    found = shown(plan_markers(AT, *solved(2, obstacles=(box,))))
    assert 'floor' not in found
    (cube,) = found['obstacles']
    assert np.allclose(place(cube.pose.position)[:2], box.centre)


def test_the_world_shows_rope_reach_and_vehicle():
    flight = departure(SimSettings())
    found = shown(world_markers(AT, flight))
    ball, swing = found['rope']
    assert np.allclose(place(ball.pose.position)[: len(flight.goal)], flight.goal)
    assert ball.scale.x == pytest.approx(2 * flight.settings.capture_radius)
    assert np.allclose(place(swing.points[1]), place(ball.pose.position))
    (vehicle,) = found['vehicle']
    position = flight.vehicle.position
    assert np.allclose(place(vehicle.pose.position)[: len(position)], position)
