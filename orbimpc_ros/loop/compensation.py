# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
r"""Compensation of delay, lags and disturbances.

*Delay.* A measurement is moved on along the commands in force to the time of the next one.

*Lags.* A body rate with a first-order lag, :math:`\tau\dot\omega = c - \omega`, leaves the vehicle
on the way that one without a lag takes a time :math:`\tau` later, from
:math:`\hat\theta = \theta + \tau\omega` with :math:`\dot{\hat\theta} = c`. A plan that starts from
there, at that time, is made of commands that the vehicle follows within all limits.

*Disturbance.* A Kalman filter with a constant disturbance w makes the loop offset-free:

.. math::
    \dot s = v + w + \xi, \quad \dot w = \zeta \qquad\text{(order 1)}, \qquad
    \dot s = p, \quad \dot p = a + w + \xi, \quad \dot w = \zeta \qquad\text{(order 2)}

with v or a what was commanded, along the measured attitude. Measured is the position, and at order
2 the velocity; one covariance serves all axes. At order 1 the airspeed before the first command is
a state, too, which fades with the lag of the speed.

Mathematics: docs/mathematics.md, 7.1, 7.3, 7.8 and 7.9.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array, ByContent, number, sealed
from orbimpc_ros.mpc.geometry.rotations import exp, log, turned
from orbimpc_ros.mpc.plan import Command, Plan
from orbimpc_ros.mpc.problem import Problem

SOURCES = ('ground', 'air')  # of a measured velocity
MEMORY = 32  # commands; whatever was sent before them is taken as measured
NOISE = 0.05  # of full speed: by so much a speed may be out of range unsaid


@dataclass(frozen=True, eq=False)
class Odometry(ByContent):
    """A measurement of the vehicle's motion.

    Attributes:
        time: stamp [s].
        position: in the world frame, shape (n,) [m].
        attitude: body to world rotation, shape (n, n).
        body_velocity: in the body frame, over ground or through the air, shape (n,) [m/s].
        body_rate: in the body frame, shape (1,) or (3,) [rad/s].
    """

    time: float
    position: Array
    attitude: Array
    body_velocity: Array
    body_rate: Array

    def __post_init__(self) -> None:
        for array in (self.position, self.attitude, self.body_velocity, self.body_rate):
            array.setflags(write=False)


@dataclass(frozen=True, eq=False)
class WindReport(ByContent):
    """A wind that somebody else has estimated."""

    time: float  # stamp [s]
    velocity: Array  # shape (n,) [m/s]
    variance: float = math.nan  # along each axis [m^2/s^2]; NaN where it is not known

    def __post_init__(self) -> None:
        sealed(self.velocity)


def along_the_air(odometry: Odometry) -> Odometry:
    """Return the measurement of a wing with its axis along its velocity through the air.

    A gust from the side turns the nose of a wing into it, and leaves its way over ground nearly as
    it is: what goes on is the velocity, and the nose is turned back to it.
    """
    ahead, aside = odometry.body_velocity.tolist()
    slip = np.array([math.atan2(aside, ahead)])
    velocity = np.array([math.hypot(ahead, aside), 0.0])
    return replace(odometry, attitude=odometry.attitude @ exp(slip), body_velocity=velocity)


def airspeed(odometry: Odometry, wind: Array | None, velocity_source: str = 'ground') -> float:
    """Return the speed through the air along the thrust axis [m/s]; across it only wind moves."""
    speed = float(odometry.body_velocity[0])
    if wind is None or velocity_source == 'air':
        return speed
    return speed - float(wind @ odometry.attitude[:, 0])


class Interval(NamedTuple):
    """An interval of time with one command in force, or None where none is known."""

    duration: float  # [s]
    command: Command | None
    before: Command | None  # whose speed or thrust was taken over when it ended


class CommandHistory:
    """The commands of late, and since when each is in force.

    Attributes:
        last: the last command, sent or about to be; None before the first.
        sent: commands of late and when they were, where that is known [s].
    """

    def __init__(self) -> None:
        self.last: Command | None = None
        self.sent: deque[tuple[float, Command]] = deque(maxlen=MEMORY)

    @property
    def fraction(self) -> float:
        """Return the share of full speed or thrust commanded last; 0 before the first command."""
        return 0.0 if self.last is None else self.last.speed_fraction

    def applied(self, time: float, lag: float, begun: float = 0.0) -> float:
        """Return the share of speed or thrust at a time [s], behind commands by a lag [s].

        Without times the last command counts as reached; ``begun`` is the share before the first.
        """
        if not self.sent or lag == 0.0:
            return self.fraction
        since, first = self.sent[0]
        reached = begun if len(self.sent) < MEMORY else first.speed_fraction
        for interval in self.intervals(since, time):
            assert interval.command is not None
            reached, _ = _followed(reached, interval.command, interval.duration, lag)
        return reached

    def mean(self, begin: float, end: float, lag: float, begun: float = 0.0) -> float | None:
        """Return the mean share of speed or thrust from ``begin`` to ``end`` [s]; None if unknown.

        Without a lag a command's speed or thrust is taken over when the next command comes.
        ``begun`` is the share before the first command.
        """
        flown, reached = 0.0, self.applied(begin, lag, begun)
        for interval in self.intervals(begin, end):
            given = interval.before if lag == 0.0 else interval.command
            if given is None:
                return None
            reached, covered = _followed(reached, given, interval.duration, lag)
            flown += covered
        return flown / (end - begin)

    def add(self, command: Command, at: float | None = None) -> None:
        """Note a command sent at a time [s], if that is known; times do not decrease."""
        self.last = command
        if at is not None:
            self.sent.append((at, command))

    def forget(self) -> None:
        """Forget since when commands are in force, for instance because the clock jumped."""
        self.sent.clear()

    def intervals(self, begin: float, end: float) -> list[Interval]:
        """Return what was in force from ``begin`` to ``end`` [s]; nothing if that is no time."""
        found, before, command, since = [], None, None, begin
        for at, following in self.sent:
            if since < at < end:
                found.append(Interval(at - since, command, before))
                since = at
            if at < end:
                before, command = command, following
        if end > since:
            found.append(Interval(end - since, command, before))
        return found


def _followed(reached: float, command: Command, duration: float, lag: float) -> tuple[float, float]:
    """Return the share reached after a command was in force for a time [s], and its integral."""
    wanted = command.speed_fraction
    if lag == 0.0:
        return wanted, wanted * duration
    left = (reached - wanted) * math.exp(-duration / lag)
    return wanted + left, wanted * duration + lag * (reached - wanted - left)


def advanced(
    problem: Problem,
    odometry: Odometry,
    intervals: Sequence[Interval],
    disturbance: Array | None = None,
    velocity_source: str = 'ground',
) -> Odometry:
    """Return the measurement as it would be after the intervals; the same one without any.

    Within an interval body rate and forward speed (or thrust) are constant, so that the vehicle
    flies an arc, integrated exactly. As in the discrete model, a commanded rate applies at once at
    rotation order 1; everything else of a command is taken over when the next command comes, and
    until then the vehicle goes on as it was measured. Speeds through the air turn with the body,
    the wind, shape (n,), does not; ``velocity_source`` is what odometry measures.
    """
    if not intervals:
        return odometry
    attitude, body_velocity = odometry.attitude, odometry.body_velocity
    blown = np.zeros(problem.dimension) if disturbance is None else disturbance
    # Of a vehicle without inertia, what turns with the body is its velocity through the air.
    still = velocity_source == 'air' or problem.inertial
    carrying = np.zeros(problem.dimension) if still else blown
    position, rate = odometry.position, odometry.body_rate
    through_air, velocity = body_velocity - attitude.T @ carrying, attitude @ body_velocity
    for k, (time, command, before) in enumerate(intervals):
        if k and before is not None:
            through_air, rate = _forward(problem, before.speed_fraction), before.body_rate
        turning = rate
        if command is not None and problem.rotation_order == 1:
            turning = command.body_rate
        angle = time * turning
        if problem.inertial:
            push = _forward(problem, 0.0 if before is None else before.speed_fraction)
            once, twice = turned(angle, push)
            position = position + time * velocity + time * time * (attitude @ twice + 0.5 * blown)
            velocity = velocity + time * (attitude @ once + blown)
        else:
            flown, _ = turned(angle, through_air)
            position = position + time * (attitude @ flown + blown)
        attitude = attitude @ exp(angle)
    body_velocity = through_air + attitude.T @ carrying
    if problem.inertial:
        body_velocity = attitude.T @ velocity
    later = odometry.time + sum(interval.duration for interval in intervals)
    return Odometry(later, position, attitude, np.array(body_velocity), np.array(rate))


def _forward(problem: Problem, fraction: float) -> Array:
    """Return a share of full speed or thrust along the body's x axis, shape (n,)."""
    vector = np.zeros(problem.dimension)
    vector[0] = problem.forward * fraction
    return vector


