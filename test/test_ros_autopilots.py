# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Planners on the topics of autopilots: their messages, QoS, rates and frames over DDS."""

import math
import os
import re
import sys
import time
from importlib import import_module
from itertools import pairwise

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped, TwistWithCovarianceStamped
from interfaces.build import build
from nav_msgs.msg import Odometry
from planners import told
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool

from orbimpc_ros.loop.compensation import Odometry as Measured
from orbimpc_ros.mpc.geometry.rotations import exp, to_quaternion
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import Frames, Stamp, header
from orbimpc_ros.ros.planner import wings
from orbimpc_ros.ros.process import qos
from orbimpc_ros.ros.topics import AUTOPILOTS

PERIOD = 1.0 / 30.0  # [s] between messages of an autopilot


class Autopilot:
    """An autopilot as planners see it: it sends its vehicle's state and a goal periodically.

    Attributes:
        in_mode: True if it takes commands.
        alive: True if it sends anything.
        sent_at: time of its last messages [s].
    """

    in_mode, alive, topics = False, True, {}

    def __init__(self, launch, observer, name, **parameters):
        self.observer, self.node = observer, observer.node
        self.goal = self.node.create_publisher(PoseStamped, 'goal', 1)
        self.begun = self.sent_at = time.time()
        self.connect(name)
        self.planner = launch(
            'planner', {'use_sim_time': False, **parameters}, name, remapped=self.topics
        )

    def until(self, happened, what):
        """Send the vehicle's state until a condition holds."""

        def step():
            now = time.time()
            if self.alive and now - self.sent_at >= PERIOD:
                self.tell(now)
                self.sent_at = now
            return happened()

        self.observer.until(step, what)

    def aim(self, head, *place):
        goal = messages.pose(np.array(place), np.eye(3))
        self.goal.publish(PoseStamped(header=head, pose=goal))


# --- vehicles in the plane, which obey commands

BEST_EFFORT = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
FRAMES = {'ardupilot': 'base_link', 'mavros': 'map', 'rover': 'odom'}  # frames of poses
GOAL = np.array([3.0, 1.0])


class Rover(Autopilot):
    in_mode = True

    def connect(self, name):
        self.frame, self.topics = FRAMES[name], dict(AUTOPILOTS[name])
        self.halves = 'pose' in self.topics
        kinds = {'pose': PoseStamped, 'twist': TwistStamped} if self.halves else {'odom': Odometry}
        self.said = {
            topic: self.node.create_publisher(kind, self.topics.get(topic, topic), BEST_EFFORT)
            for topic, kind in kinds.items()
        }
        self.switch = self.node.create_publisher(Bool, 'engaged', 1)
        commands = self.topics.get('cmd_vel', 'cmd_vel')
        self.commands = self.observer.listen(TwistStamped, commands)
        self.ticks = self.observer.listen(DiagnosticArray, 'tick')
        self.position, self.heading, self.speed = np.zeros(2), 2.0, 0.5

    def tell(self, now):
        if self.commands:
            twist = self.commands[-1].twist
            self.speed = twist.linear.x
            self.heading += (now - self.sent_at) * twist.angular.z
        turned = exp(np.array([0.0, 0.0, self.heading]))
        velocity = self.speed * turned[:, 0]
        self.position = self.position + (now - self.sent_at) * velocity[:2]
        place = messages.pose(np.append(self.position, 10.0), turned)
        head = header(round(now * 1e9), self.frame)
        if self.halves:  # ArduPilot: pose and twist in one frame, velocity in world axes
            twist = TwistStamped(header=head)
            twist.twist.linear = messages.vector(velocity)
            self.said['twist'].publish(twist)
            self.said['pose'].publish(PoseStamped(header=head, pose=place))
        else:
            odometry = Odometry(header=head, child_frame_id='base_link')
            odometry.pose.pose = place
            odometry.twist.twist.linear.x = self.speed
            self.said['odom'].publish(odometry)
        self.aim(head, *GOAL, 0.0)
        self.switch.publish(Bool(data=self.in_mode))

    @property
    def arrived(self):
        return np.linalg.norm(self.position - GOAL) < 0.5


def assert_arrives(rover):
    rover.until(lambda: rover.arrived and rover.ticks, 'arrival')
    assert {command.header.frame_id for command in rover.commands} == {'base_link'}
    assert told(rover.ticks[-1])['status'] in ('optimal', 'feasible')


