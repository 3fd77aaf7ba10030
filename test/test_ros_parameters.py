# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Parameters: each row is one field, and invalid values are refused by name."""

import math
import re
import sys

import numpy as np
import pytest
import yaml
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.parameter import Parameter, parameter_dict_from_yaml_file
from test_ros_outputs import LANDER

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.problem.problem import weighed
from orbimpc_ros.ros.parameters.planner import PLANNER, planner_settings
from orbimpc_ros.ros.parameters.spec import completed, given_sections, outvoted, unused
from orbimpc_ros.sim.parameters import SIM, sim_settings


def defaults(table):
    return {row.name: row.default for row in table}


def settings_of(table, **changes):
    made = planner_settings if table is PLANNER else sim_settings
    return made({**defaults(table), **changes})


@pytest.mark.parametrize('row', [*PLANNER, *SIM], ids=lambda row: row.name)
def test_a_row_describes_itself(row):
    described = row.descriptor
    assert described.description
    assert described.additional_constraints == row.allowed
    assert described.read_only != row.live
    assert row.checked(row.default) == row.default
    many = isinstance(row.default, tuple) and not row.words
    refused = ['airship'] if row.choices else []
    if isinstance(row.default, float) or many:
        assert math.isfinite(row.low)
        assert math.isfinite(row.high)
        refused += [math.nan, math.inf, row.low - 1.0, row.high * 2.0 + 1.0]
    for value in refused:
        with pytest.raises(BadInput, match=re.escape(row.name)):
            row.checked((row.low, value) if many else value)


def test_planner_and_sim_agree_on_what_they_share():
    planner, sim = defaults(PLANNER), defaults(SIM)
    shared = planner.keys() & sim.keys()
    assert {'dimension', 'step', 'forward', 'mass', 'frame_id'} <= shared
    assert all(planner[name] == sim[name] for name in shared)


REFUSED = [
    (PLANNER, {'approach.direction': (1.0,)}, 'approach.direction'),
    (PLANNER, {'approach.direction': (0.0, 0.0, 0.0)}, 'approach.direction'),
    (SIM, {'approach.direction': (0.0, 0.0, 1.0)}, 'approach.direction'),
    (PLANNER, {'obstacles': (1.0, 2.0, 3.0)}, 'obstacles'),
    (PLANNER, {'deadline': 0.6}, 'deadline'),
    (PLANNER, {'deadline': 0.06, 'plan_period': 0.1}, 'deadline'),
    (PLANNER, {'plan_period': 1.5}, 'plan_period'),
    (PLANNER, {'safe_command': 'loiter', 'translation_order': 2}, 'safe_command'),
    (PLANNER, {'safe_command': 'hover'}, 'safe_command'),
    (PLANNER, {'wind': (1.0,)}, 'wind'),
    (PLANNER, {'velocity_source': 'air', 'translation_order': 2}, 'velocity_source'),
    (PLANNER, {'sideslip': True}, 'sideslip'),
    (PLANNER, {'sideslip': True, 'velocity_source': 'air', 'dimension': 3}, 'sideslip'),
    (PLANNER, {'gravity': 9.81, 'forward': 20.0, 'dimension': 3}, 'gravity'),
    (PLANNER, {'gravity': 9.81, 'forward': 20.0, 'translation_order': 2}, 'gravity'),
    (SIM, {'rope.center': (5.0,)}, 'rope.center'),
    (SIM, {'dimension': 3, 'start.position': (0.0, 0.0)}, 'start.position'),
    (SIM, {'start.orientation': (0.0, 0.0, 0.0, 0.0)}, 'start.orientation'),
    (SIM, {'start.orientation': (0.0, 0.0, 1.0)}, 'start.orientation'),
    (SIM, {'failsafe.rate': 3.2}, 'failsafe.rate'),
    (SIM, {'thrust_axis': 'z'}, 'thrust_axis'),
    (PLANNER, {**LANDER, 'gravity': 3.7}, 'gravity'),
    (PLANNER, {**LANDER, 'hover_thrust': 0.46}, 'hover_thrust'),
    (PLANNER, {'hover_thrust': 0.4}, 'hover_thrust'),
    (PLANNER, {'avoid': ('/uav2/plan',)}, 'avoid_radius'),
    (PLANNER, {'avoid': ('/uav2//plan',), 'avoid_radius': 1.0}, 'avoid'),
    (PLANNER, {'avoid': ('',), 'avoid_radius': 1.0}, 'avoid'),
    *((SIM, {name: 0.3}, name) for name in ('response.speed', 'gust', 'odom_rate')),
    (SIM, {'vehicle': 'continuous', 'drag': 0.1}, 'drag'),
    (SIM, {'vehicle': 'continuous', 'translation_order': 2, 'max_acceleration': 1.0}, 'max_accel'),
    *(
        (SIM, {'vehicle': 'cessna', name: 0.7}, name)
        for name in ('response.rate', 'drag', 'gain', 'gust_time')
    ),
    *(
        (SIM, {'vehicle': 'servicer', 'dimension': 3, 'translation_order': 2, name: 0.7}, name)
        for name in ('gust', 'stall_speed', 'response.speed')
    ),
    *(
        (SIM, {'wait_for': text}, 'wait_for')
        for text in ('tick 0', 'tick two', 'tick, tick', '/a//b', 'tick 101', 'no-dash', '2 tick')
    ),
]


