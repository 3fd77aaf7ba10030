# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A recorded run as plain arrays, for plots and comparisons, and its summary as text."""

from __future__ import annotations

import itertools
import math
import textwrap
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from orbimpc_ros.loop.capture import closest_approach
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.plan import interpolated
from orbimpc_ros.ros.messages import Frames, Stamp, read_odometry, read_sighting
from orbimpc_ros.ros.parameters.planner import planner_settings
from orbimpc_ros.sim.world import touched_in_words
from orbimpc_ros.tool import bags, settings
from orbimpc_ros.tool.bags import fields, point, seconds

WANTED = ('captured', 'goal', 'odom', 'plan', 'tick', 'truth')
WIDTH, NAMES = 80, 14  # characters
NEAR = 2.0  # [capture radii]: a closer local minimum of the distance is a near miss


@dataclass(frozen=True)
class History:
    """A recorded run; its last sample is at the catch, if there is one."""

    times: Array  # of odometry, shape (M,) [s]
    positions: Array  # of the vehicle, shape (M, 3) [m]
    attitudes: Array  # of the body in the world, shape (M, 3, 3)
    velocities: Array  # in the world, shape (M, 3) [m/s]
    rates: Array  # about the body's axes, shape (M, 3) [rad/s]
    ropes: Array  # positions of the rope at these times, shape (M, 3) [m]
    # times [s], increasing, and points, shape (N + 1, 3) [m]
    plans: tuple[tuple[float, Array], ...]
    # times [s] and fields of the topic ``tick``, up to the last odometry
    ticks: tuple[tuple[float, dict[str, Any]], ...]
    captured: bool  # whether the simulator reported the job as done
    values: dict[str, Any]  # parameters of the run, by name
    # last fields of the topic ``truth``, which is published for continuous-time vehicles
    truth: Mapping[str, Any] = field(default_factory=dict)

    @property
    def arrives(self) -> bool:
        """Return whether the job is an arrival at the goal, not a catch in passing."""
        return bool(self.values['finish'] == 'arrival')

    @property
    def caught(self) -> bool:
        """Return whether the goal was caught in passing, between two samples."""
        return self.captured and not self.arrives and len(self.times) > 1

    @property
    def radius(self) -> float:
        """Return the simulator's capture radius, or its arrival radius for an arrival [m]."""
        name = 'arrival_radius' if self.arrives else 'capture_radius'
        return float(settings.of_sim(self.values)[name])

    @property
    def boxes(self) -> Array:
        """Return the lower and the upper corner of every box obstacle, shape (M, 2, n) [m]."""
        values = settings.of_sim(self.values)
        return np.reshape(values['obstacles'], (-1, 2, values['dimension']))

    def at(self, steps: Any) -> tuple[Array, Array, Array, Array]:
        """Return what was where at K fractional indices of samples, by linear interpolation.

        These are times, shape (K,) [s], distances from vehicle to rope, (K,) [m], and positions of
        the vehicle and of the rope, (K, 3) [m].
        """
        samples = np.column_stack([self.times, self.positions, self.ropes])
        rows = interpolated(steps, np.arange(0.0, len(samples)), samples)
        flown, swung = rows[:, 1:4], rows[:, 4:]
        return rows[:, 0], np.linalg.norm(flown - swung, axis=1), flown, swung

    @cached_property
    def steps(self) -> Array:
        """Return the indices of samples, and those of closest approaches between them."""
        flown, swung = ((each[:-1], each[1:]) for each in (self.positions, self.ropes))
        shares = closest_approach(flown, swung)[1]
        return np.union1d(np.arange(len(self.times)), np.arange(len(shares)) + shares)

    @property
    def near_misses(self) -> Array:
        """Return the indices of the local minima of the distance near the goal but for a catch."""
        radius, (times, apart, _, _) = self.radius, self.at(self.steps)
        # The catch itself may be outside of the radius if an engine detects contact.
        margin = 0.5 * float(self.values['step']) if self.caught else 0.0
        near = (radius < apart) & (apart <= NEAR * radius) & (times <= times[-1] - margin)
        lowest = (apart[:-2] > apart[1:-1]) & (apart[1:-1] <= apart[2:])
        return self.steps[1:-1][near[1:-1] & lowest]

    def to_the_catch(self) -> History:
        """Return the history with its last sample at the catch, which ended the last interval."""
        if not self.caught:
            return self
        _, share = closest_approach(tuple(self.positions[-2:]), tuple(self.ropes[-2:]))
        time, _, flown, swung = self.at(len(self.times) - 2 + share)
        return replace(
            self,
            times=np.append(self.times[:-1], time),
            positions=np.vstack([self.positions[:-1], flown]),
            ropes=np.vstack([self.ropes[:-1], swung]),
        )

    def series(self, name: str) -> tuple[Array, Array]:
        """Return times [s] and values of a field, of the ticks where it is a finite number."""
        points = [
            (time - self.times[0], float(fields[name]))
            for time, fields in self.ticks
            if isinstance(fields.get(name), (int, float)) and math.isfinite(fields[name])
        ]
        times, values = np.reshape(points, (-1, 2)).T
        return times, values


