# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The documentation is true: tables, links, commands; CI runs it by pages.py, tested here.

Layouts for RViz, Foxglove and PlotJuggler name existing topics and fields.
"""

import importlib.util
import json
import re
import runpy
import xml.etree.ElementTree as ElementTree
from importlib import import_module

import pages
import pytest
import yaml
from harness import ROOT

from orbimpc_ros.ros.topics import NUMBERS, TYPES
from orbimpc_ros.tool import cli
from orbimpc_ros.tool.cli import _parser

DOCS = ROOT / 'docs'
PAGES = [*sorted(DOCS.glob('*.md')), ROOT / 'README.md', ROOT / 'CONTRIBUTING.md']
LINK = re.compile(r'\]\((?!https?:)([^)#]*)(#[^)]+)?\)|(?:src|srcset)="([^"]+)"')


def test_the_parameters_are_those_of_the_nodes():
    pytest.importorskip('rclpy')
    page = runpy.run_path(str(DOCS / 'parameters.py'))['page']
    assert (DOCS / 'parameters.md').read_text() == page(), 'make docs'


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    for linked, anchor, picture in LINK.findall(page.read_text()):
        target = page.parent / (linked or picture) if linked or picture else page
        assert target.is_file(), f'{page.name}: {target}'
        assert not anchor or anchor in anchors(target), f'{page.name}: {anchor}'


def anchors(page):
    """Return the anchors of a page's headings, as GitHub forms them."""
    headings = re.findall(r'^#+ (.*)$', page.read_text(), re.MULTILINE)
    return {'#' + re.sub(r'[^\w\- ]', '', each.lower()).replace(' ', '-') for each in headings}


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_commands_of_the_tool_exist(page):
    found = pages.blocks_of(page.read_text())
    joined = (each.text.replace('\\\n', ' ') for each in found if each.language == 'sh')
    for line in (line for text in joined for line in text.splitlines()):
        words = line.partition('#')[0].removeprefix('ros2 run orbimpc_ros ').split()
        if words[:1] == ['orbimpc']:
            assert words[1] in cli.COMMANDS
            _parser(words[1:]).parse_args(words[1:])


def test_the_pictures_can_still_be_drawn():
    from orbimpc_ros.tool.plot import look

    spec = importlib.util.spec_from_file_location('pictures', DOCS / 'pictures.py')
    pictures = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(pictures)
    for name, draw in pictures.PICTURES.items():
        with look():
            assert draw().axes, name
        for look_of in (name, f'{name}-dark'):
            assert f'pictures/{look_of}.png' in (DOCS / 'concepts.md').read_text()


def test_every_command_of_the_pages_is_followed_or_left_out_for_a_reason():
    followed = [b for page in pages.PAGES for b in pages.blocks_of((ROOT / page).read_text())]
    named = {block.file for block in followed} - {''}
    assert named == {'wing.yaml', 'problem.yaml', 'boat.py', 'boat.yaml'}
    assert all(block.output for block in followed if block.language == 'python' and not block.file)
    (rope,) = (b for b in followed if b.output and 'captured at' in ' '.join(b.output))
    assert 'make demo' in rope.text


def test_pages_that_configurations_refer_to_exist():
    for file in (ROOT / 'config').glob('*.yaml'):
        for named in re.findall(r'docs/[\w/]+\.\w+', file.read_text()):
            assert (ROOT / named).is_file(), (file, named)


def test_the_code_names_sections_of_the_mathematics_that_exist():
    page = (DOCS / 'mathematics.md').read_text()
    known = set(re.findall(r'^##+ ([0-9.]+?)\.? ', page, re.MULTILINE))
    named = {
        (file.name, number)
        for file in (ROOT / 'orbimpc_ros').rglob('*.py')
        for line in re.findall(r'mathematics\.md, ([^\n]*)', file.read_text())
        for number in re.findall(r'[0-9]+(?:\.[0-9]+)?', line)
    }
    assert len(named) > 40
    assert {each for each in named if each[1] not in known} == set()


# --- layouts

CONFIG = ROOT / 'config'
RVIZ = yaml.safe_load((CONFIG / 'rviz' / 'retrieval.rviz').read_text())['Visualization Manager']
SHOWS = {
    'MarkerArray': 'visualization_msgs/msg/MarkerArray',
    'Odometry': 'nav_msgs/msg/Odometry',
    'Path': 'nav_msgs/msg/Path',
    'Pose': 'geometry_msgs/msg/PoseStamped',
    'SetGoal': 'geometry_msgs/msg/PoseStamped',
}  # message types of RViz's displays and tools


def of_rviz():
    """Yield name and type of every topic that RViz displays or publishes."""
    for each in (*RVIZ['Displays'], *RVIZ['Tools']):
        if 'Topic' in each:
            yield each['Topic']['Value'], SHOWS[each['Class'].rpartition('/')[2]]


def require(topic, steps):
    """Return the type of a topic's field, given the path to it; fail if there is none."""
    pytest.importorskip('rclpy')
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
    assert 'rviz_default_plugins/TF' in {each['Class'] for each in RVIZ['Displays']}
    assert all(each['Enabled'] for each in RVIZ['Displays'])
    assert RVIZ['Global Options']['Fixed Frame'] == 'odom'


def test_foxglove_shows_what_there_is():
    panels = json.loads((CONFIG / 'foxglove' / 'retrieval.json').read_text())['configById']
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
    found = list(ElementTree.parse(CONFIG / 'plotjuggler' / 'retrieval.xml').iter('curve'))
    named = [c.get(key) for c in found for key in ('curve_x', 'curve_y', 'name')]
    curves = [name for name in named if name and '[' not in name]
    for curve in curves:
        topic = max((each for each in TYPES if curve.startswith(f'/{each}/')), key=len)
        assert require(topic, curve.removeprefix(f'/{topic}/').split('/')) == 'double'
    assert {'/cmd_thrust/wrench/force/x', *(f'/planner/{n}/data' for n in NUMBERS)} <= set(curves)
