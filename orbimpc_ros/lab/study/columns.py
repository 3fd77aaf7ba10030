# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The columns of a study's results: one row for each run and controller."""

from __future__ import annotations

from typing import NamedTuple

from orbimpc_ros.lab.study.settings import SETTINGS, Setting


class Column(NamedTuple):
    """One column.

    Attributes:
        name: of the column.
        kind: as Arrow spells the type.
        text: what it holds.
        unit: of the number; empty for none.
    """

    name: str
    kind: str
    text: str
    unit: str = ''


def _of_setting(setting: Setting) -> Column:
    kind = 'string' if setting.choices else 'int32' if setting.is_whole else 'double'
    return Column(setting.name, kind, f'drawn: {setting.text}', setting.unit)


KEYS = (
    Column('run', 'int32', 'number of the draw, from 0'),
    Column('controller', 'string', 'who flew it'),
    Column('forecast', 'string', 'how the goal was predicted'),
)
RESULTS = (
    Column('caught', 'bool', 'whether the rope was caught'),
    Column('ticks', 'int32', 'steps flown, the last one the catch if there was one'),
    Column('time', 'double', 'from the start to the catch; null without one', 's'),
    Column('closest', 'double', 'least distance to the rope in the whole flight', 'm'),
    Column('farthest', 'double', 'largest distance to the rope at a tick', 'm'),
    Column('turned', 'double', 'sum of the angles turned', 'rad'),
    Column('certified', 'int32', 'ticks whose plan was proved optimal within 1e-4'),
    Column('fallbacks', 'int32', 'ticks without a plan of their own'),
    Column('projection_distance', 'double', 'largest Frobenius distance from R_1 to its rotation'),
    Column(
        'projection_loss',
        'double',
        'largest distance between a step as planned and the same step as flown',
        'm',
    ),
    Column('compared', 'int32', 'ticks whose problem IPOPT solved as well (orbitope only)'),
    Column(
        'excess',
        'double',
        "on them, by how much of IPOPT's cost a plan cost more at most; negative: always less",
    ),
    Column('cheaper', 'int32', 'ticks of these that IPOPT solved at a cost higher by over 1e-6'),
    Column('tick_ms', 'list<item: float>', 'processor time of each tick but its forecast', 'ms'),
    Column('forecast_ms', 'list<item: float>', "of each tick's forecast, made once for all", 'ms'),
)
COLUMNS = (*KEYS, *(_of_setting(setting) for setting in SETTINGS), *RESULTS)