@pytest.mark.parametrize('name', ['mavros', 'rover'])
def test_a_vehicle_under_an_autopilot_arrives(name, launch, observer):
    rover = Rover(launch, observer, name)
    assert_arrives(rover)
    assert rover.planner.stop() == 0
    assert 'see velocity_frame' not in rover.planner.output


def test_an_autopilot_that_is_not_engaged_is_told_nothing_and_then_arrives(launch, observer):
    rover = Rover(launch, observer, 'ardupilot')

    def until_planned(count):
        planned = len(rover.ticks) + count
        rover.until(lambda: len(rover.ticks) > planned, 'plans')

    rover.in_mode = False
    until_planned(10)
    assert not rover.commands
    rover.in_mode = True
    assert_arrives(rover)
    assert 'see velocity_frame' not in rover.planner.output
    rover.in_mode = False
    until_planned(20)
    before = len(rover.commands)
    until_planned(20)
    assert len(rover.commands) == before
    assert rover.planner.stop() == 0
    topic = AUTOPILOTS['ardupilot']['cmd_vel']
    observer.until(lambda: not observer.node.count_publishers(topic), 'its end')
    assert len(rover.commands) == before  # nor is there a last one at the end
    for words in ('engaged: commands', 'not engaged: silent'):
        assert words in rover.planner.output


# --- wings, which fly along a circle and ignore commands

WIND, AIRSPEED, TURN = np.array([4.0, -3.0]), 15.0, 0.2
BEFORE = os.environ.get('PYTHONPATH', '')  # without the message packages
PACKAGES = {'px4': 'px4_msgs', 'arduplane': 'mavros_msgs'}
SAID = {'px4': 'px4: in offboard', 'arduplane': 'arduplane: in GUIDED'}


@pytest.fixture(scope='session')
def packages(tmp_path_factory):
    """The message packages, on the path of this process and of its children."""
    folder = tmp_path_factory.mktemp('packages')
    for package in PACKAGES.values():
        build(package, folder)
    os.environ['PYTHONPATH'] = os.pathsep.join(filter(None, (str(folder), BEFORE)))
    sys.path.insert(0, str(folder))
    yield folder
    sys.path.remove(str(folder))
    os.environ['PYTHONPATH'] = BEFORE


class Wing(Autopilot):
    height, kept = 0.0, ()

    @property
    def steered(self):
        """Return the number of setpoints, without the headings that end a command."""
        return sum(getattr(each, 'param1', 1.0) != 2.0 for each in self.setpoints)

    def connect(self, name):
        self.types = import_module(f'{PACKAGES[name]}.msg')
        self.setpoints, self.odometry = [], self.observer.listen(Odometry, 'odom')
        self.wind = self.observer.listen(TwistWithCovarianceStamped, 'wind')
        self.turned = []  # the latest attitudes sent
        self.said = {
            kind: self.node.create_publisher(kind, topic, qos())
            for topic, kind in self.outputs().items()
        }

    def tell(self, now):
        place, velocity, rotation = self.motion(now)
        self.turned = [*self.turned[-3:], rotation]
        for message in self.measured(now, place, velocity, rotation):
            self.said[type(message)].publish(message)
        self.aim(header(0, 'odom'), 900.0, 500.0, self.height)

    def motion(self, now):
        """Return position, velocity over ground, and attitude, in ROS's axes."""
        level = exp(np.array([0.0, 0.0, TURN * (now - self.begun)]))
        bank = exp(np.array([-math.atan(TURN * AIRSPEED / wings.GRAVITY), 0.0, 0.0]))
        radius, blown = AIRSPEED / TURN, np.append(WIND, 0.0)
        circle = radius * (np.array([0.0, 1.0, 0.0]) - level[:, 1])
        place = circle + (now - self.begun) * blown + [0.0, 0.0, 100.0]
        return place, AIRSPEED * level[:, 0] + blown, level @ bank


