# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""`orbimpc verify` as a user meets it: certificates and bags in, a table and an exit code out."""

import json
from pathlib import Path

import numpy as np
import pytest
from bags import GOLDEN, write
from rosbags.typesys import Stores, get_typestore

pytest.importorskip('rclpy')

from orbimpc_ros.loop.intercept import steps_before
from orbimpc_ros.mpc.proof import reading
from orbimpc_ros.mpc.proof.document import verified
from orbimpc_ros.mpc.proof.prove import WORD, Unproved, certificate_of
from orbimpc_ros.mpc.proof.refute import catches_refuted, refutation_of
from orbimpc_ros.ros.parameters import planner_settings
from orbimpc_ros.tool import bags, cli, settings
from orbimpc_ros.tool.replay.recording import recording_of
from orbimpc_ros.tool.replay.resolving import replayed

STORE = get_typestore(Stores.ROS2_JAZZY)
KINDS = ('UInt8MultiArray', 'MultiArrayLayout')
RETRIEVAL = GOLDEN / 'retrieval'
CASES = json.loads((Path(__file__).parent / 'reference' / 'cases.json').read_text())

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


BROKEN = ['', '[]', '{"lower_bound": "much"}', '{"refuted": 1}', f'{{"lower_bound": {10**400}}}']


def bag_of(path, *texts):
    """Write a bag of a flight in which these certificates were published."""
    made, layout = (STORE.types[f'std_msgs/msg/{name}'] for name in KINDS)
    kind, messages = made.__msgtype__, bags.raw(RETRIEVAL)
    for text in texts:
        message = made(layout([], 0), np.frombuffer(text.encode(), np.uint8))
        data = bytes(STORE.serialize_cdr(message, kind))
        messages.append(messages[0]._replace(topic='/certificate', type=kind, data=data))
    return write(path, messages, {})


def test_certificates_in_a_bag_are_verified_each_as_it_is(run, tmp_path, solved):
    sound = solved[1].read_text()
    spoilt = json.loads(sound)
    too_high(spoilt)
    bag = bag_of(tmp_path / 'bag', *BROKEN, sound, json.dumps(spoilt))
    code, out, _ = run('verify', bag, '--out', tmp_path / 'made')
    assert code == 1
    assert out.endswith(f'{len(BROKEN) + 1} DOES NOT HOLD, 1 holds\n')
    assert out.count('DOES NOT HOLD: ') == len(BROKEN)  # with the reason
    files = sorted((tmp_path / 'made').iterdir())
    assert len(files) == len(BROKEN) + 2
    assert run('verify', files[len(BROKEN)])[0] == 0


def test_a_bag_without_certificates_says_how_to_have_them(run):
    code, out, error = run('verify', RETRIEVAL)
    assert (code, out) == (2, '')
    assert 'publish_certificate' in error


def claims(bag, *numbers):
    """Yield what is proved of the ticks of a bag: of plans, of what is infeasible, of catches."""
    values = settings.of_bag(bag)
    ticks = replayed(recording_of(bag), planner_settings(values), True)
    for number, each in enumerate(ticks):
        tick = each.decision
        if numbers and number not in numbers:
            continue
        if tick.infeasible is not None:
            yield refutation_of(tick.infeasible)
        elif tick.plan is not None and tick.plan.proof.lower_bound > 0.0:
            case = tick.problem, tick.state, tick.goals
            yield certificate_of(*case, tick.plan.proof)
        if tick.catch is not None:
            claimed = each.recorded.answer['catch_bound']
            count = steps_before(claimed, tick.catch.sought.problem.step)
            if count:
                yield catches_refuted(tick.catch.sought, count)


@pytest.mark.parametrize(
    ('bag', 'numbers', 'count'),
    [
        ('disturbed', (), 20),
        ('dubins', (), 20),
        ('spacecraft', (), 19),
        ('obstacles', (), 30),
        ('lander', (18,), 1),
        ('fixed_wing', (9,), 2),
    ],
)
def test_what_a_flight_claims_holds_in_exact_arithmetic(bag, numbers, count):
    found = [
        verified(reading.parsed(each.text().encode())) for each in claims(GOLDEN / bag, *numbers)
    ]
    assert len(found) == count
    assert all(each.holds for each in found)
    infeasible = {'disturbed': 1, 'obstacles': 2}.get(bag, 0)
    assert sum(each.claimed == np.inf for each in found) == infeasible


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
