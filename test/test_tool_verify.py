# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""`orbimpc verify` as a user meets it: certificates and bags in, a table and an exit code out."""

import itertools
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from orbimpc_ros.mpc.kernels import COMPILED
from orbimpc_ros.mpc.outcome import Status
from orbimpc_ros.mpc.proof.document import Certificate
from orbimpc_ros.mpc.proof.prove import WORD, Unproved, certificate_of
from orbimpc_ros.mpc.proof.tree import one
from orbimpc_ros.mpc.solve.solver import Solver
from orbimpc_ros.tool import cli
from orbimpc_ros.tool.bags import BagWriter
from orbimpc_ros.tool.replay import recording
from orbimpc_ros.tool.replay.report import ticks_of
from orbimpc_ros.tool.topics import Topic
from orbimpc_ros.tool.verify import Recorded, _recorded

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = STORE.types
PROOFS = (Topic('/certificate', 'std_msgs/msg/UInt8MultiArray'),)
HERE = Path(__file__).parent
CASES = json.loads((HERE / 'reference' / 'cases.json').read_text())

FAR = {**CASES['uav_square_0'], 'terminal': 'constraint', 'goal': [60.0, 0.0]}


@pytest.fixture
def run(capsys):
    """Return a function that runs a command: (exit code, stdout, stderr)."""

    def ran(*words):
        capsys.readouterr()
        code = cli.main([str(word) for word in words])
        return code, *capsys.readouterr()

    return ran


def solve(run, folder, stated):
    """Return a problem's file, that of its certificate, and what the command answers."""
    problem, made = folder / 'problem.json', folder / 'certificate.json'
    problem.write_text(json.dumps(stated))
    return problem, made, run('solve', problem, '--certificate', made)


@pytest.fixture
def solved(tmp_path, run):
    """Return a problem's file, and that of the certificate of its plan."""
    problem, made, (code, out, _) = solve(run, tmp_path, CASES['uav_square_0'])
    assert code == 0
    assert json.loads(made.read_text())['lower_bound'] == json.loads(out)['lower_bound']
    return problem, made


@pytest.fixture
def unsatisfied(tmp_path, run):
    """Return a problem's file, and that of the certificate that nothing satisfies it."""
    problem, made, (code, out, error) = solve(run, tmp_path, FAR)
    assert (code, out) == (3, '')
    assert 'beyond what' in error
    assert error.count('\n') == 1
    assert WORD not in error  # it is proved
    return problem, made


def too_high(known):
    known['lower_bound'] *= 1.001


def without_a_pull(known):
    known['refuted']['trees'][0]['pull'] = [[[0.0, 0.0]]]


@pytest.mark.parametrize(
    ('kind', 'spoil', 'another'),
    [('solved', too_high, {'step': 0.9}), ('unsatisfied', without_a_pull, {'goal': [61.0, 0.0]})],
)
def test_a_certificate_holds_for_its_problem_until_it_is_spoilt(run, request, kind, spoil, another):
    problem, made = request.getfixturevalue(kind)
    code, out, _ = run('verify', made, '--problem', problem)
    assert code == 0
    assert '1 holds' in out
    assert out.count('inf') == (2 if kind == 'unsatisfied' else 0)
    known = json.loads(made.read_text())
    spoil(known)
    made.write_text(json.dumps(known))
    code, out, _ = run('verify', made)
    assert code == 1
    assert '1 DOES NOT HOLD' in out
    problem.write_text(json.dumps({**json.loads(problem.read_text()), **another}))
    code, _, error = run('verify', made, '--problem', problem)
    assert code == 2
    assert 'not of' in error


@pytest.mark.parametrize('text', ['', '{}', '{"format": NaN}', '[]'])
def test_what_is_no_certificate_is_bad_input(run, tmp_path, text):
    file = tmp_path / 'broken.json'
    file.write_text(text)
    code, out, error = run('verify', file)
    assert (code, out) == (2, '')  # no head of a table without rows
    assert error.count('\n') == 1


def test_a_plan_without_a_certificate_is_printed_and_says_so(run, tmp_path, monkeypatch):
    def unproved(*_):
        raise Unproved('no certificate: one tangent proves 3')

    monkeypatch.setattr('orbimpc_ros.tool.solve.certificate_of', unproved)
    problem = tmp_path / 'problem.json'
    problem.write_text(json.dumps(CASES['uav_square_0']))
    code, out, error = run('solve', problem, '--certificate', tmp_path / 'none.json')
    assert code == 1
    assert json.loads(out)['status'] == 'optimal'
    assert 'one tangent proves' in error
    assert not (tmp_path / 'none.json').exists()


