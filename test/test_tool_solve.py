# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""`orbimpc solve` as a user meets it: a process with a file, an answer, an exit code."""

import copy
import json
import subprocess
import sys
from unittest.mock import Mock

import numpy as np
import pytest
import yaml
from harness import TOOL, orbimpc, python, run
from problems import ANSWERS, CASES

from orbimpc_ros.tool import cli

PLANAR = ['uav_square_0', 'uav_hexagon_0', 'dubins_hull']
FIELDS = {
    *('status', 'objective', 'lower_bound', 'gap', 'nodes', 'solve_time_ms', 'positions'),
    *('rotations', 'projected', 'speed_fraction', 'command'),
}


def case(**changes):
    """Return the square-floor case with fields replaced; dotted names reach nested fields."""
    mapping = copy.deepcopy(CASES['uav_square_0'])
    for path, value in changes.items():
        *way, last = path.split('.')
        inner = mapping
        for step in way:
            inner = inner[step]
        if value is ...:
            del inner[last]
        else:
            inner[last] = value
    return mapping


@pytest.fixture
def solve(tmp_path, tool):
    """Return a function that solves text or a mapping: (exit code, stdout, stderr)."""

    def run(problem):
        (tmp_path / 'problem').write_text(
            problem if isinstance(problem, str) else json.dumps(problem)
        )
        return tool('solve', tmp_path / 'problem')

    return run


def test_a_file_with_a_hazard_is_solved_around_it(solve):
    away = {'centre': [50.0, 50.0], 'radius': 0.5, 'velocity': [0.0, 0.0]}
    free = json.loads(solve(case(hazards=[away]))[1])
    met = {**away, 'centre': free['positions'][2]}
    code, out, _ = solve(case(hazards=[met]))
    places = np.array(json.loads(out)['positions'])
    assert code == 0
    assert np.linalg.norm(places - met['centre'], axis=1).min() >= 0.5 - 1e-6


@pytest.mark.parametrize('name', PLANAR)
def test_reference_case_reaches_the_known_optimum(solve, name):
    code, out, _ = solve(CASES[name])
    answer = json.loads(out)
    known = ANSWERS[name]['objective']
    assert code == 0
    assert set(answer) == FIELDS
    assert answer['status'] == 'optimal'
    assert answer['objective'] == pytest.approx(known, rel=1e-4)
    assert answer['lower_bound'] <= answer['objective']
    assert answer['lower_bound'] <= known * (1 + 1e-4)
    rotations, first = np.array(answer['rotations']), answer['command']
    steps = CASES[name]['horizon'] + 1
    assert np.shape(answer['positions']) == (steps, 2)
    assert rotations.shape == np.shape(answer['projected']) == (steps, 2, 2)
    np.testing.assert_allclose(answer['speed_fraction'], np.linalg.norm(rotations[:, :, 0], axis=1))
    assert first['speed_fraction'] == pytest.approx(answer['speed_fraction'][1])
    np.testing.assert_allclose(first['rotation'], answer['projected'][1])
    assert len(first['body_rate']) == 1


GOAL, WEIGHTS = CASES['uav_square_0']['goal'], {'input': 0.05, 'terminal': 10.0}
AS_YAML = yaml.safe_dump(CASES['uav_square_0']).replace(' 1.0\n', ' 1e0\n')
SAME = {
    'YAML reads like JSON': (CASES['uav_square_0'], AS_YAML),
    'an absent weight is zero': (
        case(weights=WEIGHTS), case(weights=WEIGHTS | {'position': 0.0, 'length': 0.0})
    ),
    'one goal stands for every step': (CASES['uav_square_0'], case(goal=[GOAL] * 5)),
}  # fmt: skip


@pytest.mark.parametrize('same', SAME.values(), ids=SAME)
def test_problems_that_are_the_same_cost_the_same(solve, same):
    first, second = (json.loads(solve(each)[1])['objective'] for each in same)
    assert first == pytest.approx(second)


