# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc solve``: solve one problem from a file, and print the plan as a table or as JSON."""

from __future__ import annotations

import json
import math
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from orbimpc_ros.mpc.arrays import number
from orbimpc_ros.mpc.errors import BadInput, Infeasible
from orbimpc_ros.mpc.plan import Plan, command_of
from orbimpc_ros.mpc.problem.case import Case, case_of
from orbimpc_ros.mpc.proof import document
from orbimpc_ros.mpc.proof.document import WORD, held_in_time, text_of
from orbimpc_ros.mpc.solve.refute import refutation_of
from orbimpc_ros.mpc.solve.solver import Deadline, Solver
from orbimpc_ros.tool import files


def run(
    file: str, projection: str, *, as_json: bool, time_limit: float, certificate: str | None
) -> int:
    """Solve the problem and print its plan."""
    number(time_limit, '--time-limit', 0.0, above=True)
    if certificate:
        files.folder_at(Path(certificate).parent, '--certificate')
        if Path(certificate).is_dir() or Path(certificate).resolve() == Path(file).resolve():
            raise BadInput('--certificate', certificate, 'a file other than the problem')
    case = case_of(files.read(file))
    solver = Solver(case.problem, projection=projection, patient=True)
    if case.state.hazards:
        solver.expect_hazards()
    begin = time.perf_counter()
    late = Deadline(time.perf_counter, begin + time_limit)
    try:
        plan = solver.solve(case.state, case.goals, None, late)
    except Infeasible as error:
        refuted = held_in_time(lambda late: refutation_of(case, 1, late), late.clock, late.end)
        if refuted is None:
            raise Infeasible(f'{error}; {WORD}') from None
        if certificate:
            Path(certificate).write_text(text_of(refuted) + '\n')
        raise
    values = answer(case, plan, 1e3 * (time.perf_counter() - begin))
    if as_json or not (sys.stdout and sys.stdout.isatty()):
        print(json.dumps(values, indent=1, allow_nan=False))
    else:
        print(table(case, plan, values))
    if certificate:
        proved = document.certificate_of(*case.parts, plan.proof)
        Path(certificate).write_text(text_of(proved) + '\n')
    return 0


def answer(case: Case, plan: Plan, solve_time_ms: float) -> dict[str, Any]:
    """Return a plan as plain values; bound and gap are None if no bound was proved."""
    command = command_of(case.problem, case.state, plan)
    proved = math.isfinite(plan.gap)
    return {
        'status': plan.status,
        'objective': plan.objective,
        'lower_bound': plan.lower_bound if proved else None,
        'gap': plan.gap if proved else None,
        'nodes': plan.proof.nodes,
        'solve_time_ms': solve_time_ms,
        'positions': plan.positions.tolist(),
        'rotations': plan.rotations.tolist(),
        'projected': plan.projected.tolist(),
        'speed_fraction': plan.speed_fraction.tolist(),
        'command': {
            'speed_fraction': command.speed_fraction,
            'body_rate': command.body_rate.tolist(),
            'rotation': command.rotation.tolist(),
        },
    }


def table(case: Case, plan: Plan, values: dict[str, Any]) -> str:
    """Return a plan as text: its quality, the command, and a line for each step."""
    problem, bound, command = case.problem, values['lower_bound'], values['command']
    least = 'unknown' if bound is None else f'{bound:.6g}'
    gap = 'unknown' if bound is None else f'{100.0 * plan.gap:.2g} %' if plan.gap >= 1e-6 else '0 %'
    turn = ', '.join(f'{math.degrees(each):.1f}' for each in command['body_rate'])
    full = 'speed' if problem.translation_order == 1 else 'thrust'
    axes, ahead = 'xyz'[: problem.dimension], plan.projected[:, :, 0]
    headings = [f'forward {each}' for each in axes]
    if problem.dimension == 2:
        headings, ahead = ['heading [deg]'], np.degrees(np.arctan2(ahead[:, 1:], ahead[:, :1]))
    heads = ['time [s]', *(f'{axis} [m]' for axis in axes), full, *headings]
    times = problem.step * np.arange(problem.horizon + 1)
    rows = np.column_stack([times, plan.positions, plan.speed_fraction, ahead]).tolist()
    lines = [
        f'status      {plan.status}, gap {gap}',
        f'cost        {plan.objective:.6g}, at least {least}',
        f'solved in   {values["solve_time_ms"]:.1f} ms, {plan.proof.nodes} nodes',
        f'command     {command["speed_fraction"]:.3f} of full {full}, turn at {turn} deg/s',
        '',
    ]
    for row in [heads, *([f'{each:.3f}' for each in row] for row in rows)]:
        cells = zip(row, heads, strict=True)
        lines.append(''.join(f'{cell:>{max(9, len(head) + 1)}}' for cell, head in cells))
    return '\n'.join(lines)