class Px4(Wing):
    height = 120.0

    def outputs(self):
        return {
            'fmu/out/vehicle_local_position_v1': self.types.VehicleLocalPosition,
            'fmu/out/vehicle_attitude': self.types.VehicleAttitude,
            'fmu/out/airspeed_validated_v1': self.types.AirspeedValidated,
            'fmu/out/wind': self.types.Wind,
            'fmu/out/vehicle_status_v1': self.types.VehicleStatus,
        }

    def connect(self, name):
        super().connect(name)
        types = self.types
        self.lateral = self.observer.listen(
            types.FixedWingLateralSetpoint, 'fmu/in/fixed_wing_lateral_setpoint'
        )
        self.setpoints = self.observer.listen(
            types.FixedWingLongitudinalSetpoint, 'fmu/in/fixed_wing_longitudinal_setpoint'
        )
        self.kept = self.observer.listen(types.OffboardControlMode, 'fmu/in/offboard_control_mode')

    def measured(self, now, place, velocity, rotation):
        types, at = self.types, round(1e6 * now)
        known = {'xy_valid': True, 'v_xy_valid': True, 'z_global': True, 'ref_alt': 200.0}
        ned = dict(zip('xyz', map(float, wings.NED @ place), strict=True))
        speeds = dict(zip(('vx', 'vy', 'vz'), map(float, wings.NED @ velocity), strict=True))
        unit = to_quaternion(wings.NED @ rotation @ wings.FRD).astype(np.float32)
        east, north = WIND
        return (
            types.VehicleAttitude(timestamp_sample=at, q=unit),
            types.AirspeedValidated(
                true_airspeed_m_s=AIRSPEED, calibrated_airspeed_m_s=0.9 * AIRSPEED
            ),
            types.Wind(
                timestamp_sample=at,
                windspeed_north=float(north),
                windspeed_east=float(east),
                variance_north=0.1,
                variance_east=0.1,
            ),
            types.VehicleStatus(nav_state=14 if self.in_mode else 4),
            types.VehicleLocalPosition(timestamp_sample=at, **known, **ned, **speeds),
        )

    def assert_kept_in_mode(self):
        """Assert that there are signs of life, which are needed to enter the mode."""
        self.until(lambda: len(self.kept) > 20, 'signs of life')
        assert np.median(np.diff([each.timestamp for each in self.kept])) < 5e5  # [us]: 2 Hz
        assert all(each.velocity and not each.position for each in self.kept)

    def assert_told(self):
        """Assert that the setpoints are what PX4 reads."""
        self.until(lambda: self.lateral, 'a lateral setpoint')
        across, along = self.lateral[-1], self.setpoints[-1]
        assert math.isnan(across.course)
        assert -math.pi <= across.airspeed_direction <= math.pi
        assert abs(across.lateral_acceleration) <= 18.0 * 0.25 + 1e-3
        assert 0.75 * 18.0 * 0.9 - 1e-3 <= along.equivalent_airspeed <= 18.0 * 0.9 + 1e-3
        assert along.altitude == pytest.approx(320.0)  # above mean sea level
        unused = along.height_rate, along.pitch_direct, along.throttle_direct
        assert all(map(math.isnan, unused))


class ArduPlane(Wing):
    refusing = False

    def assert_kept_in_mode(self):
        """ArduPilot needs no signs of life."""

    def assert_told(self):
        """Assert what is commanded, and that a refusal is warned of once."""
        self.refusing = True
        said = 'arduplane: refused command 43'
        self.until(lambda: said in self.planner.output, said)
        assert {each.command for each in self.setpoints} == {43000, 43002}  # no altitude: held
        more = len(self.setpoints) + 24
        self.until(lambda: len(self.setpoints) > more, 'setpoints')
        assert self.planner.output.count(said) == 1
        self.refusing = False

    def outputs(self):
        return {
            'mavros/local_position/odom': Odometry,
            'mavros/vfr_hud': self.types.VfrHud,
            'mavros/wind_estimation': TwistWithCovarianceStamped,
            'mavros/state': self.types.State,
        }

    def connect(self, name):
        super().connect(name)
        service = import_module('mavros_msgs.srv').CommandInt
        self.node.create_service(service, 'mavros/cmd/command_int', self.obey)

    def obey(self, request, response):
        self.setpoints.append(request)
        response.success = not self.refusing
        return response

    def measured(self, now, place, velocity, rotation):
        stamp = Stamp(round(1e9 * now), Frames('map', 'base_link'))
        body = Measured(now, place, rotation, rotation.T @ velocity, np.zeros(3))
        wind = TwistWithCovarianceStamped(header=header(stamp.nanoseconds, ''))
        wind.twist.twist.linear.x, wind.twist.twist.linear.y = WIND.tolist()
        wind.twist.covariance[0] = -1.0  # unknown, as from MAVROS with ArduPilot
        share = wings.equivalent(1000.0)
        return (
            self.types.VfrHud(airspeed=share * AIRSPEED, altitude=1000.0),
            wind,
            self.types.State(connected=True, mode='GUIDED' if self.in_mode else 'AUTO'),
            messages.odometry_message(stamp, body),
        )


