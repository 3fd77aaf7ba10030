# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A servicing spacecraft in Basilisk that approaches its client with wheels and thrusters.

Basilisk moves both spacecraft around the Earth, including wheels and thrusters. The flight software
is Basilisk's as well: attitude error, feedback in modified Rodrigues parameters, wheel torques, and
thruster pulses. Wheels and thrusters come from Basilisk's library: Honeywell's HR12 and Moog's
Monarc-1.

The attitude setpoint turns at the commanded rate. Only the hull, the gains, and the model errors
are defined here. These errors are hidden from the flight software: the position of the center of
mass, and the strength and direction of each thruster.

The axes do not rotate; their origin moves with the client.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from Basilisk.architecture import bskLogging, messaging, sim_model, sys_model_task
from Basilisk.fswAlgorithms import attTrackingError, mrpFeedback, rwMotorTorque, thrFiringRemainder
from Basilisk.simulation import (
    extForceTorque,
    gravityEffector,
    reactionWheelStateEffector,
    simpleNav,
    spacecraft,
    thrusterDynamicEffector,
)
from Basilisk.utilities import simIncludeRW, simIncludeThruster
from Basilisk.utilities.RigidBodyKinematics import C2MRP, MRP2C, PRV2C

from orbimpc_ros.sim.engines import Array, Engine, EngineFailure, Vehicle

SECOND = 1_000_000_000  # [ns]
STEP = 0.02  # [s] integration step, by the fourth-order Runge-Kutta method
CONTROL = 0.1  # [s] period of the wheel torques
PULSE = 0.5  # [s] period of the thruster pulses
EARTH = 3.986004418e14  # [m^3/s^2]
ORBIT = 6.878e6  # [m] radius of the client's orbit, 500 km above the Earth
MASS = 60.0  # [kg]
INERTIA = np.diag([4.8, 5.0, 5.2])  # [kg m^2] roughly a cube of 0.7 m
AFT = [-0.35, 0.0, 0.0]  # [m] position of the thruster, which pushes forward
FORCE, BRIEFEST = 0.9, 0.02  # [N, s] thrust and shortest pulse of a Monarc-1
MOMENTUM = 12.0  # [N m s] capacity of a wheel, the smallest HR12
SHARPEST = 0.03  # [rad/s^2] the setpoint's limit: 0.16 N m of the wheels' 0.2 N m
STIFFNESS = 0.6  # [rad/s] bandwidth of the critically damped feedback
OFF_CENTER = 0.005  # [m] standard deviation of the center of mass along each axis
OFF_FORCE = 0.02  # relative standard deviation of a thruster's force
OFF_AXIS = 0.01  # [rad] standard deviation of a thruster's axis about each normal


