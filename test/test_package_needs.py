"""What a node needs to run: ROS, NumPy and SciPy; what else some problems need is said."""

import subprocess
import sys
import textwrap

import pytest

pytest.importorskip('rclpy')

from orbimpc_ros.mpc.kernels import COMPILED

# As if these were not installed: the general program's, and those of the tool.
BLOCKED = ('cvxpy', 'clarabel', 'rosbags', 'mcap', 'lz4', 'zstandard', 'matplotlib', 'PIL')


def run(text):
    block = f'import sys; sys.modules.update(dict.fromkeys({BLOCKED}))'
    words = [sys.executable, '-c', f'{block}\n{textwrap.dedent(text)}']
    return subprocess.run(words, capture_output=True, text=True, check=False)


@pytest.mark.skipif(not COMPILED, reason='machine code takes numba')
def test_nodes_run_and_plan_with_what_a_distribution_has():
    done = run(
        """
        import numpy as np
        import orbimpc_ros.ros.planner.node, orbimpc_ros.ros.sim.node
        from orbimpc_ros import Floor, Problem, Solver, State
        for problem in (Problem(), Problem(floor=Floor('circle', fraction=0.5))):
            goals = np.tile([3.0, 1.0], (5, 1))
            print(Solver(problem).solve(State.at([0, 0], np.eye(2)), goals).status)
        """
    )
    assert done.stdout.split() == ['optimal'] * 2, done.stderr


def test_a_problem_that_takes_more_says_what_and_how_to_get_it():
    done = run(
        """
        from orbimpc_ros.mpc.errors import BadInput
        from orbimpc_ros.mpc.loop.controller import Controller
        from orbimpc_ros.mpc.problem import Box, Problem
        boxes = (Box([1.0, 1.0, 1.0], [2.0, 2.0, 2.0]),)
        among = Problem(dimension=3, max_rate=1.0, obstacles=boxes)
        try:
            Controller(among)
        except BadInput as error:
            print(error)
        """
    )
    said = "problem: solving it takes clarabel, which is missing; pip install 'cvxpy>=1.7'\n"
    assert done.stdout.replace('cvxpy, which', 'clarabel, which') == said, done.stderr
