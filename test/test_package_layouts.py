# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Layouts for RViz, Foxglove and PlotJuggler name topics and fields that there are."""

import json
import xml.etree.ElementTree as ElementTree
from importlib import import_module
from pathlib import Path

import pytest
import yaml

from orbimpc_ros.ros.topics import NUMBERS, TYPES

pytest.importorskip('rclpy')
CONFIG = Path(__file__).parents[1] / 'config'
SHOWS = {
    'MarkerArray': 'visualization_msgs/msg/MarkerArray',
    'Odometry': 'nav_msgs/msg/Odometry',
    'Path': 'nav_msgs/msg/Path',
    'Pose': 'geometry_msgs/msg/PoseStamped',
    'SetGoal': 'geometry_msgs/msg/PoseStamped',
}  # what RViz's displays and tools are for


def rviz():
    return yaml.safe_load((CONFIG / 'rviz' / 'retrieval.rviz').read_text())


def foxglove():
    return json.loads((CONFIG / 'foxglove' / 'retrieval.json').read_text())


def plotjuggler():
    return ElementTree.parse(CONFIG / 'plotjuggler' / 'retrieval.xml').getroot()


def of_rviz():
    """Return name and type of every topic that RViz is to show or to send."""
    manager = rviz()['Visualization Manager']
    for each in (*manager['Displays'], *manager['Tools']):
        if 'Topic' in each:
            yield each['Topic']['Value'], SHOWS[each['Class'].rpartition('/')[2]]


def require(topic, steps):
    """Fail unless a topic's type has a field at the end of a way through fields."""
    kind = TYPES[topic]
    for step in steps:
        package, _, name = kind.split('/')
        have = getattr(import_module(f'{package}.msg'), name).get_fields_and_field_types()
        assert step in have, f'{kind} has no {step}'
        found = have[step].removeprefix('sequence<').removesuffix('>')
        kind = found.replace('/', '/msg/')
    return kind


def test_rviz_shows_what_there_is():
    found = dict(of_rviz())
    assert set(found) == {'plan', 'plan_markers', 'world_markers', 'odom', 'goal'}
    for topic, kind in found.items():
        assert TYPES[topic] == kind
    displays = rviz()['Visualization Manager']['Displays']
    assert 'rviz_default_plugins/TF' in {each['Class'] for each in displays}
    assert all(each['Enabled'] for each in displays)
    assert rviz()['Visualization Manager']['Global Options']['Fixed Frame'] == 'odom'


def test_foxglove_shows_what_there_is():
    panels = foxglove()['configById']
    assert set(panels['3D!world']['topics']) == {f'/{topic}' for topic, _ in of_rviz()}
    for name, panel in panels.items():
        if name.startswith('Diagnostic'):
            assert TYPES[panel['topicToRender'][1:]] == 'diagnostic_msgs/msg/DiagnosticArray'
        for path in panel.get('paths', ()):
            topic, *steps = path['value'][1:].split('.')
            assert require(topic, steps) == 'double'
    plotted = {path['value'] for panel in panels.values() for path in panel.get('paths', ())}
    assert {f'/planner/{name}.data' for name in NUMBERS} <= plotted


def test_plotjuggler_shows_what_there_is():
    curves = [c.get(key) for c in plotjuggler().iter('curve') for key in ('curve_x', 'curve_y')]
    curves = [c for c in curves if c] + [
        c.get('name') for c in plotjuggler().iter('curve') if '[' not in c.get('name')
    ]
    for curve in curves:
        topic = max((each for each in TYPES if curve.startswith(f'/{each}/')), key=len)
        assert require(topic, curve.removeprefix(f'/{topic}/').split('/')) == 'double'
    assert {'/cmd_thrust/wrench/force/x', *(f'/planner/{n}/data' for n in NUMBERS)} <= set(curves)
