# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""`orbimpc verify` as a user meets it: certificates and bags in, a table and an exit code out."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bags import write
from problems import CASES
from rosbags.typesys import Stores, get_typestore

from orbimpc_ros.mpc.outcome import Status
from orbimpc_ros.mpc.proof.document import OLD, Certificate
from orbimpc_ros.mpc.proof.prove import WORD, Unproved
from orbimpc_ros.mpc.proof.tree import one
from orbimpc_ros.tool import bags
from orbimpc_ros.tool.replay import recording
from orbimpc_ros.tool.replay.resolving import replayed

STORE = get_typestore(Stores.ROS2_JAZZY)
KINDS = ('UInt8MultiArray', 'MultiArrayLayout')
HERE = Path(__file__).parent

FAR = {**CASES['uav_square_0'], 'terminal': 'constraint', 'goal': [60.0, 0.0]}


def solve(tool, folder, stated):
    """Return a problem's file, that of its certificate, and what the command answers."""
    problem, made = folder / 'problem.json', folder / 'certificate.json'
    problem.write_text(json.dumps(stated))
    return problem, made, tool('solve', problem, '--certificate', made)


@pytest.fixture
def solved(tmp_path, tool):
    """Return a problem's file, and that of the certificate of its plan."""
    problem, made, (code, out, _) = solve(tool, tmp_path, CASES['uav_square_0'])
    assert code == 0
    assert json.loads(made.read_text())['lower_bound'] == json.loads(out)['lower_bound']
    return problem, made


@pytest.fixture
def unsatisfied(tmp_path, tool):
    """Return a problem's file, and that of the certificate that nothing satisfies it."""
    problem, made, (code, out, error) = solve(tool, tmp_path, FAR)
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
def test_a_certificate_holds_for_its_problem_until_spoilt(tool, request, kind, spoil, another):
    problem, made = request.getfixturevalue(kind)
    code, out, _ = tool('verify', made, '--problem', problem)
    assert code == 0
    assert '1 holds' in out
    assert out.count('inf') == (2 if kind == 'unsatisfied' else 0)
    known = json.loads(made.read_text())
    spoil(known)
    made.write_text(json.dumps(known))
    code, out, _ = tool('verify', made)
    assert code == 1
    assert '1 DOES NOT HOLD' in out
    problem.write_text(json.dumps({**json.loads(problem.read_text()), **another}))
    code, _, error = tool('verify', made, '--problem', problem)
    assert code == 2
    assert 'not of' in error


@pytest.mark.parametrize('text', ['', '{}', '{"format": NaN}', '[]'])
def test_what_is_no_certificate_is_bad_input(tool, tmp_path, text):
    file = tmp_path / 'broken.json'
    file.write_text(text)
    code, out, error = tool('verify', file)
    assert (code, out) == (2, '')  # no head of a table without rows
    assert error.count('\n') == 1


def test_a_plan_without_a_certificate_is_printed_and_says_so(tool, tmp_path, monkeypatch):
    def unproved(*_):
        raise Unproved('no certificate: one tangent proves 3')

    monkeypatch.setattr('orbimpc_ros.tool.solve.certificate_of', unproved)
    problem = tmp_path / 'problem.json'
    problem.write_text(json.dumps(CASES['uav_square_0']))
    code, out, error = tool('solve', problem, '--certificate', tmp_path / 'none.json')
    assert code == 1
    assert json.loads(out)['status'] == 'optimal'
    assert 'one tangent proves' in error
    assert not (tmp_path / 'none.json').exists()


@pytest.mark.parametrize('own', [True, False], ids=['with a bound', 'whose bound proves nothing'])
def test_a_bound_above_what_a_trajectory_costs_fails(tool, monkeypatch, own):
    known = recording.recording_of(HERE / 'golden' / 'disturbed').answers[3].answer
    claiming(monkeypatch, 'lower_bound', 1.01 * known['lower_bound'])
    if not own:
        monkeypatch.setattr('orbimpc_ros.mpc.plan.Plan.lower_bound', 0.0)
    code, out, _ = tool('verify', HERE / 'golden' / 'disturbed', '--tick', 3)
    assert code == 1
    assert 'DOES NOT HOLD: a trajectory costs' in out


