# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Moving obstacles: observed bodies, and other vehicles that publish plans.

Another vehicle is predicted along its latest plan, and beyond that along the plan's last segment.
If it has not published for longer than a timeout, it counts as two hazards: one that flies on, and
a ball around all points where it may have stopped. It is forgotten ``FORGOTTEN`` seconds later.

Bodies are enlarged along a plan by a *reserve*, because the uncertainty of all positions grows.

Mathematics: docs/mathematics.md, 7.11.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from orbimpc_ros.loop.compensation import Odometry
from orbimpc_ros.loop.goal.motion import slope
from orbimpc_ros.mpc.arrays import Array, ByContent, Sealed
from orbimpc_ros.mpc.clearance import clearances
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.problem import MAX_HAZARDS, Ball, Box, MovingObstacle, Problem, State
from orbimpc_ros.mpc.problem.reach import depths, farthest

if TYPE_CHECKING:  # slow to import, and the simulator needs no solver
    from orbimpc_ros.mpc.solve.solver import Task

LATEST = 3  # sightings used to fit a velocity
MOST = 1000  # largest number of bodies
FORGOTTEN = 10.0  # [s] after falling silent, a vehicle is no longer avoided
SHARES = (1 / 3, 2 / 3, 1.0)  # of a reserve, tested in turn


@dataclass(frozen=True, eq=False)
class ObservedBody(ByContent):
    """A sighting of a body."""

    name: str  # identifies the body
    time: float  # stamp [s]
    body: Box | Ball  # its shape and position
    lifetime: float = math.inf  # after which it is dropped unless seen again [s]


Track = tuple[ObservedBody, ...]  # the latest observations of a body


class ObstacleTracker(dict[str, deque[ObservedBody]]):
    """The latest sightings of each body by its name, from which it is extrapolated linearly."""

    def see(self, seen: ObservedBody, fastest: float) -> str:
        """Take in a sighting; return a message if it is unusual, or an empty string.

        A body that would have moved faster than ``fastest`` [m/s] is taken for a new one of the
        same name, at rest until it is seen again. A change of size keeps the velocity.

        Raises:
            BadInput: older than the one before; another place at the same time; too many bodies.
        """
        if seen.name not in self and len(self) >= MOST:
            raise BadInput('count', seen.name, f'at most {MOST} bodies')
        track, message = self.setdefault(seen.name, deque(maxlen=LATEST)), ''
        if track:
            last = track[-1]
            if seen.time < last.time:
                raise BadInput('reordered stamp', seen.time, f'after the last one, {last.time:g} s')
            if seen.time == last.time:
                if seen.body != last.body:
                    raise BadInput('duplicate id', seen.name, 'one position per stamp')
                return ''
            distance = float(np.linalg.norm(seen.body.centre - last.body.centre))
            speed = distance / (seen.time - last.time)
            if speed > fastest:
                track.clear()
                message = f'{seen.name!r} jumped at {speed:.3g} m/s: taken for a new body at rest'
        track.append(seen)
        return message

    def current(self, at: float) -> tuple[Track, ...]:
        """Return the tracks of all bodies at a time [s]; drop those whose lifetime is over."""
        over = [name for name, (*_, last) in self.items() if at - last.time > last.lifetime]
        for name in over:
            del self[name]
        return tuple(map(tuple, self.values()))


def _hazard(track: Track, at: float, unseen: float) -> MovingObstacle:
    """Return the hazard of a body on the straight line fitted to its latest sightings."""
    last, places = track[-1], np.array([seen.body.centre for seen in track])
    velocity = slope(np.array([seen.time for seen in track]), places)
    body = last.body.shifted((at - last.time) * velocity)
    moving = MovingObstacle.drifting(body, velocity)
    return replace(moving, unsure=0.0 if len(track) > 1 else unseen)


@dataclass(frozen=True, eq=False)
class AgentTrajectory(Sealed):
    """A plan of another vehicle."""

    time: float  # when it was made [s]
    times: Array  # increasing, shape (K,) [s]
    positions: Array  # shape (K, n) [m]

    def hazards(self, at: float, distance: Distance) -> list[MovingObstacle]:
        """Return the hazards that the vehicle constitutes from a time [s] on."""
        age, begun, first = at - self.time, self.times[0], Ball(self.positions[0], distance.radius)
        if age > distance.timeout + FORGOTTEN:
            return []
        course = MovingObstacle.drifting(first)
        if len(self.times) > 1:
            course = MovingObstacle(first, self.times - begun, self.positions - self.positions[0])
        hazards = [course.after(at - float(begun))]
        if age > distance.timeout:  # a ball around all points where it may have stopped
            times = self.times[(self.times > self.time) & (self.times < at)]
            path = first.centre + course.moved(np.array([self.time, *times, at]) - begun)
            middle = 0.5 * (path.min(axis=0) + path.max(axis=0))
            reach = distance.radius + float(np.linalg.norm(path - middle, axis=1).max())
            hazards.append(MovingObstacle.drifting(Ball(middle, reach)))
        return hazards