def of_bag(path: Path, namespace: str = '', params: str | None = None) -> History:
    """Return the history of a vehicle recorded in a bag.

    Args:
        path: path of the bag.
        namespace: of the vehicle, such as ``/uav1``.
        params: file of its parameters, if not those noted in the bag.

    Raises:
        BadInput: no bag, or one without odometry and goal.
    """
    values = settings.of_bag(path, namespace, params)
    logged: dict[str, list[Any]] = defaultdict(list)
    for each in bags.of_vehicle(path, namespace, WANTED):
        if each.topic == 'goal' and not each.stamp and logged['odom']:  # by hand: dated by odometry
            each.content.header.stamp = logged['odom'][-1].header.stamp
        logged[each.topic].append(each.content)
    frames = Frames(thrust_axis=values['thrust_axis'], velocity=values['velocity_frame'])
    measured = _valid(read_odometry, logged['odom'], frames)
    sighted = _valid(read_sighting, logged['goal'], frames)
    if not measured or not sighted:
        wrong = 'goal' if measured else 'odom'
        raise BadInput.stating(str(path), f'no valid {wrong}', 'odometry and a goal are needed')
    times, attitudes = measured['time'], measured['attitude']
    plans = [(seconds(m), [point(stamped.pose.position) for stamped in m.poses])
             for m in logged['plan'] if m.poses]  # fmt: skip
    answers = {seconds(m): fields(m)  # of repeated ones the last
               for m in logged['tick'] if m.status and seconds(m) <= times[-1]}  # fmt: skip
    return History(
        times=times,
        positions=measured['position'],
        attitudes=attitudes,
        velocities=np.einsum('kij,kj->ki', attitudes, measured['body_velocity']),
        rates=measured['body_rate'],
        ropes=_seen(times, sighted, planner_settings(values).goal_timeout),
        plans=tuple((time, np.array(points)) for time, points in plans),
        ticks=tuple(answers.items()),
        captured=any(m.data for m in logged['captured']),
        values=values,
        truth=next((fields(m) for m in reversed(logged['truth']) if m.status), {}),
    ).to_the_catch()


def _valid(
    read: Callable[..., tuple[Stamp, Any]], messages: Iterable[Any], frames: Frames
) -> dict[str, Array]:
    """Return the values of the messages that the planner would accept, by name, in order of time.

    Runs with faults have invalid messages. In lock-step the simulator repeats its messages if an
    answer is late: the last message of each stamp counts.
    """
    by_stamp: dict[int, dict[str, Any]] = {}
    for message in messages:
        with suppress(BadInput):
            stamp, value = read(message, 3, frames)
            by_stamp[stamp.nanoseconds] = vars(value)
    rows = [by_stamp[at] for at in sorted(by_stamp)]
    return {name: np.array([row[name] for row in rows]) for row in rows[:1] for name in row}


def _seen(at: Array, sighted: Mapping[str, Array], longest: float) -> Array:
    """Return a goal's positions at times [s]; it stays put in gaps longer than ``longest`` [s]."""
    times, places = sighted['time'], sighted['position']
    held = np.flatnonzero(np.diff(times) > longest)
    times = np.insert(times, held + 1, np.nextafter(times[held + 1], -np.inf))
    return interpolated(at, times, np.insert(places, held + 1, places[held], axis=0))


