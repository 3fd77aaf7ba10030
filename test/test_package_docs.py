# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The documentation is true: tables, links, commands, and the page's own vehicle over DDS."""

import importlib.util
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from conftest import PATIENCE

from orbimpc_ros.mpc.model.translation import TRANSLATIONS
from orbimpc_ros.mpc.problem.floor import SHAPES
from orbimpc_ros.mpc.proof.prove import WORD
from orbimpc_ros.tool import cli
from orbimpc_ros.tool.cli import _parser

ROOT = Path(__file__).parents[1]
DOCS = ROOT / 'docs'
PAGES = [*sorted(DOCS.glob('*.md')), ROOT / 'README.md', ROOT / 'CONTRIBUTING.md']
BLOCK = re.compile(r'^```(\w+)\n(.*?)^```$', re.DOTALL | re.MULTILINE)
LINK = re.compile(r'\]\((?!https?:)([^)#]*)(#[^)]+)?\)|(?:src|srcset)="([^"]+)"')


def blocks(page, language):
    """Return the code blocks of a page in a language."""
    return [text for kind, text in BLOCK.findall(page.read_text()) if kind == language]


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
    """Return what headings of a page can be linked by, as GitHub has it."""
    headings = re.findall(r'^#+ (.*)$', page.read_text(), re.MULTILINE)
    return {'#' + re.sub(r'[^\w\- ]', '', each.lower()).replace(' ', '-') for each in headings}


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_commands_of_the_tool_exist(page):
    joined = (text.replace('\\\n', ' ') for text in blocks(page, 'sh'))
    for line in (line for text in joined for line in text.splitlines()):
        words = line.partition('#')[0].removeprefix('ros2 run orbimpc_ros ').split()
        if words[:1] == ['orbimpc']:
            assert words[1] in cli.COMMANDS
            _parser(words[1:]).parse_args(words[1:])


def test_the_pictures_can_still_be_drawn():
    from orbimpc_ros.tool.style import look

    spec = importlib.util.spec_from_file_location('pictures', DOCS / 'pictures.py')
    pictures = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(pictures)
    for name, draw in pictures.PICTURES.items():
        with look():
            assert draw().axes, name
        for look_of in (name, f'{name}-dark'):
            assert f'pictures/{look_of}.png' in (DOCS / 'concepts.md').read_text()


def test_the_problem_of_the_first_page_is_solved(tmp_path, capsys):
    (text,) = (t for t in blocks(DOCS / 'getting_started.md', 'yaml') if t.startswith('dimension'))
    (tmp_path / 'problem.yaml').write_text(text)
    assert cli.main(['solve', str(tmp_path / 'problem.yaml')]) == 0
    assert yaml.safe_load(capsys.readouterr().out)['status'] == 'optimal'


@pytest.fixture
def registries():
    """Forget after the test what a page has registered."""
    known = [(each, dict(each)) for each in (SHAPES, TRANSLATIONS)]
    yield
    for registry, before in known:
        registry.clear()
        registry.update(before)


@pytest.mark.parametrize(
    'page',
    [DOCS / 'library.md', DOCS / 'getting_started.md', ROOT / 'README.md'],
    ids=lambda page: page.name,
)
@pytest.mark.usefixtures('registries')
def test_python_that_needs_no_ros_runs(page, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    texts = [text for text in blocks(page, 'python') if 'rclpy' not in text]
    assert texts
    for text in texts:
        exec(compile(text, page.name, 'exec'), {'__name__': '__main__'})
        out = capsys.readouterr().out
        assert 'optimal' in out or ('feasible' in out and WORD in out), out


def test_the_first_pages_boat_reaches_its_beacon(tmp_path, domain):
    pytest.importorskip('rclpy')
    (boat,) = (t for t in blocks(DOCS / 'getting_started.md', 'python') if 'rclpy' in t)
    (parameters,) = (
        t for t in blocks(DOCS / 'getting_started.md', 'yaml') if t.startswith('planner')
    )
    (tmp_path / 'boat.py').write_text(boat)
    (tmp_path / 'boat.yaml').write_text(parameters)
    environment = here() | {'ROS_DOMAIN_ID': str(domain)}
    words = ('--ros-args', '--params-file', 'boat.yaml', '-r', 'goal:=beacon')
    planner = subprocess.Popen(
        [sys.executable, '-m', 'orbimpc_ros.ros.planner', *words],
        cwd=tmp_path,
        env=environment,
    )
    try:
        done = subprocess.run(
            [sys.executable, 'boat.py'],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=PATIENCE,
        )
        assert done.returncode == 0, done.stderr
        assert 'at the beacon' in done.stdout
    finally:
        planner.terminate()
        assert planner.wait(PATIENCE) == 0


CONFIGURATIONS = sorted((ROOT / 'config').glob('*.yaml'))
# That have been believed: each is false, or holds of something else only.
UNTRUE = [
    'any Linux',  # rclpy from PyPI has no wheels for arm64
    r'nodes never import',  # modules of both are shared
    'calls back',
    r'replays (them )?all',
    r'the same (run|result) every time(?! on a machine \(a `deadline` then limits work)',
    'mcap-ros2-support',  # nothing imports it
]


@pytest.mark.parametrize(
    'page', [*PAGES, ROOT / 'package.xml', *CONFIGURATIONS], ids=lambda page: page.name
)
def test_what_was_found_to_be_untrue_is_not_claimed_again(page):
    text = ' '.join(page.read_text().split())
    assert [each for each in UNTRUE if re.search(each, text)] == []


@pytest.mark.parametrize('file', CONFIGURATIONS, ids=lambda file: file.name)
def test_pages_that_a_configuration_refers_to_exist(file):
    for named in re.findall(r'docs/[\w/]+\.\w+', file.read_text()):
        assert (ROOT / named).is_file(), named


def recommended():
    """Return where parameters of planners are recommended, and which."""
    texts = [(page.name, text) for page in PAGES for text in blocks(page, 'yaml')]
    texts += [(file.name, file.read_text()) for file in CONFIGURATIONS]
    for name, text in texts:
        for node, section in (yaml.safe_load(text) or {}).items():
            if node.endswith('planner') and 'ros__parameters' in section:
                yield name, section['ros__parameters']


def test_who_is_to_catch_what_moves_is_recommended_the_forecast_that_finds_its_motion():
    """Straight on from the last observations loses to flying at where the goal was seen."""
    forecasts = {
        name: given.get('goal_prediction', 'hold')
        for name, given in recommended()
        if given.get('objective') == 'intercept'
    }
    assert {'README.md', 'vehicle.md', 'fixed_wing.yaml'} <= forecasts.keys()
    assert set(forecasts.values()) == {'auto'}, forecasts


def here():
    """Return an environment in which this very package is imported from anywhere."""
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get('PYTHONPATH'))))
    return os.environ | {'PYTHONPATH': path}


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
