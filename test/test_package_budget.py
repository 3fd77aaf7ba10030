# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Size budget: lines of Python in each folder, words of Markdown."""

import pytest
from harness import ROOT

LINES = {
    'orbimpc_ros': 28_522,
    'orbimpc_ros/mpc': 14_970,
    'orbimpc_ros/loop': 3_158,
    'orbimpc_ros/ros': 4_043,
    'orbimpc_ros/sim': 2_180,
    'orbimpc_ros/tool': 4_044,
    'benchmarks': 3_352,
    'test': 18_000,
}
WORDS = {'docs': 23_903, 'README.md': 900}


@pytest.mark.parametrize('folder', LINES)
def test_a_folder_has_no_more_lines_than_its_budget(folder):
    count = sum(len(f.read_text().splitlines()) for f in (ROOT / folder).rglob('*.py'))
    assert 0 < count <= LINES[folder]


@pytest.mark.parametrize('place', WORDS)
def test_pages_have_no_more_words_than_their_budget(place):
    pages = [ROOT / place] if place.endswith('.md') else sorted((ROOT / place).rglob('*.md'))
    count = sum(len(page.read_text().split()) for page in pages)
    assert 0 < count <= WORDS[place]
