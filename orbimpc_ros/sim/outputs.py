# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Messages of a flight to others: measurements, with faults from a seed, and all the rest.

Faults are noise, losses, delays and wrong stamps. The random draws of a tick depend on the seed and
the tick number only, so that runs repeat exactly, faults do not affect each other's draws, and
repeated queries of one tick agree.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from importlib.util import find_spec
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped, Vector3
from nav_msgs.msg import Path
from rosgraph_msgs.msg import Clock
from visualization_msgs.msg import Marker, MarkerArray

from orbimpc_ros.loop.compensation import Odometry
from orbimpc_ros.loop.goal.motion import GoalObservation
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.problem import Ball
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import Stamp, marker, point, pose
from orbimpc_ros.ros.topics import message_of
from orbimpc_ros.sim.engines import Vehicle
from orbimpc_ros.sim.parameters import SimSettings
from orbimpc_ros.sim.vehicle import between, measured
from orbimpc_ros.sim.world import Flight

ODOMETRY, GOAL, COMMAND = range(3)  # rows of a tick's draws
TREE = find_spec('tf2_msgs') is not None  # the PyPI wheels of ROS have none
Seen = Odometry | GoalObservation  # a message to the planner, at the true time of measurement


class View:
    """The messages of a flight that reach its planner at each tick."""

    def __init__(self, settings: SimSettings) -> None:
        faults, self._seed = settings.faults, settings.seed
        self.faults = faults
        self._shares = np.array([faults.dropout, faults.reorder, faults.duplicate, faults.nan])
        self._past: deque[Vehicle] = deque()  # from what odometry shows to the present
        self._held_back: list[Seen] = []

    def of(self, flight: Flight) -> list[Seen]:
        """Return the messages that arrive at this tick, in order. Call it once per tick."""
        arriving, self._held_back = self._held_back, []
        chances, shifts, turn = _draws(self._seed, flight.ticks)
        shifts = self.faults.position_noise * shifts[:, : len(flight.goal)]
        length, period = self.faults.occlusion_length, self.faults.occlusion_period
        window, into = divmod(flight.vehicle.time, period)  # the goal is hidden once in each
        begin = (period - length) * np.random.default_rng((self._seed, 1, int(window))).uniform()
        if not begin <= into < begin + length:
            goal = GoalObservation(flight.vehicle.time, flight.goal + shifts[GOAL])
            arriving += self._through(chances[GOAL], goal)
        seen = measured(self._delayed(flight), flight.settings.velocity_source)
        turned = seen.attitude @ exp(self.faults.attitude_noise * turn[: len(seen.body_rate)])
        seen = replace(seen, position=seen.position + shifts[ODOMETRY], attitude=turned)
        return arriving + self._through(chances[ODOMETRY], seen)

    def command_lost(self, ticks: int) -> bool:
        """Return True if the command that answers a tick is lost."""
        return bool(_draws(self._seed, ticks)[0][COMMAND, 0] < self.faults.dropout)

    def _delayed(self, flight: Flight) -> Vehicle:
        """Return the vehicle as it was ``delay`` ago; before the start, its initial state."""
        past, at = self._past, flight.vehicle.time - self.faults.delay
        past.extend(flight.trail or (flight.vehicle,))
        while len(past) > 1 and past[1].time <= at:
            past.popleft()
        if len(past) > 1 and past[0].time <= at:
            return between(past[0], past[1], at)
        return replace(past[0], time=at)

    def _through(self, chances: Array, sent: Seen) -> list[Seen]:
        """Return the copies of a message that arrive now: zero, one or two."""
        lost, late, twice, spoilt = chances < self._shares
        if lost:
            return []
        if spoilt:
            sent = replace(sent, position=np.full_like(sent.position, np.nan))
        copies = [sent] * (2 if twice else 1)
        if late:
            self._held_back += copies
            return []
        return copies


def _draws(seed: int, ticks: int) -> tuple[Array, Array, Array]:
    """Return a tick's draws: uniform, shape (3, 4), and normal, shapes (2, 3) and (3,)."""
    rng = np.random.default_rng((seed, 0, ticks))
    return rng.uniform(size=(3, 4)), rng.normal(size=(2, 3)), rng.normal(size=3)


# --- as messages


