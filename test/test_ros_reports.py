# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Reports as those read them who gather them: diagnostic_aggregator's analyzers, and monitors."""

import json

import numpy as np
import pytest

pytest.importorskip('rclpy')

import yaml
from conftest import ROOT
from diagnostic_msgs.msg import DiagnosticStatus
from scenarios import retrieval
from stepping import Stepped

from orbimpc_ros.mpc.outcome import Cause, Reason
from orbimpc_ros.mpc.problem import Floor, Problem
from orbimpc_ros.ros.reports import Report, health_message, tick_message
from orbimpc_ros.sim.vehicle import measured
from orbimpc_ros.sim.world import departure

GOALS = np.tile([4.0, 1.0], (5, 1))
PROBLEM = Problem(floor=Floor('circle', fraction=0.5))


def planned():
    return Stepped(PROBLEM).tick(measured(departure(retrieval()).vehicle), GOALS)


@pytest.mark.parametrize(
    ('node', 'name', 'vehicle'),
    [('/planner', 'planner', 'none'), ('/uav1/planner', 'uav1/planner', 'uav1')],
)
def test_a_status_is_named_as_diagnostic_updater_names_it(node, name, vehicle):
    (told,) = health_message(0, node, 'condition', DiagnosticStatus.OK, 'ready', {}).status
    assert (told.name, told.hardware_id) == (f'{name}: condition', vehicle)


def test_margins_on_tick_are_those_of_the_plan_and_none_without_one():
    report = Report(planned())
    told = {each.key: each.value for each in tick_message(0, '/planner', report).status[0].values}
    margins = json.loads(told['margins'])
    fractions = report.decision.plan.speed_fraction[1:]
    assert margins['floor'] == pytest.approx(fractions.min() - 0.5)
    assert margins['hull'] == pytest.approx(1.0 - fractions.max(), abs=1e-6)
    safe = Stepped(PROBLEM).safe(np.eye(2), Reason(Cause.ODOMETRY, 'odometry is old'))
    assert Report(safe).values['margins'] == {}


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
