# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""What a planner publishes for whom: topics by its settings, thrust, reports with their prices."""

import json

import numpy as np
import pytest
import yaml
from harness import ROOT

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticStatus
from planners import settings
from planners import told as values_of
from scenarios import retrieval
from stepping import Stepped

from orbimpc_ros.mpc.outcome import Cause, Reason
from orbimpc_ros.mpc.plan import Command
from orbimpc_ros.mpc.problem import Floor, Problem
from orbimpc_ros.ros.messages import Frames, Stamp, header, health_message
from orbimpc_ros.ros.planner.outputs import (
    command_messages,
    outputs,
    prices,
    tick_message,
    values,
)
from orbimpc_ros.sim.vehicle import measured
from orbimpc_ros.sim.world import departure

CRAFT = {
    'dimension': 3,
    'translation_order': 2,
    'thrust_axis': 'z',
    'forward': 16.35,  # the weight is 0.6 of full thrust
    'gravity': 9.81,
    'mass': 1.5,
}
STAMP = Stamp(7, Frames('odom', 'base_link', 'z'))


def told(fraction, **given):
    command = Command(fraction, np.array([0.1, 0.2, 0.3]), np.eye(3))
    return command_messages(settings(**CRAFT, **given), STAMP, command)


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


@pytest.mark.parametrize(
    ('node', 'name', 'vehicle'),
    [('/planner', 'planner', 'none'), ('/uav1/planner', 'uav1/planner', 'uav1')],
)
def test_a_status_is_named_as_diagnostic_updater_names_it(node, name, vehicle):
    (told,) = health_message(0, node, 'condition', DiagnosticStatus.OK, 'ready', {}).status
    assert (told.name, told.hardware_id) == (f'{name}: condition', vehicle)


def test_margins_on_tick_are_those_of_the_plan_and_none_without_one():
    decision = tick(Stepped(FLOORED), [4.0, 1.0])
    told = values_of(tick_message(0, '/planner', decision))
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
    told = values_of(tick_message(0, 'planner', decision))
    assert json.loads(told['binding']) == pytest.approx(prices(decision))


def test_longer_plans_than_can_be_priced_in_time_have_none():
    assert prices(tick(Stepped(Problem(horizon=61)), FAR, 61)) == {}


def test_a_plan_that_only_stands_in_has_no_prices():
    planner = Stepped(Problem(horizon=5, terminal='constraint'))
    assert tick(planner, [4.0, 0.0]).fallback == ''
    decision = tick(planner, [50.0, 0.0])
    assert decision.fallback
    assert prices(decision) == {}


def test_a_shrinking_horizon_is_priced_as_what_is_left_of_it():
    planner = Stepped(Problem(), shrinking=True)
    for left in (5, 4, 3):
        assert list(prices(tick(planner, FAR, left))) == [f'hull@{k}' for k in range(1, left)]
