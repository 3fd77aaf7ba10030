# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Ticks of the planner: its inputs put to the controller, within a deadline."""

from __future__ import annotations

import math
import statistics
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from orbimpc_ros.loop.controller import Controller, Tick
from orbimpc_ros.loop.delay import Interval, advanced
from orbimpc_ros.loop.disturbance import Estimator
from orbimpc_ros.loop.interception import FARTHEST, Catch, steps_before
from orbimpc_ros.loop.odometry import Odometry, along_the_air
from orbimpc_ros.loop.traffic.nearest import nearest
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.command import Command
from orbimpc_ros.mpc.outcome import Reason
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.mpc.problem.sought import Sought
from orbimpc_ros.ros.clock import UNKNOWN, RosTime
from orbimpc_ros.ros.messages import SECOND
from orbimpc_ros.ros.parameters.planner import PlannerSettings
from orbimpc_ros.ros.planner.inbox import Inbox, Received
from orbimpc_ros.ros.reports import Report

RECENT = 15  # ticks
LATE = 1.5  # periods from one tick to the next
LOOK = 1e-4  # [s] that a look at the deadline counts for in lock-step: some take 3e-3
LONGEST = 0.25  # [s] a deadline counts for at most there, where somebody waits for the answer


def prepared(settings: PlannerSettings) -> tuple[PlannerSettings, Controller]:
    """Return the settings with a controller compiled for them."""
    controller = Controller(
        settings.problem,
        projection=settings.projection,
        shrinking=settings.shrinking,
        gap_tolerance=settings.gap_tolerance,
        safe=settings.safe_command,
        response=settings.response,
        disturbance=settings.disturbance,
        velocity_source=settings.velocity_source,
        capture_radius=settings.capture_radius,
        approach=settings.approach,
        reserve=settings.obstacle_reserve,
        centred=settings.centred,
    )
    if settings.avoid:
        controller.expect_hazards()
    return settings, controller


def _is_past(clock: Callable[[], float], end: float) -> bool:
    return clock() > end


def _joined(*words: str) -> str:
    return '; '.join(filter(None, words))


def _estimator(settings: PlannerSettings) -> Estimator | None:
    if not settings.estimated:
        return None
    known = settings.problem, settings.response.speed, settings.velocity_source
    return Estimator(*known, measured=settings.sideslip)


class Work:
    """A clock that goes on by the looks at it, of which a search takes one after each part.

    What it limits is the same on every machine, however busy.
    """

    def __init__(self) -> None:
        self._looks = 0

    def __call__(self) -> float:
        """Return how long the work so far is taken to last [s]."""
        self._looks += 1
        return LOOK * self._looks


class Timing:
    """How long ticks take.

    Attributes:
        misses: ticks that took longer than their deadline.
        overruns: ticks that took longer than their period.
        late: ticks of the timer that came late, whatever held them up.
    """

    def __init__(self) -> None:
        self.misses = self.overruns = self.late = 0
        self._recent: deque[float] = deque(maxlen=RECENT)
        self._last: float | None = None

    @property
    def expected(self) -> float:
        """Return how long a tick usually takes [s]."""
        return statistics.median(self._recent) if self._recent else 0.0

    def began(self, clock: float, period: float) -> None:
        """Note a tick of the timer, at a time of the timer's clock [s]."""
        if self._last is not None and clock - self._last > LATE * period:
            self.late += 1
        self._last = clock

    def took(self, duration: float, deadline: float, period: float) -> None:
        """Note how long a tick took, and how long it may and must not take [s]."""
        self._recent.append(duration)
        self.misses += duration > deadline
        self.overruns += duration > period