@pytest.mark.parametrize(('table', 'change', 'culprit'), REFUSED)
def test_nonsense_is_refused_with_what_is_allowed(table, change, culprit):
    with pytest.raises(BadInput, match=rf'{re.escape(culprit)}.*allowed') as refusal:
        settings_of(table, **change)
    assert '\n' not in str(refusal.value)


def test_readers_are_listed_with_their_number():
    assert settings_of(SIM).wait_for == {}
    listed = settings_of(SIM, wait_for='tick, /uav1/odom  2,,/clock 12,').wait_for
    assert listed == {'tick': 1, '/uav1/odom': 2, '/clock': 12}


def test_deadline_and_timeouts_follow_the_period():
    every_step = settings_of(PLANNER, step=1.0)
    assert (every_step.period, every_step.deadline, every_step.odom_timeout) == (1.0, 0.5, 1.5)
    often = settings_of(PLANNER, step=1.0, plan_period=0.1)
    assert (often.period, often.deadline, often.odom_timeout) == (0.1, 0.05, 0.2)
    assert often.problem == every_step.problem


def test_weights_over_time_are_sums_and_those_of_thrust_are_more_unless_given():
    thrust = {'dimension': 3, 'translation_order': 2}
    timed = {**thrust, 'weights.scaling': 'time'}
    for stated, wanted in (
        ({}, 0.05), (thrust, 0.05), ({'weights.scaling': 'time'}, 0.05), (timed, 150.0),
        ({**timed, 'weights.input': 0.05}, 0.05),
    ):  # fmt: skip
        assert completed(PLANNER, stated)['weights.input'] == wanted
    timed = settings_of(PLANNER, forward=3.0, **{'weights.scaling': 'time'})
    sums = settings_of(PLANNER, forward=3.0)
    assert timed.problem == weighed(sums.problem, 'time') != sums.problem


BAD_STARTS = [
    ('planner', {'horizn': 5}, "unknown parameter 'horizn'; did you mean 'horizon' or "),
    ('sim', {'rope.center': 'here'}, "rope.center is 'here'; allowed: a list of numbers"),
    ('planner', {'use_sim_time': 1}, "'1' of type 'INTEGER', expecting type 'BOOL'"),
    ('sim', {'qos_overrides./cmd_vel.publisher.depth': 5}, "unknown parameter 'qos_overrides."),
]


@pytest.mark.parametrize(('node', 'bad', 'line'), BAD_STARTS)
def test_bad_parameters_end_a_node_with_one_line_and_code_2(launch, node, bad, line):
    process = launch(node, bad)
    assert process.wait() == 2, process.output
    lines = process.output.strip().splitlines()
    assert len(lines) == 1, process.output
    assert re.search(re.escape(line), lines[0]), lines


def test_two_topics_remapped_to_one_are_told_in_one_line(launch):
    process = launch('planner', remapped={'odom': '/goal'})
    assert process.wait() == 2, process.output
    assert process.output.strip() == '/goal: two types of message; check what is remapped to it'


