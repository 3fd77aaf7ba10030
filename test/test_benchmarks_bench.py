# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""`orbimpc bench`: who takes part, what is written, and that the objectives agree."""

import json
import math
import sys
from dataclasses import replace

import numpy as np
import pytest
from problems import reference

from benchmarks import bench
from benchmarks.bench import picture
from benchmarks.bench import problems as parts
from benchmarks.bench.interleaved import OURS, Samples, interleaved_run
from benchmarks.bench.problems import COMPARISONS, CVXPY, GUROBI, IPOPT, SCIP
from benchmarks.bench.results import LATE, BenchRow, growth, rows_of, table
from benchmarks.bench.solvers import Declined, Solution
from benchmarks.bench.solvers.planar import CondensedPlanar, slope_of
from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.problem import Floor, Problem
from orbimpc_ros.mpc.solve.solver import Solver
from orbimpc_ros.tool import cli

FIELDS = [
    *('problem', 'contender', 'n', 'p50_ms', 'p99_ms', 'worst_gap', 'objective'),
    *('ratio_p50', 'ratio_p99', 'required'),
]


PATIENCE = 600.0  # [s]: on a busy machine too
searched = pytest.mark.skipif(
    not COMPILED, reason='minutes, or without a proof, in plain Python: pip install numba'
)


def comparison(key, horizon=None):
    """A comparison, with fewer steps to plan than it has where others take minutes for all."""
    found = next(each for each in COMPARISONS if each.key == key)
    return replace(found, problem=replace(found.problem, horizon=horizon)) if horizon else found


def solved(each, name, indices):
    """The answers of a contender to some instances; skips where it is not installed."""
    if name in parts.PACKAGES:
        pytest.importorskip(parts.PACKAGES[name])
    contender, answers = each.solver(name, PATIENCE), []
    instances = each.instances(each.problem, max(indices) + 1)
    for index in indices:
        contender.solve(*instances[index])
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
    assert code == ('MISSED' in out), out
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
        monkeypatch.setitem(sys.modules, f'benchmarks.bench.solvers.{name}', None)
    code, out, _, result = run('--only', 'square')
    assert code == ('MISSED' in out)
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
    each = comparison(key)
    tolerance = 2 * each.gap
    for theirs, ours in zip(
        solved(each, name, range(count)), solved(each, OURS, range(count)), strict=True
    ):
        assert theirs.objective == pytest.approx(ours.objective, rel=tolerance)
        assert not theirs.gap > each.gap


@pytest.mark.parametrize('key', ['circle-0.3', 'circle-1.0'])
def test_a_local_solver_is_never_better_than_what_was_proved(key):
    each, indices = comparison(key), range(20)
    theirs, ours = solved(each, IPOPT, indices), solved(each, OURS, indices)
    pairs = [(a.objective, b.objective) for a, b in zip(theirs, ours, strict=True)]
    assert all(a > b * (1 - 1e-6) for a, b in pairs if not math.isnan(a))
    assert any(a == pytest.approx(b, rel=1e-6) for a, b in pairs)  # and sometimes finds it


def test_the_circling_ticks_are_near_the_rope():
    each = comparison('square')
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
        self.met = 0

    def solve(self, state, goals):
        self.met += 1
        if self.log is not None:
            self.log.append(self.name)
        if self.error is not None:
            raise self.error

    def solution(self):
        return Solution(self.objective)


def fight(solvers, count=4):
    samples = interleaved_run(
        solvers, [(None, None)] * count, warm_up=0, budget=60.0, show=lambda done: None
    )
    return samples, {row.contender: row for row in rows_of('p', samples, {})}


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
    solvers = {name: Fake(error=error) for name, error in errors.items()}
    _, rows = fight({OURS: Fake(), **solvers})
    assert (rows['small'].n, rows['small'].note) == (0, 'licence')
    assert 'ZeroDivisionError' in rows['broken'].note
    assert rows[OURS].n == 4