LONGEST = 1e3  # [s]


@dataclass(frozen=True)
class Response:
    """First-order lags of a vehicle that obeys at once.

    Attributes:
        speed: time constant of the speed, or at translation order 2 of the thrust [s].
        rate: of the body rate [s].
    """

    speed: float = 0.0
    rate: float = 0.0

    def __post_init__(self) -> None:
        number(self.speed, 'response.speed', 0.0, LONGEST)
        number(self.rate, 'response.rate', 0.0, LONGEST)

    @property
    def lags(self) -> bool:
        """Return whether there is any lag."""
        return self.speed > 0.0 or self.rate > 0.0

    def lead(self, problem: Problem) -> float:
        """Return by how long a plan starts ahead of the vehicle [s].

        Half a step of it the ``euler`` model has already: it keeps R_k for the whole step in which
        a vehicle turns on to R_{k+1}.
        """
        known = 0.5 * problem.step if problem.discretisation == 'euler' else 0.0
        return max(0.0, self.rate - known)


GIVEN, ESTIMATED = 'given', 'estimated'
DISTURBANCES = (GIVEN, ESTIMATED)
GATE = 5.0  # standard deviations: what is farther off is no measurement of the model
PATIENCE = 2  # measurements in a row that are refused, after which the position is believed
SHIFT = 3.0  # standard deviations: measurements that lean to one side by more show another wind
RECENT = 0.5  # [s] over which they are looked at
GAP = 2.0  # [s] without odometry, over which nothing is learnt
LARGEST = 0.8  # of full speed or thrust: what is left steers
REPORTED = 1.5  # the same of a wind that is reported: it blows wings backwards
UNSTATED = 1.0  # [m^2/s^2] variance of a reported wind that comes without one
ALIKE = 10.0  # [s] over which the errors of reported winds are alike


