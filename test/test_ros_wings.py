# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Planners of wings on the topics of their autopilots, with the messages of both over DDS."""

import math
import os
import re
import sys
import time
from importlib import import_module
from itertools import pairwise

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, TwistWithCovarianceStamped
from interfaces.build import build
from nav_msgs.msg import Odometry

from orbimpc_ros.loop.state import Odometry as Measured
from orbimpc_ros.mpc.geometry.rotations import to_quaternion
from orbimpc_ros.ros import firmware, messages
from orbimpc_ros.ros.messages import Frames, Stamp
from orbimpc_ros.ros.process import qos

WIND, AIRSPEED = np.array([4.0, -3.0]), 15.0
BEFORE = os.environ.get('PYTHONPATH', '')  # without the packages
PACKAGES = {'px4': 'px4_msgs', 'arduplane': 'mavros_msgs'}
SAID = {'px4': 'px4: in offboard', 'arduplane': 'arduplane: in GUIDED'}


@pytest.fixture(scope='session')
def packages(tmp_path_factory):
    """The message packages, on the path of this process and of those that it starts."""
    folder = tmp_path_factory.mktemp('packages')
    for package in PACKAGES.values():
        build(package, folder)
    os.environ['PYTHONPATH'] = os.pathsep.join(filter(None, (str(folder), BEFORE)))
    sys.path.insert(0, str(folder))
    yield folder
    sys.path.remove(str(folder))
    os.environ['PYTHONPATH'] = BEFORE


class Wing:
    """A wing that flies along a circle, and its autopilot, which obeys nobody."""

    def __init__(self, launch, observer, name, **parameters):
        self.observer, self.node = observer, observer.node
        self.types = import_module(f'{PACKAGES[name]}.msg')
        self.goal = self.node.create_publisher(PoseStamped, 'goal', 1)
        self.setpoints, self.odometry = [], observer.listen(Odometry, 'odom')
        self.wind = observer.listen(TwistWithCovarianceStamped, 'wind')
        self.turned = []  # attitudes sent of late
        self.sent_at, self.in_mode, self.alive, self.height = 0.0, False, True, 0.0
        self.connect()
        self.planner = launch('planner', {'use_sim_time': False, **parameters}, name)
        self.begun = time.time()

    def until(self, happened, what):
        def step():
            now = time.time()
            if self.alive and now - self.sent_at >= 0.05:
                self.sent_at = now
                place, velocity, rotation = self.motion(now)
                self.turned = [*self.turned[-3:], rotation]
                self.tell(now, place, velocity, rotation)
                there = messages.pose(np.array([900.0, 500.0, self.height]), np.eye(3))
                self.goal.publish(PoseStamped(header=messages.header(0, 'odom'), pose=there))
            return happened()

        self.observer.until(step, what)

    def motion(self, now):
        """Position and velocity over ground, and the attitude, in ROS's axes."""
        turn = 0.2
        yaw, bank = turn * (now - self.begun), -math.atan(turn * AIRSPEED / firmware.GRAVITY)
        c, s = math.cos(yaw), math.sin(yaw)
        level = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        cos, sin = math.cos(bank), math.sin(bank)
        banked = np.array([[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]])
        radius = AIRSPEED / turn
        place = np.array([radius * s, radius * (1.0 - c), 100.0])
        place[:2] += (now - self.begun) * WIND
        return place, AIRSPEED * level[:, 0] + np.append(WIND, 0.0), level @ banked


class Px4(Wing):
    def connect(self):
        types, node = self.types, self.node
        self.said = {
            kind: node.create_publisher(kind, f'fmu/out/{name}', qos())
            for name, kind in (
                ('vehicle_local_position_v1', types.VehicleLocalPosition),
                ('vehicle_attitude', types.VehicleAttitude),
                ('airspeed_validated_v1', types.AirspeedValidated),
                ('wind', types.Wind),
                ('vehicle_status_v1', types.VehicleStatus),
            )
        }
        self.lateral = self.observer.listen(
            types.FixedWingLateralSetpoint, 'fmu/in/fixed_wing_lateral_setpoint'
        )
        self.setpoints = self.observer.listen(
            types.FixedWingLongitudinalSetpoint, 'fmu/in/fixed_wing_longitudinal_setpoint'
        )
        self.kept = self.observer.listen(types.OffboardControlMode, 'fmu/in/offboard_control_mode')

    def tell(self, now, place, velocity, rotation):
        types, at = self.types, round(1e6 * now)
        known = {'xy_valid': True, 'v_xy_valid': True, 'z_global': True, 'ref_alt': 200.0}
        ned = dict(zip('xyz', map(float, firmware.NED @ place), strict=True))
        speeds = dict(zip(('vx', 'vy', 'vz'), map(float, firmware.NED @ velocity), strict=True))
        unit = to_quaternion(firmware.NED @ rotation @ firmware.FRD).astype(np.float32)
        east, north = WIND
        for message in (
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
        ):
            self.said[type(message)].publish(message)


