# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``python docs/parameters.py``: prints docs/parameters.md from the tables."""

from __future__ import annotations

from collections.abc import Iterable

from orbimpc_ros.ros.parameters.planner import PLANNER
from orbimpc_ros.ros.parameters.spec import ParameterSpec
from orbimpc_ros.sim.parameters import SIM

PAGE = """\
# Parameters

`make docs` writes this page from the tables of the nodes; `ros2 param describe` shows the same.

- *live* parameters of the planner can be changed while it runs; an invalid change is rejected with
  a reason. All others are set at the start, as are all of the simulator's.
- Integers are accepted for all numbers: `1` for `1.0`. Lengths are in metres, angles in radians,
  times in seconds, in the frames of REP-103 and REP-105.
- Unknown names are refused. One file may serve both nodes: each ignores the names that only the
  other one has.
- [Precedence](operating.md#there-are-no-commands) of files and command line.
- Both nodes have ROS's own `use_sim_time`: true for a planner where `/clock` sets the pace, as in
  lock-step; ignored by the simulator, which makes time.

## Equal in planner and simulator

{both}

## Of each node

{process}

## Planner

{planner}

## Simulator

{sim}
"""
PROCESS = {'autostart', 'executor'}
HEAD = ('parameter', 'default', 'allowed', 'unit', 'live', 'meaning')


def page() -> str:
    """Return the page on parameters, in Markdown."""
    own = [row for row in PLANNER if row.name in PROCESS]
    shared = {row.name for row in PLANNER} & {row.name for row in SIM}
    return PAGE.format(
        both=_table(row for row in PLANNER if row.name in shared - PROCESS),
        process=_table(own),
        planner=_table(row for row in PLANNER if row.name not in shared),
        sim=_table(row for row in SIM if row.name not in shared),
    )


def _table(rows: Iterable[ParameterSpec]) -> str:
    lines = [HEAD, ('---',) * len(HEAD), *map(_cells, rows)]
    return '\n'.join(f'| {" | ".join(cells)} |' for cells in lines)


def _cells(row: ParameterSpec) -> tuple[str, ...]:
    live = 'yes' if row.live else ''
    return f'`{row.name}`', _default(row), _allowed(row), row.unit, live, row.description


def _default(row: ParameterSpec) -> str:
    if row.default == '':
        return 'empty'
    if isinstance(row.default, bool):
        return str(row.default).lower()
    if isinstance(row.default, tuple):
        return ', '.join(_decimal(float(each)) for each in row.default) or 'none'
    return _decimal(row.default) if isinstance(row.default, float) else str(row.default)


def _decimal(number: float) -> str:
    """Return a number as ROS takes it for a decimal one."""
    text = f'{number:.6g}'
    return text if '.' in text or 'e' in text else f'{text}.0'


def _allowed(row: ParameterSpec) -> str:
    if row.choices:
        return ', '.join(f'`{choice}`' for choice in row.choices)
    if row.words or isinstance(row.default, (bool, str)):
        return row.allowed.replace(' | ', ', ')
    if isinstance(row.default, int):
        return f'whole, {row.low:.0f} to {row.high:.0f}'
    span = f'{row.low:g} to {row.high:g}'
    return f'decimals, {span}' if isinstance(row.default, tuple) else span


if __name__ == '__main__':
    print(page(), end='')