OWN = 'planner:dry_run:=true'
SECTIONS = """
/**: {ros__parameters: {step: 1.0}}
/**/planner: {ros__parameters: {horizon: 5}}
/**/sim: {ros__parameters: {seed: 1}}
/**/plannr: {ros__parameters: {horizon: 9}}
/uav1: {planner: {ros__parameters: {horizon: 7}}, sim: {ros__parameters: {seed: 7}}}
/uav1/**: {ros__parameters: {mass: 2.0}}
/uav2/**: {ros__parameters: {mass: 3.0}}
planner: {ros__parameters: {mass: 4.0}}
"""


@pytest.mark.parametrize(
    ('name', 'sections', 'rules'),
    [
        ('/planner', ['/**/plannr'], []),  # sections of /uav2 are for another vehicle
        ('/uav1/planner', ['/**/plannr', '/planner'], [OWN]),  # ROS takes no namespace there
        ('/pilot', ['/**/planner', '/**/plannr', '/uav1/planner', '/planner'], [OWN]),
    ],
)
def test_parameters_that_no_node_takes_are_told(tmp_path, monkeypatch, name, sections, rules):
    """Otherwise a misspelt name would silently mean the defaults."""
    file = tmp_path / 'params.yaml'
    file.write_text(SECTIONS)
    words = ['planner', '--ros-args', '--params-file', str(file), '-p', 'step:=1.0', '-p', OWN]
    monkeypatch.setattr(sys, 'argv', words)
    told = [*(f'section {each} in {file}' for each in sections), *(f'-p {each}' for each in rules)]
    assert unused(given_sections(), name, 'planner') == told
    assert [len(outvoted({'step': given}, name)) for given in (1.0, 2.0)] == [0, 1]  # of a file
    file.write_text('/uav3/planner: {ros__parameters: {step: 1.0}}')  # and none for this node
    assert unused(given_sections(), name, 'planner')[0] == f'section /uav3/planner in {file}'
    monkeypatch.setattr(sys, 'argv', ['planner'])
    assert unused(given_sections(), name, 'planner') == []


@pytest.mark.parametrize(
    ('values', 'told'),
    [
        (' {obstacles: [[0.0, 0.0, 1.0, 1.0]]}', '2: obstacles is a list of seq; needed: [0.0, '),
        (' {wind: [1, 2.5]}', '2: wind is a list of float and int; needed: [0.0, 1.0]'),
        ('\n  step: 0.2\n  step: 0.3', '3: step is given twice; keep one of them'),
        ('\n  step:', '3: step has no value; '),
    ],
)
def test_what_rcl_drops_or_overwrites_is_refused(tmp_path, monkeypatch, values, told):
    """Otherwise a wall in a nested list would be none, without a word."""
    file = tmp_path / 'params.yaml'
    file.write_text(f'planner: ros__parameters:{values}'.replace(': ', ':\n ', 1))
    monkeypatch.setattr(sys, 'argv', ['planner', '--ros-args', '--params-file', str(file)])
    with pytest.raises(BadInput, match=re.escape(f'{file} line {told}')):
        given_sections()


def test_a_simulator_says_which_sections_it_does_not_use(launch, observer, tmp_path):
    file = tmp_path / 'wrong.yaml'
    file.write_text('/**/simulator: {ros__parameters: {step: 2.0}}')
    sim = launch('sim', {}, file)
    observer.until(lambda: f'section /**/simulator in {file} is not for /sim' in sim.output)
    assert sim.stop() == 0


@pytest.fixture(scope='module')
def running(shared):
    launch, observer = shared
    launch('planner', {'floor.shape': 'polygon', 'obstacles': []})

    def ask(kind, name, **fields):
        return observer.call(kind, f'/planner/{name}', kind.Request(**fields))

    return ask


def held(running, names):
    return running(GetParameters, 'get_parameters', names=list(names)).values


def change(running, values):
    """Set several parameters atomically; return success, and the reason of a refusal."""
    wanted = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
    answer = running(SetParametersAtomically, 'set_parameters_atomically', parameters=wanted)
    return answer.result.successful, answer.result.reason


