# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc study``: draws of flights, their results, resumed studies, and reports."""

import json
import os
import signal
import subprocess
from concurrent.futures import ThreadPoolExecutor
from unittest.mock import Mock

import numpy as np
import pytest
from dying_engine import FAILURES
from harness import PATIENCE, ROOT, TOOL, alive, children_of, wait_for

from orbimpc_ros.mpc.errors import BadInput, OrbimpcError
from orbimpc_ros.ros.parameters.planner import planner_settings
from orbimpc_ros.sim.parameters import sim_settings
from orbimpc_ros.tool import cli, files, offline, settings, study
from orbimpc_ros.tool.offline import OURS, flown
from orbimpc_ros.tool.settings import config
from orbimpc_ros.tool.study import draws_of, report

STUDIES = sorted(file.stem for file in (ROOT / 'config' / 'studies').glob('*.yaml'))
PLANES = 'arduplane', 'px4'  # which state no goal, and fly past the default one in a step
CONFIGS = [str(file) for file in (ROOT / 'config').glob('*.yaml') if file.stem not in PLANES]


@pytest.mark.parametrize('name', [*STUDIES, *CONFIGS])
def test_flights_draw_what_is_allowed_and_one_parameter_does_not_change_another(name):
    draws = draws_of(name)
    assert draws.of(3, 0) != draws.of(3, 1)
    assert draws.of(3, 1) == draws.of(3, 1)
    assert sim_settings(settings.of_sim(draws.of(3, 0))).max_ticks > 1
    fixed = draws_of(name, ('rope.phase=[0.1, 0.1, 0.0]',)).of(3, 0)
    assert fixed == draws.of(3, 0) | {'rope.phase': (0.1, 0.1, 0.0)}


def test_draws_fill_their_ranges():
    draws = draws_of('retrieval')
    found = np.array([draws.of(5, k)['rope.frequency'] for k in range(400)])
    assert 0.02 <= found.min() < 0.03 < 0.29 < found.max() <= 0.3


def test_the_wind_is_the_simulators_alone():
    values = draws_of('fixed_wing').of(0, 0)
    assert not planner_settings(values).disturbance.any()
    assert np.linalg.norm(settings.of_sim(values)['wind']) > 0.0


def test_a_parameter_file_is_studied_with_goals_all_around_as_far_away_as_its_own():
    draws = draws_of(str(config('fixed_wing.yaml')))
    start, goal = (np.array(draws.values[name]) for name in ('start.position', 'rope.center'))
    away = np.array([draws.of(0, k)['rope.center'] for k in range(60)]) - start
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), np.linalg.norm(goal - start))
    assert np.linalg.norm(away.mean(axis=0)) < 0.4 * np.linalg.norm(goal - start)
    assert not away[:, 2].any()
    among = draws_of(str(config('multirotor.yaml')))  # its boxes could be around a goal
    assert among.of(0, 0)['rope.center'] == among.values['rope.center']
    pads = np.array([draws_of('lander').of(0, k)['rope.center'] for k in range(9)])
    ahead = (pads - [60.0, -30.0, 0.0]) @ [1.0, 4.0, 0.0]
    assert ahead.min() > 0.0
    assert not pads[:, 2].any()  # a lander comes from above


@pytest.mark.parametrize(('name', 'vehicle'), [('rover', 'continuous'), ('spacecraft', 'discrete')])
def test_vehicles_with_lags_fly_continuously_and_those_that_state_none_in_steps(name, vehicle):
    assert draws_of(name).values['vehicle'] == vehicle


def test_a_flight_lasts_as_long_as_its_ticks():
    rover = str(config('rover.yaml'))  # 0.5 m/s, to goals 5 m away
    assert [draws_of(rover, each).limit for each in ((), ('max_ticks=60',))] == [40.0, 12.0]
    assert draws_of('rope', ('step=0.2', 'max_ticks=80')).limit == pytest.approx(8.0)  # of 0.1 s
    assert draws_of('retrieval', ('sim.step=0.2', 'max_ticks=80')).limit == pytest.approx(16.0)


