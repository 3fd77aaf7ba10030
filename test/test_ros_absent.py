# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""What is not installed: fast methods do without, the others say in a line what they need."""

import re
import textwrap

import pytest

pytest.importorskip('rclpy')

from orbimpc_ros.ros.entry import OTHERS, in_a_line

# As where only what apt has is installed.
BARE = """
    import sys

    class Absent:
        '''Finds nothing of what is not to be there.'''

        def find_spec(self, name, *_more):
            if name.partition('.')[0] in {others}:
                raise ModuleNotFoundError(f'No module named {{name!r}}', name=name)

    sys.meta_path.insert(0, Absent())
    from orbimpc_ros.ros.entry import {node}
    sys.exit({node}())
"""


@pytest.fixture
def bare(tmp_path, launch):
    """Start a node without the packages that only general methods and the tool need."""

    def start(node, *arguments):
        script = tmp_path / f'{node}.py'
        script.write_text(textwrap.dedent(BARE).format(node=node, others=OTHERS))
        return launch(script, *arguments)

    return start


def test_a_rope_is_caught_by_a_fast_method_without_any_of_it(bare):
    planner = bare('planner', {'odom_timeout': 60.0, 'goal_timeout': 60.0}, 'retrieval')
    sim = bare('sim', {'exit_when_done': True}, 'retrieval')
    assert sim.wait() == 0, sim.output + planner.output
    assert planner.stop() == 0
    assert 'planning' in planner.output
    assert 'Traceback' not in planner.output + sim.output


def test_a_general_method_says_in_a_line_what_it_needs(bare):
    planner = bare('planner', {}, 'dubins')
    assert planner.wait() == 2, planner.output
    said = planner.output.strip()
    assert said.startswith('clarabel: not installed; this problem takes a general method, which ')
    assert said.endswith('pip install clarabel')


@pytest.mark.parametrize(
    ('name', 'line'),
    [
        ('rosbags.typesys', 'rosbags is missing: .*pip install rosbags'),
        ('mcap', 'mcap is missing: .*pip install mcap'),
        (
            'lifecycle_msgs.srv',
            'lifecycle_msgs is missing: install ROS 2, or .*pip install',
        ),
        ('orbimpc_ros.nowhere', ''),
        (None, ''),
    ],
)
def test_what_is_missing_is_said_with_the_way_to_get_it(name, line):
    found = in_a_line(ModuleNotFoundError(f'No module named {name!r}', name=name))
    assert re.match(line, found)
    assert bool(found) == bool(line)
