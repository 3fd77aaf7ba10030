# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Compensation of delay, lags and disturbances.

*Delay.* A measurement is propagated with the commands in force to the time of the next command.

*Lags.* A vehicle with lags flies, a time tau later, the path of one without that starts from
another state (7.8a). A plan from there, at that time, has commands that the vehicle follows within
all limits.

*Disturbance.* A Kalman filter with a constant disturbance makes the loop offset-free (7.9a). The
position is measured, at order 2 also the velocity; all axes share one covariance. At order 1,
another state is the excess airspeed before the first command, which decays with the lag.

Mathematics: docs/mathematics.md, 7.1, 7.3, 7.8 and 7.9.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np

from orbimpc_ros.mpc.arrays import Array, Sealed, frozen, number, word
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import exp, log, turned
from orbimpc_ros.mpc.plan import Command, Plan
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.mpc.problem.reach import moved_towards

F = TypeVar('F', float, Array)
SOURCES = ('ground', 'air')  # of a measured velocity
PARTS = 4  # of the time between commands, in each of which a vehicle with lags moves evenly
MEMORY = 32  # commands
LONGEST = 1e3  # [s] largest lag
NOISE = 0.05  # of full speed: smaller excesses over the range are not reported


@dataclass(frozen=True, eq=False)
class Odometry(Sealed):
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


@dataclass(frozen=True, eq=False)
class WindReport(Sealed):
    """A wind estimate from an external source."""

    time: float  # stamp [s]
    velocity: Array  # shape (n,) [m/s]
    variance: float = math.nan  # along each axis [m^2/s^2]; NaN if unknown


def along_the_air(odometry: Odometry) -> Odometry:
    """Return the measurement of a wing with its body axis along its velocity through the air.

    A side gust turns the nose of a wing into the wind but hardly changes its path over ground: the
    velocity persists, and the nose turns back to it.
    """
    ahead, aside = odometry.body_velocity.tolist()
    slip = np.array([math.atan2(aside, ahead)])
    velocity = np.array([math.hypot(ahead, aside), 0.0])
    return replace(odometry, attitude=odometry.attitude @ exp(slip), body_velocity=velocity)


class Interval(NamedTuple):
    """A time interval with one command in force, or None if it is unknown."""

    duration: float  # [s]
    command: Command | None
    before: Command | None  # previous one, whose speed or thrust was in effect


class CommandHistory:
    """The recent commands with their times.

    Attributes:
        lag: of the vehicle's speed or thrust behind commands [s].
        last: the last command, sent or about to be; None before the first.
        sent: recent commands with known times [s], and the share of full speed or thrust then.
        due: the command of the step that begins, of a vehicle with lags; None if it is the last.
        begun: share of full speed or thrust before the first of the ``sent`` ones.
        reached: share of full speed led to by commands within limits; None without any.
    """

    def __init__(self, lag: float = 0.0) -> None:
        self.lag, self.begun = lag, 0.0
        self.last: Command | None = None
        self.sent: deque[tuple[float, Command, float]] = deque(maxlen=MEMORY)
        self.due: Command | None = None
        self.reached: float | None = None

    @property
    def coming(self) -> Command | None:
        """Return the command of the step that begins; None before the first."""
        return self.due or self.last

    @property
    def fraction(self) -> float:
        """Return the share reached, or last commanded; 0 before the first command."""
        return getattr(self.last, 'speed_fraction', 0.0) if self.reached is None else self.reached

    def applied(self, time: float) -> float:
        """Return the share of full speed or thrust that commands have led to at a time [s].

        Without times, the last command counts as reached.
        """
        if not self.sent:
            return self.begun if self.last is None else self.last.speed_fraction
        for at, command, reached in reversed(self.sent):
            if at < time:
                return followed(reached, command.speed_fraction, time - at, self.lag)[0]
        return reached

    def means(self, begin: float, end: float) -> tuple[float, float] | None:
        """Return the mean share of speed or thrust from ``begin`` to ``end`` [s]; None if unknown.

        The second mean is weighted by the time that is left: a thrust moves a vehicle the farther,
        the earlier it acts. Without a lag, the speed or thrust of a command takes effect when the
        next command comes.
        """
        flown, moved, reached = 0.0, 0.0, self.applied(begin)
        for time, command, before in self.intervals(begin, end):
            acting = command if self.lag else before
            if acting is None:
                return None
            wanted, first = acting.speed_fraction, reached
            reached, covered = followed(first, wanted, time, self.lag)
            lagging = self.lag * ((first - wanted) * time - (covered - wanted * time))
            moved += flown * time + 0.5 * wanted * time * time + lagging
            flown += covered
        return flown / (end - begin), 2.0 * moved / (end - begin) ** 2

    def add(self, command: Command, at: float | None = None) -> None:
        """Record a command, with its time [s] if that is known; times must not decrease."""
        self.last = command
        if at is not None:
            reached = self.applied(at) if self.sent else self.begun
            self.sent.append((at, command, reached))

    def forget(self) -> None:
        """Forget all but the last command, for instance because the clock jumped."""
        self.sent.clear()
        self.due, self.begun = None, 0.0

    def intervals(self, begin: float, end: float) -> list[Interval]:
        """Return the commands in force from ``begin`` to ``end`` [s]; empty unless begin < end."""
        intervals, before, command, since = [], None, None, begin
        for at, following, _ in self.sent:
            if since < at < end:
                intervals.append(Interval(at - since, command, before))
                since = at
            if at < end:
                before, command = command, following
        if end > since:
            intervals.append(Interval(end - since, command, before))
        return intervals