@dataclass(frozen=True)
class NoiseModel:
    """Standard deviations of the model, as shares of full speed or thrust z."""

    position: float = 0.01  # measured, of z s (order 1) or z s^2 (order 2)
    velocity: float = 0.01  # measured (order 2), of z s
    model: float = 0.05  # of what commands do, over a second: gusts, gains, discretisation
    drift: float = 0.03  # by how much the disturbance changes in a second
    prior: float = 0.3  # of the disturbance before anything is known


MEASURED = NoiseModel(model=0.01)  # gusts are seen in the velocity, and commands have no part
PUSHED = NoiseModel(drift=0.2)  # gusts push a vehicle with inertia for as long as they last


class Estimator:
    """Learns a disturbance from odometry and the commands that were in force.

    Args:
        problem: gives the orders and the full speed or thrust.
        lag: of speed or thrust [s].
        velocity_source: what odometry measures: velocity over ``ground`` or through the ``air``.
        given: the disturbance that is known, shape (n,); None for none.
        measured: whether the measured speed is believed, through the air, not the commanded one.

    Attributes:
        innovation: how far the last measurement was from what was expected, in standard
            deviations; 0 before the second.
        refused: measurements in a row that were too far off to be believed.
    """

    def __init__(
        self,
        problem: Problem,
        lag: float = 0.0,
        velocity_source: str = 'ground',
        given: Array | None = None,
        *,
        measured: bool = False,
    ) -> None:
        usual = PUSHED if problem.inertial else NoiseModel()
        self._noise = MEASURED if measured else usual
        self._problem, self._lag, self._as_measured = problem, lag, measured
        self._velocity_source = velocity_source
        self._given = np.zeros(problem.dimension) if given is None else given
        self.reset()

    def reset(self) -> None:
        """Forget everything, the disturbance too."""
        self._estimate = np.zeros((3, self._problem.dimension))
        self._covariance = np.diag([0.0, 0.0, self._noise.prior**2])
        self.start_afresh()

    def start_afresh(self) -> None:
        """Forget where the vehicle was, for instance because the clock jumped."""
        self._last: Odometry | None = None
        self._begun = 0.0  # share of full speed with which the first command found the vehicle
        self._leaning = np.zeros(self._problem.dimension)  # innovations of late, as if only noise
        self._reported = -math.inf  # stamp of the last wind that was reported [s]
        self.innovation, self.refused = 0.0, 0

    def continue_from(self, other: Estimator) -> None:
        """Take over what another estimator of the same vehicle knows."""
        self._estimate, self._covariance = other._estimate, other._covariance
        self._last, self._begun = other._last, other._begun
        self._leaning, self._reported = other._leaning, other._reported
        self.innovation, self.refused = other.innovation, other.refused

    @property
    def disturbance(self) -> Array:
        """Return the wind [m/s] or acceleration [m/s^2], the given one included, shape (n,)."""
        return np.asarray(self._given + self._estimate[-1])

    @property
    def _measured(self) -> tuple[float, ...]:
        """Return the variances of what is measured."""
        noise = self._noise
        return (noise.position**2, noise.velocity**2)[: 1 + self._problem.inertial]

    def observe(self, odometry: Odometry, history: CommandHistory) -> None:
        """Take in a measurement; stamps that do not increase are passed over."""
        last = self._last
        if last is not None and odometry.time <= last.time:
            return
        self._last = odometry
        if not history.sent and not self._problem.inertial:
            self._begin(odometry)
        moved = None if last is None else self._moved(last, odometry, history)
        if moved is None:
            self._believe(odometry)
        else:
            time = odometry.time - last.time  # type: ignore[union-attr]
            self._predict(moved, time)
            self._correct(odometry, time)

    def hear(self, wind: WindReport) -> None:
        """Take in a reported wind, once; reports that follow soon add as little as they are new."""
        since = wind.time - self._reported
        if since <= 0.0:
            return
        self._reported = wind.time
        variance = wind.variance if wind.variance > 0.0 else UNSTATED
        variance *= max(1.0, ALIKE / since) / self._problem.forward**2
        missed = wind.velocity - self._given - self._estimate[2]
        self._learn(np.eye(3)[2:], missed[None], np.array([variance]))

    def _learn(self, rows: Array, missed: Array, variances: Array) -> None:
        """Correct the state by what ``rows`` of it, shape (M, 3), were measured to be beyond it.

        ``variances``, shape (M,), are those of the measurements; ``missed`` has shape (M, n).
        """
        spread = rows @ self._covariance @ rows.T + np.diag(variances)
        gain = self._covariance @ rows.T @ np.linalg.inv(spread)
        self._estimate = self._estimate + gain @ missed
        left = np.eye(3) - gain @ rows
        # Joseph's form: symmetric and positive whatever is rounded.
        self._covariance = left @ self._covariance @ left.T + gain * variances @ gain.T

    def limit(self) -> str:
        """Keep the whole disturbance within what the vehicle can work against; return if it is."""
        problem, given, whole = self._problem, self._given, self.disturbance
        known = REPORTED if self._reported > -math.inf else LARGEST
        size, most = float(np.linalg.norm(whole)), known * problem.forward
        most = max(most, float(np.linalg.norm(given)))
        if size <= most:
            return ''
        self._estimate[-1] = whole * (most / size) - given
        unit = 'm/s^2' if problem.inertial else 'm/s'
        return f'the disturbance is estimated to be {size:.3g} {unit}, taken as {most:.3g} {unit}'

    def _begin(self, odometry: Odometry) -> None:
        """Take the measured airspeed for that with which the first command finds the vehicle.

        Over ground it is known as well as the wind is, or as what the vehicle can fly.
        """
        least = self._problem.least_speed
        source, noise = self._velocity_source, self._noise.velocity
        speed = airspeed(odometry, self.disturbance, source)
        self._begun = min(1.0, max(least, speed / self._problem.forward))
        if source == 'ground':
            noise = min(1.0 - least, math.sqrt(self._covariance[-1, -1]))
        self._forget(1, noise**2)
        self._estimate[1] = 0.0

    def _doubt(self) -> None:
        """Forget how well the disturbance is known: it has shifted."""
        self._forget(2, self._noise.prior**2)
        self._leaning = np.zeros_like(self._leaning)

    def _forget(self, row: int, variance: float) -> None:
        """Let a part of the state be known by no more than its variance."""
        self._covariance[row] = self._covariance[:, row] = 0.0
        self._covariance[row, row] = variance

    def _seen(self, odometry: Odometry) -> Array:
        """Return what is measured: the position, and at order 2 the velocity; shape (1 or 2, n)."""
        if not self._problem.inertial:
            return odometry.position[None]
        return np.array([odometry.position, odometry.attitude @ odometry.body_velocity])

    def _believe(self, odometry: Odometry) -> None:
        """Take the measurement for the state, which says nothing about the disturbance."""
        seen = self._seen(odometry)
        self._estimate[: len(seen)] = seen
        for row, variance in enumerate(self._measured):
            self._forget(row, variance)
        self.innovation, self.refused = 0.0, 0

    def _moved(self, last: Odometry, now: Odometry, history: CommandHistory) -> Array | None:
        """Return what commands and the given disturbance did since, shape (1 or 2, n); or None."""
        time = now.time - last.time
        share = self._mean_share(last, now, history)
        if time > GAP or share is None:
            return None
        given, ahead = self._given, _forward(self._problem, share)
        once, twice = turned(log(last.attitude.T @ now.attitude), ahead)
        if not self._problem.inertial:
            return np.array([time * (last.attitude @ once + given)])
        place = time * time * (last.attitude @ twice + 0.5 * given)
        return np.array([place, time * (last.attitude @ once + given)])

    def _mean_share(self, last: Odometry, now: Odometry, history: CommandHistory) -> float | None:
        """Return the mean share of full speed, or thrust, in between; None if it is unknown."""
        if self._as_measured:
            return 0.5 * float(last.body_velocity[0] + now.body_velocity[0]) / self._problem.forward
        return history.mean(last.time, now.time, self._lag, self._begun)

    def _predict(self, moved: Array, time: float) -> None:
        """Move the state on by so much, and by itself for a time [s]."""
        step, driven = np.eye(3), np.array([0.0, 1.0, 0.0])
        step[:2, 2] = 0.5 * time * time, time
        step[0, 1] = driven[0] = time
        if not self._problem.inertial:
            fading = math.exp(-time / self._lag) if self._lag else 0.0
            step[:2, 1:] = [[self._lag * (1.0 - fading), time], [fading, 0.0]]
            driven = np.array([1.0, 0.0, 0.0])
        self._estimate = step @ self._estimate
        self._estimate[: len(moved)] += moved
        drift = step[:, -1] * self._noise.drift
        spread = time * (self._noise.model**2 * np.outer(driven, driven) + np.outer(drift, drift))
        self._covariance = step @ self._covariance @ step.T + spread

    def _correct(self, odometry: Odometry, time: float) -> None:
        """Learn from a measurement a time [s] after the last, unless it is out of the question."""
        seen = self._seen(odometry)
        count, unit = len(seen), self._problem.forward
        missed = seen - self._estimate[:count]
        spread = self._covariance[:count, :count] + np.diag(self._measured)
        off = np.einsum('in,ij,jn->n', missed, np.linalg.inv(spread), missed) / unit**2
        self.innovation = float(np.sqrt(off.max() / count))
        if self.innovation > GATE:
            self.refused += 1
            if self.refused >= PATIENCE:  # the wind may have shifted as well
                self._believe(odometry)
                self._doubt()
            return
        self.refused, kept = 0, math.exp(-time / RECENT)
        latest = missed[-1] / (unit * math.sqrt(spread[-1, -1]))
        self._leaning = kept * self._leaning + math.sqrt(1.0 - kept**2) * latest
        self._learn(np.eye(count, 3), missed, np.array(self._measured))
        if np.abs(self._leaning).max() > SHIFT:
            self._doubt()


