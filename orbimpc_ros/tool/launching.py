# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Launch descriptions: simulated flights, one or several, and planners of real vehicles.

Needs ROS 2's launch, which PyPI does not have: only launch files import this module.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.action import Action
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    ExecuteProcess,
    OpaqueFunction,
    RegisterEventHandler,
    SetEnvironmentVariable,
)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.events.process import ProcessExited
from launch.launch_context import LaunchContext
from launch.launch_description import LaunchDescription
from launch.substitutions import EnvironmentVariable
from launch_ros.actions import Node

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.firmware import TOPICS
from orbimpc_ros.ros.process import RANGE
from orbimpc_ros.sim.fleet import vehicles

RECORDED = 'odom, goal, cmd_vel, rotation, plan, tick'  # read by a recorder of everything
AUTO = 'auto'
SEVERAL = ('crossing', 'fleet')  # files for several vehicles
Values = Mapping[str, object]


def flight(scenario: str = 'retrieval') -> LaunchDescription:
    """Return planner and simulator of a scenario; the launch ends when the flight does."""
    timed = 'of the planner; auto: in lock-step alone, where the simulator makes the time'
    return _described(
        _flight,
        _argument('scenario', scenario, 'what flies: a file in config/', _scenarios()),
        *_common("the scenario's", 'both nodes'),
        _argument(
            'clock', 'lockstep', 'simulated time as fast as it goes, or real', ('lockstep', 'wall')
        ),
        _argument('use_sim_time', AUTO, timed, (AUTO, 'true', 'false', 'True', 'False')),
    )


def fleet() -> LaunchDescription:
    """Return a fleet; the launch ends when the last flight does.

    It flies in real time: simulators cannot share one /clock.
    """
    return _described(
        _fleet,
        *_common('config/fleet.yaml', 'the whole fleet'),
        _argument('vehicles', '4', 'how many'),
        _argument('seed', '0', 'of the ropes'),
    )


def vehicle() -> LaunchDescription:
    """Return a planner alone, on the topics of a vehicle's autopilot and with parameters for it."""
    return _described(
        _pilot,
        _argument('autopilot', None, 'what flies or drives', TOPICS),
        _argument('params_file', '', "by default autopilot's"),
        _argument('namespace', '', 'of the planner'),
        _switch('dry_run', 'false', 'plan and report, and command nothing'),
    )


# --- what is launched, now that the arguments are known


def _flight(context: LaunchContext) -> list[Action]:
    asked = context.launch_configurations
    _settled(asked, asked['scenario'])
    told, lockstep = asked['use_sim_time'].lower(), asked['clock'] == 'lockstep'
    planner: Values = {'use_sim_time': lockstep if told == AUTO else told == 'true'}
    if lockstep:  # on a timer it would wait for time, which waits for its answers
        planner = {**planner, 'trigger': 'odom'}
    return _flown(asked, {_outer(asked): {'clock': asked['clock']}}, planner)


def _fleet(context: LaunchContext) -> list[Action]:
    asked = context.launch_configurations
    _settled(asked, 'fleet')
    drawn = vehicles(int(asked['vehicles']), int(asked['seed']))
    own = {
        _outer(asked) + namespace: {
            'clock': 'wall',
            **{name: list(v) if isinstance(v, tuple) else v for name, v in each.items()},
        }
        for namespace, each in drawn.items()
    }
    return _flown(asked, own, {'use_sim_time': False})


def _flown(asked: dict[str, str], own: Mapping[str, Values], planner: Values) -> list[Action]:
    """Return planners, simulators with values of their own by namespace, and a recorder."""
    recorded = asked['record'] == 'true'
    settings: Values = {'exit_when_done': asked['exit_when_done'] == 'true'}
    if recorded:  # who records waits for the flight
        settings = {**settings, 'wait_for': RECORDED}
    planners, sims = [], []
    for where, values in own.items():
        planners.append(_node(asked, 'planner', where, planner))
        sims.append(_node(asked, 'sim', where, {**settings, **values}))
    words = ['ros2', 'bag', 'record', '--storage', 'mcap', '--all']
    recorders = [ExecuteProcess(cmd=words, output='screen')] if recorded else []
    return [*recorders, *planners, *sims, *_ending(sims, [*planners, *recorders])]


