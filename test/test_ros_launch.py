"""The launch files, where ROS's launch is installed (PyPI has none of it)."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

FILES = sorted((Path(__file__).resolve().parents[1] / 'launch').glob('*.launch.py'))
FLIGHTS = [file for file in FILES if file.stem != 'fleet.launch']
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
    assert {f.name.split('.')[0] for f in FILES} == {f.stem for f in configs.glob('*.yaml')}


@pytest.fixture
def launched():
    """Return a function that loads a launch file; skip where it could not be launched."""
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


def nodes_in(entities):
    from launch_ros.actions import Node

    return [entity for entity in entities if isinstance(entity, Node)]


@pytest.mark.parametrize('file', FLIGHTS, ids=lambda file: file.name)
def test_a_launch_file_starts_planner_and_simulator(file, launched):
    description = launched(file)
    assert [n.node_executable for n in nodes_in(description.entities)] == ['planner', 'sim']
    arguments = {argument.name for argument in description.get_launch_arguments()}
    assert arguments == EVERYWHERE | {'clock', 'use_sim_time'}


def test_a_fleet_is_as_large_as_asked_for(launched):
    from launch.actions import OpaqueFunction

    from launch import LaunchContext

    description = launched(FILES[0].parent / 'fleet.launch.py')
    arguments = {argument.name for argument in description.get_launch_arguments()}
    assert arguments == EVERYWHERE | {'vehicles', 'seed'}
    context = LaunchContext()
    context.launch_configurations.update(vehicles='3', seed='0', namespace='team')
    late = next(e for e in description.entities if isinstance(e, OpaqueFunction))
    nodes = nodes_in(late.execute(context))
    assert [node.node_executable for node in nodes] == ['planner'] * 3 + ['sim'] * 3


@pytest.mark.parametrize(
    ('name', 'words', 'said'),
    [
        ('dubins', ['namespace:=car'], '[car.sim]: arrived'),
        ('fleet', ['vehicles:=1', 'namespace:=team'], '[team.uav1.sim]: captured'),
    ],
)
def test_a_launch_ends_with_its_flight(name, words, said, launched, domain, monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    file = FILES[0].parent / f'{name}.launch.py'
    done = subprocess.run(
        [sys.executable, '-c', LAUNCH, str(file), *words],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert said in done.stdout + done.stderr