class Start(NamedTuple):
    """Where a plan starts."""

    odometry: Odometry  # what to plan from
    state: dict[str, Any]  # the same as arguments of State.at
    told: dict[str, Any]  # of how it was found: fields of a decision
    limited: str  # that the estimate was limited, in words; empty if not
    odd: str  # that the speed is not one that the model knows, in words; empty if it is


class Compensator:
    """Moves measurements on to where plans start, by the commands sent of late.

    Arguments are those of :class:`orbimpc_ros.loop.planner.Planner`.

    Attributes:
        history: the commands of late.
        due: the command of the step that begins, of a vehicle that lags; None where it is the last.
        response: lags of the vehicle.
        disturbance: known or estimated by now, shape (n,); None for none.
    """

    def __init__(
        self,
        problem: Problem,
        response: Response | None = None,
        given: Array | None = None,
        *,
        estimated: bool = False,
        velocity_source: str = 'ground',
        sideslip: bool = False,
    ) -> None:
        self._problem, self.response = problem, response or Response()
        self.disturbance = given
        self._velocity_source, self._sideslip = velocity_source, sideslip
        self.history = CommandHistory()
        self.due: Command | None = None
        self._estimator: Estimator | None = None
        if estimated:
            known = problem, self.response.speed, velocity_source, given
            self._estimator = Estimator(*known, measured=sideslip)

    def start_afresh(self, *, wind: bool = False) -> None:
        """Forget where the vehicle was, when commands were sent and, with ``wind``, what blows."""
        self.history.forget()
        self.due = None
        if self._estimator is not None:
            (self._estimator.reset if wind else self._estimator.start_afresh)()

    def continue_from(self, other: Compensator) -> None:
        """Take over what another one remembers."""
        self.history, self.due = other.history, other.due
        if self._estimator is not None and other._estimator is not None:
            self._estimator.continue_from(other._estimator)

    @property
    def coming(self) -> Command | None:
        """Return the command of the step that begins; None before the first."""
        return self.due or self.history.last

    def start(
        self,
        measured: Odometry,
        latency: float = 0.0,
        now: float | None = None,
        wind: WindReport | None = None,
    ) -> Start:
        """Return where a plan starts that follows a measurement by a ``latency`` [s].

        ``now`` is when its command is in force, on the clock of the commands sent [s]; None where
        delays are not compensated.
        """
        odometry = along_the_air(measured) if self._sideslip else measured
        limited = self._estimate(odometry, wind)
        coming = [] if now is None else self.history.intervals(now - latency, now)
        if coming and self.response.lags:
            # For a time that is short against its lags, a vehicle goes on as it was measured.
            whole = sum(each.duration for each in coming)
            coming = [Interval(whole, None, self.history.last)]
        known = self.disturbance, self._velocity_source
        odometry = self._settled(advanced(self._problem, odometry, coming, *known))
        led = self.response.lead(self._problem)
        told = {
            'advanced': odometry.time - measured.time - led,
            'led': led,
            'disturbance': self.disturbance,
            'innovation': None if self._estimator is None else self._estimator.innovation,
        }
        return Start(odometry, self.state(odometry), told, limited, self.odd_speed(odometry))

    def _estimate(self, odometry: Odometry, wind: WindReport | None) -> str:
        """Learn the disturbance from a measurement; return that it is limited, if it is."""
        if self._estimator is None:
            return ''
        self._estimator.observe(odometry, self.history)
        if wind is not None:
            self._estimator.hear(wind)
        limited = self._estimator.limit()
        self.disturbance = self._estimator.disturbance
        return limited

    def _settled(self, measured: Odometry) -> Odometry:
        """Return where a vehicle without lags would have to be to fly the same, a lag later.

        What a thrust that settles from f to c leaves is a speed of z tau (f - c), whenever it is
        looked at; the turn that is left over turns the axis of it meanwhile.
        """
        problem, response, coming = self._problem, self.response, self.coming
        if not response.lags:
            return measured
        time, rate = response.lead(problem), measured.body_rate
        if not problem.inertial:
            intervals = [Interval(time, None, None)] if time > 0.0 else []
            settled = advanced(
                problem, measured, intervals, self.disturbance, self._velocity_source
            )
        else:
            applied = self.history.applied(measured.time, response.speed)
            commanded = 0.0 if coming is None else coming.speed_fraction
            pushed = problem.forward * (measured.attitude @ exp(0.5 * time * rate))[:, 0]
            left = response.speed * (applied - commanded) * pushed
            push = commanded * pushed + (0.0 if self.disturbance is None else self.disturbance)
            velocity = measured.attitude @ measured.body_velocity + left
            position = measured.position + time * velocity + 0.5 * time * time * push
            attitude = measured.attitude @ exp(time * rate)
            body = attitude.T @ (velocity + time * push)
            place = position - response.speed * left
            settled = Odometry(measured.time + time, place, attitude, body, rate)
        if problem.rotation_order == 1 or coming is None:
            return settled
        return replace(settled, body_rate=coming.body_rate)

    def state(self, odometry: Odometry) -> dict[str, Any]:
        """Return the state there, as arguments of State.at: R_0 = sigma_0 Q_0, in conv SO(n).

        At translation order 1 sigma_0 is the measured share of full speed, but with ``max_rate``
        the one that commands have led to: a gust is no change of speed that a plan has to make up
        for, and a vehicle in a dead band would never be told more than a step from the speed that
        it has.
        """
        problem, coming, velocity = self._problem, self.coming, None
        applied = 0.0 if coming is None else coming.speed_fraction
        if problem.inertial:
            fraction = applied
            velocity = odometry.attitude @ odometry.body_velocity
        elif coming is not None and problem.max_rate:
            fraction = applied
            if problem.turns_are_angles:
                fraction = self.history.applied(odometry.time, self.response.speed)
        else:
            speed = airspeed(odometry, self.disturbance, self._velocity_source)
            fraction = min(1.0, max(0.0, speed / problem.forward))
        coasted = None
        if problem.rotation_order == 2:
            coasted = odometry.attitude @ exp(problem.step * odometry.body_rate)
        return {
            'position': odometry.position,
            'rotation': fraction * odometry.attitude,
            'velocity': velocity,
            'attitude': odometry.attitude,
            'coasted': coasted,
            'disturbance': self.disturbance,
        }

    def odd_speed(self, odometry: Odometry) -> str:
        """Return that the measured speed is not one that the model knows, in words; else empty.

        Such a speed counts as the nearest that it does: none, or full speed.
        """
        full = self._problem.forward
        speed = airspeed(odometry, self.disturbance, self._velocity_source)
        if self._problem.inertial or -NOISE * full <= speed <= (1.0 + NOISE) * full:
            return ''
        taken = full if speed > 0.0 else 0.0
        return f'measured a forward speed of {speed:.3g} m/s, taken as {taken:g} m/s'

    def held_back(self, problem: Problem, plan: Plan, command: Command) -> Command:
        """Return what to send now of a plan's first command, which becomes due.

        At second order the model takes a command over at the end of a step: a vehicle that obeys
        at once is sent in this one what was commanded before. With ``exact`` steps thrust changes
        evenly from one to the other.
        """
        before, self.due = self.coming, command
        fraction, rate, rotation = command.speed_fraction, command.body_rate, command.rotation
        if problem.inertial:
            due = problem.least_speed if before is None else before.speed_fraction
            late = {'euler': 0.0, 'exact': 0.5, 'held': 1.0}[problem.discretisation]
            fraction = (1.0 - late) * due + late * fraction
        if problem.rotation_order == 2:
            rate = np.zeros(len(rate)) if before is None else before.body_rate
            rotation = np.array(plan.projected[1])
        return Command(fraction, np.array(rate), np.array(rotation))
