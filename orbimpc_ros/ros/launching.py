"""What the launch files share: planner and simulator on one parameter file.

Needs ROS 2's launch, which PyPI does not have: only launch files import this module.
"""

from __future__ import annotations

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, EmitEvent, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.launch_description import LaunchDescription
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue


def flight(scenario: str) -> LaunchDescription:
    """Return planner and simulator of a scenario; the launch ends when the flight does."""
    clock = LaunchConfiguration('clock')
    simulated = ParameterValue(LaunchConfiguration('use_sim_time'), value_type=bool)
    done = ParameterValue(LaunchConfiguration('exit_when_done'), value_type=bool)
    planner = _node('planner', {'use_sim_time': simulated})
    sim = _node('sim', {'clock': clock, 'exit_when_done': done})
    ended = OnProcessExit(target_action=sim, on_exit=[EmitEvent(event=Shutdown())])
    return LaunchDescription([*_arguments(scenario), planner, sim, RegisterEventHandler(ended)])


def _node(name: str, parameters: dict[str, object]) -> Node:
    return Node(
        package='orbimpc_ros',
        namespace=LaunchConfiguration('namespace'),
        executable=name,
        name=name,
        output='screen',
        parameters=[LaunchConfiguration('params_file'), parameters],
    )


def _arguments(scenario: str) -> list[DeclareLaunchArgument]:
    share = Path(get_package_share_directory('orbimpc_ros'))
    default = str(share / 'config' / f'{scenario}.yaml')
    return [
        DeclareLaunchArgument('params_file', default_value=default),
        DeclareLaunchArgument('namespace', default_value=''),
        DeclareLaunchArgument('clock', default_value='lockstep', choices=['lockstep', 'wall']),
        DeclareLaunchArgument(
            'use_sim_time', default_value='true', description='false with clock:=wall'
        ),
        DeclareLaunchArgument('exit_when_done', default_value='true'),
    ]
