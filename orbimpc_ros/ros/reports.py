# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A node's reports on itself: one record a tick, and diagnostics."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from orbimpc_ros.loop.traffic import clearance
from orbimpc_ros.mpc.check import margins
from orbimpc_ros.mpc.outcome import Cause, Fallback, Reason, Status
from orbimpc_ros.mpc.sensitivity.constraints import explained
from orbimpc_ros.ros.messages import header

if TYPE_CHECKING:  # the simulator reports without a solver, and starts sooner for it
    from orbimpc_ros.loop.planner import Decision

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
AFRESH = Reason(Cause.AFRESH, 'starting afresh')
RESET = Reason(Cause.RESET, 'reset')
DISABLED = Reason(Cause.DISABLED, 'disabled')
INACTIVE = Reason(Cause.DISABLED, 'inactive')  # as a managed node
ANOTHER_PLAN = 0.01  # unexplained share of the gradient beyond which a plan is no optimum
LONGEST = 60  # steps; prices of longer plans take milliseconds


@dataclass(frozen=True)
class Report:
    """A decision, and what belongs to it on the topic ``tick``.

    Attributes:
        decision: what was decided, and why.
        solve_time_ms: of the whole decision, check included [ms].
        goal_stamps: of the goals known, by topic: the messages that the plan is made of [ns].
        goal_counts: goals taken in so far, by topic: some may be lost on the way, and a replay
            has to know.
        goal_model: how the forecast takes the goal to move; empty unless it chooses.
        traffic_stamps: of what was heard last of obstacles and of other vehicles, by topic [ns].
        binding: price of each constraint that keeps the plan from being better, dearest first, by
            its name and step, such as ``floor@3``; empty if none does or the plan is no optimum.
    """

    decision: Decision
    solve_time_ms: float = 0.0
    goal_stamps: Mapping[str, int] = field(default_factory=dict)
    goal_counts: Mapping[str, int] = field(default_factory=dict)
    goal_model: str = ''
    traffic_stamps: Mapping[str, int] = field(default_factory=dict)
    binding: Mapping[str, float] = field(default_factory=dict)

    @property
    def level(self) -> bytes:
        """Return how bad it is, in diagnostics' terms."""
        decision = self.decision
        if decision.fallback is Fallback.SAFE_COMMAND:
            return ERROR
        good = decision.status is Status.OPTIMAL and not (decision.fallback or decision.reason)
        return OK if good else WARN

    @property
    def numbers(self) -> dict[str, float]:
        """Return what is published as numbers, by name: the time [s], and of a plan its costs."""
        plan, took = self.decision.plan, {'solve_time': 1e-3 * self.solve_time_ms}
        if plan is None:
            return took
        costs = {'objective': plan.objective, 'lower_bound': plan.lower_bound, 'gap': plan.gap}
        return costs | took

    @property
    def values(self) -> dict[str, object]:
        """Return the values on the topic ``tick``, by key.

        Attributes of the plan are NaN or empty without one. ``speed_fraction`` is |R_k e1| along
        the plan, k = 0..N; ``projection_distance`` the largest Frobenius distance from R_k to its
        rotation, k = 1..N. ``catch_bound`` is the time before which nothing can catch the goal, as
        far as that was counted again, or refuted.
        """
        decision, plan, catch = self.decision, self.decision.plan, self.decision.catch
        refuted, wind, case = decision.refutation is not None, decision.disturbance, decision.case
        objective = lower_bound = gap = projection_distance = clear = math.nan
        fractions: tuple[float, ...] = ()
        if plan is not None:
            objective, lower_bound, gap = plan.objective, plan.lower_bound, plan.gap
            fractions = tuple(plan.speed_fraction.tolist())
            projection_distance = float(plan.projection_distance[1:].max())
        if case is not None and plan is not None:
            clear = clearance(case.problem, case.state, plan.positions)
        catch_checked = catch is not None and (catch.checked or refuted)
        catch_bound = math.nan
        if catch is not None:
            catch_bound = catch.bound if catch_checked else catch.counted
        return {
            'status': decision.status,
            'reason': decision.reason,
            'objective': objective,
            'lower_bound': lower_bound,
            'gap': gap,
            'bound_checked': plan is not None and plan.proof.checked,
            'infeasible_checked': decision.infeasible is not None and refuted,
            'nodes': 0 if plan is None else plan.nodes,
            'solve_time_ms': self.solve_time_ms,
            'speed_fraction': fractions,
            'projection_distance': projection_distance,
            'fallback': decision.fallback,
            'cause': decision.cause,
            'binding': self.binding,
            'advanced': decision.advanced,
            'earliest_catch': math.nan if catch is None else catch.time,
            'catch_bound': catch_bound,
            'catch_checked': catch_checked,
            'disturbance': () if wind is None else tuple(wind.tolist()),
            'innovation': math.nan if decision.innovation is None else decision.innovation,
            'goal_stamps': self.goal_stamps,
            'goal_counts': self.goal_counts,
            **({'goal_model': self.goal_model} if self.goal_model else {}),
            'obstacles': 0 if decision.state is None else len(decision.state.hazards),
            'clearance': clear,
            'margins': {} if case is None or plan is None else margins(*case, plan),
            'obstacles_left_out': decision.left_out,
            'traffic_stamps': self.traffic_stamps,
        }


