# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Bad input to any command: one line that names the culprit, exit code 2, and nothing written."""

import shlex

import pytest
from bags import GOLDEN
from drawing import needs_rerun

from orbimpc_ros.tool import cli
from orbimpc_ros.tool.study import flights

pytest.importorskip('rclpy')
DUBINS, RETRIEVAL = GOLDEN / 'dubins', GOLDEN / 'retrieval'
REFUSED = {
    '': 'COMMAND',
    'dance': 'dance',
    'solve': 'FILE|-',
    'solve a b': 'unrecognized arguments: b',
    **{f'solve a --time-limit {limit}': '--time-limit' for limit in ('0', '-1', 'nan', 'soon')},
    'demo --set flor.shape=none': 'floor.shape',
    'demo --set step=fast': 'step',
    'demo --set step': 'name=value',
    'demo --set zzzzzz=1': 'dimension',  # unlike anything
    'demo --set horizon=2.5': 'horizon',
    'demo --set floor.fraction=0.9': 'floor.fraction',  # above the limit
    'demo --set rope.center=[1.0]': 'rope.center',
    'demo --set rope.center=[1.0': 'rope.center',
    'demo swim': 'swim',
    'demo --out /dev/null/x': '--out',
    'demo retrieval --vehicles 2': '--vehicles',
    'demo fleet --vehicles 0': 'vehicles',
    'demo fleet --vehicles 65': 'vehicles',
    'demo fleet --vehicles all': '--vehicles',
    'demo fleet --set clock=lockstep': 'clock',
    'demo fleet --set rope.frequency=-1': 'rope.frequency',
    'plot nowhere -o out': 'nowhere',
    f'plot {DUBINS} -o thesis.tex --no-animation': '--out',
    f'plot {DUBINS} -o thesis.tex/below --no-animation': '--out',
    f'plot {DUBINS} -o out --namespace /uav7': 'without /uav7/odom',
    f'replay {RETRIEVAL} --tick 26': '--tick is 26; allowed: 0 to 25',
    f'replay {RETRIEVAL} --tick -1': '--tick is -1',
    f'replay {RETRIEVAL} --set weights.input=-1': 'weights.input is -1',
    f'replay {RETRIEVAL} --set wait=1': "--set: unknown parameter 'wait'",
    f'replay {RETRIEVAL} --params nowhere.yaml': 'nowhere.yaml',
    f'replay {RETRIEVAL} --namespace uav7': 'without /uav7/odom',
    'verify missing.json': 'No such file',
    'study --runs 0': '--runs is 0',
    'study --seed -1': '--seed is -1',
    'study --workers 0': '--workers is 0',
    'study --workers 2 --cluster tcp://127.0.0.1:1': '--workers is 2',
    'study --controllers orbitope,autopilot': 'autopilot',
    'study --controllers lead,lead': 'at most once',
    'study --set rope.freq=1': 'rope.frequency',
    'study --set capture_radius=0': 'capture_radius',
    'study --resume': '-o DIR',
    'study -o .': 'other files',
    'study nobody': 'a parameter file, or one of',
    'bench --only chess': 'chess',
    'bench --json /dev/null/x': '--json',
    'bench --json /proc/x.json': '--json',  # a folder that takes no files
    'bench --json /tmp': '--json',
    'faults --only weather': '--only',
    'faults --json /nowhere/rows.json': '--json',
}
VIEWER = {
    'view nowhere': 'nowhere',
    f'view {DUBINS} --namespace /uav7': 'without /uav7/odom',
    f'view {DUBINS} --port 70000': '--port',
}
CASES = [
    *(pytest.param(*case, id=case[0]) for case in REFUSED.items()),
    *(pytest.param(*case, id=case[0], marks=needs_rerun) for case in VIEWER.items()),
]


def no_workers(*_given):
    raise AssertionError('nothing was to be flown')


def no_module(_name):
    raise ModuleNotFoundError(name='jsbsim')


MISSING = {
    'faults': ('benchmarks.faults.find_spec', lambda _name: None, 'ros-jazzy-rclpy'),
    f'view {DUBINS}': ('orbimpc_ros.tool.view.installed', lambda: False, 'rerun-sdk'),
    'demo cessna': ('orbimpc_ros.sim.engine_vehicle.import_module', no_module, 'jsbsim>=1.2'),
}


@pytest.mark.parametrize('line', MISSING)
def test_what_is_not_installed_is_named(line, tmp_path, monkeypatch, capsys):
    absent, instead, hint = MISSING[line]
    monkeypatch.setattr(absent, instead)
    test_bad_input_is_one_line_and_writes_nothing(line, hint, tmp_path, monkeypatch, capsys)


@pytest.mark.parametrize(('line', 'culprit'), CASES)
def test_bad_input_is_one_line_and_writes_nothing(line, culprit, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(flights, 'workers', no_workers)
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