class Servicer(Engine):
    """The spacecraft in flight; its position is the centre of its hull.

    It starts in space; the goal is the client, which stays on its orbit. Its wind is an
    acceleration in addition to gravity; the seed draws the model errors.
    """

    name = 'basilisk'
    tick = CONTROL
    every = 5

    def __init__(
        self, start: Vehicle, forward: float, _gust: float, seed: int, rest: Array
    ) -> None:
        bskLogging.setDefaultLogLevel(bskLogging.BSK_ERROR)
        draw = np.random.default_rng(seed)
        still, off_center = np.zeros(3), OFF_CENTER * draw.normal(size=3)
        away = start.position - rest
        self._forward, self._rest, self._now = forward, rest, 0  # [ns]
        self._setpoint = _Setpoint(start.attitude, start.body_rate, still)
        self._client = _orbiting(still, still, np.eye(3), still, still)
        self._vehicle = _orbiting(away, start.velocity, start.attitude, start.body_rate, off_center)
        self._attitude, self._force = messaging.AttRefMsg(), messaging.THRArrayCmdForceMsg()
        thrusters, self._firing, *kept = _propelled(self._vehicle, self._force, draw)
        self._wheels, software, *more = _steered(self._vehicle, self._attitude)
        unknown = extForceTorque.ExtForceTorque()
        unknown.extForce_N = (MASS * start.wind).tolist()
        self._vehicle.addDynamicEffector(unknown)
        bodies = [self._wheels, thrusters, unknown, self._client, self._vehicle]
        # The software runs one step late, so that commands sent between two motions act at once.
        self._simulation, *most = _simulated(
            (STEP, 0.0, bodies), (CONTROL, STEP, software), (PULSE, STEP, [self._firing])
        )
        self._kept = kept, more, most  # Basilisk holds pointers to these; Python must not free them
        self._tell(0.0)
        self._simulation.StepUntilStop(0, -1)

    def fly(self, fraction: float, rate: Array) -> None:
        """Fly for one tick at a commanded thrust acceleration; see :meth:`Engine.fly`."""
        self._tell(self._forward * fraction)
        self._setpoint = self._setpoint.after(CONTROL, rate)
        self._now += round(CONTROL * SECOND)
        try:
            self._simulation.StepUntilStop(self._now, -1)
        except bskLogging.BasiliskError as error:
            raise EngineFailure(f'{self.name}: {error}') from error

    def _tell(self, push: float) -> None:
        """Send the attitude setpoint and the thrust acceleration [m/s^2] to the flight software."""
        attitude, rate, gain = self._setpoint
        self._attitude.write(
            messaging.AttRefMsgPayload(
                sigma_RN=C2MRP(attitude.T).tolist(),
                omega_RN_N=(attitude @ rate).tolist(),
                domega_RN_N=(attitude @ gain).tolist(),
            ),
            self._now,
        )
        force = messaging.THRArrayCmdForceMsgPayload(thrForce=[MASS * push])
        self._force.write(force, self._now)

    def state(self) -> Vehicle:
        """Return the present state; ``fraction`` is the mean thrust of the latest pulses.

        ``pointing`` is the angle between attitude and setpoint [rad], ``wheel`` the speed of the
        fastest wheel [rad/s].
        """
        now, client = self._vehicle.scStateOutMsg.read(), self._client.scStateOutMsg.read()
        attitude = MRP2C(now.sigma_BN).T
        pulse = min(self._firing.onTimeOutMsg.read().OnTimeRequest[0], PULSE)
        speeds = self._wheels.rwSpeedOutMsg.read().wheelSpeeds[:3]
        off = C2MRP(attitude.T @ self._setpoint.attitude)
        return Vehicle(
            self._simulation.CurrentNanos / SECOND,
            self._rest + np.subtract(now.r_BN_N, client.r_BN_N),
            np.subtract(now.v_BN_N, client.v_BN_N),
            attitude,
            np.array(now.omega_BN_B),
            min(FORCE * pulse / PULSE / MASS / self._forward, 1.0),
            np.zeros(3),
            facts={
                'pointing': 4.0 * math.atan(float(np.linalg.norm(off))),
                'wheel': float(np.abs(speeds).max()),
            },
        )


class _Setpoint(NamedTuple):
    """Attitude setpoint of the flight software; rates are in the body frame."""

    attitude: Array  # body to world, shape (3, 3)
    rate: Array  # shape (3,) [rad/s]
    gain: Array  # rate of change of the rate, shape (3,) [rad/s^2]

    def after(self, span: float, rate: Array) -> _Setpoint:
        """Return the setpoint after a short time [s], moved towards a body rate."""
        gain = np.clip((rate - self.rate) / span, -SHARPEST, SHARPEST)
        turned = span * (self.rate + 0.5 * span * gain)
        return _Setpoint(self.attitude @ PRV2C(turned).T, self.rate + span * gain, gain)


def _orbiting(
    away: Array, velocity: Array, attitude: Array, body_rate: Array, off_center: Array
) -> Any:
    """Return a spacecraft around the Earth; position and velocity are relative to the client.

    The center of mass is ``off_center`` from the centre of the hull, shape (3,) [m].
    """
    craft, earth = spacecraft.Spacecraft(), gravityEffector.GravBodyData()
    hub, past = craft.hub, attitude @ np.cross(body_rate, off_center)
    hub.mHub, hub.IHubPntBc_B, hub.r_BcB_B = MASS, INERTIA.tolist(), off_center.tolist()
    place, speed = np.array([ORBIT, 0.0, 0.0]), np.array([0.0, math.sqrt(EARTH / ORBIT), 0.0])
    hub.r_CN_NInit = (place + away + attitude @ off_center).tolist()
    hub.v_CN_NInit = (speed + velocity + past).tolist()
    hub.sigma_BNInit, hub.omega_BN_BInit = C2MRP(attitude.T).tolist(), body_rate.tolist()
    earth.planetName, earth.mu, earth.isCentralBody = 'earth', EARTH, True
    earth.usePointMassGravityModel()
    craft.gravField.gravBodies = spacecraft.GravBodyVector([earth])
    return craft


