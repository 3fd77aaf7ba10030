# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc study``: small studies end to end, and what is refused in one line."""

import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from studies import SMALL, complaint, same

pytest.importorskip('distributed', reason="no distributed: pip install 'orbimpc_ros[study]'")
pytest.importorskip('pyarrow', reason="no pyarrow: pip install 'orbimpc_ros[study]'")
pytest.importorskip('casadi', reason="no casadi: pip install 'orbimpc_ros[study]'")

import distributed
import pyarrow as pa
import pyarrow.parquet as pq

from orbimpc_ros.lab.study import cluster, columns, store, trial
from orbimpc_ros.lab.study.controllers import CONTROLLERS, require_installed
from orbimpc_ros.lab.study.settings import SETTINGS
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool import cli

ROOT = Path(__file__).parents[1]
PATIENCE = 300.0  # [s] on a busy machine


def command(*words):
    return [sys.executable, '-m', 'orbimpc_ros.tool.cli', 'study', *map(str, words)]


def rows_of(folder):
    return pq.read_table(folder / 'runs.parquet').to_pylist()


@pytest.mark.parametrize(
    ('words', 'named'),
    [
        (['--runs', '0'], '--runs is 0'),
        (['--seed', '-1'], '--seed is -1'),
        (['--controllers', 'orbitope,autopilot'], 'autopilot'),
        (['--controllers', 'pursuit,pursuit'], 'at most once'),
        (['--forecast', 'oracle'], 'oracle'),
        (['--set', 'rope.freq=1'], 'rope.frequency'),
        (['--set', 'capture_radius'], 'name=value'),
        (['--set', 'capture_radius=0'], 'capture_radius'),
        (['--set', 'capture_radius=[0.2, 0.1]'], 'low <= high'),
        (['--set', 'capture_radius=[1, 2, 3]'], 'capture_radius'),
        (['--set', 'horizon=2.5'], 'horizon'),
        (['--set', 'floor.shape=star'], 'none | polygon | circle'),
        (['--set', 'floor.shape=polygon', '--set', 'floor.fraction=[0.1, 0.9]'], 'floor.fraction'),
        (['--set', 'max_rate=[0, 4]'], 'max_rate'),
        (['--resume'], '-o DIR'),
        (['--resume', '-o', 'nowhere'], 'nowhere'),
        (['--workers', '0'], '--workers is 0'),
        (['--workers', '2', '--scheduler', 'tcp://127.0.0.1:1'], '--workers is 2'),
        (['-o', '/proc/study'], '/proc/study'),
    ],
)
def test_bad_input_is_one_line(words, named, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code, line = complaint(capsys, *words)
    assert code == 2
    assert named in line
    assert not list(tmp_path.rglob('study.json'))


@pytest.mark.parametrize('address', ['tcp://127.0.0.1:1', 'pigeon://coop', '127.0.0.1:no'])
def test_a_scheduler_that_does_not_answer_leaves_nothing(address, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(cluster, 'PATIENCE', 0.5)
    folder = tmp_path / 'study'
    for _ in range(2):  # nothing that would be in the way of a second try
        code = cli.main(['study', '--scheduler', address, '-o', str(folder)])
        assert code == 2
        assert f'--scheduler is {address}' in capsys.readouterr().err.splitlines()[-1]
    assert not list(folder.iterdir())


def test_what_is_not_installed_is_named(monkeypatch, capsys):
    for module in ('pyarrow', 'casadi', 'distributed'):
        with monkeypatch.context() as patched:
            patched.setitem(sys.modules, module, None)  # as if it were not there
            code, line = complaint(capsys, '--runs', '1')
            assert code == 2
            assert module in line
            assert "pip install 'orbimpc_ros[study]'" in line


def test_without_casadi_the_others_fly(monkeypatch):
    monkeypatch.setitem(sys.modules, 'casadi', None)
    require_installed(['orbitope', 'linearised', 'pursuit'])
    with pytest.raises(BadInput, match='casadi'):
        require_installed(list(CONTROLLERS))


@pytest.fixture(scope='module')
def finished(tmp_path_factory):
    """Return the folder of a small study with everyone, two workers, and what was printed."""
    folder = tmp_path_factory.mktemp('done') / 'study'
    done = subprocess.run(
        command('--runs', 6, '--seed', 3, '--workers', 2, '-o', folder),
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        cwd=ROOT,
    )
    assert done.returncode == 0, done.stderr
    return folder, done


def test_a_study_is_the_same_whoever_flies_it(finished):
    folder, _ = finished
    same(rows_of(folder), trial.flown(SMALL, range(6)))


def test_a_study_is_reported(finished):
    folder, done = finished
    text = (folder / 'report.md').read_text()
    for name in CONTROLLERS:
        assert f'`{name}`' in text
    assert '| caught | 100.0% |' in text
    assert 'IPOPT solved' in text
    assert '`rope.frequency` | [0.02, 0.3] Hz' in text
    assert '| caught | 100.0% |' in done.stdout
    assert (folder / 'study.png').read_bytes().startswith(b'\x89PNG')
    assert sorted(p.name for p in folder.iterdir()) == [
        *('report.md', 'runs.parquet', 'study-dark.png', 'study.json', 'study.png')
    ]


def test_a_finished_study_is_only_reported_again(finished, capsys):
    folder, _ = finished
    before = (folder / 'runs.parquet').read_bytes()
    (folder / 'report.md').unlink()
    assert cli.main(['study', '--resume', '-o', str(folder)]) == 0
    assert (folder / 'report.md').is_file()
    assert (folder / 'runs.parquet').read_bytes() == before
    (folder / 'runs.parquet').write_bytes(before[:-100])
    assert complaint(capsys, '--resume', '-o', folder)[0] == 2
    (folder / 'runs.parquet').write_bytes(before)


def test_a_cheaper_plan_of_ipopts_fails_the_study(finished, tmp_path, capsys):
    folder = shutil.copytree(finished[0], tmp_path / 'study')
    table = pq.read_table(folder / 'runs.parquet')
    rows = table.to_pylist()
    rows[0]['excess'] = 2e-3
    pq.write_table(pa.Table.from_pylist(rows, table.schema), folder / 'runs.parquet')
    assert cli.main(['study', '--resume', '-o', str(folder)]) == 1
    assert 'cheaper by 2.0e-03' in capsys.readouterr().out


@pytest.fixture(scope='module')
def peers():
    """Return the address of a scheduler with a worker, both in this process."""
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=':0'
    ) as cluster:
        yield cluster.scheduler_address


def test_ctrl_c_keeps_what_is_flown_and_the_study_goes_on(peers, tmp_path):
    folder = tmp_path / 'study'
    words = ['--runs', 60, '--seed', 3, '--controllers', 'linearised', '--workers', 1]
    # Its own session: the signal goes to its workers as well, as from a terminal.
    process = subprocess.Popen(
        command(*words, '-o', folder),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        start_new_session=True,
    )
    parts, end = folder / store.PARTS, time.monotonic() + PATIENCE
    while len(list(parts.glob('*.parquet'))) < 3 and time.monotonic() < end:
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130, err
    assert 'Traceback' not in err
    kept = len(list(parts.glob('*.parquet')))
    assert f'kept {kept} of 60 runs' in out
    assert f'orbimpc study --resume -o {folder}' in out
    assert 3 <= kept < 60
    assert cli.main(['study', '--resume', '--scheduler', peers, '-o', str(folder)]) == 0
    assert not parts.exists()
    study = replace(SMALL, runs=60, controllers=('linearised',))
    same(
        rows_of(folder)[:5] + rows_of(folder)[-5:], trial.flown(study, [*range(5), *range(55, 60)])
    )


def test_an_existing_cluster_is_used(peers, tmp_path):
    folder = tmp_path / 'study'
    words = ['--runs', '2', '--seed', '3', '--controllers', 'pursuit', '-o', str(folder)]
    assert cli.main(['study', '--scheduler', peers, *words]) == 0
    same(rows_of(folder), trial.flown(replace(SMALL, runs=2, controllers=('pursuit',)), range(2)))


def test_a_cluster_without_workers_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(cluster, 'PATIENCE', 0.5)
    with distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=':0') as peers:
        words = ['--scheduler', peers.scheduler_address, '-o', str(tmp_path / 'study')]
        code = cli.main(['study', *words])
    assert code == 2
    assert 'has workers' in capsys.readouterr().err


def test_a_run_that_fails_is_reported(peers, monkeypatch, tmp_path, capsys):
    def fail(study, numbers):
        raise RuntimeError('out of luck')

    monkeypatch.setattr(cluster, 'flown', fail)
    words = ['--runs', '2', '--controllers', 'pursuit', '-o', str(tmp_path / 'study')]
    assert cli.main(['study', '--scheduler', peers, *words]) == 1
    assert 'RuntimeError: out of luck' in capsys.readouterr().err


def test_the_columns_are_documented():
    text = (ROOT / 'docs' / 'study.md').read_text()
    for column in (*columns.KEYS, *columns.RESULTS):
        unit = f' [{column.unit}]' if column.unit else ''
        assert f'| `{column.name}` | {column.kind} | {column.text}{unit} |' in text
    for setting in SETTINGS:
        assert f'| `{setting.name}` |' in text
