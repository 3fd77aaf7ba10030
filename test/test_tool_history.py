# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""From a run to its near misses, its summary and its picture."""

import numpy as np
import pytest
from bags import GOLDEN, made_up, rewritten, write

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool import bags, settings, summary
from orbimpc_ros.tool.history import of_bag


def history(distances, captured, **changes):
    """Return a run whose vehicle is, tick by tick, at given distances right of a still rope."""
    positions = np.zeros((len(distances), 3))
    positions[:, 0] = distances
    own = {'capture_radius': 0.1, 'rope.center': (0.0, 0.0, 0.0)}
    fields = {'solve_time_ms': 2.0, 'gap': 1e-6, 'fallback': '', 'speed_fraction': [1.0, 0.6, 0.6]}
    ticks = tuple((10.0 + k, fields) for k in range(len(distances)))
    values = settings.read('{}') | own | changes
    return made_up(positions, values, ticks=ticks, captured=captured)


def test_passing_by_is_closest_on_the_way():
    passing = history([1.0, -1.0], captured=True)
    passing.positions[:, 1] = 0.05
    (approach,) = passing.approaches
    assert approach.time == pytest.approx(10.5)
    assert approach.distance == pytest.approx(0.05)
    np.testing.assert_allclose(approach.vehicle, [0.0, 0.05, 0.0])


def test_near_misses_are_local_minima_that_came_near():
    run = history([3.0, 0.15, 0.9, 0.18, 0.6, 2.0, 0.5, 2.0, 0.05], captured=True)
    assert [m.distance for m in run.near_misses] == pytest.approx([0.15, 0.18])
    assert [m.time for m in run.near_misses] == pytest.approx([11.0, 13.0])
    assert run.capture.time == pytest.approx(18.0)


def test_a_catch_by_contact_is_no_near_miss():
    """An engine may see the contact a little farther from the middle than the radius."""
    run = history([3.0, 0.15, 0.9, 0.12], captured=True)
    run.positions[2:, 1] = [0.0, 0.13]
    assert [m.time for m in run.near_misses] == pytest.approx([11.0])


def test_what_is_not_captured_has_no_capture():
    assert history([1.0, 0.5], captured=False).capture is None
    assert history([1.0], captured=True).capture is None


def test_summary_tells_the_story():
    text = summary.text(history([3.0, 0.15, 0.9, 0.05], captured=True))
    assert 't = 3.00 s, 50 mm from the rope' in text
    assert '1: 0.15 m at 1.0 s' in text
    assert 'p50 2.0 ms, p99 2.0 ms, max 2.0 ms' in text
    assert '1.0e-06' in text


def test_summary_of_a_run_without_ticks():
    run = history([1.0, 2.0], captured=False)
    object.__setattr__(run, 'ticks', ())
    text = summary.text(run)
    assert 'no' in text
    assert text.count('unknown') == 2


@pytest.fixture
def file(tmp_path):
    """Return a parameter file."""
    path = tmp_path / 'parameters.yaml'
    path.write_text(
        '/**:\n  ros__parameters:\n    floor: {shape: polygon, faces: 6}\n    step: 0.5\n'
    )
    return path


def test_settings_are_defaults_then_file_then_changes(file):
    values = settings.resolve(file, ['step=2', 'rope.center=[1, 2.5, 0]', 'terminal=constraint'])
    assert values['floor.shape'] == 'polygon'
    assert values['floor.faces'] == 6
    assert values['step'] == 2.0
    assert isinstance(values['step'], float)
    assert values['rope.center'] == (1.0, 2.5, 0.0)
    assert values['terminal'] == 'constraint'
    assert values['horizon'] == settings.ROWS['horizon'].default


def test_settings_survive_their_file(file, tmp_path):
    values = settings.resolve(file, ['step=2'])
    text = settings.write(tmp_path / 'written.yaml', values, use_sim_time=True)
    read = settings.read(text)
    assert read.pop('use_sim_time') is True
    assert {k: list(v) if isinstance(v, tuple) else v for k, v in values.items()} == {
        k: list(v) if isinstance(v, tuple) else v for k, v in read.items()
    }


OWN = """
/**: {ros__parameters: {step: 0.5, forward: 15.0, wind: [1.0, 0.0, 0.0]}}
/**/planner: {ros__parameters: {horizon: 7}}
/**/sim: {ros__parameters: {forward: 14.0, step: 0.5, wind: [3.0, 0.0, 0.0], max_ticks: 9}}
"""


