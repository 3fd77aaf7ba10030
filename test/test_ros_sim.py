"""The simulator as a process: faults on purpose, commands refused, and a stop in time."""

import math
import signal
from dataclasses import replace

import numpy as np
import pytest
from conftest import new_domain

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry

from orbimpc_ros.mpc.controller import Controller
from orbimpc_ros.mpc.forecast import forecast_named
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import Frames, Stamp
from orbimpc_ros.ros.process import qos
from orbimpc_ros.world.disturbed import fly_disturbed
from orbimpc_ros.world.faults import Faults, View
from orbimpc_ros.world.scenario import retrieval, retrieval_problem

DISTURBED = {
    'faults.position_noise': 0.05,
    'faults.attitude_noise': 0.035,
    'faults.dropout': 0.2,
    'seed': 3,
    'capture_radius': 0.3,
    'exit_when_done': True,
}
LOCKSTEP = {
    'use_sim_time': True,
    'trigger': 'odom',
    'goal_prediction': 'harmonic',
    'floor.shape': 'polygon',
    'odom_timeout': 5.0,
    'goal_timeout': 5.0,
}
WALL = {'clock': 'wall', 'max_ticks': 10_000}


def place(message):
    position = message.pose.pose.position
    return [position.x, position.y]


def moved(odometry):
    return len(odometry) > 1 and place(odometry[-1]) != place(odometry[0])


def stands(odometry):
    return len(odometry) > 2 and len({tuple(place(each)) for each in odometry[-3:]}) == 1


def complaints(diagnostics, word):
    return [
        status.message
        for message in diagnostics
        for status in message.status
        if status.level == DiagnosticStatus.ERROR
        and status.name == '/sim'
        and word in status.message
    ]


def test_a_flight_through_faults_is_the_one_without_ros(launch):
    """Noise, a fifth of all messages lost: the same seed, the same flight, and no standstill."""
    scenario = replace(retrieval(), capture_radius=0.3)
    view = View(Faults(0.05, 0.035, 0.2), 3, scenario.model.step)
    forecast = forecast_named('harmonic')
    end = fly_disturbed(Controller(retrieval_problem()), scenario, forecast, view)
    assert end.captured
    told = f'{end.miss:.3f} m from the goal, after {end.ticks} ticks'
    assert any(told in flown_through(launch, DISTURBED, new_domain()) for _ in range(3))


def flown_through(launch, parameters, domain):
    """Return what a simulator says of a flight; a planner that starves may miss a goal."""
    launch('planner', LOCKSTEP, domain=domain)
    sim = launch('sim', parameters, domain=domain)
    assert sim.wait() == 0, sim.output
    return sim.output


@pytest.mark.parametrize(
    'faults',
    [
        {'faults.clock_jump': -20.0, 'faults.clock_jump_tick': 3},
        {'faults.clock_jump': 500.0, 'faults.clock_jump_tick': 3},
        {'faults.delay': 0.3, 'faults.reorder': 0.1, 'faults.nan': 0.1, 'faults.duplicate': 0.2},
        {'faults.occlusion_length': 3.0, 'faults.occlusion_period': 6.0},
    ],
)
def test_no_fault_brings_lock_step_to_a_standstill(launch, domain, faults):
    assert 'captured' in flown_through(launch, DISTURBED | faults, domain)


def test_the_vehicle_stops_when_its_planner_is_killed(launch, observer):
    """Within the step: signs of life stop long before the next command is due."""
    odometry = observer.listen(Odometry, 'odom')
    diagnostics = observer.listen(DiagnosticArray, '/diagnostics')
    planner = launch('planner', {'trigger': 'odom'})
    launch('sim', WALL)
    observer.until(lambda: moved(odometry), 'a vehicle that flies')
    planner.tell(signal.SIGKILL)
    observer.until(lambda: complaints(diagnostics, 'no sign of life'), 'a complaint')
    odometry.clear()
    observer.until(lambda: stands(odometry), 'a vehicle that stands')
    assert odometry[-1].twist.twist.linear.x == 0.0


@pytest.fixture
def commanded(launch, observer):
    """Return what commands a simulator, its odometry and its diagnostics."""
    odometry = observer.listen(Odometry, 'odom')
    diagnostics = observer.listen(DiagnosticArray, '/diagnostics')
    publisher = observer.node.create_publisher(TwistStamped, 'cmd_vel', qos())
    launch('sim', {**WALL, 'step': 0.1})
    observer.until(lambda: publisher.get_subscription_count() > 0, 'the simulator')

    def command(speed, rate=0.0, stamp=0):
        at = Stamp(stamp, Frames('odom', 'base_link'))
        publisher.publish(messages.twist_message(at, speed, np.array([rate])))

    return command, odometry, diagnostics


def test_the_vehicle_stops_when_commands_stop(commanded, observer):
    command, odometry, diagnostics = commanded

    def flies():
        command(1.0)
        return moved(odometry)

    observer.until(flies, 'a vehicle that flies')
    observer.until(lambda: complaints(diagnostics, 'no command for 0.2 s'), 'a complaint')
    odometry.clear()
    observer.until(lambda: stands(odometry), 'a vehicle that stands')


def test_bad_commands_are_refused_counted_and_not_flown(commanded, observer):
    command, odometry, diagnostics = commanded
    bad = [(math.nan, 0.0), (1.5, 0.0), (-0.5, 0.0), (1.0, 40.0), (1.0, math.inf)]

    def complained():
        for speed, rate in bad:
            command(speed, rate)
        command(1.0, stamp=2**31 * 10**9 - 1)
        return len(complaints(diagnostics, 'refused')) > 1

    observer.until(complained, 'complaints')
    observer.until(lambda: len(odometry) > 5, 'odometry')
    assert all(place(each) == [0.0, 0.0] for each in odometry)
    counted = {pair.key for m in diagnostics for s in m.status for pair in s.values}
    fields = ('twist.linear', 'twist.linear.x', 'twist.angular', 'header.stamp')
    assert {f'refused cmd_vel: {field}' for field in fields} <= counted


def test_impossible_faults_end_the_simulator_with_one_line(launch):
    sim = launch('sim', {'faults.occlusion_length': 20.0})
    assert sim.wait() == 2
    assert sim.output.strip().count('\n') == 0
    assert 'faults.occlusion_length' in sim.output
