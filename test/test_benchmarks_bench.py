# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""`orbimpc bench`: who takes part, what is written, and that the objectives agree."""

import json
import math
import sys

import numpy as np
import pytest
from problems import reference

from benchmarks import bench
from benchmarks.bench import contest as parts
from benchmarks.bench import picture, table
from benchmarks.bench.contenders.contender import Declined, Solution
from benchmarks.bench.contenders.planar import CondensedPlanar
from benchmarks.bench.contest import CVXPY, GUROBI, IPOPT, SCIP
from benchmarks.bench.contests import CONTESTS
from benchmarks.bench.duel import OURS, Samples, duel
from benchmarks.bench.rows import LATE, BenchRow, growth, of_duel
from orbimpc_ros.mpc.solve.solver import Solver
from orbimpc_ros.tool import cli

FIELDS = [
    *('problem', 'contender', 'n', 'p50_ms', 'p99_ms', 'worst_gap', 'objective'),
    *('ratio_p50', 'ratio_p99', 'required'),
]


def contest(key):
    return next(each for each in CONTESTS if each.key == key)


def solved(key, name, count=2):
    """The objectives of a contender on the first instances; skips where it is not installed."""
    each = contest(key)
    if name in parts.PACKAGES:
        pytest.importorskip(parts.PACKAGES[name])
    contender = each.contender(name, 600.0)  # [s]: on a busy machine too
    answers = []
    for instance in each.instances(each.problem, count):
        contender.solve(*instance)
        answers.append(contender.solution())
    return answers


@pytest.fixture
def run(tmp_path, capsys):
    def go(*words):
        file = tmp_path / 'result.json'
        code = cli.main(['bench', '--quick', '--json', str(file), *words])
        out, err = capsys.readouterr()
        return code, out, err, json.loads(file.read_text()) if file.exists() else None

    return go


def test_a_quick_run_writes_the_agreed_file_and_a_picture(run, tmp_path):
    code, out, _, result = run('--only', 'hull', 'square')
    assert code == 0, out
    assert list(result) == ['machine', 'versions', 'rows']
    assert all(list(row) == FIELDS for row in result['rows'])
    names = [row['contender'] for row in result['rows']]
    assert names.count(OURS) == 2
    assert {CVXPY, GUROBI, SCIP} <= set(names)
    assert result['versions']['clarabel']
    assert (tmp_path / 'result.png').read_bytes()[:8] == b'\x89PNG\r\n\x1a\n'
    for row in result['rows']:
        assert row['contender'] in out
        if row['contender'] == OURS:
            assert row['ratio_p50'] == row['ratio_p99'] == 1.0


def test_who_is_not_installed_is_absent_and_told_how_to_come(run, monkeypatch):
    for name in ('gurobi', 'scip'):
        monkeypatch.setitem(sys.modules, f'benchmarks.bench.contenders.{name}', None)
    code, out, _, result = run('--only', 'square')
    assert code == 0
    rows = {row['contender']: row for row in result['rows']}
    for name, package in ((GUROBI, 'gurobipy'), (SCIP, 'pyscipopt')):
        assert f'absent: pip install {package}' in out
        assert rows[name]['n'] == 0
        assert rows[name]['p50_ms'] is rows[name]['ratio_p50'] is None
        assert rows[name]['required']['ratio_p50'] > 1.0


@pytest.mark.parametrize(
    ('key', 'name'),
    [
        ('hull', CVXPY),
        ('square', GUROBI),
        ('square', SCIP),
        ('dubins', GUROBI),
        ('dubins-length', GUROBI),
        ('spacecraft', CVXPY),
        ('se3', CVXPY),
        ('boxes', GUROBI),
        ('boxes', SCIP),
    ],
)
def test_every_contender_solves_the_same_problem_as_ours(key, name):
    """No problem is made easier for anybody."""
    count = 1 if key.startswith('dubins') else 3
    tolerance = 2 * contest(key).gap
    for theirs, ours in zip(solved(key, name, count), solved(key, OURS, count), strict=True):
        assert theirs.objective == pytest.approx(ours.objective, rel=tolerance)
        assert not theirs.gap > contest(key).gap


@pytest.mark.parametrize('key', ['circle-0.3', 'circle-1.0'])
def test_a_local_solver_is_never_better_than_what_was_proved(key):
    theirs, ours = solved(key, IPOPT, 20), solved(key, OURS, 20)
    pairs = [(a.objective, b.objective) for a, b in zip(theirs, ours, strict=True)]
    assert all(a > b * (1 - 1e-6) for a, b in pairs if not math.isnan(a))
    assert any(a == pytest.approx(b, rel=1e-6) for a, b in pairs)  # and sometimes finds it


def test_the_circling_ticks_are_near_the_rope():
    each = contest('square')
    for state, goals in each.instances(each.problem, 20):
        assert np.linalg.norm(state.position - goals[0]) < 2.5