def test_a_bound_above_what_a_trajectory_costs_fails(run, monkeypatch):
    monkeypatch.setitem(recording.READERS, 'lower_bound', lambda value: 1.01 * float(value))
    code, out, _ = run('verify', HERE / 'golden' / 'disturbed', '--tick', 3)
    assert code == 1
    assert 'DOES NOT HOLD: a trajectory costs' in out


def test_a_claim_is_held_against_a_plan_whose_own_bound_proves_nothing(run, monkeypatch):
    claiming(monkeypatch, 'lower_bound', 1e3)
    monkeypatch.setattr('orbimpc_ros.mpc.plan.Plan.lower_bound', 0.0)
    code, out, _ = run('verify', HERE / 'golden' / 'disturbed', '--tick', 3)
    assert code == 1
    assert 'DOES NOT HOLD: a trajectory costs' in out


@pytest.mark.parametrize('claimed', [{'lower_bound': 1e-3}, {'catch_bound': 3.0}])
def test_a_claim_about_what_is_not_found_any_more_fails(run, monkeypatch, claimed):
    (known,) = claimed.items()
    claiming(monkeypatch, *known)
    monkeypatch.setattr('orbimpc_ros.tool.replay.report.ticks_of', lost)
    code, out, _ = run('verify', HERE / 'golden' / 'disturbed', '--tick', 3)
    assert code == 1
    assert 'DOES NOT HOLD: ' in out
    assert ' now\n' in out


def lost(*known):
    """Ticks whose plans are not found again."""
    for each in ticks_of(*known):
        yield replace(
            each, decision=replace(each.decision, plan=None, status=Status.FAILED, catch=None)
        )


def bag_of(path, *texts):
    made = TYPES['std_msgs/msg/UInt8MultiArray']
    layout = TYPES['std_msgs/msg/MultiArrayLayout']([], 0)
    with BagWriter(path, PROOFS, {}) as writer:
        for text in texts:
            message = made(layout, np.frombuffer(text.encode(), np.uint8))
            writer.write('/certificate', 1, bytes(STORE.serialize_cdr(message, made.__msgtype__)))
    return path


def test_certificates_are_taken_from_a_bag(tmp_path, solved):
    text = solved[1].read_text()
    (known,) = _recorded(bag_of(tmp_path / 'run', text), '').bounds.items()
    assert known == (json.loads(text)['lower_bound'], json.loads(text))


BROKEN = ['', '[]', '{"lower_bound": "much"}', '{"refuted": 1}', f'{{"lower_bound": {10**400}}}']


def test_what_is_no_certificate_leaves_the_others_of_a_bag(tmp_path, solved):
    text = solved[1].read_text()
    known = _recorded(bag_of(tmp_path / 'run', *BROKEN, text), '')
    assert list(known.bounds.values()) == [json.loads(text)]
    assert len(known.refused) == len(BROKEN)


def test_a_message_that_is_no_certificate_fails_and_ends_nothing(run, monkeypatch):
    recorded = Recorded({}, {}, ('no certificate: it is none',))
    monkeypatch.setattr('orbimpc_ros.tool.verify._recorded', lambda *_: recorded)
    code, out, _ = run('verify', HERE / 'golden' / 'disturbed', '--tick', 3)
    assert code == 1
    assert '1 DOES NOT HOLD, 1 holds' in out


def test_a_recorded_certificate_that_does_not_prove_its_bound_fails(run, tmp_path, monkeypatch):
    asked = 'verify', HERE / 'golden' / 'disturbed', '--tick', 3
    assert run(*asked, '--out', tmp_path)[0] == 0
    known = json.loads((tmp_path / 'tick_00003.json').read_text())
    known['tree']['point'] = [[0.0, 0.0]] * len(known['tree']['point'])
    recorded = Recorded({known['lower_bound']: known}, {})
    monkeypatch.setattr('orbimpc_ros.tool.verify._recorded', lambda *_: recorded)
    code, out, _ = run(*asked)
    assert code == 1
    assert '1 DOES NOT HOLD' in out


PUBLISHED = {
    'infeasible': (('obstacles', 4), 'tick_00004.json'),
    'catch': (('fixed_wing', 9), 'tick_00009_catch.json'),
}