def test_live_changes_are_made_whole(running):
    values = {'weights.input': 0.2, 'max_rate': 1.0, 'obstacles': [1.0, 1.0, 2.0, 2.0]}
    assert change(running, values) == (True, '')
    weight, rate, boxes = held(running, values)
    assert (weight.double_value, rate.double_value) == (0.2, 1.0)
    assert list(boxes.double_array_value) == values['obstacles']
    for values, culprit in (
        ({'weights.input': 0.3, 'floor.fraction': 0.9}, 'floor.fraction is 0.9; allowed: '),
        ({'weights.input': math.nan}, 'weights.input'),
        ({'weights.input': -1.0}, 'weights.input'),
        ({'weights.input': 'heavy'}, "weights.input is 'heavy'; allowed: a number"),
        ({'weights.input': 0.3, 'horizon': 7}, 'read-only'),
        ({'obstacles': [1.0, 2.0]}, 'obstacles'),
        ({'use_sim_time': True}, 'use_sim_time'),
    ):
        before = held(running, values)
        done, reason = change(running, values)
        assert not done
        assert culprit in reason
        assert held(running, values) == before
    assert change(running, {'floor.shape': 'none'})[0]  # the node still runs


BOX = [1.0, 1.0, 2.0, 2.0]


@pytest.mark.parametrize('kind', ['BOOL', 'BYTE', 'INTEGER', 'STRING', 'DOUBLE'])
def test_an_empty_list_clears_the_boxes_whatever_type_it_comes_as(running, kind):
    """YAML's [] has no element type: ``ros2 param set`` sends it as booleans."""
    assert change(running, {'obstacles': BOX})[0]
    empty = Parameter('obstacles', Parameter.Type[f'{kind}_ARRAY'], []).to_parameter_msg()
    answer = running(SetParametersAtomically, 'set_parameters_atomically', parameters=[empty])
    assert answer.result.successful, answer.result.reason
    (boxes,) = held(running, ['obstacles'])
    assert list(boxes.double_array_value) == []


def test_an_integer_is_taken_for_any_number_and_a_list_of_them(running):
    assert change(running, {'mass': 2, 'obstacles': [1, 1, 2, 2]})[0]
    assert not change(running, {'mass': 0})[0]
    assert not change(running, {'dry_run': 1})[0]


@pytest.mark.parametrize('boxes', [[], BOX])
def test_what_a_node_holds_can_be_given_back_to_it(running, tmp_path, boxes):
    """As with ``ros2 param dump`` and ``ros2 param load``: all live parameters, at once."""
    assert change(running, {'obstacles': boxes})[0] or not boxes
    names = [*(row.name for row in PLANNER if row.live), 'use_sim_time']
    values = {
        name: Parameter.from_parameter_msg(ParameterMessage(value=each)).value
        for name, each in zip(names, held(running, names), strict=True)
    }
    values['obstacles'], values['wind'] = boxes, list(values['wind'])
    values['approach.direction'] = list(values['approach.direction'])
    file = tmp_path / 'dump.yaml'
    file.write_text(yaml.safe_dump({'/planner': {'ros__parameters': values}}))
    loaded = list(parameter_dict_from_yaml_file(str(file)).values())
    answer = running(SetParametersAtomically, 'set_parameters_atomically', parameters=loaded)
    assert answer.result.successful, answer.result.reason
    assert list(held(running, ['obstacles'])[0].double_array_value) == boxes


def test_wind_and_gravity_add_up_to_one_disturbance_of_planner_and_simulator():
    known = {**LANDER, 'wind': (0.5, 0.0, 1.0), 'discretisation': 'exact'}
    planner = settings_of(PLANNER, **known)
    np.testing.assert_allclose(planner.disturbance, [0.5, 0.0, -0.62])
    assert planner.safe_command == 'hover'
    known = {name: known[name] for name in known.keys() & defaults(SIM).keys()}
    model = settings_of(SIM, **known).model
    np.testing.assert_allclose(model.blown, planner.disturbance)
    assert model.discretisation == planner.problem.discretisation == 'exact'
    np.testing.assert_allclose(settings_of(PLANNER, wind=(0.3, -0.2, 7.0)).disturbance, [0.3, -0.2])
    assert not settings_of(PLANNER).disturbance.any()