@pytest.mark.parametrize('claimed', [{'lower_bound': 1e-3}, {'catch_bound': 3.0}])
def test_a_claim_about_what_is_not_found_any_more_fails(tool, monkeypatch, claimed):
    (known,) = claimed.items()
    claiming(monkeypatch, *known)
    monkeypatch.setattr('orbimpc_ros.tool.replay.resolving.replayed', lost)
    code, out, _ = tool('verify', HERE / 'golden' / 'disturbed', '--tick', 3)
    assert code == 1
    assert 'DOES NOT HOLD: ' in out
    assert ' now\n' in out


def lost(*known):
    """Ticks whose plans are not found again."""
    for each in replayed(*known):
        yield replace(
            each, decision=replace(each.decision, plan=None, status=Status.FAILED, catch=None)
        )


BROKEN = ['', '[]', '{"lower_bound": "much"}', '{"refuted": 1}', f'{{"lower_bound": {10**400}}}']


def test_certificates_in_a_bag_are_verified_each_as_it_is(tool, tmp_path, solved):
    sound = solved[1].read_text()
    spoilt = json.loads(sound)
    too_high(spoilt)
    old = json.dumps({'format': OLD})  # what it is about is proved anew
    made, layout = (STORE.types[f'std_msgs/msg/{name}'] for name in KINDS)
    kind = made.__msgtype__
    early = 3 * 10**9  # [ns] three ticks
    messages = [each for each in bags.raw(HERE / 'golden' / 'spacecraft') if each.stamp < early]
    for text in (*BROKEN, sound, json.dumps(spoilt), old):
        message = made(layout([], 0), np.frombuffer(text.encode(), np.uint8))
        data = bytes(STORE.serialize_cdr(message, kind))
        messages.append(messages[0]._replace(topic='/certificate', type=kind, data=data))
    bag = write(tmp_path / 'bag', messages, bags.notes(HERE / 'golden' / 'spacecraft'))
    code, out, _ = tool('verify', bag)
    assert code == 1
    assert f'{len(BROKEN) + 1} DOES NOT HOLD' in out
    assert '4 holds' in out  # three of ticks


@pytest.mark.parametrize('rows', [3, 5])
def test_where_what_a_search_left_proves_less_there_is_no_certificate(tool, monkeypatch, rows):
    """Be it that it is weaker, or that it is refused."""

    def poor(problem, state, goals, proof):
        leaf = one(np.zeros((rows, 2)), np.zeros(rows))
        return Certificate(problem, state, goals, proof.lower_bound, leaf)

    monkeypatch.setattr('orbimpc_ros.tool.verify.certificate_of', poor)
    code, out, _ = tool('verify', HERE / 'golden' / 'retrieval', '--tick', 3)
    assert code == 0
    assert '1 no certificate' in out


def test_a_certificate_without_the_problems_walls_is_refused(tool, tmp_path):
    problem, made = tmp_path / 'problem.json', tmp_path / 'certificate.json'
    box = {'min': [1.5, -1.0], 'max': [2.5, 0.5]}
    case = {**CASES['uav_square_0'], 'floor': {'shape': 'none'}}
    problem.write_text(json.dumps({**case, 'obstacles': [box]}))
    assert tool('solve', problem, '--certificate', made)[0] == 0
    assert tool('verify', made, '--problem', problem)[0] == 0
    problem.write_text(json.dumps(case))
    code, _, error = tool('verify', made, '--problem', problem)
    assert code == 2
    assert 'not of' in error


def test_ticks_of_a_bag_hold(tool, tmp_path):
    bag = HERE / 'golden' / 'disturbed'
    code, out, _ = tool('verify', bag, '--out', tmp_path / 'made')
    assert code == 0
    assert '20 holds, 1 nothing claimed' in out
    assert len(list((tmp_path / 'made').iterdir())) == 20
    assert tool('verify', tmp_path / 'made' / 'tick_00003.json')[0] == 0


