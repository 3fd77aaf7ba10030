# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""`orbimpc verify` as a user meets it: certificates and bags in, a table and an exit code out."""

import json
import re
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from bags import GOLDEN, rewritten, write
from problems import CASES
from rosbags.typesys import Stores, get_typestore

from orbimpc_ros.mpc.outcome import Status
from orbimpc_ros.mpc.proof import document
from orbimpc_ros.mpc.proof.document import WORD, Unproved, certificate_of
from orbimpc_ros.mpc.proof.tree import one
from orbimpc_ros.tool import bags, replay
from orbimpc_ros.tool.replay import replayed

STORE = get_typestore(Stores.ROS2_JAZZY)
KINDS = ('UInt8MultiArray', 'MultiArrayLayout')

DISTURBED, WING = (GOLDEN / 'disturbed', '--tick', 3), (GOLDEN / 'fixed_wing', '--tick', 9)
BEATEN = 1.01 * replay.recording_of(DISTURBED[0]).answers[3].answer['lower_bound']
FAR = {**CASES['uav_square_0'], 'terminal': 'constraint', 'goal': [60.0, 0.0]}


def solve(tool, folder, stated):
    """Return the file of a problem, that of its certificate, and the command's output."""
    problem, made = folder / 'problem.json', folder / 'certificate.json'
    problem.write_text(json.dumps(stated))
    return problem, made, tool('solve', problem, '--certificate', made)


def too_high(known):
    known['lower_bound'] *= 1.001


def without_a_pull(known):
    known['refuted']['trees'][0]['pull'] = [[[0.0, 0.0]]]


WALLED = CASES['uav_square_0'] | {
    'floor': {'shape': 'none'},
    'obstacles': [{'min': [1.5, -1.0], 'max': [2.5, 0.5]}],
}


@pytest.mark.parametrize(
    ('stated', 'spoil', 'another'),
    [
        (CASES['uav_square_0'], too_high, {'step': 0.9}),
        (WALLED, too_high, {'obstacles': []}),
        (FAR, without_a_pull, {'goal': [61.0, 0.0]}),  # infeasible
    ],
)
def test_a_certificate_holds_for_its_problem_until_spoilt(tool, tmp_path, stated, spoil, another):
    problem, made, (code, out, error) = solve(tool, tmp_path, stated)
    known = json.loads(made.read_text())
    if stated is FAR:
        assert (code, out, error.count('\n')) == (3, '', 1)
        assert 'beyond what' in error
        assert WORD not in error  # infeasibility is proved
    else:
        assert (code, known['lower_bound']) == (0, json.loads(out)['lower_bound'])
    code, out, _ = tool('verify', made, '--problem', problem)
    assert code == 0
    assert '1 holds' in out
    assert out.count('inf') == (2 if stated is FAR else 0)
    spoil(known)
    spoilt = tmp_path / 'spoilt.json'
    spoilt.write_text(json.dumps(known))
    code, out, _ = tool('verify', spoilt)
    assert code == 1
    assert '1 DOES NOT HOLD' in out
    problem.write_text(json.dumps({**stated, **another}))
    code, _, error = tool('verify', made, '--problem', problem)
    assert code == 2
    assert 'not for' in error


@pytest.mark.parametrize('text', ['', '{}', '{"format": NaN}', '[]'])
def test_what_is_no_certificate_is_bad_input(tool, tmp_path, text):
    file = tmp_path / 'broken.json'
    file.write_text(text)
    code, out, error = tool('verify', file)
    assert (code, out) == (2, '')  # no header of an empty table
    assert error.count('\n') == 1


def test_a_huge_file_is_refused_before_it_is_taken_apart(tool, tmp_path, monkeypatch):
    file = tmp_path / 'huge.json'
    with file.open('wb') as made:
        made.truncate(1 << 30)  # sparse
    monkeypatch.setattr(document, 'parsed', lambda text: pytest.fail('it was'))
    code, _, error = tool('verify', file)
    assert code == 2
    assert 'bytes are read' in error