class Ticker:
    """Makes ticks of inputs, planned or safe; publishing them is not done here.

    Args:
        settings: of the planner.
        controller: compiled for them.
        simulated: whether time stands still while a tick is computed.
        clock: that deadlines are kept by [s].
        counted: whether deadlines are kept by work instead while goals come with odometry.

    Attributes:
        timing: of its ticks.
    """

    def __init__(
        self,
        settings: PlannerSettings,
        controller: Controller,
        *,
        simulated: bool,
        clock: Callable[[], float] = time.perf_counter,
        counted: bool = False,
    ) -> None:
        self._settings, self._controller, self._simulated = settings, controller, simulated
        self._clock, self._counted = clock, counted
        self._limit: Callable[[], float] = clock  # that the last tick's end is a time of
        self._estimator = _estimator(settings)
        self._end = math.inf  # of the last tick's time [s]
        self.timing = Timing()

    def expect_hazards(self) -> None:
        """Make what plans among obstacles take; only the first call takes any time."""
        self._controller.expect_hazards()

    def install(self, settings: PlannerSettings, controller: Controller) -> None:
        """Go on with other settings and the controller made for them."""
        controller.continue_from(self._controller)
        self._settings, self._controller = settings, controller
        before, self._estimator = self._estimator, _estimator(settings)
        if before is not None and self._estimator is not None:
            self._estimator.continue_from(before)

    def start_afresh(self) -> None:
        """Forget the plan; the command in force stays so, and the wind."""
        self._controller.start_afresh()
        if self._estimator is not None:
            self._estimator.start_afresh()

    def forget(self) -> None:
        """Forget the plan and the wind; the command in force stays so."""
        self.start_afresh()
        if self._estimator is not None:
            self._estimator.reset()

    def planned(self, inbox: Inbox, now: float, ros: RosTime = UNKNOWN) -> Report:
        """Return a tick by a plan, if there is one; nothing in the inbox may be missing.

        Args:
            inbox: the inputs.
            now: on the steady clock [s].
            ros: on the ROS clock.
        """
        begun = self._clock()
        received, settings = inbox.odometry, self._settings
        assert received is not None
        measured = along_the_air(received.value) if settings.sideslip else received.value
        limited = self._estimate(measured)
        odometry = advanced(
            settings.problem,
            measured,
            self._intervals(received, ros),
            self._controller.disturbance,
            settings.velocity_source,
        )
        odometry = self._controller.settled(odometry)
        left_out = self._look_out(inbox, odometry)
        history, lost = self._controller.history, inbox.stale_goal(now, ros)
        sent = history.last
        if lost:
            tick = self._controller.hold(odometry, lost)
        else:
            targets = partial(inbox.targets, now=now, ros=ros)
            self._set_limit(begun, in_step=inbox.in_step)
            tick = self._ticked(odometry, targets, inbox.wanted(now, ros))
        history.last = sent  # what is commanded now counts once it went out
        if limited:
            tick = replace(tick, reason=_joined(tick.reason, limited))
        lead = settings.response.lead(settings.problem)
        took = self._clock() - begun
        self.timing.took(took, settings.deadline, settings.period)
        return Report(
            tick,
            0.0 if lost else 1e3 * took,
            advanced=odometry.time - received.value.time - lead,
            led=lead,
            disturbance=self._controller.disturbance,
            innovation=None if self._estimator is None else self._estimator.innovation,
            goal_stamps=inbox.goal_stamps,
            goal_counts=dict(inbox.goal_counts),
            goal_model=inbox.goal_model,
            left_out=left_out,
            traffic_stamps=dict(inbox.lookout.stamps),
        )

    def _set_limit(self, begun: float, *, in_step: bool) -> None:
        self._limit, self._end = self._clock, begun + self._settings.deadline
        if self._counted and in_step:
            self._limit, self._end = Work(), min(self._settings.deadline, LONGEST)

    def _ticked(
        self, odometry: Odometry, targets: Callable[[Array], Array], wanted: Array | None
    ) -> Tick:
        ends = self._controller.ends(odometry.time)
        late = partial(_is_past, self._limit, self._end)
        return self._controller.tick(odometry, targets(ends), late, targets, wanted)

    def proved(self, report: Report, *, catches: bool = False) -> Report:
        """Return the report on the last tick with proofs in exact arithmetic of what it says.

        That is of a bound that closes the gap and was not counted again, that nothing is feasible,
        and that nothing is caught before a time. They are looked for until the tick's deadline:
        after its command went out, which need not wait.

        Args:
            report: on that tick.
            catches: whether what is said of catches is to be refuted, too.
        """
        tick, catch = report.tick, report.tick.catch
        if tick.plan is not None and tick.plan.is_the_methods_word and not tick.fallback:
            report = self._bounded(report, tick.plan)
        if tick.infeasible is not None:
            return self._refuted(report, tick.infeasible)
        return self._barred(report, catch) if catches and catch else report

    def _barred(self, report: Report, catch: Catch) -> Report:
        """Return a report with what refutes that anything is caught before the bound of catches."""
        count = steps_before(catch.bound, catch.sought.problem.step)
        if not count:
            return report
        # Imported by the first tick that needs it: a tenth of a second that starts are spared.
        from orbimpc_ros.mpc.proof.prove import held_in_time
        from orbimpc_ros.mpc.proof.refute import catches_refuted

        found = held_in_time(
            lambda late: [catches_refuted(catch.sought, count, late)], self._limit, self._end
        )
        return replace(report, refutation=found)

    def _bounded(self, report: Report, plan: Plan) -> Report:
        """Return a report with what proves a plan's bound, or that it is not proved."""
        from orbimpc_ros.mpc.proof.prove import WORD, certificates_for, held_in_time

        tick, bound = report.tick, plan.proof.lower_bound
        assert tick.case is not None
        known = *tick.case, plan, bound
        made = held_in_time(lambda late: certificates_for(*known, late), self._limit, self._end)
        if made is None:
            return replace(report, tick=replace(tick, reason=_joined(tick.reason, WORD)))
        plan = replace(plan, proof=replace(plan.proof, checked=True))
        return replace(report, tick=replace(tick, plan=plan, status=plan.status), certificate=made)

    def _refuted(self, report: Report, sought: Sought) -> Report:
        """Return a report with what proves that nothing is feasible, or that it is not proved."""
        from orbimpc_ros.mpc.proof.prove import WORD, held_in_time
        from orbimpc_ros.mpc.proof.refute import refutation_of

        made = held_in_time(lambda late: [refutation_of(sought, late)], self._limit, self._end)
        if made is None:
            tick = report.tick
            report = replace(report, tick=replace(tick, reason=_joined(tick.reason, WORD)))
        return replace(report, refutation=made)

    def _look_out(self, inbox: Inbox, odometry: Odometry) -> int:
        """Tell the controller what moves around the vehicle; return how much of it is left out."""
        controller, problem = self._controller, self._settings.problem
        if not inbox.lookout.stamps:
            controller.hazards = ()
            return 0
        horizons = float(FARTHEST if self._settings.capture_radius else 1)
        found = inbox.lookout.hazards(odometry.time)
        known = problem, odometry, controller.disturbance, found
        controller.hazards, left_out = nearest(*known, horizons)
        return left_out

    def _estimate(self, odometry: Odometry) -> str:
        """Learn the disturbance from a measurement; return that it is limited, if it is."""
        given, estimator = self._settings.disturbance, self._estimator
        if estimator is None or self._settings.dry_run:  # who else commands is not known
            return ''
        estimator.observe(odometry, self._controller.history, given)
        limited = estimator.limit(given)
        self._controller.disturbance = given + estimator.disturbance
        return limited

    def safe(self, inbox: Inbox, reason: Reason) -> Report:
        """Return the safe tick."""
        return Report(self._controller.safe(inbox.attitude, reason))

    def went_out(self, command: Command, at: float) -> None:
        """Note that a command was published at a time of the ROS clock [s]."""
        self._controller.history.add(command, at)

    def _intervals(self, received: Received[Odometry], ros: RosTime) -> list[Interval]:
        """Return what is in force from the measurement until the answer to it is there."""
        if not self._settings.delay_compensation or not received.timed or ros.nanoseconds is None:
            return []
        now = ros.nanoseconds / SECOND
        taking = 0.0 if self._simulated else self.timing.expected
        history = self._controller.history
        found = history.intervals(now - received.delay(ros), now + taking)
        if not found or not self._settings.response.lags:
            return found
        # For a time that is short against its lags, a vehicle goes on as it was measured.
        return [Interval(sum(each.duration for each in found), None, history.last)]
