# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Bad input to any command: one line that names the culprit, exit code 2, and nothing written."""

import json
import shlex
from importlib.util import find_spec
from unittest.mock import Mock

import pytest
import yaml
from bags import GOLDEN

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool import bags, cli, files, settings, study

DUBINS, RETRIEVAL = GOLDEN / 'dubins', GOLDEN / 'retrieval'
REFUSED = {
    '': 'COMMAND',
    'dance': 'dance',
    'solve': 'FILE|-',
    'solve a b': 'unrecognized arguments: b',
    **{f'solve a --time-limit {each}': 'a number in (0, inf)' for each in ('0', '-1', 'nan')},
    'solve a --certificate /dev/null/b': '--certificate /dev/null',
    **{f'solve a --certificate {each}': f'{each}; allowed: a file other' for each in ('.', './a')},
    'demo --set flor.shape=none': 'floor.shape',
    'demo --set step=fast': 'step',
    'demo --set step': 'name=value',
    'demo --set step=.nan': '--set step is nan; allowed: finite',
    'demo --set zzzzzz=1': 'dimension',  # similar to no parameter
    'demo --set horizon=2.5': 'horizon',
    'demo --set floor.fraction=0.9': 'floor.fraction',  # above the limit
    'demo --set rope.center=[1.0': 'rope.center',
    'demo swim': 'swim',
    'demo --out /dev/null/x': '--out',
    'demo retrieval --vehicles 2': '--vehicles',
    'demo fleet --vehicles 65': 'vehicles',
    'demo fleet --set clock=lockstep': 'clock',
    'demo fleet --set rope.frequency=-1': 'rope.frequency',
    'plot nowhere -o out': 'nowhere',
    f'plot {DUBINS} -o thesis.tex --no-animation': '--out',
    **{f'{each} {RETRIEVAL} --tick 26': 'allowed: 0 to 25' for each in ('replay', 'verify')},
    f'replay {RETRIEVAL} --set weights.input=-1': 'weights.input is -1',
    f'replay {RETRIEVAL} --set wait=1': "--set: unknown parameter 'wait'",
    f'replay {RETRIEVAL} --params nowhere.yaml': 'nowhere.yaml',
    f'replay {RETRIEVAL} --namespace uav7': 'without /uav7/odom',
    'replay "a\x1b"': 'a?: missing',  # an escape sequence
    'verify missing.json': 'no such file',
    'verify missing.json --tick 3': '--tick is 3; allowed: only with a bag',
    f'verify {RETRIEVAL} --problem a': '--problem is a; allowed: only with a certificate',
    'study --runs 0': '--runs is 0',
    'study --workers 0': '--workers is 0',
    'study --workers 2 --cluster tcp://127.0.0.1:1': '--workers is 2',
    'study --controllers orbitope,autopilot': 'autopilot',
    'study --controllers lead,lead': 'at most once',
    'study --set capture_radius=0': 'capture_radius',
    'study --resume': '-o DIR',
    'study --resume -o fresh': 'a study to continue',
    'study -o .': 'a folder with files; allowed: a new or an empty folder, or --resume',
    'study nobody': 'a parameter file, or one of',
    'study arduplane': 'rope.center is 5 m away; allowed: farther than a step, 9 m',
    'bench --only chess': 'chess',
    'bench --json /proc/x.json': '--json',  # a folder that accepts no files
    'faults --only weather': '--only',
    'faults --json /nowhere/rows.json': '--json',
}
VIEWER = {
    'view nowhere': 'nowhere',
    f'view {DUBINS} --namespace /uav7': 'without /uav7/odom',
    f'view {DUBINS} --port 70000': '--port',
}
needs_rerun = pytest.mark.skipif(find_spec('rerun') is None, reason='needs the extra view')
CASES = [
    *(pytest.param(*case, id=case[0]) for case in REFUSED.items()),
    *(pytest.param(*case, id=case[0], marks=needs_rerun) for case in VIEWER.items()),
]


def without(package):
    return Mock(side_effect=ModuleNotFoundError(name=package))


MISSING = {
    'faults': ('benchmarks.faults.find_spec', lambda _name: None, 'ros-jazzy-rclpy'),
    f'view {DUBINS}': ('orbimpc_ros.tool.cli.import_module', without('rerun'), 'rerun-sdk'),
    'demo cessna': ('orbimpc_ros.sim.vehicle.import_module', without('jsbsim'), 'jsbsim>=1.2'),
}


@pytest.mark.parametrize('line', MISSING)
def test_what_is_not_installed_is_named(line, tmp_path, monkeypatch, capsys):
    absent, instead, hint = MISSING[line]
    monkeypatch.setattr(absent, instead)
    test_bad_input_is_one_line_and_writes_nothing(line, hint, tmp_path, monkeypatch, capsys)