@pytest.mark.parametrize('name', ['uav_square_0', 'dubins_square'])
def test_the_contenders_condensed_cost_is_the_problems(name):
    problem, state, goals = reference(name)
    plan, planar = Solver(problem).solve(state, goals), CondensedPlanar(problem)
    z = plan.rotations[1:, :, 0]
    linear, constant = planar.linear(state, goals)
    cost = np.sum(z * (planar.quadratic @ z + linear)) + constant
    cost += planar.length * np.linalg.norm(z[:-1], axis=1).sum()
    assert cost == pytest.approx(plan.objective, rel=1e-9)
    assert np.sum((planar.squares @ z) ** 2) == pytest.approx(
        np.sum(z * (planar.quadratic @ z)), rel=1e-9, abs=1e-12
    )
    if problem.terminal == 'constraint':
        assert planar.arrival @ z == pytest.approx(planar.to_go(state, goals), abs=1e-6)


class Fake:
    """A contender that says what it is told to."""

    def __init__(self, objective=1.0, error=None, log=None, name=''):
        self.objective, self.error, self.log, self.name = objective, error, log, name

    def solve(self, state, goals):
        if self.log is not None:
            self.log.append(self.name)
        if self.error is not None:
            raise self.error

    def solution(self):
        return Solution(self.objective)


def fight(contenders, count=4):
    samples = duel(
        contenders, [(None, None)] * count, warm_up=0, budget=60.0, show=lambda done: None
    )
    return samples, {row.contender: row for row in of_duel('p', samples, {})}


def test_contenders_take_turns_on_the_same_instance_in_alternating_order():
    log = []
    fight({OURS: Fake(log=log, name='a'), 'other': Fake(log=log, name='b')})
    assert ''.join(log) in ('abbaabba', 'baabbaab')


def test_objectives_that_differ_are_flagged_and_better_ones_fail_the_run():
    _, rows = fight({OURS: Fake(), 'worse': Fake(1.01), 'better': Fake(0.99), 'same': Fake(1.0)})
    assert 'worse on 4' in rows['worse'].note
    assert not rows['worse'].beaten
    assert 'BETTER than ours on 4' in rows['better'].note
    assert rows['better'].beaten
    assert rows['same'].note == 'objectives agree'


def test_who_refuses_or_breaks_is_a_row_that_says_why():
    errors = {'small': Declined('licence'), 'broken': ZeroDivisionError('x')}
    contenders = {name: Fake(error=error) for name, error in errors.items()}
    _, rows = fight({OURS: Fake(), **contenders})
    assert (rows['small'].n, rows['small'].note) == (0, 'licence')
    assert 'ZeroDivisionError' in rows['broken'].note
    assert rows[OURS].n == 4


def test_who_has_used_up_the_budget_is_compared_on_what_it_did():
    slow, ours = Samples({0: 100.0}, {0: Solution(1.0, 0.1, True)}), Samples()
    ours.times.update({0: 10.0, 1: 1.0})
    ours.solutions.update({0: Solution(1.0), 1: Solution(1.0)})
    row = of_duel('p', {OURS: ours, 'slow': slow}, {})[1]
    assert row.ratio_p50 == pytest.approx(10.0)
    assert 'time limit hit on 1' in row.note


def test_requirements_are_least_ratios_and_most_of_everything_else():
    row = BenchRow(
        'p', OURS, 1, p50_ms=2.0, ratio_p50=5.0, required={'p50_ms': 1.0, 'ratio_p50': 4.0}
    )
    assert row.missed == ['p50_ms']
    assert 'MISSED' in table.text([row])
    assert 'met' in table.text([BenchRow('p', OURS, 1, p50_ms=2.0, required={'p50_ms': 3.0})])


@pytest.mark.parametrize(('most', 'code'), [(1.0, 1), (3.0, 0)])
def test_a_requirement_that_is_missed_fails_the_run(run, monkeypatch, most, code):
    row = BenchRow('p', OURS, 1, p50_ms=2.0, required={'p50_ms': most})
    monkeypatch.setattr(bench, 'contested', lambda *_: [row])
    assert run('--only', 'square')[0] == code


def test_growth_is_the_exponent_of_n():
    rows = [BenchRow(f'SE(2) hull N={n}', OURS, 1, p50_ms=0.1 * n**1.5) for n in (5, 10, 50)]
    (row,) = growth(rows)
    assert row.objective == pytest.approx(1.5)
    assert row.missed == ['objective']
    assert growth(rows[:2]) == []


@pytest.fixture
def second(monkeypatch):
    """Return a function that has something happen in the place of the second measurement."""

    def replace(happen):
        measure = bench.contested

        def contested(contest, quick):
            return measure(contest, quick) if contest.key == 'hull' else happen()

        monkeypatch.setattr(bench, 'contested', contested)

    return replace


def test_rows_are_on_disk_before_the_next_measurement_begins(run, second, tmp_path):
    file, seen = tmp_path / 'result.json', []
    second(lambda: seen.extend(json.loads(file.read_text())['rows']) or [])
    run('--only', 'hull', 'square')
    assert {row['contender'] for row in seen} >= {OURS, CVXPY}


