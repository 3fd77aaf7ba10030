"""The launch files, where ROS's launch is installed (PyPI has none of it)."""

import importlib.util
from pathlib import Path

import pytest

FILES = sorted((Path(__file__).resolve().parents[1] / 'launch').glob('*.launch.py'))


def test_every_scenario_can_be_launched():
    configs = FILES[0].parents[1] / 'config'
    assert {f.name.split('.')[0] for f in FILES} == {f.stem for f in configs.glob('*.yaml')}


@pytest.mark.parametrize('file', FILES, ids=lambda file: file.name)
def test_a_launch_file_starts_planner_and_simulator(file):
    pytest.importorskip('launch_ros', reason='launch is not installed')
    from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
    from launch_ros.actions import Node

    try:
        get_package_share_directory('orbimpc_ros')
    except PackageNotFoundError:
        pytest.skip('orbimpc_ros is not installed in an ament workspace')
    spec = importlib.util.spec_from_file_location('launched', file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    description = module.generate_launch_description()
    nodes = [entity for entity in description.entities if isinstance(entity, Node)]
    assert [node.node_executable for node in nodes] == ['planner', 'sim']
    arguments = {argument.name for argument in description.get_launch_arguments()}
    assert arguments == {'params_file', 'namespace', 'clock', 'use_sim_time', 'exit_when_done'}
