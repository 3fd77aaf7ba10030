# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Random problems through the solver, its plans and proofs judged by an evaluation of its own.

    python test/long/proofs.py --count 3000 --seed 1 --jobs 2
    python test/long/proofs.py --count 300 --seed 2 --through file
    python test/long/proofs.py --case finding.json

Every problem follows from the seed and its index. Each answer goes to a file as it comes, one line
of JSON; what is wrong with it is printed with the problem, in the form that ``orbimpc solve`` takes
(only ``state.coasted``, and the ``state.attitude`` of a vehicle at rest, are beyond that form).
Exit code 1 if anything was found.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import beater
import instances
import judge
import numpy as np

Array = np.ndarray
BEATEN = 1e-4  # relative: an optimal plan's cost above a legal trajectory's
EXACT = 1e-6  # relative: a bound above a legal trajectory's cost, an objective off, a violation
NEGLIGIBLE = 1e-9  # of the natural cost: relative errors of less than that do not count
ENDLESS = 60.0  # [s] of computing without an answer
HANGING = 600.0  # [s] until a process that does not answer is given up, on a busy machine, too
STATUSES = ('optimal', 'feasible', 'infeasible', 'failed', 'refused', 'raised', 'endless')


@dataclass(frozen=True)
class Answer:
    """What came of a problem.

    Attributes:
        status: the plan's, or why there is none: infeasible, failed, refused (bad input), raised
            (anything undocumented) or endless.
        reason: the error's message.
        seconds: until the answer, without compiling the problem; nan where that is not known.
        rotations, positions: the plan's; None without one.
        objective, bound: as published.
    """

    status: str
    reason: str = ''
    seconds: float = float('nan')
    rotations: Array | None = None
    positions: Array | None = None
    objective: float = float('nan')
    bound: float = -float('inf')


# --- both ways to the solver


class Endless(Exception):
    """No answer came."""


def _give_up(*_: Any) -> None:
    raise Endless


def by_api(mapping: dict[str, Any], deadline: float) -> Answer:
    from orbimpc_ros.mpc import errors

    signal.signal(signal.SIGPROF, _give_up)
    signal.setitimer(signal.ITIMER_PROF, ENDLESS)  # its own time: others' load is not its fault
    begun = time.perf_counter()
    try:
        return _solved(mapping, deadline)
    except (KeyboardInterrupt, SystemExit):
        raise
    except Endless:
        return Answer('endless', f'no answer in {ENDLESS:g} s of computing')
    except errors.Infeasible as error:
        return Answer('infeasible', str(error), time.perf_counter() - begun)
    except errors.SolverFailure as error:
        return Answer('failed', str(error), time.perf_counter() - begun)
    except errors.BadInput as error:
        return Answer('refused', str(error))
    except BaseException as error:  # a panic in native code is no Exception
        return Answer('raised', f'{type(error).__name__}: {error}')
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


def _solved(mapping: dict[str, Any], deadline: float) -> Answer:
    from orbimpc_ros.mpc.problem import State
    from orbimpc_ros.mpc.problem.case import case_of
    from orbimpc_ros.mpc.solve.solver import Solver

    known = mapping['state']
    plain = {name: known[name] for name in known if name not in ('attitude', 'coasted')}
    case = case_of({**mapping, 'state': plain})
    coasting = 'coasted' in known
    solver = Solver(case.problem, coasting=coasting)
    state = State.at(**{name: np.array(value) for name, value in known.items()})
    begun = time.perf_counter()
    plan = solver.solve(
        state, case.goals, out_of_time=lambda: time.perf_counter() - begun > deadline
    )
    seconds = time.perf_counter() - begun
    return Answer(
        plan.status,
        '',
        seconds,
        np.array(plan.rotations),
        np.array(plan.positions),
        plan.objective,
        plan.lower_bound,
    )


