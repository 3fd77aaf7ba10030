# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Studies of vehicles as they are: draws, rivals, statistics, results, report."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from dying_engine import FAILURES

from orbimpc_ros.lab.study.vehicles import statistics
from orbimpc_ros.mpc.errors import BadInput

pytest.importorskip('rclpy', reason='needs ROS 2, or pip install orbimpc_ros[ros]')

from orbimpc_ros.lab.study.vehicles import flights, results, tuning
from orbimpc_ros.lab.study.vehicles.pilots import ORBITOPE, PILOTS, RIVALS, class_of, pilot
from orbimpc_ros.lab.study.vehicles.pilots.guidance import crabbed
from orbimpc_ros.lab.study.vehicles.pilots.rival import Sight
from orbimpc_ros.lab.study.vehicles.pilots.sampling import _nearest
from orbimpc_ros.lab.study.vehicles.report import report
from orbimpc_ros.lab.study.vehicles.scenario import CONE, NAMES, TRAFFIC, scenario_named
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.problem import State
from orbimpc_ros.ros.parameters import planner_settings, sim_settings
from orbimpc_ros.tool import cli
from orbimpc_ros.tool.io import settings

GUIDANCE = ('pursuit', 'lead', 'proportional')


@pytest.mark.parametrize('name', NAMES)
def test_flights_draw_what_is_allowed_and_one_parameter_does_not_change_another(name):
    scenario = scenario_named(name)
    drawn = [scenario.drawn(3, index) for index in range(3)]
    assert drawn[0] != drawn[1]
    assert drawn == [scenario.drawn(3, index) for index in range(3)]
    assert sim_settings(settings.of_sim(scenario.values | drawn[0])).scenario.max_ticks > 1
    fixed = scenario_named(name, ('rope.amplitude=[0.1, 0.1, 0.0]',)).drawn(3, 0)
    assert fixed == {key: drawn[0][key] for key in drawn[0] if key != 'rope.amplitude'}


def test_the_wind_is_the_simulators_alone():
    scenario = scenario_named('fixed_wing')
    values = scenario.values | scenario.drawn(0, 0)
    assert not planner_settings(values).disturbance.any()
    assert np.linalg.norm(settings.of_sim(values)['wind']) > 0.0


def sight(goal, heading=0.0, wind=(0.0, 0.0), velocity=(0.0, 0.0), steps=12):
    """Of a goal that moves straight on, from the origin at 12 m/s."""
    goal, velocity = np.array(goal), np.array(velocity)
    state = State.at(np.zeros(2), 0.8 * exp(np.array([heading])))
    state = replace(state, attitude=exp(np.array([heading])))

    def ahead(times):
        return goal + np.multiply.outer(np.asarray(times), velocity)

    return Sight(0.0, state, ahead(0.5 * np.arange(1, steps + 1)), ahead, np.array(wind))


def made(name, **tuned):
    return pilot(name, planner_settings(scenario_named('fixed_wing').values), tuned)


@pytest.mark.parametrize('name', RIVALS)
def test_rivals_turn_to_the_side_of_the_goal(name):
    if name == 'nonlinear':
        pytest.importorskip('casadi')
    for side in (1.0, -1.0):
        rival = made(name)
        for _ in range(4):  # a sampling pilot improves from tick to tick
            fraction, rate = rival.steered(sight([30.0, side * 40.0]))
        assert side * rate > 0.05
        assert 0.5 < fraction <= 1.0


def test_the_lead_is_where_both_are_at_the_same_time():
    lead = made('lead')
    course, fraction = lead._meeting(sight([60.0, 0.0], wind=(0.0, 2.0), velocity=(0.0, 7.0)))
    flown = 15.0 * fraction * np.array([math.cos(course), math.sin(course)]) + [0.0, 2.0]
    closing = flown - [0.0, 7.0]
    assert closing[1] == pytest.approx(0.0, abs=0.3)
    assert closing[0] > 5.0


def test_proportional_navigation_holds_a_course_on_which_nothing_turns():
    rate = made('proportional').steered(sight([60.0, 0.0], velocity=(3.0, 0.0)))[1]
    assert rate == pytest.approx(0.0, abs=1e-12)
    assert made('proportional').steered(sight([60.0, 0.0], velocity=(0.0, 4.0)))[1] > 0.0


def test_a_crabbed_course_leads_along_the_way():
    wind, way = np.array([-2.0, 4.0]), np.array([3.0, 1.0])
    course = crabbed(way, 12.0, wind)
    over_ground = 12.0 * np.array([math.cos(course), math.sin(course)]) + wind
    across = over_ground[0] * way[1] - over_ground[1] * way[0]
    assert across == pytest.approx(0.0, abs=1e-9)
    assert over_ground @ way > 0.0


def test_samples_see_a_catch_between_the_ends_of_a_step():
    assert _nearest(np.array([[[-3.0, 1.0], [3.0, 1.0], [4.0, 1.0]]]))[0] == pytest.approx(
        [1.0, math.hypot(3.0, 1.0)]
    )