def test_a_plan_without_a_certificate_is_printed_and_says_so(tool, tmp_path, monkeypatch):
    unproved = Mock(side_effect=Unproved('no certificate: one tangent proves 3'))
    monkeypatch.setattr('orbimpc_ros.mpc.proof.document.certificate_of', unproved)
    _, made, (code, out, error) = solve(tool, tmp_path, CASES['uav_square_0'])
    assert code == 1
    assert json.loads(out)['status'] == 'optimal'
    assert 'one tangent proves' in error
    assert not made.exists()


def lost(known):
    """Yield replayed ticks without their plans."""
    for each in replayed(known):
        yield replace(
            each, decision=replace(each.decision, plan=None, status=Status.FAILED, catch=None)
        )


BROKEN = ['', '[]', '{"lower_bound": "much"}', '{"refuted": 1}', f'{{"lower_bound": {10**400}}}']


def test_certificates_in_a_bag_are_verified_each_as_it_is(tool, tmp_path):
    _, certificate, _ = solve(tool, tmp_path, CASES['uav_square_0'])
    sound = certificate.read_text()
    spoilt = json.loads(sound)
    too_high(spoilt)
    made, layout = (STORE.types[f'std_msgs/msg/{name}'] for name in KINDS)
    kind = made.__msgtype__
    early = 3 * 10**9  # [ns] end of three ticks
    messages = [each for each in bags.raw(GOLDEN / 'spacecraft') if each.stamp < early]
    for text in (*BROKEN, sound, json.dumps(spoilt)):
        message = made(layout([], 0), np.frombuffer(text.encode(), np.uint8))
        data = bytes(STORE.serialize_cdr(message, kind))
        messages.append(messages[0]._replace(topic='/certificate', type=kind, data=data))
    bag = write(tmp_path / 'bag', messages, bags.notes(GOLDEN / 'spacecraft'))
    code, out, _ = tool('verify', bag)
    assert code == 1
    assert f'{len(BROKEN) + 1} DOES NOT HOLD' in out
    assert '4 holds' in out  # three of them are of ticks


@pytest.mark.parametrize('rows', [3, 5])
def test_where_what_a_search_left_proves_less_there_is_no_certificate(tool, monkeypatch, rows):
    """Whether the certificate proves too little, or is refused."""

    def poor(problem, state, goals, proof):
        leaf = one(np.zeros((rows, 2)), np.zeros(rows))
        return certificate_of(problem, state, goals, replace(proof, tree=leaf))

    monkeypatch.setattr('orbimpc_ros.tool.verify.certificate_of', poor)
    code, out, _ = tool('verify', GOLDEN / 'retrieval', '--tick', 3)
    assert code == 0
    assert '1 no certificate' in out


@pytest.mark.parametrize(
    ('bag', 'words', 'said'),
    [
        ('disturbed', (), '\n20 holds, 1 nothing claimed'),
        ('dubins', ('--tick', 10), '\n1 holds'),
        ('spacecraft', (), '\n19 holds, '),
        ('obstacles', (), '\n30 holds'),
        ('lander', ('--tick', 18), '\n1 holds'),
    ],
)
def test_every_tick_of_a_bag_holds(tool, tmp_path, bag, words, said):
    code, out, _ = tool('verify', GOLDEN / bag, *words, '--out', tmp_path)
    assert code == 0
    assert said in out
    made = sorted(tmp_path.iterdir())
    assert len(made) == int(said.split()[0])
    assert tool('verify', made[-1])[0] == 0
    assert 'no certificate' not in out
    assert out.count('inf') == 2 * {'disturbed': 1, 'obstacles': 2}.get(bag, 0)  # infeasible