KINDS = {'px4': Px4, 'arduplane': ArduPlane}


@pytest.fixture
def wing(launch, observer, packages):
    def fly(name, **parameters):
        return KINDS[name](launch, observer, name, **parameters)

    return fly


def engage(flown, name):
    flown.until(lambda: flown.odometry, 'odometry')
    flown.in_mode = True
    told = len(flown.setpoints) + 6
    flown.until(lambda: len(flown.setpoints) > told, 'setpoints')
    assert SAID[name] in flown.planner.output


def assert_said_once(output, name):
    """Assert that each change of mode is logged once; a busy machine may add changes."""
    said = re.findall(rf'{name}: .*: (setpoints|silent)$', output, re.MULTILINE)
    assert said
    assert all(one != other for one, other in pairwise(said))


def assert_measured(flown, name):
    """Assert that odometry and wind are those of the motion, with the velocity through the air."""
    message = flown.odometry[-1]
    at = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
    place, _, _ = flown.motion(at)
    _, measured = messages.read_odometry(message, 3, Frames())
    np.testing.assert_allclose(measured.position, place, atol=1e-3)
    # Messages of two topics are not ordered: the last attitude received may be an older one.
    assert min(np.abs(measured.attitude - each).max() for each in flown.turned) < 1e-5
    np.testing.assert_allclose(measured.body_velocity, [AIRSPEED, 0.0, 0.0], atol=0.2)
    assert np.linalg.norm(measured.body_velocity) == pytest.approx(AIRSPEED, abs=1e-3)
    assert measured.body_rate[2] == pytest.approx(TURN, abs=1e-3)
    told = flown.wind[-1].twist
    np.testing.assert_allclose([told.twist.linear.x, told.twist.linear.y], WIND, atol=1e-6)
    variance = told.covariance[0]
    assert variance == pytest.approx(0.1) if name == 'px4' else variance == -1.0


@pytest.mark.parametrize('name', KINDS)
def test_what_is_measured_becomes_odometry_and_setpoints_leave_in_the_mode_alone(wing, name):
    """Half a second after the autopilot has stopped, they have stopped too."""
    flown = wing(name)
    flown.until(lambda: len(flown.odometry) > 30 and flown.wind, 'odometry and wind')
    assert_measured(flown, name)
    flown.assert_kept_in_mode()
    assert not flown.setpoints
    engage(flown, name)
    flown.assert_told()
    flown.in_mode = False
    flown.until(lambda: 'silent' in flown.planner.output, 'silence')
    before = flown.steered
    heard = len(flown.odometry)
    flown.until(lambda: len(flown.odometry) > heard + 20, 'odometry')
    assert flown.steered <= before + 1  # one may have been in flight
    engage(flown, name)
    flown.alive, stopped = False, flown.sent_at
    flown.until(lambda: time.time() - stopped > 0.5, 'half a second')
    before, kept = flown.steered, len(flown.kept)
    flown.until(lambda: time.time() - stopped > 2.0, 'another second')
    assert flown.steered == before
    assert len(flown.kept) <= kept + 1
    said = f'{name}: no position for 0.4 s: silent'
    flown.until(lambda: said in flown.planner.output, said)
    assert flown.planner.stop() == 0
    assert_said_once(flown.planner.output, name)


@pytest.mark.parametrize('name', KINDS)
def test_a_dry_run_sends_nothing(wing, name):
    flown = wing(name, dry_run=True)
    flown.in_mode = True
    flown.until(lambda: len(flown.odometry) > 60, 'odometry')
    flown.alive = False
    flown.until(lambda: 'no position' in flown.planner.output, 'the loss of its position')
    flown.observer.spin(0.5)
    assert not [*flown.setpoints, *flown.kept]
    assert not flown.node.count_publishers('fmu/in/offboard_control_mode')
    assert 'dry run: sends no commands' in flown.planner.output


def test_without_its_messages_a_line_says_what_to_install(launch, monkeypatch):
    monkeypatch.setenv('PYTHONPATH', BEFORE)
    planner = launch('planner', {}, 'px4')
    assert planner.wait() == 2
    said = 'px4_msgs is missing; install ros-<distro>-px4-msgs, or build it in your workspace'
    assert planner.output.strip() == f'autopilot: px4, and {said}'
