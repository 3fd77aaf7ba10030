# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Machine code finds what plain Python does, is compiled once, and is forgotten when it is old."""

import json
import os
import subprocess
import sys
import textwrap

import pytest
from harness import python

from orbimpc_ros.mpc import kernels
from orbimpc_ros.mpc.kernels import COMPILED

pytestmark = pytest.mark.skipif(
    not COMPILED, reason="numba is not installed: pip install 'orbimpc_ros[fast]' runs these"
)
PLAIN = """
    import json, numpy as np
    from orbimpc_ros.mpc.problem import Floor, Problem, State, Weights
    from orbimpc_ros.mpc.solve.solver import Solver

    found = []
    for n, floor in ((2, Floor()), (2, Floor('circle', 4, 0.6)), (2, Floor('polygon', 4, 0.6)),
                     (3, Floor('circle'))):
        problem = Problem(n, horizon=3, floor=floor, weights=Weights(input=0.05 * (n == 2)))
        goals = np.tile([0.4, 0.3, 0.2][:n], (3, 1))
        plan = Solver(problem).solve(State.at(np.zeros(n), np.eye(n)), goals)
        found += [plan.objective, plan.lower_bound]
    print(json.dumps(found))
"""


def test_plain_python_finds_what_machine_code_does():
    def found(disabled):
        return json.loads(python(PLAIN, env={**os.environ, 'NUMBA_DISABLE_JIT': disabled}).stdout)

    assert found('0') == pytest.approx(found('1'), rel=1e-6)


ONCE = """
    import sys, time
    from pathlib import Path
    from orbimpc_ros.mpc.kernels import entry_point

    @entry_point
    def added(one, other):
        return one + other

    mine, others = map(Path, sys.argv[1:])
    mine.touch()
    while not others.exists():
        time.sleep(0.001)
    added(1.0, 2.0)
    print(sum(added.stats.cache_misses.values()))
"""


def test_processes_that_need_the_same_code_at_once_compile_it_once(tmp_path):
    script = tmp_path / 'once.py'
    script.write_text(textwrap.dedent(ONCE))
    command = [sys.executable, str(script)]
    options = {'cwd': tmp_path, 'stdout': subprocess.PIPE, 'text': True}
    pair = [subprocess.Popen([*command, *names], **options) for names in ('ab', 'ba')]
    assert sorted(each.communicate(timeout=60)[0] for each in pair) == ['0\n', '1\n']


def test_code_from_other_sources_is_forgotten(tmp_path):
    """Code contains what it calls in other files: one of them that changes makes all of it old."""
    source, kept = tmp_path / 'one.py', tmp_path / 'kept'
    kept.mkdir()
    source.write_text('a = 1')

    def left():
        (kept / 'one.f-1.nbi').touch()
        (kept / 'one.f-1.1.nbc').touch()
        kernels._forget_other_sources.__wrapped__(tmp_path, kept)
        return sorted(each.suffix for each in kept.iterdir() if each.suffix != '.sha256')

    assert left() == []
    assert left() == ['.nbc', '.nbi']
    source.write_text('a = 2')
    assert left() == []
    kernels._forget_other_sources.__wrapped__(tmp_path, tmp_path / 'where nobody may write')