def followed(reached: F, wanted: F, duration: float, lag: float) -> tuple[F, F]:
    """Return the share reached after one was commanded for a time [s], and its integral."""
    if lag == 0.0:
        return wanted, wanted * duration
    left = (reached - wanted) * math.exp(-duration / lag)
    return wanted + left, wanted * duration + lag * (reached - wanted - left)


@dataclass(frozen=True)
class Response:
    """First-order lags of a vehicle that otherwise follows commands at once.

    Attributes:
        speed: time constant of the speed, or at translation order 2 of the thrust [s].
        rate: time constant of the body rate [s].
    """

    speed: float = 0.0
    rate: float = 0.0

    def __post_init__(self) -> None:
        number(self.speed, 'response.speed', 0.0, LONGEST)
        number(self.rate, 'response.rate', 0.0, LONGEST)

    @property
    def lags(self) -> bool:
        """Return True if there is any lag."""
        return self.speed > 0.0 or self.rate > 0.0

    def lead(self, problem: Problem) -> float:
        """Return the time by which a plan starts ahead of the vehicle [s].

        The ``euler`` model already contains half a step of it: it keeps R_k for the whole step in
        which a vehicle turns to R_{k+1}.
        """
        included = 0.5 * problem.step if problem.discretisation == 'euler' else 0.0
        return max(0.0, self.rate - included)


GIVEN, ESTIMATED = 'given', 'estimated'
DISTURBANCES = (GIVEN, ESTIMATED)
GATE = 5.0  # standard deviations: a larger deviation is rejected as an outlier, unless repeated
SHIFT = 3.0  # standard deviations: a larger bias of the innovations indicates another wind
RECENT = 0.5  # [s] time constant of that bias
SMOOTHING = 10.0  # [s] time constant of the noise of measurements
GAP = 2.0  # [s] longest gap in odometry that is bridged
LARGEST = 0.8  # of full speed or thrust, as the largest estimate: the rest is for steering
REPORTED = 1.5  # the same with a reported wind, which may blow wings backwards
UNSTATED = 1.0  # [m^2/s^2] variance of a reported wind that states none
ALIKE = 10.0  # [s] correlation time of the errors of reported winds
# Standard deviations, relative to full speed or thrust z.
NOISE_SEEN = 0.01  # of measurements, at least, in z s; at order 2 of places in z s^2
GUSTS = 0.05  # of the effect of commands per second: gusts, gains, discretisation
GUSTS_SEEN = 0.01  # the same if the measured airspeed, with its gusts, is used instead of commands
DRIFT = 0.03  # of the change of the disturbance per second
DRIFT_PUSHED = 0.2  # of a vehicle with inertia, which gusts push for as long as they last
PRIOR = 0.3  # of the initial disturbance


class PlanStart(NamedTuple):
    """Initial state of a plan."""

    odometry: Odometry  # initial motion of the plan
    state: dict[str, Any]  # the same as arguments of State.at
    compensated: dict[str, Any]  # fields of a decision: delay, lag, disturbance, innovation
    odd: tuple[str, ...]  # messages if the estimate was limited, or the speed is out of range


