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
    from orbimpc_ros.mpc.plan import Plan

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
        return (
            WARN
            if decision.fallback or decision.reason or decision.status is not Status.OPTIMAL
            else OK
        )

    @property
    def _catch_checked(self) -> bool:
        """Return whether what is said of catches was counted again, or refuted."""
        catch = self.decision.catch
        return catch is not None and (catch.checked or self.decision.refutation is not None)

    @property
    def _catch(self) -> dict[str, object]:
        """Return when the plan catches the goal, and before when nothing can, from its start [s].

        Before when nothing can is said as far as it was counted again, or refuted.
        """
        catch = self.decision.catch
        if catch is None:
            return {'earliest_catch': math.nan, 'catch_bound': math.nan}
        bound = catch.bound if self._catch_checked else catch.counted
        return {'earliest_catch': catch.time, 'catch_bound': bound}

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
        rotation, k = 1..N.
        """
        decision, plan = self.decision, self.decision.plan
        refuted, wind = decision.refutation is not None, decision.disturbance
        fractions = () if plan is None else tuple(plan.speed_fraction.tolist())
        return {
            'status': decision.status,
            'reason': decision.reason,
            'objective': math.nan if plan is None else plan.objective,
            'lower_bound': math.nan if plan is None else plan.lower_bound,
            'gap': math.nan if plan is None else plan.gap,
            'bound_checked': plan is not None and plan.proof.checked,
            'infeasible_checked': decision.infeasible is not None and refuted,
            'nodes': 0 if plan is None else plan.nodes,
            'solve_time_ms': self.solve_time_ms,
            'speed_fraction': fractions,
            'projection_distance': math.nan if plan is None else _farthest(plan),
            'fallback': decision.fallback,
            'cause': decision.cause,
            'binding': self.binding,
            'advanced': decision.advanced,
            **self._catch,
            'catch_checked': self._catch_checked,
            'disturbance': () if wind is None else tuple(wind.tolist()),
            'innovation': math.nan if decision.innovation is None else decision.innovation,
            'goal_stamps': self.goal_stamps,
            'goal_counts': self.goal_counts,
            **({'goal_model': self.goal_model} if self.goal_model else {}),
            **_traffic(decision),
            'margins': _margins(decision),
            'obstacles_left_out': decision.left_out,
            'traffic_stamps': self.traffic_stamps,
        }


def _traffic(decision: Decision) -> dict[str, object]:
    """Return how many moving obstacles are planned with, and how clear the plan is of any."""
    count = 0 if decision.state is None else len(decision.state.hazards)
    least = math.nan
    if decision.problem is not None and decision.state is not None and decision.plan is not None:
        least = clearance(decision.problem, decision.state, decision.plan.positions)
    return {'obstacles': count, 'clearance': least}


def _margins(decision: Decision) -> dict[str, float]:
    """Return how far inside of each limit the plan stays, by name."""
    return (
        {}
        if decision.case is None or decision.plan is None
        else margins(*decision.case, decision.plan)
    )


def _farthest(plan: Plan) -> float:
    return float(plan.projection_distance[1:].max())


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
    told = diagnostics(at, f'{name}: {task}', level, message, values)
    told.status[0].hardware_id = name.rpartition('/')[0] or 'none'
    return told


def diagnostics(
    at: int, name: str, level: bytes, message: str, values: Mapping[str, object]
) -> DiagnosticArray:
    """Return one diagnostic status, stamped ``at`` [ns]."""
    pairs = [KeyValue(key=key, value=_text(value)) for key, value in values.items()]
    status = DiagnosticStatus(name=name, level=level, message=message, values=pairs)
    return DiagnosticArray(header=header(at, ''), status=[status])


def _text(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value)