@pytest.mark.parametrize(('line', 'culprit'), CASES)
def test_bad_input_is_one_line_and_writes_nothing(line, culprit, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(study, 'workers', Mock(side_effect=AssertionError('nothing is flown')))
    (tmp_path / 'thesis.tex').write_text('precious')
    try:
        code = cli.main(shlex.split(line))
    except SystemExit as error:
        code = error.code
    out, err = capsys.readouterr()
    assert (code, out, err.count('\n')) == (cli.BAD_INPUT, '', 1)
    assert culprit in err
    assert [file.name for file in tmp_path.iterdir()] == ['thesis.tex']
    assert (tmp_path / 'thesis.tex').read_text() == 'precious'


# --- damaged files, and contents that blow up parsers


def refusal(read, file):
    """Return the line with which a file is refused; None if it is accepted."""
    try:
        read(file)
    except BadInput as error:
        return str(error)
    return None


HALF = files.LARGEST // 2
SHAPES = {
    'many keys': (json.dumps(dict.fromkeys(map(str, range(15_000)))), ''),
    'the same key, often': ('{' + '"a":1,' * 30_000 + '"a":1}', 'malformed (field a given twice'),
    'a number of many digits': ('a: ' + '7' * HALF, 'malformed'),
    'deep lists': ('[' * HALF, 'malformed'),
    'deep blocks': ('- ' * HALF, 'malformed'),
    'deep JSON': ('{"a":' * (HALF // 5), 'malformed'),
    'laughs': ('a: &a [x]\n' + '\n'.join(f'b{i}: [*a, *a]' for i in range(9)), 'aliases'),
    'itself': ('&a [*a]', 'aliases'),
    'a list for a key': ('? [a]\n: b', 'malformed'),
    'no time': ('a: !!timestamp x', 'malformed'),
    'no truth': ('- !!bool x', 'malformed'),
    'no number': ('a: [.nan]', 'a is nan; allowed: finite'),
    'merged': ('<<: ' * 1000 + '{}', 'malformed'),
    'a word that no path may have': (r'a: "\0"', 'words'),
    'not UTF-8': ('\udcff', 'not UTF-8'),
    'too large': ('#' * (files.LARGEST + 1), f'at most {files.LARGEST} bytes'),
}


@pytest.mark.parametrize(('text', 'culprit'), SHAPES.values(), ids=SHAPES)
def test_shapes_that_blow_up_parsers_end(tmp_path, text, culprit):
    """Without an assertion on time: a parser of quadratic time would never end."""
    file = tmp_path / 'file'
    file.write_bytes(text.encode(errors='surrogateescape'))
    line = refusal(lambda path: files.read(str(path)), file)
    assert (line is None) == (culprit == '')
    assert culprit in (line or '')


BAD_PARAMETERS = {
    **{text: (text, 'ros__parameters') for text in ('[]', 'a: 1', 'a: {b: 1}')},
    'no parameters': ('a: {ros__parameters: 3}', 'ros__parameters'),
    'a list for a number': ('/**: {ros__parameters: {step: [1.0]}}', 'step'),
    'a mapping for a number': ('/**: {ros__parameters: {step: {a: 1}}}', 'step.a'),
    'nothing for a number': ('/**: {ros__parameters: {step: null}}', 'step is None'),
    'words in a list': ('/**: {ros__parameters: {obstacles: [a]}}', 'obstacles'),
    'only the simulator': ('/**/sim: {ros__parameters: {seed: 3}}', 'for the simulator alone'),
    'a list in a list': ('/**: {ros__parameters: {obstacles: [[1.0]]}}', 'obstacles'),
}


@pytest.mark.parametrize(('text', 'said'), BAD_PARAMETERS.values(), ids=BAD_PARAMETERS)
def test_bad_parameters_of_a_file_are_named(tmp_path, text, said):
    file = tmp_path / 'mine.yaml'
    file.write_text(text)
    line = refusal(settings.resolve, file)
    assert line is not None
    assert said in line
    assert '; ' in line  # and a remedy


def test_notes_of_another_version_are_told(tmp_path):
    notes = {'parameters': yaml.safe_dump({'/**': {'ros__parameters': {'warp': 9.0}}})}
    bags.BagWriter(tmp_path / 'bag', [], notes).close()
    assert bags.notes(tmp_path / 'bag') == notes
    line = refusal(settings.of_bag, tmp_path / 'bag')
    assert line is not None
    assert f"{tmp_path / 'bag'}: parameters: unknown parameter 'warp'; known: " in line