def prices(decision: Decision) -> dict[str, float]:
    """Return what binds at a tick's plan: apart, for the vehicle must not wait for it."""
    case, plan = decision.case, decision.plan
    if case is None or plan is None or plan.horizon > LONGEST:
        return {}
    explanation = explained(*case, plan)
    if explanation.unexplained > ANOTHER_PLAN:
        return {}
    return {str(each): each.price for each in explanation.binding}


def condition(
    wrong: Iterable[str], waiting: str, report: Report | None, notices: Iterable[str]
) -> tuple[bytes, list[str]]:
    """Return a planner's condition: a level, and what it is due to.

    Args:
        wrong: what is wrong around it, in words; empty ones do not count.
        waiting: why it does not plan, in words; empty if it does.
        report: of the last decision, if there was one.
        notices: what to warn of while all goes well; empty ones do not count.
    """
    errors, warnings = [*filter(None, wrong)], [*filter(None, notices)]
    if errors:
        return ERROR, errors
    if waiting:
        return WARN, [waiting, *warnings]
    level, message = OK, 'ready'
    if report is not None:
        level, message = report.level, report.decision.reason or 'planning'
    return WARN if level == OK and warnings else level, [message, *warnings]


def tick_message(at: int, node: str, report: Report) -> DiagnosticArray:
    """Return a report as the message on ``tick``; ``at`` is the stamp [ns]."""
    message = report.decision.reason or report.decision.status
    return diagnostics(at, f'{node}: tick', report.level, message, report.values)


def health_message(
    at: int, node: str, task: str, level: bytes, message: str, values: Mapping[str, object]
) -> DiagnosticArray:
    """Return a status for /diagnostics, named as diagnostic_updater does.

    Args:
        at: its stamp [ns].
        node: fully qualified name of who reports; the namespace tells the vehicle.
        task: what it reports on.
        level: how it is.
        message: the same in words.
        values: figures behind it, by key.
    """
    name = node.strip('/')
    made = diagnostics(at, f'{name}: {task}', level, message, values)
    made.status[0].hardware_id = name.rpartition('/')[0] or 'none'
    return made


def diagnostics(
    at: int, name: str, level: bytes, message: str, values: Mapping[str, object]
) -> DiagnosticArray:
    """Return one diagnostic status, stamped ``at`` [ns]; values that are no text become JSON."""
    pairs = [
        KeyValue(key=key, value=value if isinstance(value, str) else json.dumps(value))
        for key, value in values.items()
    ]
    status = DiagnosticStatus(name=name, level=level, message=message, values=pairs)
    return DiagnosticArray(header=header(at, ''), status=[status])