@pytest.fixture(params=PUBLISHED)
def published(request, run, tmp_path, monkeypatch):
    """Return a tick's arguments, its refutation, and a function that has one in its bag."""
    (bag, tick), name = PUBLISHED[request.param]
    asked = 'verify', HERE / 'golden' / bag, '--tick', tick
    assert run(*asked, '--out', tmp_path)[0] == 0
    most = 'orbimpc_ros.mpc.proof.refute.RefutationSearch.most'
    monkeypatch.setattr(most, 0)  # from here on none is made

    def keep(known):
        flight = bag_of(tmp_path / f'run_{len(list(tmp_path.iterdir()))}', json.dumps(known))
        recorded = _recorded(flight, '')
        monkeypatch.setattr('orbimpc_ros.tool.verify._recorded', lambda *_: recorded)

    return asked, json.loads((tmp_path / name).read_text()), keep


def test_a_published_refutation_is_gone_through(run, published):
    asked, known, keep = published
    assert '1 no certificate' in run(*asked)[1]
    keep(known)
    code, out, _ = run(*asked)
    assert code == 0
    assert 'no certificate' not in out
    radius = known['refuted'].get('radius')
    assert radius is None or f'within {radius!r} m' in out


def test_a_published_refutation_that_does_not_refute_fails(run, published):
    asked, known, keep = published
    tree = known['refuted']['trees'][0]
    for name in {'pull', 'meet', 'tether', 'share', 'slide'} & set(tree):
        tree[name] = np.zeros_like(tree[name]).tolist()
    tree['press'] = [0.0 for _ in tree['press']]
    keep(known)
    code, out, _ = run(*asked)
    assert code == 1
    assert '1 DOES NOT HOLD' in out


def test_a_published_refutation_that_is_none_fails_in_words(run, published):
    asked, known, keep = published
    known['refuted']['trees'][0]['point'] = None
    keep(known)
    code, out, _ = run(*asked)
    assert code == 1
    assert 'DOES NOT HOLD: ' in out


def test_a_published_refutation_of_anything_else_does_not_count(run, published):
    asked, known, keep = published
    for other in (
        {**known, 'goals': [[9.0, 9.0]] * len(known['goals'])},
        {**known, 'refuted': {**known['refuted'], 'trees': 2 * known['refuted']['trees']}},
        {**known, 'refuted': {**known['refuted'], 'radius': 0.5}},
    ):
        keep(other)
        code, out, _ = run(*asked)
        assert code == 0
        assert '1 no certificate' in out


@pytest.mark.parametrize('rows', [3, 5])
def test_where_what_a_search_left_proves_less_there_is_no_certificate(run, monkeypatch, rows):
    """Be it that it is weaker, or that it is refused."""

    def poor(problem, state, goals, proof):
        leaf = one(np.zeros((rows, 2)), np.zeros(rows))
        return Certificate(problem, state, goals, proof.lower_bound, leaf)

    monkeypatch.setattr('orbimpc_ros.tool.verify.certificate_of', poor)
    code, out, _ = run('verify', HERE / 'golden' / 'retrieval', '--tick', 3)
    assert code == 0
    assert '1 no certificate' in out


def test_a_certificate_without_the_problems_walls_is_refused(run, tmp_path):
    problem, made = tmp_path / 'problem.json', tmp_path / 'certificate.json'
    box = {'min': [1.5, -1.0], 'max': [2.5, 0.5]}
    case = {**CASES['uav_square_0'], 'floor': {'shape': 'none'}}
    problem.write_text(json.dumps({**case, 'obstacles': [box]}))
    assert run('solve', problem, '--certificate', made)[0] == 0
    assert run('verify', made, '--problem', problem)[0] == 0
    problem.write_text(json.dumps(case))
    code, _, error = run('verify', made, '--problem', problem)
    assert code == 2
    assert 'not of' in error


def test_ticks_of_a_bag_hold(run, tmp_path):
    bag = HERE / 'golden' / 'disturbed'
    code, out, _ = run('verify', bag, '--out', tmp_path / 'made')
    assert code == 0
    assert '20 holds, 1 nothing claimed' in out
    assert len(list((tmp_path / 'made').iterdir())) == 20
    assert run('verify', tmp_path / 'made' / 'tick_00003.json')[0] == 0


@pytest.mark.parametrize(
    ('bag', 'words', 'said'),
    [
        ('dubins', (), '\n20 holds, '),
        ('spacecraft', (), '\n19 holds, '),
        ('obstacles', (), '\n30 holds'),
        ('lander', ('--tick', 18), '\n1 holds'),
    ],
)
def test_every_tick_of_a_bag_holds(run, bag, words, said):
    code, out, _ = run('verify', HERE / 'golden' / bag, *words)
    assert code == 0
    assert said in out
    assert 'no certificate' not in out
    assert out.count('inf') == (2 * 2 if bag == 'obstacles' else 0)  # where nothing was feasible