def by_file(mapping: dict[str, Any], _deadline: float) -> Answer:
    words = [sys.executable, '-m', 'orbimpc_ros.tool.cli', 'solve', '-']
    try:
        done = subprocess.run(
            words,
            input=json.dumps(mapping),
            capture_output=True,
            text=True,
            timeout=HANGING,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Answer('endless', f'no answer in {HANGING:g} s')
    said = done.stderr.strip()
    if done.returncode:
        ends = {1: 'failed', 2: 'refused', 3: 'infeasible'}
        ended = 'raised' if 'Traceback' in said else ends.get(done.returncode, 'raised')
        return Answer(ended, f'exit code {done.returncode}: {said[-300:]}')
    told = json.loads(done.stdout)
    bound = -float('inf') if told['lower_bound'] is None else told['lower_bound']
    return Answer(
        told['status'],
        said,
        1e-3 * told['solve_time_ms'],
        np.array(told['rotations']),
        np.array(told['positions']),
        told['objective'],
        bound,
    )


WAYS = {'api': by_api, 'file': by_file}


# --- the verdict


def verdict(case: judge.PosedProblem, answer: Answer, others: Iterable[beater.Rival]) -> list[str]:
    """What is wrong with an answer, given legal trajectories of its problem."""
    best = min(others, key=lambda other: other.cost, default=None)
    if answer.rotations is None:
        return list(_without_a_plan(answer, best))
    return [*_plan_findings(case, answer), *_proof_findings(case, answer, best)]


def _without_a_plan(answer: Answer, best: beater.Rival | None) -> Iterator[str]:
    if answer.status in ('raised', 'refused', 'endless'):
        yield f'{answer.status}: {answer.reason}'
    elif best is not None:
        took = f'after {answer.seconds:.2g} s' if np.isfinite(answer.seconds) else ''
        yield f'{answer.status}, yet {best.start} is legal: {answer.reason} {took}'.rstrip()


def _plan_findings(case: judge.PosedProblem, answer: Answer) -> Iterator[str]:
    assert answer.rotations is not None
    assert answer.positions is not None
    if not np.isfinite(answer.rotations).all() or not np.isfinite(answer.positions).all():
        yield 'illegal: not finite'
        return
    for name, size in judge.violations(case, answer.rotations).items():
        if size > EXACT:
            yield f'illegal: {name} violated by {size:.2g}'
    off = np.abs(judge.rollout(case, answer.rotations)[0] - answer.positions).max()
    if off > EXACT * case.unit + 1e-13 * np.abs(answer.positions).max():
        yield f'illegal: positions are {off / case.unit:.2g} steps off a rollout'
    cost = judge.cost(case, answer.rotations)
    if not abs(answer.objective - cost) <= EXACT * scale(case, cost):
        yield f'objective: {answer.objective:.9g} published, {cost:.9g} true'


def _proof_findings(
    case: judge.PosedProblem, answer: Answer, best: beater.Rival | None
) -> Iterator[str]:
    assert answer.rotations is not None
    cost = judge.cost(case, answer.rotations)
    least, whose = (cost, 'the plan itself') if best is None else (best.cost, best.start)
    if answer.status not in ('optimal', 'feasible'):
        yield f'raised: status {answer.status!r} of a plan'
    if answer.status == 'optimal' and not cost - least <= BEATEN * scale(case, least):
        yield f'beaten: optimal at {cost:.9g}, {whose} at {least:.9g}'
    lower, whose = min((least, whose), (cost, 'the plan itself'))
    if not answer.bound - lower <= EXACT * scale(case, lower):
        yield f'bound: {answer.bound:.9g} above {lower:.9g} of {whose}'


def scale(case: judge.PosedProblem, cost: float) -> float:
    """What a difference of costs is measured against."""
    return max(abs(cost), NEGLIGIBLE * case.natural_cost)


def examined(mapping: dict[str, Any], way: str, deadline: float, patience: float) -> dict[str, Any]:
    """The record of one problem: its answer, what was found to compare, what is wrong."""
    case = judge.case_of(mapping)
    answer = WAYS[way](mapping, deadline)
    given = answer.rotations
    usable = given if given is not None and np.isfinite(given).all() else None
    rng = np.random.default_rng(case.horizon)
    others = list(beater.trajectories(case, usable, rng, patience))
    best = min(others, key=lambda other: other.cost, default=None)
    findings = verdict(case, answer, others)
    return {
        'route': instances.route_of(mapping),
        'horizon': case.horizon,
        'deadline': deadline,
        'status': answer.status,
        'reason': answer.reason,
        'seconds': answer.seconds,
        'objective': answer.objective,
        'bound': answer.bound,
        'best': None if best is None else best.cost,
        'of': '' if best is None else best.start,
        'legal trajectories': len(others),
        'findings': findings,
        **({'case': mapping} if findings else {}),
    }


# --- many of them


def task(seed: int, index: int, way: str, patience: float) -> dict[str, Any]:
    mapping = instances.draw(seed, index, file=way == 'file')
    record = examined(mapping, way, instances.deadline(seed, index), patience)
    return {'seed': seed, 'index': index, **record}


def records(
    seed: int, indices: Iterable[int], way: str, patience: float, jobs: int
) -> Iterator[dict[str, Any]]:
    """Records as they come; a process that dies ends the run, with what was in its hands."""
    with ProcessPoolExecutor(jobs) as pool:
        waiting = {pool.submit(task, seed, i, way, patience): i for i in indices}
        try:
            for done in as_completed(list(waiting)):
                yield done.result()
                del waiting[done]
        except BrokenProcessPool:
            yield {
                'seed': seed,
                'index': min(waiting.values()),
                'route': 'a process died',
                'status': 'raised',
                'findings': [
                    f'died: a process, at index {min(waiting.values())} or a little later'
                ],
            }
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def table(rows: list[dict[str, Any]]) -> str:
    """Counts by route and by kind of finding, and how deadlines were kept."""
    by_route = defaultdict(list)
    for row in rows:
        by_route[row['route'].partition('+')[0]].append(row)
    lines = [f'{"route":<18}' + ''.join(f'{s:>11}' for s in (*STATUSES, 'findings', 'late p99'))]
    for route in [*sorted(by_route), 'all']:
        some = rows if route == 'all' else by_route[route]
        counts = Counter(row['status'] for row in some)
        found = sum(bool(row['findings']) for row in some)
        cells = [*(counts[s] for s in STATUSES), found, f'{lateness(some):.2f} s']
        lines.append(f'{route:<18}' + ''.join(f'{c:>11}' for c in cells))
    kinds = Counter(kind(text) for row in rows for text in row['findings'])
    lines += [f'{count:>6}  {name}' for name, count in kinds.most_common()]
    return '\n'.join(lines)


def kind(finding: str) -> str:
    return finding.partition(':')[0].partition(', yet')[0]


def lateness(rows: list[dict[str, Any]]) -> float:
    """The 99th percentile of seconds beyond 1.2 deadlines and 10 ms; 0 where all are in time."""
    over = [
        max(0.0, r['seconds'] - 1.2 * r['deadline'] - 0.01)
        for r in rows
        if np.isfinite(r.get('seconds', np.nan))
    ]
    return float(np.percentile(over, 99)) if over else 0.0


def shown(record: dict[str, Any]) -> str:
    where = f'seed {record["seed"]} index {record["index"]}' if 'seed' in record else 'case'
    lines = [f'{where}: {record["route"]}: {text}' for text in record['findings']]
    return '\n'.join([*lines, json.dumps(record.get('case'))])


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--count', type=int, default=3000)
    parser.add_argument('--first', type=int, default=0, help='index of the first problem')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--through', choices=WAYS, default='api')
    parser.add_argument('--jobs', type=int, default=1)
    parser.add_argument('--patience', type=float, default=6.0, help='of the beater, a problem [s]')
    parser.add_argument('--case', type=Path, help='examine the problem in this file alone')
    parser.add_argument('--deadline', type=float, default=1.0, help='with --case [s]')
    parser.add_argument('--out', type=Path, help='default: out/proofs-<way>-<seed>.jsonl')
    return parser.parse_args()


def one_case(args: argparse.Namespace) -> int:
    mapping = json.loads(args.case.read_text())
    record = examined(mapping, args.through, args.deadline, args.patience)
    print(json.dumps({name: record[name] for name in record if name != 'case'}, indent=1))
    return 1 if record['findings'] else 0


def main() -> int:
    args = arguments()
    os.environ.setdefault('OMP_NUM_THREADS', '1')
    if args.case:
        return one_case(args)
    out = args.out or Path('out') / f'proofs-{args.through}-{args.seed}.jsonl'
    out.parent.mkdir(parents=True, exist_ok=True)
    rows, begun = [], time.monotonic()
    indices = range(args.first, args.first + args.count)
    with out.open('w') as file:
        for row in records(args.seed, indices, args.through, args.patience, args.jobs):
            rows.append(row)
            print(json.dumps(row, default=float), file=file, flush=True)
            if row['findings']:
                print(shown(row), flush=True)
            if len(rows) % 50 == 0:
                took = time.monotonic() - begun
                print(f'{len(rows)} of {args.count} in {took:.0f} s', file=sys.stderr, flush=True)
    print(table(rows), f'\nall records: {out}')
    return 1 if any(row['findings'] for row in rows) else 0


if __name__ == '__main__':
    sys.exit(main())