BALL, BOX = {'centre': [2.0, 0.0], 'radius': 0.5}, {'min': [0, 3], 'max': [1, 4]}
SPACE, MOVING = {'centre': [2, 0, 0], 'radius': 1}, {**BALL, 'velocity': [0, 1]}
# Errors that only files can have; out of range values are refused elsewhere.
BAD = {
    'missing horizon': ({'horizon': ...}, 'horizon'),
    'missing state': ({'state': ...}, 'state'),
    'missing position': ({'state.position': ...}, 'position'),
    'missing faces': ({'floor.faces': ...}, 'faces'),
    'unknown field': ({'horizont': 5}, 'horizont'),
    'unknown weight': ({'weights.inputs': 1.0}, 'inputs'),
    'unknown floor': ({'floor.shape': 'triangle'}, 'none | polygon | circle'),
    'floor is a list': ({'floor.shape': ['none']}, 'floor.shape'),
    'terminal is a list': ({'terminal': []}, 'penalty | constraint'),
    'weight is null': ({'weights.input': None}, 'weights.input'),
    'position ragged': ({'state.position': [0.0, [0.0]]}, 'state.position'),
    'position a mapping': ({'state.position': {'x': 0}}, 'state.position'),
    'goal empty': ({'goal': []}, 'goal'),
    'goals ragged': ({'goal': [[0.0, 0.0]] * 4 + [[0.0]]}, 'goal'),
    'rotation a number': ({'state.rotation': 1.0}, 'state.rotation'),
    'velocity at order 1': ({'state.velocity': [0.0, 0.0]}, 'velocity'),
    'obstacles not a list': ({'obstacles': {'min': [0, 0], 'max': [1, 1]}}, 'obstacles'),
    'obstacle without max': ({'obstacles': [{'min': [0.0, 0.0]}]}, 'max'),
    'ball without radius': ({'obstacles': [{'centre': [2.0, 0.0]}]}, 'obstacles'),
    'second hazard': ({'hazards': [MOVING, {**MOVING, 'radius': -1}]}, 'hazards[1].radius is -1'),
    'hazard a number': ({'hazards': [5]}, 'hazards[0] is 5'),
    'hazard without velocity': ({'hazards': [BALL]}, 'hazards[0] field velocity'),
    'hazard without shifts': ({'hazards': [{**BOX, 'times': [0, 1]}]}, 'hazards[0] field shifts'),
    'velocity too short': ({'hazards': [{**BALL, 'velocity': [1.0]}]}, 'hazards[0].velocity'),
    'hazard in space': ({'hazards': [{**SPACE, 'velocity': [1, 0, 0]}]}, 'hazards is 3'),
    'approach without cone': ({'approach': {'direction': [0.0, 1.0]}}, 'approach'),
    'approach of no goal': ({'approach': {'cone': 0.3}}, 'goal_attitude'),
    'cone a number in quotes': ({'approach': {'cone': '0.3'}}, "approach.cone is '0.3'"),
    'direction a word': ({'approach': {'cone': 0.3, 'direction': 'north'}}, 'approach'),
    'attitude too small': ({'goal_attitude': [[1.0, 0.0]]}, 'goal_attitude'),
    'attitude no rotation': ({'goal_attitude': [[2.0, 0.0], [0.0, 2.0]]}, 'state.wanted'),
    'corner cutting a word': ({'no_corner_cutting': 'yes'}, 'no_corner_cutting'),
}


BAD_TEXT = {
    'empty': ('', 'problem is '),
    'a list': ('[1, 2]', 'problem is '),
    'a word': ('hello', 'problem is '),
    'a tag': ('!!python/object/apply:os.system [ls]', 'malformed'),
    'a date': ('dimension: 2020-01-01', 'dimension'),
    'a key that is a number': ('1: 2', 'not a name'),
    'a key with a line break': ('{"a\\nb": 1}', 'a b'),
    'control characters': ('{"a\\u001b[31m": 1}', 'unknown problem field'),
}


BAD_CASES = {name: (case(**changes), culprit) for name, (changes, culprit) in BAD.items()}


@pytest.mark.parametrize(('problem', 'culprit'), [*BAD_CASES.values(), *BAD_TEXT.values()])
def test_what_is_wrong_is_named_in_one_line(solve, problem, culprit):
    code, out, err = solve(problem)
    assert (code, out) == (cli.BAD_INPUT, '')
    assert err.count('\n') == 1
    assert err.endswith('\n')
    assert culprit in err
    assert '; ' in err  # and a remedy