def separations(flown: Mapping[str, History]) -> tuple[Array, dict[tuple[str, str], Array]]:
    """Return all K times and, for each pair, the least distance in each interval, (K - 1,) [m].

    It is infinite unless both fly. Motion from one position to the next is linear.
    """
    times = np.unique(np.concatenate([each.times for each in flown.values()]))
    distances = {}
    for pair in itertools.combinations(flown, 2):
        both = [flown[name] for name in pair]
        paths = (interpolated(times, each.times, each.positions) for each in both)
        apart, _ = closest_approach(*((path[:-1], path[1:]) for path in paths))
        for each in both:
            apart[(times[:-1] < each.times[0]) | (times[1:] > each.times[-1])] = np.inf
        distances[pair] = apart
    return times, distances


# --- as text


def text(flown: Mapping[str, History]) -> str:
    """Return the summary of flights by name, or of a fleet by namespace.

    There is a line on how each ended, and totals of their ticks.
    """
    rows = {}
    for name, each in flown.items():
        rows[name.strip('/') or 'flight'] = '; '.join([ending(each), *_incidents(each)])
    times, gaps = (
        np.concatenate([each.series(name)[1] for each in flown.values()])
        for name in ('solve_time_ms', 'gap')
    )
    spent = 'unknown'
    if times.size:
        p50, p99 = np.percentile(times, (50, 99))
        spent = f'p50 {p50:.1f} ms, p99 {p99:.1f} ms, max {times.max():.1f} ms'
    # The last command of a flight is never applied.
    ticks = [tick for each in flown.values() for tick in each.ticks if tick[0] < each.times[-1]]
    rows['ticks'] = str(sum(len(each.ticks) for each in flown.values()))
    rows['solve time'] = spent
    rows['worst gap'] = f'{gaps.max():.1e}' if gaps.size else 'unknown'
    rows['fallbacks'] = str(sum(bool(fields.get('fallback')) for _, fields in ticks))
    return lines(rows)


def ending(flight: History) -> str:
    """Return in a line how a flight ended."""
    job, span = 'arrived' if flight.arrives else 'captured', flight.times[-1] - flight.times[0]
    apart = round(np.linalg.norm(flight.positions[-1] - flight.ropes[-1]), 6)
    speed = round(np.linalg.norm(flight.velocities[-1]), 6)
    done = f'{job} at' if flight.captured else f'not {job} by'
    return f'{done} t = {span:.2f} s, {apart:.2g} m from the goal, {speed:.2g} m/s'


def _incidents(flight: History) -> Iterator[str]:
    """Yield the near misses of a flight, its collisions and its stalls."""
    times, apart, _, _ = flight.at(flight.near_misses)
    if len(times):
        missed = zip(apart, times - flight.times[0], strict=True)
        descriptions = ', '.join(f'{distance:.2f} m at {time:.1f} s' for distance, time in missed)
        yield f'{len(times)} near misses: {descriptions}'
    if flight.truth.get('touched'):
        yield f'touched {touched_in_words(flight.truth["touched"], len(flight.boxes))}'
    if settings.of_sim(flight.values)['stall_speed'] and 'least_airspeed' in flight.truth:
        least, stalls = flight.truth['least_airspeed'], flight.truth.get('stalls')
        yield f'airspeed at least {least:.2f} m/s, {stalls} stalls'


def story(flown: Mapping[str, History]) -> str:
    """Return a headline on how flights ended: a line for each, or one for a fleet."""
    if len(flown) > 2:
        return f'{sum(each.captured for each in flown.values())} of {len(flown)} reached the goal'
    headlines = (f'{name.replace("_", " ")}: {ending(each)}' for name, each in flown.items())
    return '\n'.join(line.removeprefix(': ').capitalize() for line in headlines)


def lines(rows: Mapping[str, str]) -> str:
    """Return rows of a name and a value each as text, wrapped to the width of a page."""
    return '\n'.join(
        textwrap.fill(f'{name:<{NAMES}}{value}', WIDTH, subsequent_indent=' ' * NAMES)
        for name, value in rows.items()
    )
