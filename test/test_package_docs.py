# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The documentation is true: tables, links, commands; CI follows it by pages.py, tested here."""

import importlib.util
import re
import runpy
from pathlib import Path

import pages
import pytest

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


SHOWN = ['ticks         26', '...', 'solve time    p50 0.5 ms, ... boxes', 'at            1.50 m']


@pytest.mark.parametrize(
    ('printed', 'difference'),
    [
        ('ticks 26\nmore\nsolve time p50 900 ms, no boxes\nat 1.51 m\n', ''),
        ('ticks 26\nsolve time p50 0.4 ms, two boxes\nat 1.50 m\n', ''),
        ('ticks 30\nsolve time p50 0.4 ms, no boxes\nat 1.50 m\n', '30 instead of 26'),
        ('ticks 26\nsolve time p50 0.4 ms, no boxes\nat 1.90 m\n', '1.90 instead of 1.50'),
        ('ticks 26\nsolve time p50 0.4 s, no boxes\nat 1.50 m\n', 'other text'),
        ('ticks 26\nat 1.50 m\n', 'other text'),
    ],
)
def test_output_is_held_against_a_page(printed, difference):
    assert pages.differs(SHOWN, printed) == difference


def test_every_command_of_the_pages_is_followed_or_left_out_for_a_reason():
    followed = [b for page in pages.PAGES for b in pages.blocks_of((ROOT / page).read_text())]
    named = {block.file for block in followed} - {''}
    assert named == {'wing.yaml', 'problem.yaml', 'boat.py', 'boat.yaml'}
    assert all(block.output for block in followed if block.language == 'python' and not block.file)
    (rope,) = (b for b in followed if b.output and 'near misses' in ' '.join(b.output))
    assert 'make demo' in rope.text


CONFIGURATIONS = sorted((ROOT / 'config').glob('*.yaml'))
# That have been believed: each is false, or holds of something else only.


@pytest.mark.parametrize('file', CONFIGURATIONS, ids=lambda file: file.name)
def test_pages_that_a_configuration_refers_to_exist(file):
    for named in re.findall(r'docs/[\w/]+\.\w+', file.read_text()):
        assert (ROOT / named).is_file(), named


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
