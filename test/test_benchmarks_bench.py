# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""`orbimpc bench`: equal objectives of all solvers, rows, table, file and picture."""

import json
import math
import sys
from dataclasses import replace

import pytest

from benchmarks import bench
from benchmarks.bench.interleaved import OURS, interleaved_run
from benchmarks.bench.problems import COMPARISONS, CVXPY, GUROBI, IPOPT, PACKAGES, SCIP
from benchmarks.bench.results import BenchRow, rows_of, table
from benchmarks.bench.solvers import Solution
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.tool import cli

FIELDS = [
    *('problem', 'contender', 'n', 'p50_ms', 'p99_ms', 'worst_gap', 'objective'),
    *('ratio_p50', 'ratio_p99', 'required'),
]
PATIENCE = 600.0  # [s] for busy machines, too
compiled = pytest.mark.skipif(
    not COMPILED, reason='minutes, or without a proof, in plain Python: pip install numba'
)


def comparison(key, horizon=None):
    """Return a comparison, with a shorter ``horizon`` if solvers would take minutes otherwise."""
    found = next(each for each in COMPARISONS if each.key == key)
    return replace(found, problem=replace(found.problem, horizon=horizon)) if horizon else found


def solved(each, name, indices):
    """Return the results of a solver on some instances; skip if it is not installed."""
    if name in PACKAGES:
        pytest.importorskip(PACKAGES[name])
    solver = each.solver(name, PATIENCE)
    instances = each.instances(each.problem, max(indices) + 1)
    return [solver.ready(*instances[index])() for index in indices]


# --- the same problem for all solvers

WING = [0, 9, 19]  # instances early and late in a flight, in wind, above the floor


@compiled
@pytest.mark.parametrize(
    ('key', 'name', 'horizon', 'indices'),
    [
        *((key, CVXPY, None, range(3)) for key in ('hull', 'spacecraft', 'se3')),
        *((key, name, None, range(3)) for key in ('square', 'boxes') for name in (GUROBI, SCIP)),
        *((key, GUROBI, None, range(1)) for key in ('dubins', 'dubins-length')),
        *((key, name, 4, WING) for key in ('wing', 'wing-circle') for name in (GUROBI, SCIP)),
        ('wing-octagon', GUROBI, 4, WING),
    ],
)
def test_every_solver_proves_the_same_optimum_as_ours(key, name, horizon, indices):
    each = comparison(key, horizon)
    pairs = zip(solved(each, name, indices), solved(each, OURS, indices), strict=True)
    for theirs, ours in pairs:
        assert theirs.objective == pytest.approx(ours.objective, rel=2 * each.gap)
        assert not theirs.gap > each.gap


@compiled
@pytest.mark.parametrize(
    ('key', 'horizon', 'indices'),
    [
        ('circle-0.3', None, range(20)),
        ('circle-1.0', None, range(20)),
        ('wing', 6, range(0, 20, 4)),
    ],
)
def test_a_local_solver_sometimes_finds_the_optimum_and_never_a_better_one(key, horizon, indices):
    each = comparison(key, horizon)
    theirs, ours = solved(each, IPOPT, indices), solved(each, OURS, indices)
    pairs = [(a.objective, b.objective) for a, b in zip(theirs, ours, strict=True)]
    assert all(a > b * (1.0 - each.gap) for a, b in pairs if not math.isnan(a))
    assert any(a == pytest.approx(b, rel=each.gap) for a, b in pairs)


# --- the interleaved run and its rows


class Fake:
    """A solver with a given result."""

    def __init__(self, objective=1.0, error=None, log=None, name=''):
        self.objective, self.error, self.log, self.name = objective, error, log, name

    def ready(self, state, goals):
        return self.solve

    def solve(self):
        if self.log is not None:
            self.log.append(self.name)
        if self.error is not None:
            raise self.error
        return Solution(self.objective)


def compete(solvers, count=4, every=1):
    samples = interleaved_run(
        solvers, [(None, None)] * count, warm_up=0, budget=60.0, show=lambda done: None, every=every
    )
    return {row.contender: row for row in rows_of('p', samples, {})}


