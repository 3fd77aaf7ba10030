"""Planner and simulator, catching the rope: ros2 launch orbimpc_ros retrieval.launch.py."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, EmitEvent, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription


def generate_launch_description():
    """Return both nodes on one parameter file; the launch ends when the flight does."""
    default = Path(get_package_share_directory('orbimpc_ros')) / 'config' / 'retrieval.yaml'
    clock = LaunchConfiguration('clock')
    exit_when_done = ParameterValue(LaunchConfiguration('exit_when_done'), value_type=bool)
    simulated = ParameterValue(LaunchConfiguration('use_sim_time'), value_type=bool)
    common = {'package': 'orbimpc_ros', 'namespace': LaunchConfiguration('namespace')}
    file = LaunchConfiguration('params_file')
    planner = Node(
        **common,
        executable='planner',
        name='planner',
        output='screen',
        parameters=[file, {'use_sim_time': simulated}],
    )
    sim = Node(
        **common,
        executable='sim',
        name='sim',
        output='screen',
        parameters=[file, {'clock': clock, 'exit_when_done': exit_when_done}],
    )
    ended = OnProcessExit(target_action=sim, on_exit=[EmitEvent(event=Shutdown())])
    return LaunchDescription(
        [
            DeclareLaunchArgument('params_file', default_value=str(default)),
            DeclareLaunchArgument('namespace', default_value=''),
            DeclareLaunchArgument('clock', default_value='lockstep', choices=['lockstep', 'wall']),
            DeclareLaunchArgument(
                'use_sim_time', default_value='true', description='false with clock:=wall'
            ),
            DeclareLaunchArgument('exit_when_done', default_value='true'),
            planner,
            sim,
            RegisterEventHandler(ended),
        ]
    )
