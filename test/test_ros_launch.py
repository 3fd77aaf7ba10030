# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The launch files, where ROS's launch is installed (it is not on PyPI)."""

import importlib.util
import json
import os
import re
import sys
from pathlib import Path

import pytest
from harness import python

from orbimpc_ros.ros.topics import AUTOPILOTS

FILES = sorted((Path(__file__).resolve().parents[1] / 'launch').glob('*.launch.py'))
FLIGHTS = [file for file in FILES if file.stem not in ('fleet.launch', 'vehicle.launch')]
EVERYWHERE = {'params_file', 'namespace', 'exit_when_done', 'record'}
LAUNCH = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
file, *words = sys.argv[1:]
included = IncludeLaunchDescription(
    PythonLaunchDescriptionSource(file), launch_arguments=[word.split(':=') for word in words]
)
service = LaunchService()
service.include_launch_description(LaunchDescription([included]))
sys.exit(service.run())
"""


def test_every_scenario_can_be_launched():
    configs = FILES[0].parents[1] / 'config'
    by_demo = {'crossing'}  # each of its vehicles avoids the others
    launched = {f.name.split('.')[0] for f in FILES} - {'vehicle', 'flight'} | by_demo
    assert launched | set(AUTOPILOTS) == {f.stem for f in configs.glob('*.yaml')}


@pytest.fixture
def launched():
    """Return a function that loads a launch file; skip if files cannot be launched here."""
    pytest.importorskip('launch_ros', reason='launch is not installed')
    from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

    try:
        get_package_share_directory('orbimpc_ros')
    except PackageNotFoundError:
        pytest.skip('orbimpc_ros is not in a sourced workspace: colcon build, . install/setup.sh')

    def load(file):
        spec = importlib.util.spec_from_file_location('launched', file)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module.generate_launch_description()

    return load


def nodes_of(description, **told):
    """Return the nodes launched with these arguments, and the launch context."""
    from launch.actions import OpaqueFunction
    from launch_ros.actions import Node

    from launch import LaunchContext

    context = LaunchContext()
    for argument in description.get_launch_arguments():
        default = argument.default_value
        context.launch_configurations[argument.name] = default[0].text if default else ''
    context.launch_configurations.update(told)
    (late,) = (each for each in description.entities if isinstance(each, OpaqueFunction))
    return [each for each in late.execute(context) if isinstance(each, Node)], context


@pytest.mark.parametrize('file', FLIGHTS, ids=lambda file: file.name)
def test_a_launch_file_starts_planner_and_simulator(file, launched):
    description = launched(file)
    nodes, context = nodes_of(description)
    assert [node.node_executable for node in nodes] == ['planner', 'sim']
    arguments = {argument.name for argument in description.get_launch_arguments()}
    assert arguments == EVERYWHERE | {'scenario', 'clock', 'use_sim_time'}
    name = file.name.split('.')[0].replace('flight', 'retrieval')
    assert context.launch_configurations['params_file'].endswith(f'/{name}.yaml')


def test_a_planner_takes_the_topics_of_its_autopilot(launched):
    from launch.utilities import perform_substitutions

    description = launched(FILES[0].parent / 'vehicle.launch.py')
    for name, topics in AUTOPILOTS.items():
        (node,), context = nodes_of(description, autopilot=name)
        assert node.node_executable == 'planner'
        told = [
            tuple(perform_substitutions(context, part) for part in pair)
            for pair in node._Node__remappings
        ]
        assert dict(told) == topics
        assert context.launch_configurations['params_file'].endswith(f'{name}.yaml')


def test_a_fleet_is_as_large_as_asked_for(launched):
    description = launched(FILES[0].parent / 'fleet.launch.py')
    arguments = {argument.name for argument in description.get_launch_arguments()}
    assert arguments == EVERYWHERE | {'vehicles', 'seed'}
    nodes, _ = nodes_of(description, vehicles='3', namespace='team', record='true')
    assert [node.node_executable for node in nodes] == ['planner'] * 3 + ['sim'] * 3


# Like ros2 bag record on a busy machine: it subscribes some time after a topic has appeared.
RECORDER = """#!{python}
import json, sys, time
from importlib import import_module
from pathlib import Path
from orbimpc_ros.ros.process import attached, qos

seen, heard = {{}}, {{}}
with attached('recorder') as (node, executor):
    try:
        while True:
            for topic, (kind, *_) in node.get_topic_names_and_types():
                late = time.monotonic() > seen.setdefault(topic, time.monotonic()) + 5.0
                if late and topic in {topics} and topic not in heard:
                    module, _, name = kind.replace('/', '.').rpartition('.')
                    said = heard[topic] = []
                    node.create_subscription(
                        getattr(import_module(module), name), topic, said.append, qos(1000)
                    )
            executor.spin_once(timeout_sec=0.05)
    except KeyboardInterrupt:
        pass