def test_who_has_used_up_the_budget_is_compared_on_what_it_did():
    slow, ours = Samples({0: 100.0}, {0: Solution(1.0, 0.1, True)}), Samples()
    ours.times.update({0: 10.0, 1: 1.0})
    ours.solutions.update({0: Solution(1.0), 1: Solution(1.0)})
    row = rows_of('p', {OURS: ours, 'slow': slow}, {})[1]
    assert row.ratio_p50 == pytest.approx(10.0)
    assert 'time limit hit on 1' in row.note


def test_requirements_are_least_ratios_and_most_of_everything_else():
    row = BenchRow(
        'p', OURS, 1, p50_ms=2.0, ratio_p50=5.0, required={'p50_ms': 1.0, 'ratio_p50': 4.0}
    )
    assert row.missed == ['p50_ms']
    assert 'MISSED' in table([row])
    assert 'met' in table([BenchRow('p', OURS, 1, p50_ms=2.0, required={'p50_ms': 3.0})])


def test_a_table_is_as_wide_as_a_terminal():
    titles = [each.title for each in COMPARISONS]
    note = 'no solution on 12, worse on 100, BETTER than ours on 100, time limit hit on 100'
    required = dict.fromkeys(('p50_ms', 'p99_ms', 'worst_gap', 'ratio_p50', 'ratio_p99'), 1.2345e-5)
    figures = dict.fromkeys(required, 9876.543)
    rows = [
        BenchRow(title, name, 10_000, objective=-1234.5678, required=required, note=note, **figures)
        for title in titles
        for name in (OURS, *parts.PACKAGES)
    ]
    lines = table(rows).splitlines()
    assert max(map(len, lines)) <= 80
    assert all(word in ' '.join(lines) for word in note.split())


@pytest.mark.parametrize(('most', 'code'), [(1.0, 1), (3.0, 0)])
def test_a_requirement_that_is_missed_fails_the_run(run, monkeypatch, most, code):
    row = BenchRow('p', OURS, 1, p50_ms=2.0, required={'p50_ms': most})
    monkeypatch.setattr(bench, 'compared', lambda *_: [row])
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
        measure = bench.compared

        def compared(comparison, quick):
            return measure(comparison, quick) if comparison.key == 'hull' else happen()

        monkeypatch.setattr(bench, 'compared', compared)

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
    assert solves[comparison('hull').title, OURS] > 0
    assert solves[comparison('square').title, OURS] == 0


def test_an_interruption_keeps_what_was_measured(run, second, tmp_path):
    def interrupt():
        raise KeyboardInterrupt

    second(interrupt)
    code, out, err, result = run('--only', 'hull', 'square')
    assert (code, err.splitlines()[-1]) == (cli.INTERRUPTED, 'orbimpc: interrupted')
    assert {row['problem'] for row in result['rows']} == {comparison('hull').title}
    assert CVXPY in out
    assert (tmp_path / 'result.png').is_file()


def test_our_own_failure_fails_the_run():
    _, rows = fight({OURS: Fake(error=ZeroDivisionError('x')), 'other': Fake()})
    assert rows[OURS].failed
    assert not rows['other'].failed


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
    assert added.p50_ms == pytest.approx(max(0.0, beside.p50_ms - bare.p50_ms))
    assert added.p99_ms == pytest.approx(max(0.0, beside.p99_ms - bare.p99_ms))
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
    assert bench.names()[-3:] == ['start', 'latency', 'planners']
    assert len(set(bench.names())) == len(bench.names())


# --- vehicles met in flight


@searched
@pytest.mark.parametrize('name', [GUROBI, SCIP])
@pytest.mark.parametrize('key', ['wing', 'wing-octagon', 'wing-circle'])
def test_whoever_proves_something_of_a_wing_proves_it_of_the_same_problem(key, name):
    """In wind, at a turn that the attitude begins, above the floor: early and late in a flight."""
    each, indices = comparison(key, 4), [0, 9, 19]
    pairs = zip(solved(each, name, indices), solved(each, OURS, indices), strict=True)
    for theirs, ours in pairs:
        assert theirs.objective == pytest.approx(ours.objective, rel=2 * each.gap)
        assert not theirs.gap > each.gap