def test_an_attitude_in_space_is_drawn_as_a_unit_quaternion():
    draws = draws_of('servicer')
    drawn = [draws.of(0, k)['start.orientation'] for k in range(50)]
    np.testing.assert_allclose(np.linalg.norm(drawn, axis=1), 1.0)
    np.testing.assert_allclose(np.mean(drawn, axis=0), 0.0, atol=0.3)


def test_a_study_has_what_the_one_it_is_based_on_has():
    base, own = draws_of('retrieval'), draws_of('retrieval_small')
    assert {k for k in own.values if own.values[k] != base.values[k]} == {'capture_radius'}
    assert own.rules == base.rules
    assert draws_of('gates').values == draws_of('crossing').values
    tuned_of = offline.baselines().tuned_of
    assert tuned_of('gates') == tuned_of('crossing') != tuned_of('fixed_wing')


FAR_AWAY = """{about: a, config: retrieval.yaml, set: [], draw: {traffic: {bodies: 1,
    at: {x: [0, 1]}, when: [0, 1], speed: [0, 1], radius: [1, 1], clear: 99}}}"""


@pytest.mark.parametrize(
    ('text', 'named'),
    [
        ('{about: a, set: [], draw: {}}', 'needed: about, config, set, draw'),
        ('{about: a, config: retrieval.yaml, set: [], draw: {seed: {half: 3}}}', 'draw: seed is {'),
        ('{about: a, config: retrieval.yaml, set: [], draw: {seed: 3}}', 'draw: seed is 3'),
        ('{about: a, config: retrieval.yaml, set: [], draw: {seed: [0, 9]}}', r'seed is \d\.\d+'),
        ('{about: a, config: retrieval.yaml, set: [], draw: {stepp: [1, 2]}}', 'stepp'),
        ('{about: a, config: retrieval.yaml, set: [], draw: []}', 'draw is'),
        ('{about: a, config: retrieval.yaml, set: 3, draw: {}}', 'set is 3; allowed: a list'),
        ('{about: a, config: retrieval.yaml, set: [3], draw: {}}', '--set is 3'),
        ('{about: a, config: retrieval.yaml, set: [], draw: {}, margin: 1}', 'margin'),
        ('{about: a, config: ./own.yaml, set: [], draw: {}}', 'config is ./own.yaml; allowed'),
        ('{about: a, config: ../x.yaml, set: [], draw: {}}', 'no such file'),
        (FAR_AWAY, 'no body starts 99 m clear'),
    ],
)
def test_a_malformed_study_is_refused(text, named, tmp_path):
    (tmp_path / 'own.yaml').write_text(text)
    with pytest.raises(BadInput, match=named):
        draws_of(str(tmp_path / 'own.yaml'))


def job(name, controller=OURS, index=0, *changes, seed=1):
    draws = draws_of(name, changes)
    return name, controller, index, draws.of(seed, index)


@pytest.mark.parametrize('name', [OURS, 'pursuit', 'lead', 'proportional'])
def test_controllers_keep_their_limits_and_see_the_same(name):
    first, again = (flown(*job('fixed_wing', name, 0, 'max_ticks=4')) for _ in range(2))
    assert first['ticks'] == 4
    assert first['stalls'] == first['unplanned'] == 0
    assert first['closest'] == again['closest']


def test_a_row_adds_up():
    row = flown(*job('retrieval'))
    assert row['caught']
    assert row['closest'] <= 0.15
    assert row['ticks'] - 1 <= row['time'] <= row['ticks']
    assert row['optimal'] <= row['ticks']
    lost = flown(*job('retrieval', 'pursuit', 0, 'max_ticks=3', 'rope.center=[50.0, 0.0, 0.0]'))
    assert (lost['caught'], lost['time'], lost['ticks']) == (False, None, 3)
    assert lost['closest'] > 30.0