stamps = {{
    topic: [(s := m.header.stamp).sec + 1e-9 * s.nanosec for m in said]
    for topic, said in heard.items()
}}
Path('bag.json').write_text(json.dumps(stamps))
"""


@pytest.fixture
def recorder(tmp_path, monkeypatch):
    """Put a fake ``ros2`` first on the path; return a function that sets its script."""
    monkeypatch.setenv('PATH', str(tmp_path), prepend=os.pathsep)
    monkeypatch.chdir(tmp_path)

    def become(script):
        (tmp_path / 'ros2').write_text(script)
        (tmp_path / 'ros2').chmod(0o755)

    return become


@pytest.mark.usefixtures('launched')
def test_a_recording_has_the_flight_from_its_first_step(recorder, domain, monkeypatch, tmp_path):
    topics = ['/car/odom', '/car/goal', '/car/cmd_vel', '/car/tick', '/car/plan', '/car/rotation']
    recorder(RECORDER.format(python=sys.executable, topics=topics))
    done = launched_with(
        'flight', ['scenario:=dubins', 'namespace:=car', 'record:=true'], domain, monkeypatch
    )
    assert done.returncode == 0, done.stdout + done.stderr
    heard = json.loads((tmp_path / 'bag.json').read_text())
    begun = {topic: sorted({*stamps})[:5] for topic, stamps in heard.items()}
    assert begun == {topic: [0.0, 1.0, 2.0, 3.0, 4.0] for topic in topics}


@pytest.mark.usefixtures('launched')
def test_a_launch_whose_recorder_fails_ends(recorder, domain, monkeypatch):
    recorder('#!/bin/sh\nexit 3\n')
    done = launched_with('dubins', ['record:=true'], domain, monkeypatch)
    assert done.returncode == 1, done.stdout + done.stderr
    assert re.search(r'ros2-1 ended with code 3', done.stdout + done.stderr)


def launched_with(name, words, domain, monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    file = FILES[0].parent / f'{name}.launch.py'
    return python(LAUNCH, file, *words, timeout=120)


@pytest.mark.usefixtures('launched')
@pytest.mark.parametrize(
    ('name', 'parameters', 'words', 'said'),
    [
        ('retrieval', None, [], 'wanted.yaml: no such file; params_file'),
        ('fleet', '', ['vehicles:=x'], "vehicles is 'x'; allowed: an integer in [1, 64]"),
        ('retrieval', '/**/sim: {ros__parameters: {step: 0.1, max_ticks: 2}}', ['clock:=wall'],
         'sim-2 ended with code 1'),
        ('retrieval', '/**: {ros__parameters: {trigger: timer, max_ticks: 2}}', [],
         'sim-2 ended with code 1'),  # soon: in lock-step odometry triggers it anyway
        ('retrieval', '/**/planner: {ros__parameters: {trigger: odom, horizon: 0}}', [],
         'planner-1 ended with code 2'),
    ],
)  # fmt: skip
def test_a_launch_that_fails_says_why_and_does_not_end_with_code_0(
    name, parameters, words, said, domain, monkeypatch, tmp_path
):
    file = tmp_path / 'wanted.yaml'
    if parameters is not None:
        file.write_text(parameters)
    done = launched_with(name, [f'params_file:={file}', *words], domain, monkeypatch)
    assert done.returncode == 1, done.stdout + done.stderr
    said_in_all = (done.stdout + done.stderr).splitlines()
    complaints = [line for line in said_in_all if 'Caught exception' in line]
    assert len(complaints) == 1
    assert re.search(said, complaints[0])


@pytest.mark.parametrize('file', FILES, ids=lambda file: file.name)
def test_defaults_of_arguments_can_be_read(file, launched):
    """As ``ros2 launch --show-args`` prints them."""
    for argument in launched(file).get_launch_arguments():
        default = argument.default_value  # None for required arguments
        assert default is None or re.fullmatch(r"'[^<>]*'", default[0].describe())
        assert argument.description


@pytest.mark.parametrize(
    ('name', 'words', 'said'),
    [
        ('flight', ['scenario:=dubins', 'namespace:=car'], '[car.sim]: arrived'),
        ('fleet', ['vehicles:=1', 'namespace:=team'], '[team.uav1.sim]: captured'),
    ],
)
def test_a_launch_ends_with_its_flight(name, words, said, launched, domain, monkeypatch):
    done = launched_with(name, words, domain, monkeypatch)
    assert done.returncode == 0, done.stdout + done.stderr
    assert said in done.stdout + done.stderr