def test_a_measurement_that_fails_is_a_row_and_loses_no_other(run, second):
    def fail():
        raise OSError('the wind has turned')

    second(fail)
    code, out, _, result = run('--only', 'hull', 'square')
    assert code == 1
    assert 'failed: OSError: the wind has turned' in out
    solves = {(row['problem'], row['contender']): row['n'] for row in result['rows']}
    assert solves[contest('hull').title, OURS] > 0
    assert solves[contest('square').title, OURS] == 0


def test_an_interruption_keeps_what_was_measured(run, second, tmp_path):
    def interrupt():
        raise KeyboardInterrupt

    second(interrupt)
    code, out, err, result = run('--only', 'hull', 'square')
    assert (code, err.splitlines()[-1]) == (cli.INTERRUPTED, 'orbimpc: interrupted')
    assert {row['problem'] for row in result['rows']} == {contest('hull').title}
    assert CVXPY in out
    assert (tmp_path / 'result.png').is_file()


def test_our_own_failure_fails_the_run():
    _, rows = fight({OURS: Fake(error=ZeroDivisionError('x')), 'other': Fake()})
    assert rows[OURS].failed
    assert not rows['other'].failed


@pytest.mark.parametrize(
    ('words', 'culprit'),
    [
        (('--only', 'chess'), 'chess'),
        (('--json', '/dev/null/x'), '--json'),
        (('--json', '/proc/x.json'), '--json'),  # a folder that takes no files
        (('--json', '/tmp'), '--json'),
        (('--picture', '/nowhere/x.png'), '--picture'),
    ],
)
def test_bad_words_are_refused_in_one_line(capsys, words, culprit):
    assert cli.main(['bench', *words]) == 2
    err = capsys.readouterr().err
    assert err.count('\n') == 1
    assert culprit in err


def test_the_price_of_a_missing_numba_is_told(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, 'numba', None)
    assert cli.main(['bench', '--only', 'chess']) == 2
    notice, complaint = capsys.readouterr().err.splitlines()
    assert 'numba is not installed: plans take 6 to 60 times as long' in notice
    assert 'chess' in complaint


def test_two_planners_answer_in_time(monkeypatch):
    pytest.importorskip('rclpy')
    from benchmarks.bench import live

    monkeypatch.setattr(live, 'WARM_UP', 0.2)
    (row,) = live.fleet(2, 1.0)
    assert row.n == 10
    assert row.p50_ms > 0.0
    assert row.objective <= row.n


def test_reports_are_waited_for_from_who_makes_any():
    pytest.importorskip('rclpy')
    from benchmarks.bench.driver import RoundTrip, answered

    whole, commanded, lost = RoundTrip(0.0, 0.1, 1.0), RoundTrip(0.0, 0.1), RoundTrip(0.0)
    assert answered([whole, whole])
    assert not answered([whole, commanded])
    assert answered([commanded, commanded])
    assert not answered([commanded, lost])


def test_a_planner_is_timed_beside_a_node_that_only_answers():
    pytest.importorskip('rclpy.experimental.events_executor')
    from benchmarks.bench import live

    rows = live._latency('latency', 20.0, 'events', 1.0)
    whole, _, beside, bare, added = rows[:5]
    lost, ours, theirs = rows[5:]
    assert lost.n == 20
    assert whole.n + lost.objective == lost.n
    assert bare.n > 0
    assert added.p50_ms == pytest.approx(beside.p50_ms - bare.p50_ms)
    assert added.p99_ms == pytest.approx(beside.p99_ms - bare.p99_ms)
    assert not added.required  # asked at 50 Hz
    assert [row.problem for row in (ours, theirs)] == ['latency: processor [ms]'] * 2
    assert ours.objective > theirs.objective >= 0.0


def test_the_picture_shows_every_ratio_whole_and_marks_capped_ones():
    rows = [
        BenchRow('p', OURS, 1, 0.1, 0.2, ratio_p50=1.0),
        BenchRow('p', 'slow', 1, 322.0, 323.0, ratio_p50=3220.4),
        BenchRow('p', 'capped', 1, 6e4, 6e4, ratio_p50=719.6, capped=1),
        BenchRow(f'planners: {LATE}', OURS, 1, 1.0, 2.0, objective=3.0),
    ]
    figure = picture.side_by_side(rows)
    figure.draw_without_rendering()
    (axes,) = figure.axes
    assert {each.get_text() for each in axes.texts} == {'3,220 \u00d7', '> 720 \u00d7'}
    assert max(each.get_window_extent().x1 for each in axes.texts) < figure.bbox.x1
    names = [each.get_text() for each in axes.get_yticklabels()]
    assert f'planners: {OURS}' in names  # what a row counts is on no axis of times
    assert axes.get_xlabel() == 'time [ms]'


def test_every_problem_of_the_help_can_be_asked_for():
    assert bench.problems()[-3:] == ['start', 'latency', 'planners']
    assert len(set(bench.problems())) == len(bench.problems())