def test_ticks_of_a_wing_whose_speed_changes_slowly_hold_within_a_cone(run, tmp_path):
    code, out, _ = run('verify', HERE / 'golden' / 'cessna', '--out', tmp_path)
    assert code == 0
    counts = re.search(r'(\d+) holds, \d+ no certificate, 11 nothing claimed', out)
    assert int(counts[1]) >= 80  # of 101; the rest are within 1e-5 of what another search proves
    known = json.loads((tmp_path / 'tick_00000_catch.json').read_text())
    assert known['limits']['speeds']['change'] == pytest.approx(0.012)


def test_what_is_not_refuted_says_so_and_leaves_no_file(run, tmp_path, monkeypatch):
    problem, made = tmp_path / 'problem.json', tmp_path / 'none.json'
    problem.write_text(json.dumps(FAR))
    monkeypatch.setattr('orbimpc_ros.mpc.proof.refute.RefutationSearch.most', 0)
    code, _, error = run('solve', problem, '--certificate', made)
    assert code == 3
    assert 'beyond what' in error
    assert WORD in error
    assert 'no certificate' in error
    assert not made.exists()
    code, _, plainly = run('solve', problem)
    assert (code, plainly) == (3, error)


WING = HERE / 'golden' / 'fixed_wing'


def test_before_which_time_nothing_catches_is_proved(run, tmp_path):
    code, out, _ = run('verify', WING, '--tick', 9, '--out', tmp_path)
    assert code == 0
    assert '2 holds' in out
    code, out, _ = run('verify', tmp_path / 'tick_00009_catch.json')
    assert code == 0
    assert out.split()[4:8] == ['catch', '2.5', '2.5', '4']


def claiming(monkeypatch, name, value):
    monkeypatch.setitem(recording.READERS, name, lambda _: value)


def test_a_time_before_which_a_plan_catches_fails(run, monkeypatch):
    claiming(monkeypatch, 'catch_bound', 3.5)
    code, out, _ = run('verify', WING, '--tick', 9)
    assert code == 1
    assert 'DOES NOT HOLD: a plan catches it at' in out


@pytest.mark.parametrize('flown', [3.0, float('nan')])
def test_a_bound_on_another_catch_is_not_held_against_this_one(run, monkeypatch, flown):
    claiming(monkeypatch, 'lower_bound', 1e3)
    assert 'DOES NOT HOLD: a trajectory costs' in run('verify', WING, '--tick', 9)[1]
    claiming(monkeypatch, 'earliest_catch', flown)
    code, out, _ = run('verify', WING, '--tick', 9)
    assert code == 0
    assert 'it was about another catch, or none' in out
    assert '1 no certificate, 1 holds' in out


@pytest.mark.skipif(not COMPILED, reason='the method that leaves a certificate needs numba')
def test_a_published_bound_on_what_is_flown_without_a_catch_is_gone_through(run, monkeypatch):
    tick = next(itertools.islice(ticks_of(WING, None, ''), 9, None)).decision
    posed = tick.catch.sought.problem, tick.state, tick.catch.sought.goals
    plan = Solver(posed[0], coasting=True).solve(*posed[1:])
    known = certificate_of(*posed, plan.proof).document()
    for changes, word in (({}, '2 holds'), ({'goals': posed[2][::-1].tolist()}, 'another catch')):
        recorded = Recorded({plan.lower_bound: known | changes}, {})
        monkeypatch.setattr('orbimpc_ros.tool.verify._recorded', lambda *_, r=recorded: r)
        claiming(monkeypatch, 'lower_bound', plan.lower_bound)
        claiming(monkeypatch, 'earliest_catch', float('nan'))
        assert word in run('verify', WING, '--tick', 9)[1]


def test_a_time_without_a_proof_is_no_failure(run, monkeypatch):
    monkeypatch.setattr('orbimpc_ros.mpc.proof.refute.RefutationSearch.most', 0)
    code, out, _ = run('verify', WING, '--tick', 9)
    assert code == 0
    assert 'no refutation of a catch at step 1 was found' in out
    assert '1 holds, 1 no certificate' in out


def test_a_time_that_excludes_no_step_has_no_row(run, monkeypatch):
    claiming(monkeypatch, 'catch_bound', 0.5)
    assert 'catch' not in run('verify', WING, '--tick', 9)[1]


def test_a_tick_that_was_infeasible_and_has_a_plan_fails(run, monkeypatch):
    claiming(monkeypatch, 'status', 'infeasible')
    code, out, _ = run('verify', HERE / 'golden' / 'disturbed', '--tick', 3)
    assert code == 1
    assert 'DOES NOT HOLD: it is optimal now' in out
