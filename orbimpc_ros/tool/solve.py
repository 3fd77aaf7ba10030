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
from orbimpc_ros.mpc.problem.case import Case, Sought, case_of
from orbimpc_ros.mpc.proof import document
from orbimpc_ros.mpc.proof.document import Unproved, text_of
from orbimpc_ros.mpc.solve.refute import refutation_of
from orbimpc_ros.mpc.solve.solver import Solver
from orbimpc_ros.tool import files


def run(
    file: str, projection: str, *, as_json: bool, time_limit: float, certificate: str | None
) -> int:
    """Solve the problem and print its plan."""
    number(time_limit, '--time-limit', 0.0, above=True)
    case = case_of(files.read(file))
    solver = Solver(case.problem, projection=projection, patient=True)
    if case.state.hazards:
        solver.expect_hazards()
    begin = time.perf_counter()
    end = begin + time_limit

    def late() -> bool:
        return time.perf_counter() > end

    try:
        plan = solver.solve(case.state, case.goals, None, late)
    except Infeasible as error:
        _refute(case, certificate, error, late)
        raise
    elapsed = time.perf_counter() - begin
    found = answer(case, plan, 1e3 * elapsed)
    if as_json or not sys.stdout.isatty():
        print(json.dumps(found, indent=1, allow_nan=False))
    else:
        print(table(case, plan, found))
    if certificate:
        Path(certificate).write_text(text_of(document.certificate_of(*case, plan.proof)) + '\n')
    return 0


def _refute(case: Case, path: str | None, why: Infeasible, late: document.OutOfTime) -> None:
    """Prove infeasibility, and write the certificate if a path is given.

    Raises:
        Infeasible: it could not be proved; the message adds why.
    """
    try:
        made = refutation_of(Sought(*case), out_of_time=late)
        if not document.holds(made):
            raise Unproved('the proof found does not hold in exact arithmetic')
    except (Unproved, BadInput) as error:  # BadInput if Clarabel is not installed
        raise Infeasible(f'{why}; {document.WORD}; {error}') from None
    if path:
        Path(path).write_text(text_of(made) + '\n')


def answer(case: Case, plan: Plan, solve_time_ms: float) -> dict[str, Any]:
    """Return a plan as plain values; bound and gap are None if no bound was proved."""
    command = command_of(case.problem, case.state, plan)
    return {
        'status': plan.status,
        'objective': plan.objective,
        'lower_bound': _finite(plan.lower_bound),
        'gap': _finite(plan.gap),
        'nodes': plan.nodes,
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


def table(case: Case, plan: Plan, found: dict[str, Any]) -> str:
    """Return a plan as text: its quality, the command, and a line for each step."""
    problem, bound, command = case.problem, found['lower_bound'], found['command']
    least = 'unknown' if bound is None else f'{bound:.6g}'
    gap = 'unknown' if bound is None else f'{100.0 * plan.gap:.2g} %' if plan.gap >= 1e-6 else '0 %'
    turn = ', '.join(f'{math.degrees(each):.1f}' for each in command['body_rate'])
    full = 'speed' if problem.translation_order == 1 else 'thrust'
    axes = 'xyz'[: problem.dimension]
    headings = ['heading [deg]'] if problem.dimension == 2 else [f'forward {each}' for each in axes]
    heads = ['time [s]', *(f'{axis} [m]' for axis in axes), full, *headings]
    lines = [
        f'status      {plan.status}, gap {gap}',
        f'cost        {plan.objective:.6g}, at least {least}',
        f'solved in   {found["solve_time_ms"]:.1f} ms, {plan.nodes} nodes',
        f'command     {command["speed_fraction"]:.3f} of full {full}, turn at {turn} deg/s',
        '',
        ''.join(f'{head:>{max(9, len(head) + 1)}}' for head in heads).rstrip(),
    ]
    rows = zip(plan.positions, plan.speed_fraction, plan.projected, strict=True)
    for k, (position, share, rotation) in enumerate(rows):
        ahead = rotation[:, 0]
        if problem.dimension == 2:
            ahead = np.degrees(np.arctan2(ahead[1:], ahead[:1]))
        numbers = [k * problem.step, *position, share, *ahead]
        widths = (max(9, len(head) + 1) for head in heads)
        lines.append(''.join(f'{n:{w}.3f}' for n, w in zip(numbers, widths, strict=True)))
    return '\n'.join(lines)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
