# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The runs of a study: what they draw, how they are flown, what is measured."""

import json
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
from studies import SMALL

from orbimpc_ros.lab.study import trial
from orbimpc_ros.lab.study.controllers import controller_named
from orbimpc_ros.lab.study.design import FORECAST_KINDS, differences, run_of, study_of
from orbimpc_ros.lab.study.settings import SETTINGS, resolved
from orbimpc_ros.mpc.problem import Floor
from orbimpc_ros.world.flight import fly
from orbimpc_ros.world.rope import TrueMotion
from orbimpc_ros.world.scenario import retrieval_problem

CASADI = pytest.mark.skipif(
    find_spec('casadi') is None, reason="no casadi: pip install 'orbimpc_ros[study]'"
)


def test_a_run_depends_on_the_seed_and_its_number_alone():
    first, again = run_of(SMALL, 2), run_of(replace(SMALL, runs=900), 2)
    assert first.drawn == again.drawn
    assert first.noise_seed == again.noise_seed
    for other in (run_of(SMALL, 3), run_of(replace(SMALL, seed=4), 2)):
        assert other.drawn['rope.frequency'] != first.drawn['rope.frequency']
        assert other.noise_seed != first.noise_seed


def test_draws_fill_their_ranges():
    study = replace(SMALL, settings=resolved(['horizon=[3, 5]', 'weights.input=[0.01, 0.1]']))
    runs = [run_of(study, number) for number in range(400)]
    for setting in SETTINGS:
        value = study.settings[setting.name]
        found = [run.drawn[setting.name] for run in runs]
        if isinstance(value, str) or value[0] == value[1]:
            assert set(found) == {value if isinstance(value, str) else value[0]}
        elif setting.is_whole:
            assert set(found) == {3, 4, 5}
        else:
            low, high = value
            assert low <= min(found) < low + 0.03 * (high - low)
            assert high - 0.03 * (high - low) < max(found) <= high
    assert {run.problem.horizon for run in runs} == {3, 4, 5}
    assert runs[0].problem.weights.input == runs[0].drawn['weights.input']


def test_fixing_a_setting_changes_no_other_draw():
    fixed = run_of(replace(SMALL, settings=resolved(['rope.frequency=0.1'])), 1).drawn
    free = run_of(SMALL, 1).drawn
    assert fixed['rope.frequency'] == 0.1
    assert {**fixed, 'rope.frequency': free['rope.frequency']} == free


def test_the_scenario_is_what_was_drawn():
    run = run_of(replace(SMALL, settings=resolved(['start.speed_fraction=0.5'])), 0)
    scenario, drawn = run.scenario, run.drawn
    assert scenario.start.fraction == 0.5
    assert scenario.start.position.tolist() == [drawn['start.x'], drawn['start.y']]
    heading = scenario.start.attitude[:, 0]
    assert np.arctan2(heading[1], heading[0]) == pytest.approx(drawn['start.heading'])
    assert scenario.rope.center.tolist() == [drawn['rope.center.x'], drawn['rope.center.y']]
    assert scenario.rope.frequency == drawn['rope.frequency']
    assert (scenario.capture_radius, scenario.max_ticks) == (0.15, 60)


def test_the_problem_is_the_retrievals_with_the_true_floor():
    expected = replace(retrieval_problem(), floor=Floor('circle'))
    assert run_of(SMALL, 0).problem == expected


def test_a_study_survives_json():
    study = replace(SMALL, settings=resolved(['floor.shape=none', 'max_rate=[0.5, 1]']))
    assert study_of(json.loads(json.dumps(study.as_json())), 'file') == study
    assert differences(study, SMALL) == ['floor.shape', 'max_rate']


def flown(changes=(), **fields):
    study = replace(SMALL, settings=resolved(changes), **fields)
    return trial.flown(study, [0])


def test_everyone_sees_the_same_forecast():
    asked = []

    class Asked:
        def observe(self, sighting):
            asked.append(sighting)

        def at(self, times):
            return times

        def reset(self):
            raise AssertionError

    shared = trial.Shared(Asked())
    for ticks in (2, 3):
        shared.reset()
        found = []
        for tick in range(ticks):
            shared.observe(tick)
            found.append(shared.at(float(tick)))
        assert found == [0.0, 1.0, 2.0][:ticks]
    assert asked == [0, 1, 2]
    assert len(shared.spent) == 3


@CASADI
def test_rows_add_up():
    for row in flown():
        assert row['caught'] == (row['closest'] <= row['capture_radius'])
        assert len(row['tick_ms']) == len(row['forecast_ms']) == row['ticks']
        assert row['ticks'] - 1 <= row['time'] <= row['ticks']
        assert row['closest'] < row['farthest']
        assert row['projection_loss'] < 1e-12  # in the plane a rotation loses no speed
        assert row['certified'] <= row['ticks']
        assert (row['certified'] > 0) == (row['controller'] == 'orbitope')
        assert row['compared'] == (row['ticks'] if row['controller'] == 'orbitope' else 0)


def test_a_rope_out_of_reach_is_not_caught():
    (row,) = flown(['max_ticks=3', 'rope.center.x=50'], controllers=('pursuit',))
    assert (row['caught'], row['time'], row['ticks']) == (False, None, 3)
    assert row['closest'] > 30.0


def test_noise_reaches_the_controllers_but_not_the_flight():
    clean, noisy = (
        flown([f'faults.position_noise={noise}'], controllers=('pursuit',))[0]
        for noise in (0.0, 0.05)
    )
    assert clean['closest'] != noisy['closest']
    assert noisy['projection_loss'] < 1e-12  # what noise does is not the projection's fault
    assert noisy['faults.position_noise'] == 0.05


@pytest.mark.parametrize('kind', FORECAST_KINDS)
def test_every_forecast_flies(kind):
    (row,) = flown(forecast=kind, controllers=('pursuit',))
    assert row['forecast'] == kind


@CASADI
def test_no_plan_of_the_planner_costs_more_than_ipopts():
    """On random ropes, every tick; where IPOPT ends in a worse local optimum it is counted."""
    rows = [row for row in trial.flown(SMALL, range(6)) if row['controller'] == 'orbitope']
    assert all(row['excess'] <= 1e-6 for row in rows)
    assert sum(row['cheaper'] for row in rows) > 0


@CASADI
def test_a_plan_that_costs_more_would_be_noticed():
    run = run_of(SMALL, 0)
    truth = TrueMotion(run.scenario.rope)
    log = fly(controller_named('linearised', run.problem), run.scenario, truth)
    assert max(trial.excesses(run.problem, log.ticks)) > 1e-3
