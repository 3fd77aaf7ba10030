# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The list of equivalent mutants speaks of code that is there, and hides nothing else."""

import sys
from pathlib import Path

import mutation
import pytest

PACKAGE = Path(__file__).parents[1]
SHOWN = """# orbimpc_ros.mpc.command.x_flaw__mutmut_1: survived
--- orbimpc_ros/mpc/command.py
+++ orbimpc_ros/mpc/command.py
@@ -4,7 +4,7 @@
     The last look before a vehicle gets it.
-    fraction = command.speed_fraction
+    fraction = None
     rate, rotation = command.body_rate.tolist(), command.rotation.tolist()
"""
FLAW = mutation.Mutant('pkg.x_flaw', 'fraction = command.speed_fraction', 'fraction = None')


def test_a_mutant_is_known_by_its_function_and_lines():
    assert mutation.mutant_of('pkg.x_flaw__mutmut_12', SHOWN) == FLAW


def test_only_what_is_listed_may_survive_and_what_is_listed_must():
    alive, other = {'pkg.x_flaw__mutmut_1': FLAW}, FLAW._replace(became='fraction = 1.0')
    assert mutation.review(alive, {FLAW: 'a reason'}) == ([], [])
    assert mutation.review(alive, {}) == (['pkg.x_flaw__mutmut_1'], [])
    assert mutation.review(alive, {FLAW: 'a reason', other: 'another'}) == ([], [other])
    assert mutation.review({}, {FLAW: 'a reason'}) == ([], [FLAW])


@pytest.mark.skipif(sys.version_info < (3, 11), reason='tomllib is new in Python 3.11')
def test_every_listed_line_stands_in_the_code_that_is_mutated():
    import tomllib

    settings = tomllib.loads((PACKAGE / 'pyproject.toml').read_text())['tool']['mutmut']
    files = [PACKAGE / name for name in settings['only_mutate']]
    lines = {line.strip() for file in files for line in file.read_text().splitlines()}
    for mutant, reason in mutation.known().items():
        assert set(mutant.was.splitlines()) <= lines, mutant
        assert reason
    for test in settings['pytest_add_cli_args_test_selection']:
        assert (PACKAGE / test).is_file(), test
