# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planner without its node: inputs, decisions and deadlines, as its parameters state them.

The node, replays and flights in one process share it.
"""

from __future__ import annotations

import itertools
import math
import statistics
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from orbimpc_ros.loop.intercept import steps_before
from orbimpc_ros.loop.planner import Decision, Planner, Snapshot, joined
from orbimpc_ros.loop.task import Deadline
from orbimpc_ros.mpc.outcome import Cause, Reason
from orbimpc_ros.mpc.proof.document import Refutation
from orbimpc_ros.ros.messages import SECOND, UNKNOWN, RosTime
from orbimpc_ros.ros.parameters.planner import PlannerSettings
from orbimpc_ros.ros.planner.inputs import Inputs

AFRESH = Reason(Cause.AFRESH, 'starting afresh')
RESET = Reason(Cause.RESET, 'reset')
DISABLED = Reason(Cause.DISABLED, 'disabled')
INACTIVE = Reason(Cause.DISABLED, 'inactive')  # as a managed node
OF_PLANNER = (
    *('projection', 'gap_tolerance', 'response', 'disturbance', 'velocity_source', 'sideslip'),
    *('capture_radius', 'approach', 'centred', 'odom_timeout', 'goal_timeout'),
)
RECENT = 15  # decisions
LOOK = 1e-4  # [s] that a look at the deadline counts for in lock-step: some take 3e-3
LONGEST = 0.25  # [s] a deadline counts for at most there, where somebody waits for the answer


def planner_of(settings: PlannerSettings) -> tuple[PlannerSettings, Planner]:
    """Return the settings with a planner compiled for them."""
    planner = Planner(
        settings.problem,
        shrinking=settings.horizon_mode == 'shrinking',
        safe=settings.safe_command,
        # On a dry run somebody else commands, who is not known.
        estimated=settings.estimated and not settings.dry_run,
        reserve=settings.obstacle_reserve,
        **{name: getattr(settings, name) for name in OF_PLANNER},
    )
    if settings.avoid:
        planner.expect_hazards()
    return settings, planner


class Core:
    """Decides on what messages have brought; publishing is left to others.

    Times named ``now`` are of the steady clock [s], those named ``ros`` of the ROS clock.

    Args:
        settings: of the planner.
        planner: compiled for them.
        simulated: whether time stands still while a decision is made.
        clock: that deadlines are kept by [s]; None where a solve has none, so that what it finds
            does not depend on the machine.
        counted: whether deadlines are kept by work instead while goals come with odometry.
        names: of the topics as they are resolved, by their names here.
        others: topics of other vehicles' plans, as they are resolved.

    Attributes:
        settings: of the planner.
        inputs: take in messages.
        planner: decides.
        counts: ``deadline misses``, decisions that took longer than their deadline; ``overruns``,
            that took longer than their period.
        outdated: why the last plan may not be followed, made in too long a time; None if it may.
    """

    def __init__(
        self,
        settings: PlannerSettings,
        planner: Planner,
        *,
        simulated: bool = True,
        clock: Callable[[], float] | None = time.perf_counter,
        counted: bool = False,
        names: Mapping[str, str] | None = None,
        others: Sequence[str] = (),
    ) -> None:
        self.settings, self.planner = settings, planner
        self.inputs = Inputs(settings, names, others)
        self.counts = Counter({'deadline misses': 0, 'overruns': 0})
        self._recent: deque[float] = deque(maxlen=RECENT)  # how long decisions took [s]
        self.outdated: Reason | None = None
        self._simulated, self._counted = simulated, counted
        self._clock, self._unlimited = clock or time.perf_counter, clock is None
        self._deadline = Deadline(self._clock, math.inf)  # of the last decision

    @property
    def expected(self) -> float:
        """Return how long a decision usually takes [s]."""
        return statistics.median(self._recent) if self._recent else 0.0

    def install(self, settings: PlannerSettings, planner: Planner) -> None:
        """Go on with other settings and the planner made for them."""
        planner.continue_from(self.planner)
        self.settings, self.planner = settings, planner
        self.inputs.adopt(settings)

    def start_afresh(self, *, wind: bool = False) -> None:
        """Forget plan and inputs, but for a goal sent by hand; with ``wind`` that estimate, too."""
        self.planner.start_afresh(wind=wind)
        self.inputs.start_afresh()

    def unsafe(
        self, now: float, ros: RosTime = UNKNOWN, stop: Reason | None = None
    ) -> Reason | None:
        """Return why no plan may be followed now; None if one may."""
        known = self.inputs.odometry  # a whole snapshot would forget bodies, which replays do not
        if known is None:
            return self.planner.unsafe(Snapshot(stop=stop))
        age = known.age(now, ros)
        return self.planner.unsafe(Snapshot(known.value, odometry_age=age, stop=stop))

    def decide(
        self,
        now: float,
        ros: RosTime = UNKNOWN,
        stop: Reason | None = None,
        *,
        fresh: bool = False,
    ) -> Decision:
        """Return what to do next, how long that took, and which messages it is made of.

        Args:
            now: on the steady clock [s].
            ros: on the ROS clock.
            stop: why no plan may be followed, if none may.
            fresh: whether odometry counts as fresh, as where somebody else has judged it.
        """
        begun, taking = self._clock(), 0.0 if self._simulated else self.expected
        snapshot = self.inputs.snapshot(now, ros, stop=stop, taking=taking)
        heard = self.inputs.heard
        if fresh:
            snapshot = replace(snapshot, odometry_age=0.0)
        given = math.inf if self._unlimited else self.settings.deadline
        self._deadline = Deadline(self._clock, begun + given)
        if self._counted and self.inputs.in_step:
            # A clock that goes on by the looks at it, of which a search takes one after each part:
            # what it limits is the same on every machine, however busy.
            looked = (LOOK * looks for looks in itertools.count(1)).__next__
            self._deadline = Deadline(looked, min(given, LONGEST))
        at = None if ros.nanoseconds is None else ros.nanoseconds / SECOND + taking
        decision = self.planner.step(snapshot, at, self._deadline)
        took = self._clock() - begun
        if decision.state is None:
            return decision
        self.outdated = None
        if snapshot.odometry_age + took > self.settings.odom_timeout:
            later = ros
            if ros.nanoseconds is not None and not self._simulated:
                later = replace(ros, nanoseconds=ros.nanoseconds + round(took * SECOND))
            self.outdated = self.unsafe(now + took, later)
        self._recent.append(took)
        self.counts['deadline misses'] += took > self.settings.deadline
        self.counts['overruns'] += took > self.settings.period
        solving = 0.0 if decision.cause is Cause.GOAL else 1e3 * took
        return replace(decision, solve_time_ms=solving, heard=heard)

    def proved(self, decision: Decision, *, catches: bool = False) -> Decision:
        """Return the last decision with a proof of what it states, if there is one by its deadline.

        That is that nothing is feasible or, with ``catches``, that nothing is caught before a time.
        Its command went out before, and need not wait for that.
        """
        nothing, catch = decision.infeasible, decision.catch if catches else None
        count = 0 if catch is None else steps_before(catch.bound, catch.sought.problem.step)
        if nothing is None and not count:
            return decision
        # Imported by the first decision that needs it: a tenth of a second that starts are spared.
        from orbimpc_ros.mpc.proof.prove import WORD, held_in_time
        from orbimpc_ros.mpc.proof.refute import catches_refuted, refutation_of

        def made(late: Callable[[], bool]) -> Refutation:
            if nothing is not None:
                return refutation_of(nothing, late)
            assert catch is not None
            return catches_refuted(catch.sought, count, late)

        refutation = held_in_time(made, self._deadline.clock, self._deadline.end)
        reason = decision.reason
        if nothing is not None and refutation is None:
            reason = joined(reason, WORD)
        return replace(decision, refutation=refutation, reason=reason)
