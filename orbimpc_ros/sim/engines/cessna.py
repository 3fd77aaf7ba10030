# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""JSBSim's Cessna 172P on its own autopilot.

The aircraft ``c172x`` comes with two autopilots, both engaged and unmodified: the altitude hold of
``c172ap.xml``, and the roll channel of ``systems/Autopilot.xml``, which commands a bank equal to
the heading error, at most 30 degrees, with a roll rate of at most 10 degrees per second.

A turn is commanded through the heading setpoint: its error is the bank of a coordinated turn,
tan(bank) = turn * speed / g. The autopilots do not control the throttle. It is set to the value of
JSBSim's own trim at the commanded speed, plus a proportional correction of the speed error.
"""

from __future__ import annotations

import math

import jsbsim
import numpy as np

from orbimpc_ros.sim.engines import Array, Engine, EngineFailure, Vehicle, about

FOOT = 0.3048  # [m]
GRAVITY = 9.80665  # [m/s^2]
RATE = 120.0  # [Hz] as in JSBSim's own scripts for this aircraft
HEIGHT = 1000.0  # [ft] above ground; up to there, turbulence is a tenth of the wind at 20 ft
EAST, NORTH = 6378137.0 + HEIGHT * FOOT, 6335439.0 + HEIGHT * FOOT  # [m] WGS 84 radii at 0 N, 0 E
SPEEDS = (30.0, 34.0, 38.0, 42.0, 46.0, 50.0, 54.0, 58.0)  # [m/s] airspeeds
THROTTLES = (0.5558, 0.5707, 0.6022, 0.6410, 0.6824, 0.7233, 0.7650, 0.8052)  # of level trim
CORRECTION = 0.05  # throttle per m/s of speed error
MILITARY = 3  # turbulence by MIL-F-8785C, Dryden spectra
LIGHT = 3.0  # severity above 1,000 ft; 0 switches turbulence off at all heights


class Cessna(Engine):
    """The aircraft in flight, trimmed at the start.

    It starts in the plane, east and north; the goal is not its concern.

    Raises:
        EngineFailure: there is no level flight at that speed.
    """

    name = 'jsbsim'
    tick = 1.0 / RATE
    every = 6

    def __init__(
        self, start: Vehicle, forward: float, gust: float, seed: int, _rest: Array
    ) -> None:
        jsbsim.FGJSBBase().debug_lvl = 0  # of all later instances: no banner
        fdm = self._fdm = jsbsim.FGFDMExec(jsbsim.get_default_root_dir())
        fdm.load_model('c172x')
        fdm.set_dt(self.tick)
        self._forward, speed = forward, forward * start.fraction
        self._place, wind, axis = start.position, start.wind, start.attitude[:, 0]
        east, north = speed * axis + wind
        fdm['simulation/randomseed'] = seed
        fdm['ic/h-agl-ft'] = HEIGHT
        fdm['ic/lat-geod-deg'] = fdm['ic/long-gc-deg'] = 0.0
        fdm['ic/psi-true-rad'] = (0.5 * math.pi - math.atan2(axis[1], axis[0])) % (2.0 * math.pi)
        fdm['ic/vw-mag-fps'] = float(np.linalg.norm(wind)) / FOOT
        fdm['ic/vw-dir-deg'] = math.degrees(math.atan2(*wind)) % 360.0  # blows towards
        fdm['ic/ve-fps'] = east / FOOT
        fdm['ic/vn-fps'] = north / FOOT
        fdm['fcs/throttle-cmd-norm'] = float(np.interp(speed, SPEEDS, THROTTLES))
        fdm.run_ic()
        fdm['propulsion/set-running'] = -1.0
        try:
            fdm['simulation/do_simple_trim'] = 1.0
        except jsbsim.TrimFailureError as error:
            raise EngineFailure(f'{self.name}: no level flight at {speed:g} m/s') from error
        # After trimming: turbulence, and both autopilots.
        fdm['atmosphere/turb-type'] = MILITARY
        fdm['atmosphere/turbulence/milspec/severity'] = LIGHT
        fdm['atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps'] = 10.0 * gust / FOOT
        fdm['ap/altitude_setpoint'] = HEIGHT
        fdm['ap/altitude_hold'] = 1.0
        fdm['ap/autopilot-roll-on'] = 1.0
        fdm['ap/roll-attitude-mode'] = 1.0
        fdm['guidance/heading-selector-switch'] = 1.0

    def steer_to(self, point: Array) -> None:
        """Let the aircraft's own guidance fly to a waypoint and ignore commanded turns.

        Args:
            point: east and north, shape (2,) [m].
        """
        east, north = np.asarray(point, dtype=float) - self._place
        self._fdm['guidance/heading-selector-switch'] = 0.0
        self._fdm['guidance/target_wp_longitude_rad'] = east / EAST
        self._fdm['guidance/target_wp_latitude_rad'] = north / NORTH

    def fly(self, fraction: float, rate: Array) -> None:
        """Fly for one tick at a commanded airspeed; see :meth:`Engine.fly`."""
        fdm, now = self._fdm, self._fdm['velocities/vt-fps'] * FOOT
        wanted = self._forward * fraction
        bank = math.atan(float(rate[0]) * now / GRAVITY)  # to the left, where headings decrease
        throttle = np.interp(wanted, SPEEDS, THROTTLES) + CORRECTION * (wanted - now)
        fdm['guidance/specified-heading-rad'] = fdm['attitude/psi-rad'] - bank
        fdm['fcs/throttle-cmd-norm'] = min(max(float(throttle), 0.0), 1.0)
        if not fdm.run():
            raise EngineFailure(f'{self.name}: stopped at t = {self.state().time:.3f} s')

    def state(self) -> Vehicle:
        """Return the present state.

        ``bank`` is positive to the left; ``turn`` is the rate of a coordinated turn at this bank,
        as an instrument shows it, without the yaw by which the fin corrects for a gust.
        """
        fdm = self._fdm
        speed = fdm['velocities/vt-fps'] * FOOT
        offset = [EAST * fdm['position/long-gc-rad'], NORTH * fdm['position/lat-geod-rad']]
        high = (fdm['position/h-agl-ft'] - HEIGHT) * FOOT
        compass, pitch, roll = (fdm[f'attitude/{name}-rad'] for name in ('psi', 'theta', 'phi'))
        return Vehicle(
            float(fdm['simulation/sim-time-sec']),
            np.append(self._place + offset, high),
            self._enu('velocities/v-{}-fps'),
            about(2, 0.5 * math.pi - compass) @ about(1, -pitch) @ about(0, roll),
            np.array([fdm[f'velocities/{axis}-rad_sec'] for axis in 'pqr']) * [1.0, -1.0, -1.0],
            min(max(speed / self._forward, 0.0), 1.0),
            self._enu('atmosphere/total-wind-{}-fps'),
            facts={
                'bank': -float(roll),
                'turn': -GRAVITY * math.tan(roll) / speed,
                'throttle': float(fdm['fcs/throttle-cmd-norm']),
            },
        ).level()

    def _enu(self, name: str) -> Array:
        """Return one of the engine's vectors in ENU axes and metres."""
        north, east, down = (self._fdm[name.format(each)] for each in ('north', 'east', 'down'))
        return FOOT * np.array([east, north, -down])