@pytest.mark.parametrize(
    ('bag', 'words', 'said'),
    [
        ('dubins', (), '\n20 holds, '),
        ('spacecraft', (), '\n19 holds, '),
        ('obstacles', (), '\n30 holds'),
        ('lander', ('--tick', 18), '\n1 holds'),
    ],
)
def test_every_tick_of_a_bag_holds(tool, bag, words, said):
    code, out, _ = tool('verify', HERE / 'golden' / bag, *words)
    assert code == 0
    assert said in out
    assert 'no certificate' not in out
    assert out.count('inf') == (2 * 2 if bag == 'obstacles' else 0)  # where nothing was feasible


def test_ticks_of_a_wing_hold_within_a_cone(tool, tmp_path):
    code, out, _ = tool('verify', HERE / 'golden' / 'cessna', '--out', tmp_path)
    assert code == 0
    assert '7 nothing claimed' in out
    # Of 103; the rest are within 1e-5 of what another search proves.
    assert int(re.search(r'(\d+) holds', out)[1]) >= 98
    known = [json.loads(file.read_text()).get('limits', {}) for file in tmp_path.iterdir()]
    assert {each['cones'][0]['least'] for each in known if 'cones' in each} == {0.8}


def test_what_is_not_refuted_says_so_and_leaves_no_file(tool, tmp_path, monkeypatch):
    problem, made = tmp_path / 'problem.json', tmp_path / 'none.json'
    problem.write_text(json.dumps(FAR))
    monkeypatch.setattr('orbimpc_ros.mpc.proof.refute.RefutationSearch.most', 0)
    code, _, error = tool('solve', problem, '--certificate', made)
    assert code == 3
    assert 'beyond what' in error
    assert WORD in error
    assert 'no certificate' in error
    assert not made.exists()
    code, _, plainly = tool('solve', problem)
    assert (code, plainly) == (3, error)


WING = HERE / 'golden' / 'fixed_wing'


def test_before_which_time_nothing_catches_is_proved(tool, tmp_path):
    code, out, _ = tool('verify', WING, '--tick', 9, '--out', tmp_path)
    assert code == 0
    assert '2 holds' in out
    code, out, _ = tool('verify', tmp_path / 'tick_00009_catch.json')
    assert code == 0
    assert out.split()[4:8] == ['catch', '2.5', '2.5', '4']


def claiming(monkeypatch, name, value):
    read = recording.fields
    monkeypatch.setattr(recording, 'fields', lambda tick: read(tick) | {name: value})


def test_a_time_before_which_a_plan_catches_fails(tool, monkeypatch):
    claiming(monkeypatch, 'catch_bound', 3.5)
    code, out, _ = tool('verify', WING, '--tick', 9)
    assert code == 1
    assert 'DOES NOT HOLD: a plan catches it at' in out


@pytest.mark.parametrize('flown', [3.0, float('nan')])
def test_a_bound_on_another_catch_is_not_held_against_this_one(tool, monkeypatch, flown):
    claiming(monkeypatch, 'lower_bound', 1e3)
    assert 'DOES NOT HOLD: a trajectory costs' in tool('verify', WING, '--tick', 9)[1]
    claiming(monkeypatch, 'earliest_catch', flown)
    code, out, _ = tool('verify', WING, '--tick', 9)
    assert code == 0
    assert 'it was about another catch, or none' in out
    assert '1 no certificate, 1 holds' in out


def test_a_time_without_a_proof_is_no_failure(tool, monkeypatch):
    monkeypatch.setattr('orbimpc_ros.mpc.proof.refute.RefutationSearch.most', 0)
    code, out, _ = tool('verify', WING, '--tick', 9)
    assert code == 0
    assert 'no refutation of a catch at step 1 was found' in out
    assert '1 holds, 1 no certificate' in out


def test_a_time_that_excludes_no_step_has_no_row(tool, monkeypatch):
    claiming(monkeypatch, 'catch_bound', 0.5)
    assert 'catch' not in tool('verify', WING, '--tick', 9)[1]


def test_a_tick_that_was_infeasible_and_has_a_plan_fails(tool, monkeypatch):
    claiming(monkeypatch, 'status', 'infeasible')
    code, out, _ = tool('verify', HERE / 'golden' / 'disturbed', '--tick', 3)
    assert code == 1
    assert 'DOES NOT HOLD: it is optimal now' in out