@dataclass(frozen=True)
class Distance:
    """Separation from other vehicles."""

    radius: float  # between the centres of both vehicles [m]
    timeout: float  # after which a vehicle counts as silent [s]


def silence(name: str, agent: AgentTrajectory | None, due: float) -> str:
    """Describe the effect of another vehicle's silence on the topic ``name``; empty if it is heard.

    Its next plan is ``due`` at a time [s]; ``agent`` is its latest, None before the first.
    """
    if agent is None:
        return f'nothing heard on {name}: not avoided'
    silent = due - agent.time
    if silent > FORGOTTEN:
        return f'{name} is silent: no longer avoided'
    return f'{name} is silent: avoided wherever it may have stopped' if silent > 0.0 else ''


@dataclass(frozen=True)
class ObservedTraffic:
    """Observed bodies, and plans of other vehicles."""

    tracks: tuple[Track, ...] = ()  # of bodies
    agents: tuple[AgentTrajectory, ...] = ()  # plans of other vehicles
    unseen: float = 0.0  # speed assumed for a body that has been observed only once [m/s]
    distance: Distance = Distance(0.0, math.inf)

    def hazards(self, at: float) -> list[MovingObstacle]:
        """Return the hazards from a time [s] on: bodies within their lifetime, and vehicles."""
        lasting = (each for each in self.tracks if at - each[-1].time <= each[-1].lifetime)
        bodies = [_hazard(track, at, self.unseen) for track in lasting]
        return [*bodies, *(one for each in self.agents for one in each.hazards(at, self.distance))]


def nearest(
    problem: Problem,
    odometry: Odometry,
    disturbance: Array,
    hazards: Sequence[MovingObstacle],
    horizons: float = 1.0,
) -> tuple[tuple[MovingObstacle, ...], int]:
    """Return the hazards that a vehicle may meet, and the number of those left out.

    A hazard counts if the vehicle can reach it at the same time within this number of horizons. At
    most ``MAX_HAZARDS`` are returned, those that come nearest to the vehicle's present position.
    """
    times = problem.step * np.arange(math.ceil(horizons * problem.horizon) + 1)
    speed = float(np.linalg.norm(odometry.body_velocity))
    blown = float(np.linalg.norm(disturbance))
    reached = farthest(problem, speed, blown, times[1:])
    met = []
    for hazard in hazards:
        apart = -hazard.depth(odometry.position[None], times)
        # Between both ends of a step, a hazard may come closer than at either.
        speeds = np.linalg.norm(np.diff(hazard.shifts, axis=0), axis=1) / np.diff(hazard.times)
        if (apart[:-1] - float(speeds.max()) * problem.step <= reached).any():
            met.append((float(apart.min()), hazard))
    met.sort(key=lambda each: each[0])
    return tuple(hazard for _, hazard in met[:MAX_HAZARDS]), max(0, len(met) - MAX_HAZARDS)


def clearance(problem: Problem, state: State, positions: Array) -> float:
    """Return the least distance of a plan's points s_0..s_N from hazards and obstacles [m].

    It is infinite without any; for a box, it is the largest distance beyond one of its faces.
    """
    deepest = (each.max() for each in depths(problem, state, positions, 0).values())
    return -float(max(deepest, default=-math.inf))


def reserving(task: Task, reserve: float) -> Iterator[Task]:
    """Yield a task with a reserve [m] around its hazards, and with what its plan keeps of it.

    That is, for each hazard, the largest of the ``SHARES`` kept by the rest of the previous plan.
    """
    kept, reserved = list(task.state.hazards), []
    for share in SHARES:
        around = (replace(each, reserve=share * reserve) for each in kept)
        reserved.append(replace(task.state, hazards=tuple(around)))
    yield replace(task, state=reserved[-1])
    for state in reserved:
        apart = {} if task.rest is None else clearances(task.problem, state, task.rest)
        for j, each in enumerate(state.hazards):
            kept[j] = each if apart.get(f'hazard {j}', -1.0) >= 0.0 else kept[j]
    yield replace(task, state=replace(task.state, hazards=tuple(kept)))