def test_intervals_and_tests_are_those_of_the_textbook():
    low, high = statistics.wilson(8, 10)  # Wilson (1927): 49.0 to 94.3 %
    assert (low, high) == pytest.approx((0.490, 0.943), abs=1e-3)
    assert statistics.wilson(0, 20)[0] == 0.0
    assert statistics.sign_test(np.array([-1.0] * 8 + [0.0] + [1.0] * 2)) == pytest.approx(
        0.109, abs=1e-3
    )
    assert statistics.sign_test(np.zeros(3)) == 1.0
    rng = np.random.default_rng(1)
    low, high = statistics.of_mean(rng.normal(1.0, 2.0, 400))
    assert low < 1.0 < high
    assert high - low == pytest.approx(2 * 1.96 * 2.0 / 20.0, rel=0.15)


def test_the_ratio_of_pairs_knows_that_they_are_pairs():
    """Twice as long flight by flight: whichever flights are drawn, the ratio is a half."""
    theirs = np.random.default_rng(2).uniform(5.0, 50.0, 60)
    for of in (np.median, np.mean):
        assert statistics.of_ratio(of, 0.5 * theirs, theirs) == pytest.approx((0.5, 0.5))
    shuffled = np.random.default_rng(3).permutation(theirs)
    low, high = statistics.of_ratio(np.mean, shuffled, theirs)
    assert low < 0.9 < 1.1 < high


def flight(name, index, time):
    return {
        'pilot': name, 'seed': 0, 'index': index, 'caught': time is not None, 'time': time,
        'closest': 0.1, 'p50_ms': 1.0, 'longest_ms': 2.0, 'touched': False, 'unplanned': 0,
        'ticks': 9,
    }  # fmt: skip


def test_a_report_says_first_where_the_planner_loses():
    scenario = scenario_named('fixed_wing')
    rows = {
        ORBITOPE: [flight(ORBITOPE, k, 10.0 if k < 10 else None) for k in range(20)],
        'pursuit': [flight('pursuit', k, 9.0) for k in range(20)],
    }
    text = report(scenario, rows)
    assert '- Loses to `pursuit` in the share caught.' in text.splitlines()[4]
    assert '- Loses to `pursuit` in the median time to the catch: never against 9.00 s.' in text
    assert '`pursuit`: -50.0 points of catches, -288.9% of its mean time saved' in text
    assert '| `pursuit` | 0% | 100% |' in text
    assert 'Loses to nobody' in report(
        scenario, {ORBITOPE: rows['pursuit'], 'lead': rows[ORBITOPE]}
    )


def test_flights_that_a_file_has_are_not_flown_again(tmp_path, monkeypatch):
    file, count = tmp_path / 'flights.jsonl', []

    def flown(job):
        count.append(job.index)
        return flight(job.pilot, job.index, 1.0)

    monkeypatch.setattr(results, 'flown', flown)
    jobs = [results.Job('fixed_wing', (), 'lead', 0, index, {}) for index in range(4)]
    results.completed(file, jobs[:2], 1)
    file.write_text(file.read_text() + '{"pilot": "lead", "se')  # cut off in the middle
    assert [row['index'] for row in results.completed(file, jobs, 1)] == [0, 1, 2, 3]
    assert count == [0, 1, 2, 3]
    assert len(results.completed(file, jobs, 1)) == len(count) == 4
    other = [replace(jobs[0], changes=('gust=0.0',))]
    with pytest.raises(BadInput, match='flights of another study'):
        results.completed(file, other, 1)


def test_the_search_for_settings_is_the_same_every_time_and_starts_with_the_defaults():
    for name in RIVALS:
        tried = tuning.candidates(name, {CONE, TRAFFIC})
        assert tried == tuning.candidates(name, {CONE, TRAFFIC})
        space = class_of(name).SPACE
        assert tried[0] == {key: each.default for key, each in space.items()}
        for each in tried:
            assert all(
                space[key].low * 0.999 <= v <= space[key].high * 1.001 for key, v in each.items()
            )
        assert set(tuning.candidates(name, ())[0]) == {k for k in space if not space[k].need}
    rows = [flight('lead', 0, 10.0), flight('lead', 1, None)]
    assert tuning.score(rows, 60.0) == 65.0


def test_from_the_command_line_a_scenario_is_flown_reported_and_gone_on_with(tmp_path, capsys):
    words = ['study', '--scenario', 'fixed_wing', '--controllers', 'pursuit,lead', '--runs', '2']
    words += ['--set', 'max_ticks=6', '--workers', '1', '-o', str(tmp_path / 'study')]
    assert cli.main(words) == 0
    text = (tmp_path / 'study' / 'report.md').read_text()
    assert capsys.readouterr().out == text
    assert '2 flights by each pilot' in text
    assert {file.name for file in (tmp_path / 'study').glob('*.png')} == {
        'caught.png',
        'caught-dark.png',
    }
    before = (tmp_path / 'study' / 'flights.jsonl').read_text()
    assert cli.main(words) == 0
    assert (tmp_path / 'study' / 'flights.jsonl').read_text() == before
    rows = [json.loads(line) for line in before.splitlines()[1:]]
    assert {row['ticks'] for row in rows} == {6}
    assert cli.main([*words[:2], 'elsewhere']) == 2
    assert cli.main(['study', '--tune']) == 2


