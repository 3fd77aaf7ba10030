# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc solve``: one problem from a file, one plan, as a table or as JSON."""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from orbimpc_ros.mpc.errors import BadInput, Infeasible
from orbimpc_ros.mpc.plan import Plan, command_of
from orbimpc_ros.mpc.problem.case import Case, case_of
from orbimpc_ros.mpc.problem.sought import Sought
from orbimpc_ros.mpc.proof.prove import WORD, OutOfTime, Unproved, certificate_of, holds
from orbimpc_ros.mpc.proof.refute import refutation_of
from orbimpc_ros.mpc.solve.solver import Solver
from orbimpc_ros.tool import files

LIMIT = 30.0  # [s]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument('file', metavar='FILE|-', help='the problem, JSON or YAML; - reads stdin')
    parser.add_argument(
        '--projection',
        choices=('nearest', 'thrust_aligned'),
        default='thrust_aligned',
        help='how rotations are made of points of the orbitope (default: %(default)s)',
    )
    parser.add_argument(
        '--json',
        action='store_true',
        help='print JSON with all digits, as where the output is no terminal',
    )
    parser.add_argument(
        '--time-limit',
        type=_seconds,
        default=LIMIT,
        metavar='SECONDS',
        help='search no longer, and print the best plan found by then (default: %(default)g)',
    )
    parser.add_argument(
        '--certificate',
        metavar='FILE',
        help='write what proves the lower bound, or that nothing is feasible, for `orbimpc verify`',
    )


def _seconds(word: str) -> float:
    seconds = float(word)
    if not 0.0 < seconds < math.inf:
        raise ValueError
    return seconds


def run(args: argparse.Namespace) -> int:
    """Solve the problem and print its plan."""
    case = case_of(files.read(args.file))
    solver = Solver(case.problem, projection=args.projection, patient=True)
    if case.state.hazards:
        solver.expect_hazards()
    begin = time.perf_counter()
    end = begin + args.time_limit

    def late() -> bool:
        return time.perf_counter() > end

    try:
        plan = solver.solve(case.state, case.goals, None, late)
    except Infeasible as error:
        _refute(case, args.certificate, error, late)
        raise
    elapsed = time.perf_counter() - begin
    found = answer(case, plan, 1e3 * elapsed)
    as_json = args.json or not sys.stdout.isatty()
    print(json.dumps(found, indent=1, allow_nan=False) if as_json else table(case, plan, found))
    if args.certificate:
        Path(args.certificate).write_text(certificate_of(*case, plan.proof).text() + '\n')
    return 0


def _refute(case: Case, path: str | None, why: Infeasible, late: OutOfTime) -> None:
    """Prove that nothing is feasible, and write that down if there is a path to.

    Raises:
        Infeasible: there is no proof of it, which is to be said then.
    """
    try:
        made = refutation_of(Sought(*case), late)
        if not holds(made):
            raise Unproved('the proof found does not hold in exact arithmetic')
    except (Unproved, BadInput) as error:  # the latter without Clarabel
        raise Infeasible(f'{why}; {WORD}; {error}') from None
    if path:
        Path(path).write_text(made.text() + '\n')


def answer(case: Case, plan: Plan, solve_time_ms: float) -> dict[str, Any]:
    """Return a plan as plain values; what is unknown (no bound was proved) is None."""
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
    """Return a plan for people: how good it is, what to do now, and a line for each step."""
    problem, bound, command = case.problem, found['lower_bound'], found['command']
    least = 'unknown' if bound is None else f'{bound:.6g}'
    turn = ', '.join(f'{math.degrees(each):.1f}' for each in command['body_rate'])
    full = 'speed' if problem.translation_order == 1 else 'thrust'
    axes = 'xyz'[: problem.dimension]
    headings = ['heading [deg]'] if problem.dimension == 2 else [f'forward {each}' for each in axes]
    heads = ['time [s]', *(f'{axis} [m]' for axis in axes), full, *headings]
    lines = [
        f'status      {plan.status}, gap {_percent(found["gap"])}',
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


def _percent(gap: float | None) -> str:
    return 'unknown' if gap is None else f'{100.0 * gap:.2g} %' if gap >= 1e-6 else '0 %'


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