@searched
@pytest.mark.parametrize('key', ['wing', 'wing-circle'])
def test_a_local_solver_finds_no_better_wing(key):
    each, indices = comparison(key, 6), range(0, 20, 4)
    pairs = [
        (theirs.objective, ours.objective)
        for theirs, ours in zip(
            solved(each, IPOPT, indices), solved(each, OURS, indices), strict=True
        )
    ]
    assert all(theirs > ours * (1.0 - each.gap) for theirs, ours in pairs if not math.isnan(theirs))
    assert any(theirs == pytest.approx(ours, rel=each.gap) for theirs, ours in pairs)


@searched
@pytest.mark.parametrize(('key', 'horizon'), [('multirotor', 12), ('lander', 30)])
def test_the_relaxation_under_gravity_is_a_bound_that_some_plans_attain(key, horizon):
    each, indices = comparison(key, horizon), [0, 3]
    pairs = list(zip(solved(each, CVXPY, indices), solved(each, OURS, indices), strict=True))
    assert all(theirs.relaxed for theirs, _ in pairs)
    assert all(theirs.objective < ours.objective * (1.0 + 1e-5) for theirs, ours in pairs)
    assert any(
        theirs.objective == pytest.approx(ours.objective, rel=1e-4) for theirs, ours in pairs
    )


def test_wings_meet_winds_and_goals_that_move():
    each = comparison('wing', 4)
    instances = each.instances(each.problem, 80)
    assert len(instances) == 80
    winds = {tuple(state.disturbance) for state, _ in instances}
    assert len(winds) == 2  # of two flights
    assert all(np.linalg.norm(goals[-1] - goals[0]) > 0.0 for _, goals in instances)
    flown = np.diff([state.position for state, _ in instances[:40]], axis=0)
    over_ground = np.linalg.norm(flown, axis=1) / each.problem.step
    assert over_ground.max() < each.problem.forward + 5.0
    assert np.linalg.norm(instances[39].state.position - instances[39].goals[0]) < 40.0


def test_turns_of_a_quarter_and_more_are_declined():
    """Beyond them the two limits of a turn no longer say that it is so short."""
    floor = Floor('circle', fraction=0.5)
    assert slope_of(Problem(floor=floor, max_rate=1.0)) == pytest.approx(np.tan(1.0))
    with pytest.raises(Declined, match='a quarter'):
        slope_of(Problem(floor=floor, max_rate=1.6))


def test_rivals_meet_some_instances_and_are_compared_on_those():
    sides = {OURS: Fake(1.0), 'rival': Fake(1.0)}
    samples = interleaved_run(
        sides, [(None, None)] * 7, warm_up=0, budget=60.0, show=lambda done: None, every=3
    )
    assert (sides[OURS].met, sides['rival'].met) == (7, 3)
    ours, theirs = rows_of('p', samples, {})
    assert (ours.n, theirs.n) == (7, 3)


def test_a_bound_below_our_plan_beats_nobody_and_a_gap_is_no_difference():
    def row(solution, gap):
        sides = {OURS: Solution(1.0), 'other': solution}
        samples = {name: Samples({0: 1.0}, {0: each}) for name, each in sides.items()}
        return rows_of('p', samples, {}, gap)[1]

    assert row(Solution(0.99), 1e-3).beaten
    assert not row(Solution(0.9995), 1e-3).beaten
    assert row(Solution(0.9995), 1e-4).beaten
    bound = row(Solution(0.5, relaxed=True), 1e-3)
    assert not bound.beaten
    assert bound.note == 'relaxed: a bound, lower on 1'