def test_faults_of_the_parameter_file_are_flown():
    noise = 'faults.position_noise=0.1', 'faults.clock_jump=-3.0', 'faults.clock_jump_tick=2'
    noisy, plain = (flown(*job('retrieval', OURS, 0, *faults)) for faults in (noise, ()))
    assert noisy['closest'] != plain['closest'] < noisy['closest'] + 0.5
    lost = flown(*job('retrieval', 'lead', 0, 'faults.dropout=1.0', 'max_ticks=3'))
    assert (lost['ticks'], lost['caught']) == (0, False)
    assert '| 0.0% |' in report(draws_of('retrieval'), {'lead': [lost]})


def test_the_end_of_an_arrival_is_reported():
    """With this package's own vehicle: it takes no engine."""
    row = flown(*job('servicer', OURS, 0, 'vehicle=continuous'))
    assert row['missed'] < 0.1
    assert row['speed'] < 0.05
    assert '| `orbitope` | 100.0% ' in report(draws_of('servicer'), {OURS: [row]})


def test_an_engine_is_studied_beside_its_own_guidance():
    pytest.importorskip('jsbsim')
    near = 'rope.center=[400.0, 100.0, 0.0]', 'max_ticks=60'
    for name in ('lead', 'waypoint'):
        row = flown(*job('cessna', name, 0, *near, seed=700))
        assert row['airspeed'] > 1.1 * 27.6
        assert 0.0 < row['bank'] < 0.6


def test_an_engine_that_fails_ends_its_flight_and_not_the_study(monkeypatch):
    monkeypatch.setattr('orbimpc_ros.sim.vehicle.class_of', lambda _: FAILURES['Stopping'])
    row = flown(*job('cessna', 'lead', 0, seed=700))
    assert row['failed'] == 'broken: stopped at t = 2.000 s'
    assert row['caught'] is False
    assert '| 0.0% | 1 | never |' in report(draws_of('cessna'), {'lead': [row]})


@pytest.mark.parametrize(('study', 'name'), [('servicer', 'lead'), ('fixed_wing', 'waypoint')])
def test_baselines_fly_in_the_plane_and_guidance_where_an_engine_has_it(study, name):
    with pytest.raises(BadInput, match=f'--controllers is {name}'):
        flown(*job(study, name))


def flight(name, index, time):
    return {
        'controller': name, 'index': index, 'caught': time is not None, 'time': time,
        'closest': 0.1, 'p50_ms': 1.0, 'longest_ms': 2.0, 'touched': False, 'unplanned': 0,
        'optimal': 4, 'ticks': 9, 'failed': '',
    }  # fmt: skip


def test_a_report_has_a_row_for_each_controller():
    draws = draws_of('fixed_wing')
    rows = {
        OURS: [flight(OURS, k, 10.0 if k < 10 else None) for k in range(20)],
        'pursuit': [flight('pursuit', k, 9.0) for k in range(20)],
    }
    text = report(draws, rows)
    assert '| `orbitope` | 50.0% (29.9% to 70.1%) | 0.0% | 0 | never |' in text  # Wilson (1927)
    assert '| 9.00 | 9.00 | 0% / 100% |' in text


def test_results_go_on_where_they_were_cut_off_and_only_with_the_same_study(tmp_path):
    file, about = tmp_path / 'flights.jsonl', {'seed': 3, 'version': '1'}
    assert study.rows_of(file, about, resumed=False) == {}
    row = flight(OURS, 0, 1.0)
    with file.open('a') as out:
        out.write(json.dumps(row) + '\n{"controller": "orbitope", "ind')
    assert study.rows_of(file, about, resumed=True) == {(OURS, 0): row}
    assert len(file.read_text().splitlines()) == 2
    for other, named in (({'seed': 4}, 'seed'), ({'version': '2'}, 'version')):
        with pytest.raises(BadInput, match=f'a study with other {named}'):
            study.rows_of(file, about | other, resumed=True)
    for damage in ('{"seed": 3', '{}\n[]\n', '\x00\n', ''):
        file.write_text(damage)
        with pytest.raises(BadInput, match=r'damaged|other'):
            study.rows_of(file, about, resumed=True)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGKILL])
