# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Small studies, and how tests run and compare them."""

from orbimpc_ros.lab.study.controllers import CONTROLLERS
from orbimpc_ros.lab.study.design import Study
from orbimpc_ros.lab.study.settings import resolved
from orbimpc_ros.tool import cli

TIMES = ('tick_ms', 'forecast_ms')
SMALL = Study(6, 3, tuple(CONTROLLERS), 'harmonic', resolved())


def complaint(capsys, *words):
    """Run the command here; return its exit code and its one line of complaint."""
    code = cli.main(['study', *map(str, words)])
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1, lines
    return code, lines[0]


def same(rows, others):
    """Require equal rows, measured times aside."""
    one, other = (
        [{k: v for k, v in row.items() if k not in TIMES} for row in each]
        for each in (rows, others)
    )
    assert one == other
