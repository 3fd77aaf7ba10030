# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Launch descriptions: planner and simulator on one parameter file, or a planner by itself.

Needs ROS 2's launch, which PyPI does not have: only launch files import this module.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
from launch.conditions import IfCondition
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.events.process import ProcessExited
from launch.launch_context import LaunchContext
from launch.launch_description import LaunchDescription
from launch.substitutions import (
    EnvironmentVariable,
    EqualsSubstitution,
    IfElseSubstitution,
    LaunchConfiguration,
)
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.autopilots import TOPICS
from orbimpc_ros.ros.parameters.sections import given
from orbimpc_ros.ros.process import RANGE
from orbimpc_ros.sim.fleet import vehicles
from orbimpc_ros.sim.readers import RECORDED

AUTO = 'auto'
AWAITED = 'awaited'  # launch configuration: the readers that the simulator waits for


def flight(scenario: str) -> LaunchDescription:
    """Return planner and simulator of a scenario; the launch ends when the flight does."""
    clock, asked = LaunchConfiguration('clock'), LaunchConfiguration('use_sim_time')
    in_lockstep = EqualsSubstitution(clock, 'lockstep')
    simulated = IfElseSubstitution(EqualsSubstitution(asked, AUTO), in_lockstep, asked)
    planner = _node('planner', {'use_sim_time': ParameterValue(simulated, value_type=bool)})
    sim = _node(
        'sim',
        {
            'clock': clock,
            'exit_when_done': _flag('exit_when_done'),
            'wait_for': ParameterValue(LaunchConfiguration(AWAITED), value_type=str),
        },
    )
    arguments = [
        *_arguments(scenario),
        DeclareLaunchArgument('namespace', default_value='', description='of both nodes'),
        DeclareLaunchArgument(
            'clock',
            default_value='lockstep',
            choices=['lockstep', 'wall'],
            description='simulated time as fast as it goes, or real time',
        ),
        DeclareLaunchArgument(
            'use_sim_time',
            default_value=AUTO,
            choices=[AUTO, 'true', 'false', 'True', 'False'],
            description='of the planner; the simulator makes the time, auto: in lock-step alone',
        ),
    ]
    prepare, recorder = OpaqueFunction(function=_prepare_flight), _recorder()
    nodes = [recorder, planner, sim, *_ending([sim], [planner, recorder])]
    return LaunchDescription([*arguments, prepare, _reach(), *nodes])


def fleet() -> LaunchDescription:
    """Return a fleet; the launch ends when the last flight does.

    It flies in real time: simulators cannot share one /clock.
    """
    arguments = [
        *_arguments('fleet'),
        DeclareLaunchArgument('vehicles', default_value='4', description='how many'),
        DeclareLaunchArgument('seed', default_value='0', description='of the ropes'),
        DeclareLaunchArgument('namespace', default_value='', description='of the whole fleet'),
    ]
    check, members = (OpaqueFunction(function=each) for each in (_check_file, _members))
    return LaunchDescription([*arguments, check, _reach(), members])


def vehicle() -> LaunchDescription:
    """Return a planner alone, on the topics of a vehicle's autopilot and with parameters for it."""
    arguments = [
        DeclareLaunchArgument(
            'autopilot', choices=list(TOPICS), description='what flies or drives'
        ),
        DeclareLaunchArgument(
            'params_file', default_value='', description="by default autopilot's"
        ),
        DeclareLaunchArgument('namespace', default_value='', description='of the planner'),
        DeclareLaunchArgument(
            'dry_run',
            default_value='false',
            choices=['true', 'false'],
            description='plan and report, and command nothing',
        ),
    ]
    return LaunchDescription([*arguments, _reach(), OpaqueFunction(function=_pilot)])


def _pilot(context: LaunchContext) -> list[Action]:
    """Return the planner, now that the autopilot is known."""
    asked = context.launch_configurations
    asked['params_file'] = asked['params_file'] or _config(asked['autopilot'])
    _check_file(context)
    topics = list(TOPICS[asked['autopilot']].items())
    planner = _node('planner', {'dry_run': _flag('dry_run')}, remappings=topics)
    return [planner, *_ending([], [planner])]