def test_a_signal_leaves_what_is_flown_and_no_process_and_the_study_goes_on(tool, tmp_path, number):
    folder = tmp_path / 'study'
    flown = ('--set', 'max_ticks=2', '--runs', 20, '--workers', 1)
    words = ('study', 'retrieval', *flown, '-o', folder)
    # In a session of its own, so that the signal reaches its workers too, as from a terminal.
    pipes = dict.fromkeys(('stdout', 'stderr'), subprocess.PIPE)
    command = [*TOOL, *map(str, words)]
    process = subprocess.Popen(command, text=True, cwd=ROOT, start_new_session=True, **pipes)
    file = folder / 'flights.jsonl'
    wait_for(lambda: file.exists() and file.read_text().count('\n') > 2)
    workers, interrupted = children_of(process.pid), number == signal.SIGINT
    (os.killpg if interrupted else os.kill)(process.pid, number)
    out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == (130 if interrupted else -number), err
    wait_for(lambda: not any(map(alive, workers)))
    assert 'Traceback' not in err
    kept = file.read_text().splitlines()
    assert f'kept {len(kept) - 1} of 20 flights' in out or not interrupted
    code, out, err = tool(*words, '--resume')
    assert code == 0, err
    assert file.read_text().splitlines()[: len(kept)] == kept
    rows = [json.loads(line) for line in file.read_text().splitlines()[1:]]
    assert sorted(row['index'] for row in rows) == list(range(20))
    assert (folder / 'report.md').read_text() == out
    assert {each.name for each in folder.glob('*.png')} == {'caught.png', 'caught-dark.png'}


def test_the_workers_of_a_cluster_fly_the_same(tmp_path, capsys):
    distributed = pytest.importorskip('distributed')
    words = ['study', 'retrieval', '--set', 'max_ticks=3', '--runs', '2', '-o', str(tmp_path)]
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=':0'
    ) as peers:
        assert cli.main([*words, '--cluster', peers.scheduler_address]) == 0
    rows = [json.loads(line) for line in (tmp_path / 'flights.jsonl').open()][1:]
    for row in rows:
        own = flown(*job('retrieval', OURS, row['index'], 'max_ticks=3', seed=0))
        assert row['closest'] == own['closest']


@pytest.mark.parametrize('address', ['tcp://127.0.0.1:1', 'pigeon://coop', '127.0.0.1:no'])
def test_a_scheduler_that_does_not_answer_is_named(address, monkeypatch):
    pytest.importorskip('distributed')
    monkeypatch.setattr(study, 'PATIENCE', 0.5)
    with pytest.raises(BadInput, match='--cluster is'), study.workers(address, 1):
        pass


def test_a_server_of_another_kind_is_no_scheduler(monkeypatch):
    distributed = pytest.importorskip('distributed')
    # Dask takes the first bytes of HTTP for the length of a message.
    monkeypatch.setattr(distributed, 'Client', Mock(side_effect=MemoryError))
    test_a_scheduler_that_does_not_answer_is_named('tcp://127.0.0.1:80', monkeypatch)


def test_a_flight_that_ends_with_an_error_is_reported(monkeypatch):
    monkeypatch.setattr(offline, 'sim_settings', lambda values: 1 / 0)
    with ThreadPoolExecutor(1) as pool, pytest.raises(OrbimpcError, match='ZeroDivision'):
        list(study.each_flown(pool, [job('retrieval')], lambda: True))


def test_baselines_need_a_clone(monkeypatch, tmp_path):
    monkeypatch.setattr(files, 'CLONE', tmp_path)
    with pytest.raises(BadInput, match='--controllers: not installed; run it from a clone'):
        offline.baselines()
