# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Errors at arrival: of the plan by itself, flown open loop by each projection, re-planned."""

from __future__ import annotations

import math
from collections.abc import Mapping

from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.ros.parameters import planner_settings
from orbimpc_ros.ros.parameters.planner import PROJECTIONS
from orbimpc_ros.sim.parameters import sim_settings
from orbimpc_ros.sim.world import Scenario
from orbimpc_ros.tool import settings
from orbimpc_ros.tool.demo.open_loop import Arrival, OpenLoop, open_loop
from orbimpc_ros.tool.history import History
from orbimpc_ros.tool.settings import Values


def opened(values: Values) -> dict[str, OpenLoop]:
    """Return what a run's parameters come to when planned once, by projection."""
    problem, scenario = _stated(values)
    return {each: open_loop(problem, scenario, each) for each in PROJECTIONS}


def _stated(values: Values) -> tuple[Problem, Scenario]:
    """Return what a planner with a run's parameters solves, and what its simulator flies."""
    scenario = sim_settings(settings.of_sim(values)).scenario
    return planner_settings(values).problem, scenario


def title(values: Values) -> str:
    """Return the title of a run's column."""
    shape = values['floor.shape']
    return 'no floor' if shape == 'none' else f'{shape}, {values["floor.fraction"]:.3f}'


def column(values: Values, history: History | None = None) -> dict[str, str]:
    """Return the errors at arrival in words, by the way of flying; re-planned if it was flown."""
    second = values['translation_order'] == 2
    found = opened(values)
    rows = {'relaxed plan': _words(found[PROJECTIONS[0]].relaxed, second)}
    rows |= {f'open loop, {name}': _words(each.flown, second) for name, each in found.items()}
    if history is not None:
        rows['closed loop'] = _words(Arrival(*history.missed, 0.0), second)
    return rows


def _words(arrival: Arrival, second: bool) -> str:
    if not second:
        return f'{arrival.position:.1e} m'
    turned = f', thrust {math.degrees(arrival.turned):.0f} deg off' if arrival.turned > 1e-3 else ''
    return f'{arrival.position:.1e} m, {arrival.velocity:.1e} m/s{turned}'


def table(columns: Mapping[str, Mapping[str, str]]) -> str:
    """Return a table with a title above each column and a name before each row."""
    names = list(dict.fromkeys(name for rows in columns.values() for name in rows))
    lines = [['error at arrival', *columns]]
    lines += [[name, *(rows.get(name, '-') for rows in columns.values())] for name in names]
    widths = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
    return '\n'.join(
        '   '.join(word.ljust(width) for word, width in zip(line, widths, strict=True)).rstrip()
        for line in lines
    )


def planned_at_start(values: Values) -> Plan:
    """Return the plan made at a run's start."""
    problem, scenario = _stated(values)
    return open_loop(problem, scenario, values['projection']).plan