def sensed(stamp: Stamp, content: Seen) -> tuple[str, Any]:
    """Return the topic and the message of a measurement."""
    if isinstance(content, Odometry):
        return 'odom', messages.odometry_message(stamp, content)
    return 'goal', messages.goal_message(stamp, content.position)


def surroundings(stamp: Stamp, flight: Flight) -> Iterator[tuple[str, MarkerArray | Path]]:
    """Yield the messages to a planner on bodies and the goal's path, if any, with their topics.

    Bodies are larger than they are by the margin of the traffic.
    """
    step, margin = flight.settings.model.step, flight.settings.traffic_margin
    markers = []
    for k, each in enumerate(flight.settings.traffic):
        ball = each.after(flight.vehicle.time).body
        assert isinstance(ball, Ball)
        empty = marker(stamp, 'traffic', k, Marker.SPHERE, messages.RED, step)
        markers.append(messages.shown(empty, Ball(ball.centre, ball.radius + margin)))
    if markers:
        yield 'obstacles', MarkerArray(markers=markers)
    if steps := flight.settings.goal_path_steps:
        times = (flight.vehicle.time + step * k for k in range(steps + 1))
        ahead = [pose(flight.settings.rope_at(time)) for time in times]
        yield 'goal_path', messages.path_message(stamp, step, ahead)


def shown(stamp: Stamp, node: str, flight: Flight) -> Iterator[tuple[str, Any]]:
    """Yield all messages on the present state of a flight but measurements, with their topics."""
    if flight.settings.clock == 'lockstep':
        yield '/clock', Clock(clock=messages.time_message(stamp.nanoseconds))
    yield from surroundings(stamp, flight)
    yield 'world_markers', world_markers(stamp, flight)
    if flight.settings.vehicle != 'discrete':
        yield 'truth', truth(stamp, node, flight)
    if TREE:
        odometry = messages.odometry_message(stamp, measured(flight.vehicle))
        turned, place = odometry.pose.pose.orientation, odometry.pose.pose.position
        link = TransformStamped(header=odometry.header, child_frame_id=odometry.child_frame_id)
        link.transform.translation = Vector3(x=place.x, y=place.y, z=place.z)
        link.transform.rotation = turned
        yield '/tf', message_of('/tf')(transforms=[link])


def truth(stamp: Stamp, node: str, flight: Flight) -> DiagnosticArray:
    """Return the vehicle's true state as a diagnostic status."""
    vehicle, now = flight.vehicle, flight.vehicle.airspeed
    values = {
        'airspeed': now,
        'least_airspeed': flight.least_airspeed,
        'stalls': flight.stalls,
        'wind': vehicle.wind.tolist(),
        'position': vehicle.position.tolist(),
        'velocity': vehicle.velocity.tolist(),
        'body_rate': vehicle.body_rate.tolist(),
        'speed_fraction': vehicle.fraction,
        'touched': sorted(flight.touched),
        **vehicle.facts,
    }
    level, text = messages.OK, 'flies'
    if flight.stalled:
        level = messages.WARN
        text = f'stalled: {now:.3g} m/s, below {flight.settings.stall_speed:g} m/s'
    return messages.diagnostics(stamp.nanoseconds, f'{node}: truth', level, text, values)


def world_markers(stamp: Stamp, flight: Flight) -> MarkerArray:
    """Return markers of the goal with its capture radius, its swing, and the vehicle."""
    model, radius = flight.settings.model, flight.settings.capture_radius
    unit, side = model.forward * model.step, 2.0 * radius
    rope = marker(stamp, 'rope', 0, Marker.SPHERE, messages.ORANGE, model.step)
    rope.scale = Vector3(x=side, y=side, z=side)
    rope.pose.position = point(flight.goal)
    swing = marker(stamp, 'rope', 1, Marker.LINE_STRIP, messages.GREY, model.step)
    swing.scale.x = messages.LINE * unit
    swing.points = [point(flight.settings.rope[0]), point(flight.goal)]
    vehicle = marker(stamp, 'vehicle', 0, Marker.ARROW, messages.BLUE, model.step)
    vehicle.pose = pose(flight.vehicle.position, flight.vehicle.attitude)
    vehicle.scale = Vector3(x=0.4 * unit, y=0.1 * unit, z=0.1 * unit)
    return MarkerArray(markers=[rope, swing, vehicle])
