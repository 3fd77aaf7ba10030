# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Launch descriptions of simulated flights, one or several, and of planners for real vehicles.

Only launch files import this module, because it needs ROS 2's launch, which is not on PyPI.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
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
from orbimpc_ros.ros.process import RANGE
from orbimpc_ros.ros.topics import AUTOPILOTS
from orbimpc_ros.sim.fleet import FLEETS, vehicles
from orbimpc_ros.tool.files import parse

RECORDED = 'odom, goal, cmd_vel, rotation, plan, tick'  # topics whose recording starts a flight
AUTO, SWITCH = 'auto', ('true', 'false')
Values = Mapping[str, object]


def flight(scenario: str = 'retrieval') -> LaunchDescription:
    """Return the launch of a scenario's planner and simulator, which ends with the flight."""
    timed = 'of the planner; auto: only in lock-step, where the simulator publishes /clock'
    scenarios = {file.stem for file in _configs().glob('*.yaml')} - {*AUTOPILOTS, *FLEETS}
    return _described(
        partial(_simulated, False),
        _argument('scenario', scenario, 'scenario: a file in config/', sorted(scenarios)),
        *_common("the scenario's", 'both nodes'),
        _argument(
            'clock', 'lockstep', 'simulated time as fast as possible, or real', ('lockstep', 'wall')
        ),
        _argument('use_sim_time', AUTO, timed, (AUTO, *SWITCH, 'True', 'False')),
    )


def fleet() -> LaunchDescription:
    """Return the launch of a fleet, which ends with the last flight.

    The fleet flies in real time because simulators cannot share one /clock.
    """
    return _described(
        partial(_simulated, True),
        *_common('config/fleet.yaml', 'the whole fleet'),
        _argument('vehicles', str(FLEETS['fleet']), 'number of vehicles'),
        _argument('seed', '0', 'seed of the ropes'),
    )


def vehicle() -> LaunchDescription:
    """Return the launch of a planner alone, with the topics and parameters of an autopilot."""
    return _described(
        _pilot,
        _argument('autopilot', None, 'vehicle or autopilot', AUTOPILOTS),
        _argument('params_file', '', "by default the autopilot's"),
        _argument('namespace', '', 'of the planner'),
        _argument('dry_run', 'false', 'plan and report, but send no commands', SWITCH),
    )


# --- actions, once the arguments are known


def _simulated(several: bool, context: LaunchContext) -> list[Action]:
    """Return planners, simulators, and a recorder: of a fleet, or of a scenario's one vehicle."""
    config = context.launch_configurations
    _settled(config, 'fleet' if several else config['scenario'])
    clock, timed = ('wall', AUTO) if several else (config['clock'], config['use_sim_time'].lower())
    lockstep, recorded = clock == 'lockstep', config['record'] == 'true'
    planner: Values = {'use_sim_time': lockstep if timed == AUTO else timed == 'true'}
    if lockstep:  # a timer would deadlock: simulated time waits for the planner's answers
        planner = {**planner, 'trigger': 'odom'}
    common: Values = {'clock': clock, 'exit_when_done': config['exit_when_done'] == 'true'}
    if recorded:  # the flight waits for the recorder's subscriptions
        common = {**common, 'wait_for': RECORDED}
    drawn: Mapping[str, Values] = {'': {}}
    if several:
        drawn = vehicles('fleet', *(parse(config[each], each) for each in ('vehicles', 'seed')))
    planners, sims = [], []
    for namespace, own in drawn.items():
        values = {name: list(v) if isinstance(v, tuple) else v for name, v in own.items()}
        planners.append(_node(config, 'planner', namespace, planner))
        sims.append(_node(config, 'sim', namespace, {**common, **values}))
    command = ['ros2', 'bag', 'record', '--storage', 'mcap', '--all']
    recorders = [ExecuteProcess(cmd=command, output='screen')] if recorded else []
    return [*recorders, *planners, *sims, *_ending(sims, [*planners, *recorders])]


def _pilot(context: LaunchContext) -> list[Action]:
    config = context.launch_configurations
    _settled(config, config['autopilot'])
    topics, dry_run = AUTOPILOTS[config['autopilot']], config['dry_run'] == 'true'
    planner = _node(config, 'planner', '', {'dry_run': dry_run}, [*topics.items()])
    return [planner, *_ending([], [planner])]


def _settled(config: dict[str, str], default: str) -> None:
    """Resolve the parameter file; refuse a missing one, which launch would ignore."""
    file = config['params_file'] = config['params_file'] or str(_configs() / f'{default}.yaml')
    if not Path(file).is_file():
        raise BadInput.stating(file, 'no such file', 'params_file must name a parameter file')


def _node(
    config: Mapping[str, str],
    name: str,
    namespace: str,
    parameters: Values,
    remappings: Sequence[tuple[str, str]] = (),
) -> Node:
    outer = f'/{config["namespace"].strip("/")}'.rstrip('/')
    return Node(
        package='orbimpc_ros',
        namespace=outer + namespace,
        executable=name,
        name=name,
        output='screen',
        parameters=[Path(config['params_file']), parameters],
        remappings=remappings,
    )


def _ending(sims: Sequence[Node], others: Sequence[ExecuteProcess]) -> list[Action]:
    """Return handlers that shut down after the last simulator's end or any process's failure.

    An exception raised in a handler ends the launch with a nonzero exit code.
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
    """Return the arguments common to all simulated flights."""
    return [
        _argument('params_file', '', f'of all nodes; by default {file}'),
        _argument('namespace', '', f'of {whose}'),
        _argument('exit_when_done', 'true', 'exit after the flight, or wait for a reset', SWITCH),
        _argument('record', 'false', 'record all topics with ros2 bag into this folder', SWITCH),
    ]


def _argument(
    name: str, default: str | None, description: str, choices: Iterable[str] | None = None
) -> DeclareLaunchArgument:
    allowed = None if choices is None else list(choices)
    return DeclareLaunchArgument(
        name, default_value=default, description=description, choices=allowed
    )


def _configs() -> Path:
    return Path(get_package_share_directory('orbimpc_ros')) / 'config'