def test_ticks_of_a_wing_hold_within_a_cone(tool, tmp_path):
    first = rewritten(GOLDEN / 'cessna', tmp_path / 'bag', lambda m: m if m.stamp < 1e10 else None)
    code, out, _ = tool('verify', first, '--out', tmp_path / 'made')
    assert code == 0
    assert '5 nothing claimed' in out
    assert int(re.search(r'(\d+) holds', out)[1]) >= 33  # of 40
    # Searches round differently on other processors: the other bounds are proved up to rounding.
    others = [line.split()[2:4] for line in out.splitlines() if 'another search' in line]
    assert all(float(claimed) - float(proved) < 1e-7 for claimed, proved in others)
    known = [json.loads(file.read_text()).get('limits', {}) for file in tmp_path.glob('made/*')]
    assert {each['cones'][0]['least'] for each in known if 'cones' in each} == {0.8}


def test_what_is_not_refuted_says_so_and_leaves_no_file(tool, tmp_path, monkeypatch):
    monkeypatch.setattr('orbimpc_ros.mpc.solve.refute._proves', lambda *_: False)
    problem, made, (code, _, error) = solve(tool, tmp_path, FAR)
    assert code == 3
    assert 'beyond what' in error
    assert WORD in error
    assert not made.exists()
    code, _, plainly = tool('solve', problem)
    assert (code, plainly) == (3, error)


def test_before_which_time_nothing_catches_is_proved(tool, tmp_path):
    code, out, _ = tool('verify', *WING, '--out', tmp_path)
    assert code == 0
    assert '2 holds' in out
    code, out, _ = tool('verify', tmp_path / 'tick_00009_catch.json')
    assert code == 0
    assert out.split()[4:8] == ['catch', '2.5', '2.5', '4']


def without_refutations(monkeypatch):
    monkeypatch.setattr('orbimpc_ros.mpc.solve.refute._proves', lambda *_: False)


def without_plans(monkeypatch):
    monkeypatch.setattr('orbimpc_ros.tool.replay.replayed', lost)


def without_bounds(monkeypatch):
    monkeypatch.setattr('orbimpc_ros.mpc.plan.Plan.lower_bound', 0.0)


FALSE, PLAN = 'DOES NOT HOLD: ', 'a trajectory costs'
OTHER = 'it planned another catch, or none'
# Claims of a tick, what is missing during verification, and the expected output.
CLAIMS = [
    (DISTURBED, {'lower_bound': BEATEN}, None, (FALSE + PLAN,)),
    (DISTURBED, {'lower_bound': BEATEN}, without_bounds, (FALSE + PLAN,)),
    (DISTURBED, {'lower_bound': 1e-3}, without_plans, (FALSE, 'the replay is ')),
    (DISTURBED, {'catch_bound': 3.0}, without_plans, (FALSE, 'the replay seeks')),
    (DISTURBED, {'status': 'infeasible'}, None, (f'{FALSE}the replay is optimal',)),
    (WING, {'lower_bound': 1e3}, None, (FALSE + PLAN,)),
    *((WING, {'lower_bound': 1e3, 'earliest_catch': at}, None, (OTHER, '1 no certificate, 1 holds'))
      for at in (3.0, float('nan'))),
    (WING, {'catch_bound': 3.5}, None, (f'{FALSE}a plan catches the goal at',)),
    (WING, {}, without_refutations,
     ('no refutation of a catch at step 1 was found', '1 holds, 1 no certificate')),
]  # fmt: skip


@pytest.mark.parametrize(('at', 'claims', 'lacking', 'said'), CLAIMS)
def test_a_claim_fails_where_a_plan_is_against_it(tool, monkeypatch, at, claims, lacking, said):
    claiming(monkeypatch, claims)
    if lacking:
        lacking(monkeypatch)
    code, out, _ = tool('verify', *at)
    assert code == said[0].startswith(FALSE)
    assert all(words in out for words in said)


def claiming(monkeypatch, claims):
    read = replay.fields
    monkeypatch.setattr(replay, 'fields', lambda tick: {**read(tick), **claims})


def test_a_time_that_excludes_no_step_has_no_row(tool, monkeypatch):
    claiming(monkeypatch, {'catch_bound': 0.5})
    assert 'catch' not in tool('verify', *WING)[1]