def test_a_goal_is_caught_within_the_simulators_radius():
    assert history([1.0], True, capture_radius=0.3).radius == 0.3
    own = {'capture_radius': 5.0, 'sim.capture_radius': 0.1}
    assert history([1.0], True, **own).radius == 0.1


def test_what_both_nodes_and_the_simulator_alone_are_given_holds_in_either_order():
    both = ['wind=[1.0, 0.0, 0.0]', 'sim.wind=[3.0, 0.0, 0.0]']
    for changes in (both, both[::-1]):
        values = settings.changed(settings.read('{}'), changes)
        assert values['wind'] == (1.0, 0.0, 0.0)
        assert settings.of_sim(values)['wind'] == (3.0, 0.0, 0.0)
    assert 'sim.wind' not in settings.changed(values, ['wind=[2.0, 0.0, 0.0]'])


def test_a_simulator_may_have_values_of_its_own():
    """Those that differ from the planner's, however they were given, and through a file."""
    values = settings.read(OWN)
    assert {name for name in values if name.startswith('sim.')} == {'sim.forward', 'sim.wind'}
    assert (values['forward'], values['step'], values['max_ticks']) == (15.0, 0.5, 9)
    told = settings.of_sim(values)
    assert (told['forward'], told['wind'], told['horizon']) == (14.0, (3.0, 0.0, 0.0), 7)
    assert not any(name.startswith('sim.') for name in told)
    assert settings.read(settings.text(values)) == values
    for_both = settings.changed(values, ['wind=[2.0, 0.0, 0.0]'])
    assert settings.of_sim(for_both)['wind'] == for_both['wind'] == (2.0, 0.0, 0.0)
    alone = settings.changed(values, ['sim.step=0.25'])
    assert (alone['step'], settings.of_sim(alone)['step']) == (0.5, 0.25)
    with pytest.raises(BadInput, match=r'sim\.horizon'):
        settings.changed(values, ['sim.horizon=3'])


@pytest.mark.parametrize('text', ['[]', 'a: 1', 'a: {b: 1}', 'a: {ros__parameters: 3}'])
def test_what_is_not_a_parameter_file_is_refused(tmp_path, text):
    path = tmp_path / 'parameters.yaml'
    path.write_text(text)
    with pytest.raises(BadInput, match='ros__parameters'):
        settings.resolve(path)


def test_repeated_odometry_counts_once(tmp_path):
    raw = bags.raw(GOLDEN / 'retrieval')
    again = [each for each in raw if each.topic == '/odom'][:3]
    found = of_bag(write(tmp_path / 'bag', [*raw, *again, *again], {}))
    assert found.times.tolist() == of_bag(GOLDEN / 'retrieval').times.tolist()
    assert found.positions.shape == found.ropes.shape == (26, 3)


@pytest.mark.parametrize('missing', ['/goal', '/odom'])
def test_a_bag_without_what_is_needed_is_refused(tmp_path, missing):
    def kept(each):
        return None if each.topic == missing else each

    path = rewritten(GOLDEN / 'retrieval', tmp_path / 'bag', kept)
    with pytest.raises(BadInput, match=f'without {missing}'):
        of_bag(path)


def test_what_a_planner_would_refuse_is_no_history(tmp_path):
    run = of_bag(GOLDEN / 'faulty')
    assert np.isfinite(run.positions).all()
    assert np.isfinite(run.ropes).all()
    assert (np.diff(run.times) > 0.0).all()
    assert run.times[-1] - run.times[0] == 40.0


def test_a_bag_without_anything_that_a_planner_would_take_is_refused(tmp_path):
    from nav_msgs.msg import Odometry
    from rclpy.serialization import deserialize_message, serialize_message

    def turned_wrong(each):
        if each.topic != '/odom':
            return each
        message = deserialize_message(each.data, Odometry)
        message.pose.pose.orientation.w = 7.0
        return each._replace(data=serialize_message(message))

    path = rewritten(GOLDEN / 'retrieval', tmp_path / 'bag', turned_wrong)
    with pytest.raises(BadInput, match='no valid odom; odometry and a goal are needed'):
        of_bag(path)


def test_a_vehicle_of_a_fleet_has_its_own_history(tmp_path):
    def moved(each):
        return each._replace(topic=f'/uav1{each.topic}')

    path = rewritten(GOLDEN / 'retrieval', tmp_path / 'bag', moved)
    alone, member = of_bag(GOLDEN / 'retrieval'), of_bag(path, '/uav1')
    np.testing.assert_array_equal(alone.positions, member.positions)
    with pytest.raises(BadInput, match='without /odom; give --namespace /uav1'):
        of_bag(path)