class Compensator:
    """Propagates measurements to the start of plans, and estimates the disturbance on the way.

    Arguments are those of :class:`orbimpc_ros.loop.planner.Planner`.

    Attributes:
        history: the recent commands.
        response: lags of the vehicle.
        innovation: deviation of the last measurement from its prediction, in standard deviations;
            0 before the second.
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
        self._full = problem.forward * np.eye(problem.dimension)[0]  # speed or thrust
        self._velocity_source = word(velocity_source, 'velocity_source', SOURCES)
        if sideslip and problem.dimension == 3:
            raise BadInput('sideslip', sideslip, 'False in space')
        self._sideslip, still = sideslip, np.zeros(problem.dimension)
        self._given = still if given is None else frozen(given, still.shape, 'disturbance')
        self._estimated = estimated
        self._gusts = GUSTS_SEEN if sideslip else GUSTS
        self._drift = DRIFT_PUSHED if problem.inertial else DRIFT
        self.history = CommandHistory(self.response.speed)
        self.start_afresh(wind=True)

    def start_afresh(self, *, wind: bool = False) -> None:
        """Forget the vehicle's state, command times and, with ``wind``, the disturbance."""
        self.history.forget()
        if wind:
            self._estimate = np.zeros((3, self._problem.dimension))
            self._estimate[-1] = self._given
            self._covariance = np.diag([0.0, 0.0, PRIOR**2])
            self._variances = np.full(1 + self._problem.inertial, NOISE_SEEN**2)  # measured
        self._last: Odometry | None = None
        self._missed: Array | None = None  # innovation of the last measurement
        self._leaning = np.zeros(self._problem.dimension)  # recent bias of innovations, normalised
        self._reported = -math.inf  # stamp of the last reported wind [s]
        self.innovation = 0.0

    def continue_from(self, other: Compensator) -> None:
        """Take over the memory of another compensator."""
        self.history = other.history
        self.history.lag = self.response.speed
        if not self._estimated:
            return
        self._estimate, self._covariance = other._estimate.copy(), other._covariance
        self._estimate[-1] += self._given - other._given
        self._last, self._leaning, self._reported = other._last, other._leaning, other._reported
        self.innovation, self._missed = other.innovation, other._missed
        self._variances = other._variances

    @property
    def disturbance(self) -> Array:
        """Return the wind [m/s] or acceleration [m/s^2], with the given part, shape (n,)."""
        disturbance: Array = self._estimate[-1].copy()
        disturbance.setflags(write=False)
        return disturbance

    def start(
        self,
        measured: Odometry,
        latency: float = 0.0,
        now: float | None = None,
        wind: WindReport | None = None,
    ) -> PlanStart:
        """Return the start of a plan that follows a measurement by a ``latency`` [s].

        ``now`` is when its command takes effect, on the clock of sent commands [s]; None if delays
        are not compensated.
        """
        if len(measured.position) != self._problem.dimension:
            allowed = f'{self._problem.dimension} numbers'
            raise BadInput('odometry.position', measured.position.tolist(), allowed)
        odometry = along_the_air(measured) if self._sideslip else measured
        if not self.history.sent:
            self._begin(odometry)
        limited = self.observe(odometry, wind) if self._estimated else ''
        coming = [] if now is None else self.history.intervals(now - latency, now)
        odometry = self._settled(odometry, coming)
        compensated = {
            'advanced': latency if coming else 0.0,
            'led': self.response.lead(self._problem),
            'disturbance': self.disturbance,
            'innovation': self.innovation if self._estimated else None,
        }
        odd = self.odd_speed(odometry), limited
        return PlanStart(odometry, self.state(odometry), compensated, odd)

    def advanced(self, measured: Odometry, intervals: Sequence[Interval]) -> Odometry:
        """Return the measurement propagated over intervals; unchanged without any.

        The vehicle flies arcs, integrated exactly. Its airspeed turns with the body; the wind does
        not.
        """
        if not intervals:
            return measured
        inertial, wind = self._problem.inertial, self.disturbance
        later = measured.time + sum(interval.duration for interval in intervals)
        position, attitude = measured.position, measured.attitude
        carrying = 0.0 * wind if inertial or self._velocity_source == 'air' else wind
        velocity = attitude @ measured.body_velocity
        through_air = measured.body_velocity - attitude.T @ carrying
        arcs, through_air, rate = self._arcs(measured, through_air, intervals)
        for time, turning, ahead in arcs:
            once, twice = turned(time * turning, ahead)
            if inertial:
                moved = time * (attitude @ twice + 0.5 * wind)
                position = position + time * (velocity + moved)
                velocity = velocity + time * (attitude @ once + wind)
            else:
                position = position + time * (attitude @ once + wind)
            attitude = attitude @ exp(time * turning)
        body_velocity = attitude.T @ velocity if inertial else through_air + attitude.T @ carrying
        return Odometry(later, position, attitude, body_velocity, np.array(rate))

    def _arcs(
        self, measured: Odometry, air: Array, intervals: Sequence[Interval]
    ) -> tuple[list[tuple[float, Array, Array]], Array, Array]:
        """Return the arcs of a vehicle with the airspeed ``air``, and airspeed and rate thereafter.

        An arc has a duration, a body rate, and the velocity through the air or the thrust, both in
        the body frame. As in the discrete model, a commanded rate acts at once at rotation order 1;
        the rest of a command takes effect when the next command comes, and until then the vehicle
        continues as measured. With lags, all of it acts at once: each part of an interval is an
        arc, at its mean rate and speed or thrust. What the measured speed has beyond the commanded
        one, such as a gust, remains.
        """
        problem, lags, rate, arcs = self._problem, self.response, measured.body_rate, []
        inertial, full = problem.inertial, self._full
        if not lags.lags:
            for k, (time, command, before) in enumerate(intervals):
                if k and before is not None:
                    air, rate = before.speed_fraction * full, before.body_rate
                obeyed = command is not None and problem.rotation_order == 1
                turning = command.body_rate if command is not None and obeyed else rate
                thrust = 0.0 if before is None else before.speed_fraction
                arcs.append((time, turning, thrust * full if inertial else air))
            return arcs, air, rate
        share = self.history.applied(measured.time)
        for duration, command, _ in intervals:
            for _ in range(PARTS):
                time, wanted, turn = duration / PARTS, share, rate
                if command is not None:
                    wanted, turn = command.speed_fraction, command.body_rate
                later, flown = followed(share, wanted, time, lags.speed)
                reached, angle = followed(rate, turn, time, lags.rate)
                mean = flown / time
                ahead = mean * full if inertial else air + (mean - share) * full
                arcs.append((time, angle / time, ahead))
                air, share, rate = air + (later - share) * full, later, reached
        return arcs, air, rate

    def _settled(self, measured: Odometry, intervals: list[Interval]) -> Odometry:
        """Return the state, after intervals, from which a vehicle without lags flies the same path.

        It does so a lag later. A thrust that settles from f to c leaves a residual speed of
        z tau (f - c) at all times; its axis is turned by the remaining rotation.
        """
        problem, response, coming = self._problem, self.response, self.history.coming
        time = response.lead(problem)
        if time > 0.0 and not problem.inertial:
            intervals = [*intervals, Interval(time, None, None)]
        settled = measured = self.advanced(measured, intervals)
        if not response.lags:
            return measured
        if problem.inertial:
            rate = measured.body_rate
            applied = self.history.applied(measured.time)
            commanded = 0.0 if coming is None else coming.speed_fraction
            pushed = problem.forward * (measured.attitude @ exp(0.5 * time * rate))[:, 0]
            left = response.speed * (applied - commanded) * pushed
            push = commanded * pushed + self.disturbance
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

        At translation order 1, sigma_0 is the measured share of full speed; with ``max_rate``, the
        share reached by commands: plans must not correct speed changes by gusts, and a vehicle with
        a dead band would never be sent a speed more than one step from its own.
        """
        problem, coming, velocity = self._problem, self.history.coming, None
        applied = 0.0 if coming is None else coming.speed_fraction
        if problem.inertial:
            fraction = applied
            velocity = odometry.attitude @ odometry.body_velocity
        elif coming is not None and problem.max_rate:
            lagging = problem.turns_are_angles and self.response.speed
            fraction = self.history.applied(odometry.time) if lagging else applied
            fraction = moved_towards(problem, self.history.fraction, fraction)  # unlike a stop
        else:
            fraction = min(1.0, max(0.0, self._airspeed(odometry) / problem.forward))
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

    def _airspeed(self, odometry: Odometry) -> float:
        """Return the airspeed along the thrust axis [m/s]; across it, only wind moves a vehicle."""
        speed = float(odometry.body_velocity[0])
        if self._velocity_source == 'air':
            return speed
        return speed - float(self.disturbance @ odometry.attitude[:, 0])

    def odd_speed(self, odometry: Odometry) -> str:
        """Return a message if the measured speed is outside the model's range; otherwise empty.

        Such a speed is clipped to zero or full speed.
        """
        full, speed = self._problem.forward, self._airspeed(odometry)
        if self._problem.inertial or -NOISE * full <= speed <= (1.0 + NOISE) * full:
            return ''
        taken = full if speed > 0.0 else 0.0
        return f'measured a forward speed of {speed:.3g} m/s, taken as {taken:g} m/s'

    def held_back(self, problem: Problem, plan: Plan, command: Command) -> Command:
        """Return the command to send now, given the first command of a plan, which becomes due.

        At second order, the model adopts a command at the end of a step: a vehicle that responds at
        once is sent the previous command during this step. With ``exact`` steps, thrust changes
        linearly between both.
        """
        before, self.history.due = self.history.coming, command
        if problem.inertial:
            due = max(problem.least_speed, before.speed_fraction if before else 0.0)  # after a stop
            late = float(problem.maps.lasting[-1])
            fraction = (1.0 - late) * due + late * command.speed_fraction
            command = replace(command, speed_fraction=fraction)
        if problem.rotation_order == 2:
            rate = np.zeros(len(command.body_rate)) if before is None else before.body_rate
            command = replace(command, body_rate=rate, rotation=np.array(plan.projected[1]))
        return command

    # --- the estimated disturbance

    def observe(self, odometry: Odometry, wind: WindReport | None = None) -> str:
        """Update the disturbance; return a message if it was limited to what can be counteracted.

        A measurement is ignored if its stamp does not increase. A reported wind is taken in once;
        the sooner it follows another, the less it counts.
        """
        last = self._last
        if last is None or odometry.time > last.time:
            self._last = odometry
            if last is None or not self._predict(last, odometry):
                self._believe(odometry)
            else:
                self._correct(odometry, odometry.time - last.time)
        if wind is not None and wind.time != self._reported:
            since, self._reported = abs(wind.time - self._reported), wind.time  # may be set back
            variance = wind.variance if wind.variance > 0.0 else UNSTATED
            variance *= max(1.0, ALIKE / since) / self._problem.forward**2
            missed = wind.velocity - self._estimate[2]
            self._learn(np.eye(3)[2:], missed[None], np.array([variance]))
        return self._limit()

    def _learn(self, rows: Array, missed: Array, variances: Array) -> None:
        """Correct the state by measurements of its components ``rows``, shape (M, 3).

        ``missed``, shape (M, n), are innovations, ``variances``, shape (M,), of the measurements.
        """
        spread = rows @ self._covariance @ rows.T + np.diag(variances)
        gain = self._covariance @ rows.T @ np.linalg.inv(spread)
        self._estimate = self._estimate + gain @ missed
        left = np.eye(3) - gain @ rows
        # Joseph's form stays symmetric and positive under rounding.
        self._covariance = left @ self._covariance @ left.T + gain * variances @ gain.T

    def _limit(self) -> str:
        """Limit the disturbance to what the vehicle can counteract; return a message if limited."""
        problem, share = self._problem, REPORTED if self._reported > -math.inf else LARGEST
        size, given = (float(np.linalg.norm(each)) for each in (self._estimate[-1], self._given))
        most = max(share * problem.forward, given)
        if size <= most:
            return ''
        self._estimate[-1] *= most / size
        unit = 'm/s^2' if problem.inertial else 'm/s'
        return f'the disturbance is estimated to be {size:.3g} {unit}, taken as {most:.3g} {unit}'

    def _begin(self, odometry: Odometry) -> None:
        """Take the measured airspeed as the initial one, at the first command.

        Over ground, its uncertainty is that of the wind, or the range of speeds of the vehicle. A
        vehicle with inertia is taken to carry its weight: it hovers, or stands on the ground.
        """
        if self._problem.inertial:
            carried = -float(self._given @ odometry.attitude[:, 0]) / self._problem.forward
            self.history.begun = min(1.0, max(0.0, carried))
            return
        least, noise = self._problem.least_speed, NOISE_SEEN
        share = self._airspeed(odometry) / self._problem.forward
        self.history.begun = min(1.0, max(least, share))
        if self._velocity_source == 'ground':
            noise = min(1.0 - least, math.sqrt(self._covariance[-1, -1]))
        self._forget(1, noise**2)
        self._estimate[1] = 0.0

    def _doubt(self) -> None:
        """Reset the uncertainty of the disturbance to its prior: it has shifted."""
        self._forget(2, PRIOR**2)
        self._leaning = np.zeros_like(self._leaning)

    def _forget(self, row: int, variance: float) -> None:
        """Reset a component of the state to a variance, without correlations."""
        self._covariance[row] = self._covariance[:, row] = 0.0
        self._covariance[row, row] = variance

    def _seen(self, odometry: Odometry) -> Array:
        """Return the measured position, at order 2 also the velocity; shape (1 or 2, n)."""
        if not self._problem.inertial:
            return odometry.position[None]
        return np.array([odometry.position, odometry.attitude @ odometry.body_velocity])

    def _believe(self, odometry: Odometry) -> None:
        """Reset the state to the measurement, which carries no information on the disturbance."""
        seen = self._seen(odometry)
        self._estimate[: len(seen)] = seen
        for row, variance in enumerate(self._variances):
            self._forget(row, variance)
        self.innovation, self._missed = 0.0, None

    def _predict(self, last: Odometry, now: Odometry) -> bool:
        """Propagate the state to a measurement; return False if the commands since are unknown.

        Their direction follows from the measured attitudes.
        """
        problem, time = self._problem, now.time - last.time
        shares = self.history.means(last.time, now.time)
        if self._sideslip:
            seen = 0.5 * float(last.body_velocity[0] + now.body_velocity[0]) / problem.forward
            shares = seen, seen
        if time > GAP or shares is None:
            return False
        turn, lag, bent = log(last.attitude.T @ now.attitude), self.response.rate, 0.0
        if lag:  # the rate changes first: on average the body is ahead of an even turn, by this
            bent = lag * (-1.0 / math.expm1(-time / lag) - lag / time - 0.5)
        attitude = last.attitude @ exp(bent * (last.body_rate - now.body_rate))
        both = zip(shares, turned(turn, self._full), strict=True)
        once, twice = (share * (attitude @ each) for share, each in both)
        moved = np.array([time * time * twice, time * once])
        step, driven = np.eye(3), np.array([time, 1.0, 0.0])
        step[:2, 2], step[0, 1] = (0.5 * time * time, time), time
        if not problem.inertial:
            lag = self.response.speed
            fading = math.exp(-time / lag) if lag else 0.0
            step[:2, 1:] = [[lag * (1.0 - fading), time], [fading, 0.0]]
            moved, driven = moved[1:], np.array([1.0, 0.0, 0.0])
        self._estimate = step @ self._estimate
        self._estimate[: len(moved)] += moved
        drift = step[:, -1] * self._drift
        spread = time * (self._gusts**2 * np.outer(driven, driven) + np.outer(drift, drift))
        self._covariance = step @ self._covariance @ step.T + spread
        return True

    def _correct(self, odometry: Odometry, time: float) -> None:
        """Update with a measurement, a time [s] after the last, unless it is an outlier."""
        seen = self._seen(odometry)
        count, unit = len(seen), self._problem.forward
        missed = seen - self._estimate[:count]
        predicted = self._covariance[:count, :count]
        spread = predicted + np.diag(self._variances)
        off = np.einsum('in,ij,jn->n', missed, np.linalg.inv(spread), missed) / unit**2
        refused, self.innovation = self.innovation > GATE, float(np.sqrt(off.max() / count))
        if self._missed is not None:
            # Innovations due to noise are independent; those due to lags or wind change slowly.
            total = 0.5 * np.mean((missed - self._missed) ** 2, axis=1) / unit**2
            noise = np.minimum(total, GATE**2 * np.diagonal(spread))
            kept = math.exp(-time / SMOOTHING)
            smooth = kept * self._variances + (1.0 - kept) * (noise - np.diagonal(predicted))
            self._variances = np.maximum(smooth, NOISE_SEEN**2)
        self._missed = missed
        if self.innovation > GATE:
            if refused:  # again: the wind may have shifted as well
                self._believe(odometry)
                self._doubt()
            return
        kept = math.exp(-time / RECENT)
        latest = missed[-1] / (unit * math.sqrt(spread[-1, -1]))
        self._leaning = kept * self._leaning + math.sqrt(1.0 - kept**2) * latest
        self._learn(np.eye(count, 3), missed, self._variances)
        if np.abs(self._leaning).max() > SHIFT:
            self._doubt()
