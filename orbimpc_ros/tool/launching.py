# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Launch descriptions: planner and simulator on one parameter file, or a planner by itself.

Needs ROS 2's launch, which PyPI does not have: only launch files import this module.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
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
from orbimpc_ros.ros.firmware import TOPICS
from orbimpc_ros.ros.parameters.sections import given
from orbimpc_ros.ros.process import RANGE
from orbimpc_ros.sim.fleet import vehicles

RECORDED = 'odom, goal, cmd_vel, rotation, plan, tick'  # read by a recorder of everything
AUTO = 'auto'
SEVERAL = ('crossing', 'fleet')  # files for several vehicles
AWAITED = 'awaited'  # launch configuration: the readers that the simulator waits for


def flight(scenario: str = 'retrieval') -> LaunchDescription:
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
        _argument('scenario', scenario, 'what flies: a file in config/', _scenarios()),
        *_common("the scenario's", 'both nodes'),
        _argument(
            'clock', 'lockstep', 'simulated time as fast as it goes, or real', ('lockstep', 'wall')
        ),
        _argument(
            'use_sim_time',
            AUTO,
            'of the planner; auto: in lock-step alone, where the simulator makes the time',
            (AUTO, 'true', 'false', 'True', 'False'),
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
        *_common('config/fleet.yaml', 'the whole fleet'),
        _argument('vehicles', '4', 'how many'),
        _argument('seed', '0', 'of the ropes'),
    ]
    return LaunchDescription([*arguments, _reach(), OpaqueFunction(function=_members)])


def vehicle() -> LaunchDescription:
    """Return a planner alone, on the topics of a vehicle's autopilot and with parameters for it."""
    arguments = [
        _argument('autopilot', None, 'what flies or drives', TOPICS),
        _argument('params_file', '', "by default autopilot's"),
        _argument('namespace', '', 'of the planner'),
        _switch('dry_run', 'false', 'plan and report, and command nothing'),
    ]
    return LaunchDescription([*arguments, _reach(), OpaqueFunction(function=_pilot)])


def _prepare_flight(context: LaunchContext) -> None:
    """Check the parameters, and settle for whom the simulator waits."""
    asked = context.launch_configurations
    _settle_file(asked, asked['scenario'])
    outer = f'/{asked["namespace"].strip("/")}'.rstrip('/')
    _check_pace(asked, f'{outer}/planner')
    asked[AWAITED] = _awaited(asked, f'{outer}/sim')


def _pilot(context: LaunchContext) -> list[Action]:
    """Return the planner, now that the autopilot is known."""
    asked = context.launch_configurations
    _settle_file(asked, asked['autopilot'])
    topics = list(TOPICS[asked['autopilot']].items())
    planner = _node('planner', {'dry_run': _flag('dry_run')}, remappings=topics)
    return [planner, *_ending([], [planner])]


def _settle_file(asked: dict[str, str], default: str) -> None:
    """Fill in the parameter file, and refuse one that is not there: launch itself would go on."""
    file = asked['params_file'] = asked['params_file'] or str(_configs() / f'{default}.yaml')
    if not Path(file).is_file():
        raise BadInput.stating(file, 'no such file', 'params_file is to name one of parameters')


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
    asked = context.launch_configurations
    _settle_file(asked, 'fleet')
    count, seed, outer = int(asked['vehicles']), int(asked['seed']), asked['namespace'].strip('/')
    outer = f'/{outer}' if outer else ''
    planners, sims, recorder = [], [], _recorder()
    for namespace, own in vehicles(count, seed).items():
        where = outer + namespace
        planners.append(_node('planner', {'use_sim_time': False}, where))
        plain = {name: list(v) if isinstance(v, tuple) else v for name, v in own.items()}
        settings = {
            'clock': 'wall',
            'exit_when_done': _flag('exit_when_done'),
            'wait_for': _awaited(asked, f'{where}/sim'),
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