def test_a_process_reads_standard_input_and_keeps_tracebacks_to_itself():
    done, bad = (orbimpc('solve', '-', text=json.dumps(case(horizon=each))) for each in (5, 0))
    assert (done.returncode, done.stderr) == (0, '')
    assert json.loads(done.stdout)['status'] == 'optimal'
    assert bad.returncode == cli.BAD_INPUT
    assert bad.stderr == 'orbimpc: horizon is 0; allowed: an integer in [1, 500]\n'


def test_a_process_without_output_or_input_still_works(tmp_path, monkeypatch):
    (tmp_path / 'problem').write_text(json.dumps(case(horizon=5)))
    monkeypatch.setattr(sys, 'stdout', None)  # as after >&-
    assert cli.main(['solve', str(tmp_path / 'problem')]) == 0
    monkeypatch.setattr(sys, 'stdin', None)
    assert cli.main(['solve', '-']) == cli.BAD_INPUT


@pytest.mark.parametrize('command', cli.COMMANDS)
def test_help_of_a_command_has_the_exit_codes_within_80_columns(command, capsys, monkeypatch):
    monkeypatch.setenv('COLUMNS', '80')
    with pytest.raises(SystemExit):
        cli.main([command, '--help'])
    out = capsys.readouterr().out
    assert 'exit codes: 0 done, 1 failed' in out
    assert max(map(len, out.splitlines())) <= 80


@pytest.mark.parametrize('name', ['uav_square_0', 'uav3_hull_0', 'spacecraft_fuel0.1'])
def test_on_a_terminal_a_plan_is_a_table(solve, monkeypatch, name):
    answer = json.loads(solve(CASES[name])[1])
    monkeypatch.setattr(sys.stdout, 'isatty', lambda: True)
    lines = solve(CASES[name])[1].splitlines()
    assert lines[0].startswith(f'status      {answer["status"]}, gap 0')
    assert max(map(len, lines)) <= 80
    dimension = CASES[name]['dimension']
    rows = np.array([line.split() for line in lines[6:]], dtype=float)
    assert rows[:, 1 : 1 + dimension] == pytest.approx(np.array(answer['positions']), abs=1e-3)
    assert rows[:, 1 + dimension] == pytest.approx(answer['speed_fraction'], abs=1e-3)


def test_an_interruption_at_any_time_is_one_line(capsys, monkeypatch):
    monkeypatch.setattr(cli, '_parser', Mock(side_effect=KeyboardInterrupt))
    assert cli.main(['solve', '-']) == cli.INTERRUPTED
    assert capsys.readouterr().err == 'orbimpc: interrupted\n'


def test_the_tool_can_be_interrupted_before_it_has_imported_what_takes_long():
    """Imports before the command must be quick: interrupted during them, it prints a traceback."""
    words = (
        'import sys, orbimpc_ros.tool.cli; print({"numpy", "scipy", "rclpy"} & set(sys.modules))'
    )
    assert python(words).stdout == 'set()\n'


def test_output_that_the_disk_does_not_take_is_a_failure_in_one_line(tmp_path):
    (tmp_path / 'problem').write_text(json.dumps(case()))
    words = [*TOOL, 'solve', str(tmp_path / 'problem')]
    with open('/dev/full', 'w') as full:
        done = run(*words, capture_output=False, stdout=full, stderr=subprocess.PIPE)
    assert done.returncode == cli.FAILED
    assert done.stderr == 'orbimpc: output: no space left on device\n'


def test_a_search_that_would_take_hours_ends_at_its_limit_with_a_bound(tool, tmp_path):
    """Sixty steps, twenty-four faces: too many combinations for any search."""
    floor = {'shape': 'polygon', 'faces': 24, 'fraction': 0.9}
    limits = {'horizon': 60, 'step': 0.3, 'max_rate': 0.7, 'floor': floor}
    (tmp_path / 'long.json').write_text(json.dumps(case(**limits, goal=[0.3, 0.2])))
    code, out, _ = tool('solve', tmp_path / 'long.json', '--time-limit', 1)
    assert code == 0
    told = json.loads(out)
    assert told['status'] == 'feasible'
    assert 0.0 <= told['lower_bound'] < told['objective']