class ArduPlane(Wing):
    def connect(self):
        types, node = self.types, self.node
        self.service = import_module('mavros_msgs.srv').CommandInt
        self.refusing = False
        node.create_service(self.service, 'mavros/cmd/command_int', self.obey)
        self.said = {
            kind: node.create_publisher(kind, f'mavros/{name}', qos())
            for name, kind in (
                ('local_position/odom', Odometry),
                ('vfr_hud', types.VfrHud),
                ('wind_estimation', TwistWithCovarianceStamped),
                ('state', types.State),
            )
        }

    def obey(self, request, response):
        self.setpoints.append(request)
        response.success = not self.refusing
        return response

    def tell(self, now, place, velocity, rotation):
        stamp = Stamp(round(1e9 * now), Frames('map', 'base_link'))
        body = Measured(now, place, rotation, rotation.T @ velocity, np.zeros(3))
        wind = TwistWithCovarianceStamped(header=messages.header(stamp.nanoseconds, ''))
        wind.twist.twist.linear.x, wind.twist.twist.linear.y = WIND.tolist()
        wind.twist.covariance[0] = -1.0  # as MAVROS has it of ArduPilot: unknown
        share = firmware.equivalent(1000.0)
        for message in (
            self.types.VfrHud(airspeed=share * AIRSPEED, altitude=1000.0),
            wind,
            self.types.State(connected=True, mode='GUIDED' if self.in_mode else 'AUTO'),
            messages.odometry_message(stamp, body),
        ):
            self.said[type(message)].publish(message)


KINDS = {'px4': Px4, 'arduplane': ArduPlane}


@pytest.fixture
def wing(launch, observer, packages):
    def fly(name, **parameters):
        return KINDS[name](launch, observer, name, **parameters)

    return fly


def engage(flown, name):
    flown.until(lambda: flown.odometry, 'odometry')
    flown.in_mode = True
    flown.until(lambda: len(flown.setpoints) > 6, 'setpoints')
    assert SAID[name] in flown.planner.output


def assert_said_once(output, name):
    """Each change is said once; on a busy machine there may be more than those of a test."""
    said = re.findall(rf'{name}: .*: (setpoints|silent)$', output, re.MULTILINE)
    assert said
    assert all(one != other for one, other in pairwise(said))


@pytest.mark.parametrize('name', KINDS)
def test_setpoints_leave_in_the_mode_alone(wing, name):
    flown = wing(name)
    flown.until(lambda: len(flown.odometry) > 30, 'odometry')
    assert not flown.setpoints
    engage(flown, name)
    flown.in_mode = False
    flown.until(lambda: 'silent' in flown.planner.output, 'silence')
    before = [each for each in flown.setpoints if getattr(each, 'param1', 1.0) != 2.0]
    heard = len(flown.odometry)
    flown.until(lambda: len(flown.odometry) > heard + 20, 'odometry')
    assert len(flown.setpoints) <= len(before) + 1  # one may have been on its way
    assert flown.planner.stop() == 0
    assert_said_once(flown.planner.output, name)


@pytest.mark.parametrize('name', KINDS)
def test_an_autopilot_that_stops_gets_no_setpoint_half_a_second_later(wing, name):
    flown = wing(name)
    engage(flown, name)
    flown.alive, stopped = False, flown.sent_at
    flown.until(lambda: time.time() - stopped > 0.5, 'half a second')
    is_setpoint = [getattr(each, 'param1', 1.0) != 2.0 for each in flown.setpoints]
    kept = len(getattr(flown, 'kept', ()))
    flown.until(lambda: time.time() - stopped > 2.0, 'another second')
    later = flown.setpoints[len(is_setpoint) :]
    assert not [each for each in later if getattr(each, 'param1', 1.0) != 2.0]
    assert len(getattr(flown, 'kept', ())) <= kept + 1
    said = f'{name}: no position for 0.4 s: silent'
    flown.until(lambda: said in flown.planner.output, said)
    assert_said_once(flown.planner.output, name)