def _check_file(context: LaunchContext) -> None:
    """Refuse a parameter file that is not there: launch itself would go on with defaults."""
    file = context.launch_configurations['params_file']
    if not Path(file).is_file():
        raise BadInput.stating(file, 'no such file', 'params_file is to name one of parameters')


def _prepare_flight(context: LaunchContext) -> None:
    """Check the parameters, and settle for whom the simulator waits."""
    _check_file(context)
    asked = context.launch_configurations
    outer = f'/{asked["namespace"].strip("/")}'.rstrip('/')
    _check_pace(asked, f'{outer}/planner')
    asked[AWAITED] = _awaited(asked, f'{outer}/sim')


def _check_pace(asked: Mapping[str, str], name: str) -> None:
    """Refuse a planner on a timer in lock-step: that waits for time, which waits for answers."""
    trigger = given(asked['params_file'], name, 'trigger') or 'timer'
    if asked['clock'] == 'lockstep' and trigger != 'odom':
        where = f'trigger of {name} in {asked["params_file"]}'
        raise BadInput(where, trigger, 'odom, as clock is lockstep (or clock:=wall)')


def _awaited(asked: Mapping[str, str], name: str) -> str:
    """Return the readers that a simulator waits for: those of its file, or the recorder."""
    recorder = RECORDED if asked['record'] == 'true' else ''
    return str(given(asked['params_file'], name, 'wait_for') or recorder)


def _members(context: LaunchContext) -> list[Action]:
    """Return the nodes of a fleet, now that the arguments are known."""
    count, seed = (int(context.launch_configurations[name]) for name in ('vehicles', 'seed'))
    outer = context.launch_configurations['namespace'].strip('/')
    outer = f'/{outer}' if outer else ''
    planners, sims, recorder = [], [], _recorder()
    for namespace, own in vehicles(count, seed).items():
        where = outer + namespace
        planners.append(_node('planner', {'use_sim_time': False}, where))
        plain = {name: list(v) if isinstance(v, tuple) else v for name, v in own.items()}
        settings = {
            'clock': 'wall',
            'exit_when_done': _flag('exit_when_done'),
            'wait_for': _awaited(context.launch_configurations, f'{where}/sim'),
            **plain,
        }
        sims.append(_node('sim', settings, where))
    return [recorder, *planners, *sims, *_ending(sims, [*planners, recorder])]


def _flag(name: str) -> ParameterValue:
    return ParameterValue(LaunchConfiguration(name), value_type=bool)


def _node(
    name: str,
    parameters: dict[str, object],
    namespace: str | None = None,
    remappings: Sequence[tuple[str, str]] = (),
) -> Node:
    return Node(
        package='orbimpc_ros',
        namespace=LaunchConfiguration('namespace') if namespace is None else namespace,
        executable=name,
        name=name,
        output='screen',
        parameters=[LaunchConfiguration('params_file'), parameters],
        remappings=list(remappings),
    )


def _recorder() -> ExecuteProcess:
    """Return what records all topics where that is wanted; simulators wait for it."""
    return ExecuteProcess(
        cmd=['ros2', 'bag', 'record', '--storage', 'mcap', '--all'],
        condition=IfCondition(LaunchConfiguration('record')),
        output='screen',
    )


def _reach() -> Action:
    return SetEnvironmentVariable(RANGE, EnvironmentVariable(RANGE, default_value='LOCALHOST'))


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


def _arguments(scenario: str) -> list[DeclareLaunchArgument]:
    default = _config(scenario)
    return [
        DeclareLaunchArgument('params_file', default_value=default, description='of all nodes'),
        DeclareLaunchArgument(
            'exit_when_done',
            default_value='true',
            choices=['true', 'false'],
            description='end with the flight, or wait for a reset',
        ),
        DeclareLaunchArgument(
            'record',
            default_value='false',
            choices=['true', 'false'],
            description='all topics by ros2 bag record, which flights wait for; into this folder',
        ),
    ]


def _config(name: str) -> str:
    return str(Path(get_package_share_directory('orbimpc_ros')) / 'config' / f'{name}.yaml')