def test_solvers_take_turns_on_the_same_instance_in_alternating_order():
    log = []
    compete({OURS: Fake(log=log, name='a'), 'other': Fake(log=log, name='b')})
    assert ''.join(log) in ('abbaabba', 'baabbaab')


def test_objectives_that_differ_are_flagged_and_better_ones_fail_the_run():
    rows = compete({OURS: Fake(), 'worse': Fake(1.01), 'better': Fake(0.99), 'same': Fake(1.0)})
    assert 'worse on 4' in rows['worse'].note
    assert not rows['worse'].beaten
    assert 'BETTER than ours on 4' in rows['better'].note
    assert rows['better'].beaten
    assert rows['same'].note == 'objectives agree'


def test_a_solver_that_breaks_is_a_row_with_the_reason():
    rows = compete({OURS: Fake(), 'broken': Fake(error=ZeroDivisionError('x'))})
    assert (rows['broken'].n, rows['broken'].note) == (0, 'failed: ZeroDivisionError: x')
    assert rows[OURS].n == 4
    assert not rows['broken'].failed
    assert compete({OURS: Fake(error=ZeroDivisionError('x'))})[OURS].failed


def test_requirements_are_least_ratios_and_most_of_everything_else():
    row = BenchRow(
        'p', OURS, 1, p50_ms=2.0, ratio_p50=5.0, required={'p50_ms': 1.0, 'ratio_p50': 4.0}
    )
    assert row.missed == ['p50_ms']
    assert 'MISSED' in table([row])
    assert 'met' in table([BenchRow('p', OURS, 1, p50_ms=2.0, required={'p50_ms': 3.0})])


# --- the command


@pytest.fixture
def run(tmp_path, capsys):
    def go(*words):
        file = tmp_path / 'result.json'
        code = cli.main(['bench', '--quick', '--json', str(file), *words])
        out, err = capsys.readouterr()
        return code, out, err, json.loads(file.read_text()) if file.exists() else None

    return go


def test_a_quick_run_writes_the_agreed_file(run):
    code, out, _, result = run('--only', 'hull', 'square')
    assert code == ('MISSED' in out), out
    assert list(result) == ['machine', 'versions', 'rows']
    assert all(list(row) == FIELDS for row in result['rows'])
    names = [row['contender'] for row in result['rows']]
    assert names.count(OURS) == 2
    assert {CVXPY, GUROBI, SCIP} <= set(names)
    assert result['versions']['clarabel']
    for row in result['rows']:
        assert row['contender'] in out
        if row['contender'] == OURS:
            assert row['ratio_p50'] == row['ratio_p99'] == 1.0


def test_a_solver_that_is_not_installed_is_listed_with_a_hint(run, monkeypatch):
    for package in ('gurobipy', 'pyscipopt'):
        monkeypatch.setitem(sys.modules, package, None)
    code, out, _, result = run('--only', 'square')
    assert code == ('MISSED' in out)
    rows = {row['contender']: row for row in result['rows']}
    for name in (GUROBI, SCIP):
        assert 'absent: ' in out
        assert f'pip install {PACKAGES[name]}' in ' '.join(out.split())
        assert rows[name]['n'] == 0
        assert rows[name]['p50_ms'] is rows[name]['ratio_p50'] is None
        assert rows[name]['required']['ratio_p50'] > 1.0


def test_a_measurement_that_fails_is_a_row_and_loses_no_other(run, monkeypatch):
    def compared(each, _quick):
        if each.key == 'square':
            raise OSError('the wind has turned')
        return [BenchRow(each.title, OURS, 1, 1.0, 1.0)]

    monkeypatch.setattr(bench, 'compared', compared)
    code, out, _, result = run('--only', 'hull', 'square')
    assert code == 1
    assert 'failed: OSError: the wind has turned' in out
    solves = {row['problem']: row['n'] for row in result['rows']}
    assert solves == {comparison('hull').title: 1, comparison('square').title: 0}