@pytest.mark.parametrize('name', [ORBITOPE, *GUIDANCE, 'sampling', 'linearised'])
def test_pilots_keep_their_limits_and_see_the_same(name):
    from orbimpc_ros.lab.study.vehicles.flights import row

    scenario = scenario_named('fixed_wing', ('max_ticks=4',))
    flown = [row(scenario, name, 1, 0, {}) for _ in range(2)]
    assert flown[0]['ticks'] == 4
    assert flown[0]['stalls'] == flown[0]['unplanned'] == 0
    assert flown[0]['closest'] == flown[1]['closest']
    assert set(PILOTS) == {ORBITOPE, *RIVALS}


def test_what_is_tuned_is_known_to_the_rival():
    for name in NAMES:
        for rival, numbers in tuning.tuned_of(name).items():
            assert set(numbers) <= set(class_of(rival).SPACE)


def test_samples_can_be_drawn_where_the_speed_is_constant():
    values = scenario_named('retrieval', ('floor.fraction=1.0',)).values
    rival = pilot('sampling', planner_settings(values), {})
    fraction, rate = rival.steered(sight([3.0, 4.0], steps=5))
    assert fraction == pytest.approx(1.0)
    assert math.isfinite(rate)


def test_an_engine_is_studied_beside_its_own_guidance(tmp_path, capsys):
    pytest.importorskip('jsbsim')
    near = 'rope.center=[400.0, 100.0, 0.0]'
    words = ['study', '--engine', 'cessna', '--controllers', 'lead,waypoint', '--runs', '1']
    words += ['--set', near, '--seed', '700', '--workers', '1', '-o', str(tmp_path / 'study')]
    assert cli.main(words) == 0
    text = (tmp_path / 'study' / 'report.md').read_text()
    assert 'least airspeed' in text
    assert '- `waypoint` missed' in text
    rows = [json.loads(line) for line in (tmp_path / 'study' / 'flights.jsonl').open()][1:]
    assert [row['pilot'] for row in rows] == ['lead', 'waypoint']
    for row in rows:
        assert row['apart'] >= row['closest'] - 1e-9
        assert row['airspeed'] > 1.1 * 27.6
        assert 0.0 < row['bank'] < 0.6
        assert 5.0 < row['closing'] < 40.0


def test_a_study_of_arrivals_tells_where_they_end(tmp_path, capsys):
    """In the vehicle of this package that an engine is compared with."""
    words = ['study', '--scenario', 'servicer', '--set', 'vehicle=continuous', '--runs', '1']
    assert cli.main([*words, '--workers', '1', '-o', str(tmp_path / 'study')]) == 0
    text = (tmp_path / 'study' / 'report.md').read_text()
    assert 'distance at the end [m]' in text
    assert '- `orbitope` missed 0: none.' in text
    assert 'rival' not in text
    assert 'attitude' not in text  # which only an engine's inner loop tracks
    (row,) = [json.loads(line) for line in (tmp_path / 'study' / 'flights.jsonl').open()][1:]
    assert row['missed'] < 0.1
    assert row['speed'] < 0.05
    assert 0.0 < row['tracking'] < 1.0
    assert 'off the plan after a tick' in text


def test_rivals_do_not_fly_in_space(tmp_path, capsys):
    words = ['study', '--engine', 'servicer', '--controllers', 'lead', '-o', str(tmp_path / 'no')]
    assert cli.main(words) == 2
    assert '--controllers is lead; allowed: each of orbitope' in capsys.readouterr().err


def test_an_attitude_in_space_is_drawn_as_a_unit_quaternion():
    scenario = scenario_named('servicer')
    drawn = [scenario.drawn(0, k)['start.orientation'] for k in range(50)]
    np.testing.assert_allclose(np.linalg.norm(drawn, axis=1), 1.0)
    np.testing.assert_allclose(np.mean(drawn, axis=0), 0.0, atol=0.3)


def test_an_engine_that_fails_ends_its_flight_and_not_the_study(monkeypatch):
    monkeypatch.setattr('orbimpc_ros.world.engines.class_of', lambda _: FAILURES['Stopping'])
    scenario = scenario_named('cessna')
    row = flights.row(scenario, 'lead', 700, 0, {})
    assert row['failed'] == 'broken: stopped at t = 2.000 s'
    assert row['caught'] is False
    assert row['tracking'] is None
    assert '- `lead` missed 1: 0 (broken: stopped' in report(scenario, {'lead': [row]})


def test_only_an_engine_has_guidance_of_its_own():
    with pytest.raises(BadInput, match='--controllers is waypoint'):
        flights.row(scenario_named('fixed_wing'), 'waypoint', 0, 0, {})