def _propelled(vehicle: Any, force: Any, draw: np.random.Generator) -> list[Any]:
    """Return a thruster with random errors, its firing module, and objects to keep alive."""
    factory = simIncludeThruster.thrusterFactory()
    axis = [1.0, *(OFF_AXIS * draw.normal(size=2))]
    thruster = factory.create('MOOG_Monarc_1', AFT, axis)
    thruster.thrusterMagDisp = float(OFF_FORCE * draw.normal())
    thrusters = thrusterDynamicEffector.ThrusterDynamicEffector()
    factory.addToSpacecraft('thrusters', thrusters, vehicle)
    firing, config = thrFiringRemainder.thrFiringRemainder(), factory.getConfigMessage()
    firing.thrMinFireTime, firing.baseThrustState = BRIEFEST, 0
    firing.thrConfInMsg.subscribeTo(config)
    firing.thrForceInMsg.subscribeTo(force)
    thrusters.cmdsInMsg.subscribeTo(firing.onTimeOutMsg)
    return [thrusters, firing, factory, config]


def _steered(vehicle: Any, attitude: Any) -> list[Any]:
    """Return the wheels, their flight software, and objects to keep alive."""
    factory = simIncludeRW.rwFactory()
    for axis in np.eye(3):
        factory.create('Honeywell_HR12', axis.tolist(), maxMomentum=MOMENTUM)
    wheels = reactionWheelStateEffector.ReactionWheelStateEffector()
    factory.addToSpacecraft('wheels', wheels, vehicle)
    inertia, config = messaging.VehicleConfigMsg(), factory.getConfigMessage()
    inertia.write(messaging.VehicleConfigMsgPayload(ISCPntB_B=INERTIA.ravel().tolist()))
    navigation, error = simpleNav.SimpleNav(), attTrackingError.attTrackingError()
    feedback, torques = mrpFeedback.mrpFeedback(), rwMotorTorque.rwMotorTorque()
    navigation.scStateInMsg.subscribeTo(vehicle.scStateOutMsg)
    error.attNavInMsg.subscribeTo(navigation.attOutMsg)
    error.attRefInMsg.subscribeTo(attitude)
    feedback.guidInMsg.subscribeTo(error.attGuidOutMsg)
    feedback.vehConfigInMsg.subscribeTo(inertia)
    feedback.rwParamsInMsg.subscribeTo(config)
    feedback.rwSpeedsInMsg.subscribeTo(wheels.rwSpeedOutMsg)
    mean = float(np.diag(INERTIA).mean())
    feedback.K, feedback.P, feedback.Ki = 4.0 * mean * STIFFNESS**2, 2.0 * mean * STIFFNESS, -1.0
    torques.vehControlInMsg.subscribeTo(feedback.cmdTorqueOutMsg)
    torques.rwParamsInMsg.subscribeTo(config)
    torques.controlAxes_B = np.eye(3).ravel().tolist()
    wheels.rwMotorCmdInMsg.subscribeTo(torques.rwMotorTorqueOutMsg)
    return [wheels, [navigation, error, feedback, torques], factory, config, inertia]


def _simulated(*tasks: tuple[float, float, list[Any]]) -> list[Any]:
    """Return a simulation of tasks, ready to run, and objects to keep alive.

    A task is its period [s], its first time [s] and its models; simultaneous tasks keep this order.
    """
    simulation, process = sim_model.SimModel(), sim_model.SysProcess('flight')
    simulation.addNewProcess(process)
    kept = [simulation, process]
    for number, (period, begin, models) in enumerate(tasks):
        task = sys_model_task.SysModelTask(round(period * SECOND), round(begin * SECOND))
        for model in models:
            task.AddNewObject(model, -1)
        process.addNewTask(task, len(tasks) - number)
        kept += [task, *models]
    simulation.assignRemainingProcs()
    simulation.selfInitSimulation()
    simulation.resetInitSimulation()
    return kept