@pytest.mark.parametrize('name', KINDS)
def test_what_is_measured_becomes_odometry_through_the_air(wing, name):
    flown = wing(name)
    flown.until(lambda: len(flown.odometry) > 30 and flown.wind, 'odometry and wind')
    message = flown.odometry[-1]
    at = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
    place, _, _ = flown.motion(at)
    _, measured = messages.read_odometry(message, 3, Frames())
    np.testing.assert_allclose(measured.position, place, atol=1e-3)
    # Topics are not ordered: PX4's attitude may be the one sent before.
    assert min(np.abs(measured.attitude - each).max() for each in flown.turned) < 1e-5
    np.testing.assert_allclose(measured.body_velocity, [AIRSPEED, 0.0, 0.0], atol=0.2)
    assert np.linalg.norm(measured.body_velocity) == pytest.approx(AIRSPEED, abs=1e-3)
    assert measured.body_rate[2] == pytest.approx(0.2, abs=1e-3)
    told = flown.wind[-1].twist
    np.testing.assert_allclose([told.twist.linear.x, told.twist.linear.y], WIND, atol=1e-6)
    variance = told.covariance[0]
    assert variance == pytest.approx(0.1) if name == 'px4' else variance == -1.0


def test_px4_is_kept_in_offboard_mode_and_told_what_it_reads(wing):
    flown = wing('px4')
    flown.height = 120.0
    flown.until(lambda: len(flown.kept) > 20, 'signs of life')  # before the mode: to enter it
    assert not flown.setpoints
    assert np.median(np.diff([each.timestamp for each in flown.kept])) < 5e5  # [us]: 2 Hz
    assert all(each.velocity and not each.position for each in flown.kept)
    engage(flown, 'px4')
    flown.until(lambda: flown.lateral, 'a lateral setpoint')
    across, along = flown.lateral[-1], flown.setpoints[-1]
    assert math.isnan(across.course)
    assert -math.pi <= across.airspeed_direction <= math.pi
    assert abs(across.lateral_acceleration) <= 18.0 * 0.25 + 1e-3
    assert 0.75 * 18.0 * 0.9 - 1e-3 <= along.equivalent_airspeed <= 18.0 * 0.9 + 1e-3
    assert along.altitude == pytest.approx(320.0)  # above mean sea level
    unused = along.height_rate, along.pitch_direct, along.throttle_direct
    assert all(map(math.isnan, unused))


def test_a_refused_command_is_warned_of_once(wing):
    flown = wing('arduplane')
    flown.refusing = True
    engage(flown, 'arduplane')
    said = 'arduplane: has refused command 43'
    flown.until(lambda: said in flown.planner.output, said)
    kinds = {each.command for each in flown.setpoints}
    assert kinds == {43000, 43002}  # and the altitude is held
    flown.until(lambda: len(flown.setpoints) > 30, 'setpoints')
    assert flown.planner.output.count(said) == 1


def test_a_dry_run_sends_nothing(wing):
    flown = wing('px4', dry_run=True)
    flown.in_mode = True
    flown.until(lambda: len(flown.odometry) > 60, 'odometry')
    assert not flown.setpoints
    assert not flown.kept
    assert not flown.node.count_publishers('fmu/in/offboard_control_mode')
    assert 'commands nothing: a dry run' in flown.planner.output


@pytest.mark.parametrize('name', KINDS)
def test_without_its_messages_a_line_says_what_to_install(launch, monkeypatch, name):
    monkeypatch.setenv('PYTHONPATH', BEFORE)
    planner = launch('planner', {}, name)
    assert planner.wait() == 2
    package = PACKAGES[name]
    assert planner.output.strip() == (
        f'autopilot: {name}, and {package} is missing; '
        f'install ros-<distro>-{package.replace("_", "-")}'
    )
