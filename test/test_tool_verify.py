# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""`orbimpc verify` as a user meets it: certificates and bags in, a table and an exit code out."""

import json
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool import cli
from orbimpc_ros.tool.io.bag.writer import BagWriter
from orbimpc_ros.tool.io.topics import Topic
from orbimpc_ros.tool.replay import recording
from orbimpc_ros.tool.verify import _recorded

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = STORE.types
PROOFS = (Topic('/certificate', 'std_msgs/msg/UInt8MultiArray'),)
HERE = Path(__file__).parent
CASES = json.loads((HERE / 'reference' / 'cases.json').read_text())


@pytest.fixture
def run(capsys):
    """Return a function that runs a command: (exit code, stdout, stderr)."""

    def ran(*words):
        capsys.readouterr()
        code = cli.main([str(word) for word in words])
        return code, *capsys.readouterr()

    return ran


@pytest.fixture
def solved(tmp_path, run):
    """Return a problem's file, and that of the certificate of its plan."""
    problem, made = tmp_path / 'problem.json', tmp_path / 'certificate.json'
    problem.write_text(json.dumps(CASES['uav_square_0']))
    code, out, _ = run('solve', problem, '--certificate', made)
    assert code == 0
    assert json.loads(made.read_text())['lower_bound'] == json.loads(out)['lower_bound']
    return problem, made


def test_a_certificate_holds(run, solved):
    problem, made = solved
    code, out, _ = run('verify', made, '--problem', problem)
    assert code == 0
    assert '1 holds' in out


def test_a_bound_that_is_too_high_fails(run, solved):
    _, made = solved
    known = json.loads(made.read_text())
    made.write_text(json.dumps({**known, 'lower_bound': 1.001 * known['lower_bound']}))
    code, out, _ = run('verify', made)
    assert code == 1
    assert '1 DOES NOT HOLD' in out


def test_a_certificate_of_another_problem_is_refused(run, solved):
    problem, made = solved
    problem.write_text(json.dumps({**CASES['uav_square_0'], 'step': 0.9}))
    code, _, error = run('verify', made, '--problem', problem)
    assert code == 2
    assert 'not of' in error


@pytest.mark.parametrize('text', ['', '{}', '{"format": NaN}', '[]'])
def test_what_is_no_certificate_is_bad_input(run, tmp_path, text):
    file = tmp_path / 'broken.json'
    file.write_text(text)
    code, _, error = run('verify', file)
    assert code == 2
    assert error.count('\n') == 1


def test_a_missing_file_is_bad_input(run, tmp_path):
    code, _, error = run('verify', tmp_path / 'missing.json')
    assert code == 2
    assert 'No such file' in error


def test_a_plan_without_a_certificate_is_printed_and_says_so(run, tmp_path):
    problem = tmp_path / 'problem.json'
    problem.write_text(json.dumps({**CASES['uav_square_0'], 'max_acceleration': 9.0}))
    code, out, error = run('solve', problem, '--certificate', tmp_path / 'none.json')
    assert code == 1
    assert json.loads(out)['status'] == 'optimal'
    assert 'none yet for max_acceleration' in error
    assert not (tmp_path / 'none.json').exists()


def test_a_bound_above_what_a_trajectory_costs_fails(run, monkeypatch):
    monkeypatch.setitem(recording.READERS, 'lower_bound', lambda value: 1.01 * float(value))
    code, out, _ = run('verify', HERE / 'golden' / 'disturbed', '--tick', 3)
    assert code == 1
    assert 'DOES NOT HOLD: a trajectory costs' in out


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
    (known,) = _recorded(bag_of(tmp_path / 'run', text), '').items()
    assert known == (json.loads(text)['lower_bound'], json.loads(text))


@pytest.mark.parametrize('text', ['', '[]', '{"lower_bound": "much"}'])
def test_a_bag_with_what_is_no_certificate_is_bad_input(tmp_path, text):
    with pytest.raises(BadInput, match='certificate'):
        _recorded(bag_of(tmp_path / 'run', text), '')


def test_a_recorded_certificate_that_does_not_prove_its_bound_fails(run, tmp_path, monkeypatch):
    asked = 'verify', HERE / 'golden' / 'disturbed', '--tick', 3
    assert run(*asked, '--out', tmp_path)[0] == 0
    known = json.loads((tmp_path / 'tick_00003.json').read_text())
    known['tree']['point'] = [[0.0, 0.0]] * len(known['tree']['point'])
    recorded = {known['lower_bound']: known}
    monkeypatch.setattr('orbimpc_ros.tool.verify._recorded', lambda *_: recorded)
    code, out, _ = run(*asked)
    assert code == 1
    assert '1 DOES NOT HOLD' in out


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


def test_ticks_among_walls_hold(run):
    code, out, _ = run('verify', HERE / 'golden' / 'obstacles')
    assert code == 0
    assert '28 holds, 2 nothing claimed' in out


def test_a_tick_within_cones_holds(run):
    code, out, _ = run('verify', HERE / 'golden' / 'lander', '--tick', 18)
    assert code == 0
    assert '1 holds' in out


def test_ticks_of_a_bag_hold(run, tmp_path):
    bag = HERE / 'golden' / 'disturbed'
    code, out, _ = run('verify', bag, '--out', tmp_path / 'made')
    assert code == 0
    assert '20 holds, 1 nothing claimed' in out
    assert len(list((tmp_path / 'made').iterdir())) == 20
    assert run('verify', tmp_path / 'made' / 'tick_00003.json')[0] == 0
