# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""RotorPy's Hummingbird in MuJoCo, which catches a rope with a hook on its nose.

MuJoCo moves all bodies, including the rope, and detects contacts. RotorPy supplies rotor and air
loads on the vehicle: the parameters of the AscTec Hummingbird, the wrench on its body, and its
geometric controller, all unmodified.

The controller tracks a setpoint that moves in the plane of flight at the commanded forward speed
and turn rate. Only the shape of the hook, the rope, and the gusts are defined here.

The rope hangs from a point above: 25 links on ball joints, and a weight at its end. It is released
off its rest position and swings; wind acts on it by MuJoCo's own drag on each link. The vehicle
observes where the rope crosses the plane of flight, or its end if it is all above.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from rotorpy.controllers.quadrotor_control import SE3Control
from rotorpy.vehicles.hummingbird_params import quad_params
from rotorpy.vehicles.multirotor import Multirotor

from orbimpc_ros.sim.engines import Array, Engine, EngineFailure, Vehicle, about

STEP = 0.002  # [s] MuJoCo's time step
CONTROL = 2  # steps per update of the rotor commands
LINKS, LINK = 25, 0.1  # number of links, and the length of each [m]
ABOVE = 2.0  # [m] height of the rope's anchor above the plane of flight
FARTHEST = 1.2  # [m] largest displacement, in the plane of flight, of the released rope
FASTEST = 1.5  # [rad/s] turn limit on the way to a waypoint
QUICKEST, SHARPEST = 3.0, 6.0  # limits of the setpoint's acceleration [m/s^2, rad/s^2]
NOSE = np.array([0.45, 0.0, 0.0])  # [m] centre of the hook in the body frame
MEMORY = 1.0  # [s] correlation time of gusts

SCENE = Path(__file__).with_suffix('.xml').read_text()  # with computed values in braces
ROTOR = '<geom type="cylinder" size="{} 0.01" pos="{} {} 0.02" rgba="0.3 0.3 0.3 0.5"/>'
WEIGHT = '<geom size="0.015" fromto="0 0 -{} 0 0 -{}" mass="0.03"/>'
BODY = '<body pos="0 0 {}" childclass="link"><joint/><geom/>{}</body>'


def scene(anchor: Array) -> str:
    """Return the MuJoCo XML of all bodies; the rope hangs straight down from an anchor (3,) [m]."""
    rope = WEIGHT.format(LINK, LINK + 0.02)
    for k in reversed(range(LINKS)):
        rope = BODY.format(-LINK if k else 0.0, rope)
    rotors = [
        ROTOR.format(quad_params['rotor_radius'], *place[:2])
        for place in quad_params['rotor_pos'].values()
    ]
    return SCENE.format(
        step=STEP,
        link=LINK,
        mass=quad_params['mass'],
        inertia=' '.join(str(quad_params[name]) for name in ('Ixx', 'Iyy', 'Izz')),
        rotors='\n      '.join(rotors),
        anchor=' '.join(map(str, anchor)),
        rope=rope,
    )