def _pilot(context: LaunchContext) -> list[Action]:
    asked = context.launch_configurations
    _settled(asked, asked['autopilot'])
    topics, dry_run = TOPICS[asked['autopilot']], asked['dry_run'] == 'true'
    planner = _node(asked, 'planner', _outer(asked), {'dry_run': dry_run}, [*topics.items()])
    return [planner, *_ending([], [planner])]


def _settled(asked: dict[str, str], default: str) -> None:
    """Settle the parameter file, and refuse one that is not there: launch itself would go on."""
    file = asked['params_file'] = asked['params_file'] or str(_configs() / f'{default}.yaml')
    if not Path(file).is_file():
        raise BadInput.stating(file, 'no such file', 'params_file is to name one of parameters')


def _outer(asked: Mapping[str, str]) -> str:
    return f'/{asked["namespace"].strip("/")}'.rstrip('/')


def _node(
    asked: Mapping[str, str],
    name: str,
    namespace: str,
    parameters: Values,
    remappings: Sequence[tuple[str, str]] = (),
) -> Node:
    return Node(
        package='orbimpc_ros',
        namespace=namespace,
        executable=name,
        name=name,
        output='screen',
        parameters=[Path(asked['params_file']), parameters],
        remappings=remappings,
    )


def _ending(sims: Sequence[Node], others: Sequence[ExecuteProcess]) -> list[Action]:
    """Shut down when the last of the simulators has ended, or anything has failed.

    Raised in a handler, a failure ends the launch with a code that is not 0.
    """
    flying = set(sims)

    def ended(event: ProcessExited, context: LaunchContext) -> list[Action]:
        if event.returncode and not context.is_shutdown:
            raise RuntimeError(f'{event.process_name} ended with code {event.returncode}')
        flying.discard(event.action)
        return [] if flying else [EmitEvent(event=Shutdown(reason='every flight has ended'))]

    return [
        RegisterEventHandler(OnProcessExit(target_action=each, on_exit=ended))
        for each in (*sims, *others)
    ]


# --- arguments


def _described(
    launched: Callable[[LaunchContext], list[Action]], *arguments: DeclareLaunchArgument
) -> LaunchDescription:
    reach = SetEnvironmentVariable(RANGE, EnvironmentVariable(RANGE, default_value='LOCALHOST'))
    return LaunchDescription([*arguments, reach, OpaqueFunction(function=launched)])


def _common(file: str, whose: str) -> list[DeclareLaunchArgument]:
    """Return the arguments of everything that is simulated."""
    return [
        _argument('params_file', '', f'of all nodes; by default {file}'),
        _argument('namespace', '', f'of {whose}'),
        _switch('exit_when_done', 'true', 'end with the flight, or wait for a reset'),
        _switch('record', 'false', 'all topics by ros2 bag record into this folder'),
    ]


def _switch(name: str, default: str, description: str) -> DeclareLaunchArgument:
    return _argument(name, default, description, ('true', 'false'))


def _argument(
    name: str, default: str | None, description: str, choices: Iterable[str] | None = None
) -> DeclareLaunchArgument:
    known = None if choices is None else list(choices)
    return DeclareLaunchArgument(
        name, default_value=default, description=description, choices=known
    )


def _configs() -> Path:
    return Path(get_package_share_directory('orbimpc_ros')) / 'config'


def _scenarios() -> list[str]:
    """Return the names of the files that have one vehicle and its world."""
    return sorted({file.stem for file in _configs().glob('*.yaml')} - {*TOPICS, *SEVERAL})