class Hummingbird(Engine):
    """The vehicle in flight and the released rope; heights are above the plane of flight.

    It flies in the plane; its position is that of the hook.

    Raises:
        EngineFailure: the rope would be released too far from its rest position.
    """

    name = 'mujoco'
    tick = STEP * CONTROL
    every = 5

    def __init__(self, start: Vehicle, forward: float, gust: float, seed: int, rest: Array) -> None:
        assert start.goal is not None
        aside = start.goal - rest
        if math.hypot(*aside) > FARTHEST:
            raise EngineFailure(f'{self.name}: a rope starts at most {FARTHEST:g} m from rest')
        # Problems are raised as errors, not logged to a file.
        mujoco.set_mju_user_warning(lambda _: None)
        self._model = mujoco.MjModel.from_xml_string(scene(np.append(rest, ABOVE)))
        self._data = mujoco.MjData(self._model)
        self._vehicle = self._model.body('vehicle').id
        self._hook = {self._model.geom(name).id for name in ('hook boom', 'hook bar')}
        self._multirotor = Multirotor(quad_params, control_abstraction='cmd_motor_speeds')
        self._controller = SE3Control(quad_params)
        hover = math.sqrt(quad_params['mass'] * 9.81 / (4.0 * quad_params['k_eta']))
        self._rotors = np.full(4, hover)
        self._forward, self._wind, self._gust = forward, start.wind, gust
        self._draw = np.random.default_rng(seed)
        self._blown = gust * self._draw.normal(size=2)
        self._waypoint: Array | None = None
        self._caught = self._struck = False
        yaw = math.atan2(start.attitude[1, 0], start.attitude[0, 0])
        place = np.append(start.position, 0.0) - about(2, yaw) @ NOSE
        self._setpoint = _Setpoint(place, yaw, forward * start.fraction, 0.0, 0.0)
        data, axis = self._data, np.array([aside[1], -aside[0], 0.0])
        data.qpos[:7] = *place, math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)
        data.qvel[:3] = self._setpoint.flat['x_dot']
        axis /= max(math.hypot(*aside), 1e-12)  # about which the straight rope is turned aside
        angle = math.atan2(math.hypot(*aside), ABOVE)
        mujoco.mju_axisAngle2Quat(data.qpos[7:11], axis, angle)
        mujoco.mj_forward(self._model, data)

    def steer_to(self, point: Array) -> None:
        """Let the setpoint fly straight to a waypoint and ignore commanded turns.

        Args:
            point: target position of the hook, shape (2,) [m].
        """
        self._waypoint = np.append(point, 0.0)

    def fly(self, fraction: float, rate: Array) -> None:
        """Fly for one tick at a commanded speed over ground; see :meth:`Engine.fly`."""
        data, before, turn = self._data, self._setpoint, float(rate[0])
        begun, speed = data.time, self._forward * fraction
        if self._waypoint is not None:
            away = self._waypoint - before.position
            off = math.remainder(math.atan2(away[1], away[0]) - before.yaw, 2.0 * math.pi)
            turn = min(max(off / self.tick, -FASTEST), FASTEST)
            speed = min(speed, max(0.0, math.hypot(*away) - NOSE[0]) / self.tick)
        self._setpoint = before.after(self.tick, speed, turn)
        self._push()
        for _ in range(CONTROL):
            mujoco.mj_step(self._model, data)
            if data.ncon and not (self._caught or self._struck):  # the first touch decides
                pairs = (each.geom.tolist() for each in data.contact[: data.ncon])
                hooked = [not self._hook.isdisjoint(pair) for pair in pairs]
                self._caught, self._struck = any(hooked), not all(hooked)
        if any(warning.number for warning in data.warning):
            raise EngineFailure(f'{self.name}: unstable after t = {begun:.3f} s')

    def _push(self) -> None:
        """Apply rotor and air loads to the vehicle, and wind to the rope."""
        data, state = self._data, self._state()
        wanted = self._controller.update(data.time, state, self._setpoint.flat)
        fastest = quad_params['rotor_speed_max']
        speeds = np.clip(wanted['cmd_motor_speeds'], quad_params['rotor_speed_min'], fastest)
        kept = math.exp(-self.tick / quad_params['tau_m'])
        self._rotors = speeds + kept * (self._rotors - speeds)
        kept = math.exp(-self.tick / MEMORY)
        fresh = self._gust * math.sqrt(1.0 - kept * kept)
        self._blown = kept * self._blown + fresh * self._draw.normal(size=2)
        attitude = data.xmat[self._vehicle].reshape(3, 3)
        past = attitude.T @ (state['v'] - self._air)
        force, moment = self._multirotor.compute_body_wrench(state['w'], self._rotors, past)
        data.xfrc_applied[self._vehicle] = *(attitude @ force), *(attitude @ moment)
        self._model.opt.wind[:] = self._air

    @property
    def _air(self) -> Array:
        return np.append(self._wind + self._blown, 0.0)

    def _state(self) -> dict[str, Array]:
        """Return the vehicle's state in RotorPy's format."""
        place, velocity = self._data.qpos[:7], self._data.qvel[:6]
        return {
            'x': place[:3].copy(),
            'v': velocity[:3].copy(),
            'q': np.roll(place[3:], -1),
            'w': velocity[3:].copy(),
        }

    def state(self) -> Vehicle:
        """Return the present state of the hook."""
        data, state = self._data, self._state()
        attitude = data.xmat[self._vehicle].reshape(3, 3).copy()
        hook = state['x'] + attitude @ NOSE
        velocity = state['v'] + attitude @ np.cross(state['w'], NOSE)
        setpoint = self._setpoint
        ahead = about(2, setpoint.yaw)[:, 0]
        return Vehicle(
            data.time,
            hook,
            velocity,
            attitude,
            state['w'],
            min(max(float(velocity @ ahead) / self._forward, 0.0), 1.0),
            self._air,
            facts={
                'bank': math.acos(min(max(attitude[2, 2], -1.0), 1.0)),
                'turn': float((attitude @ state['w'])[2]),
                'off': float(np.linalg.norm(setpoint.position - state['x'])),
            },
            goal=self._crossing(),
            caught=self._caught,
            lost=self._struck,
        ).level()

    def _crossing(self) -> Array:
        """Return where the rope crosses the plane of flight, else its end, shape (3,) [m]."""
        joints = self._data.xanchor[-LINKS:]
        end = joints[-1] - LINK * self._data.xmat[-1].reshape(3, 3)[:, 2]
        places = np.vstack([joints, end])
        below = np.flatnonzero(places[:, 2] <= 0.0)
        if not below.size:
            return end
        upper, lower = places[below[0] - 1], places[below[0]]
        return lower + (upper - lower) * (lower[2] / (lower[2] - upper[2]))


class _Setpoint(NamedTuple):
    """Setpoint of the controller, for the vehicle's centre, in the plane of flight."""

    position: Array  # shape (3,) [m]
    yaw: float  # [rad]
    speed: float  # along the yaw direction [m/s]
    gain: float  # rate of change of the speed [m/s^2]
    turn: float  # rate of change of the yaw [rad/s]

    def after(self, span: float, speed: float, turn: float) -> _Setpoint:
        """Return the setpoint after a short time [s], moved towards a speed and a turn rate."""
        gain = min(max((speed - self.speed) / span, -QUICKEST), QUICKEST)
        most = SHARPEST * span
        turn = self.turn + min(max(turn - self.turn, -most), most)
        yaw, speed = self.yaw + turn * span, self.speed + gain * span
        return _Setpoint(self.position + span * speed * about(2, yaw)[:, 0], yaw, speed, gain, turn)

    @property
    def flat(self) -> dict[str, Any]:
        """Return the setpoint in RotorPy's format."""
        ahead, left, _ = about(2, self.yaw).T
        return {
            'x': self.position,
            'x_dot': self.speed * ahead,
            'x_ddot': self.gain * ahead + self.speed * self.turn * left,
            'yaw': self.yaw,
            'yaw_dot': self.turn,
        }
