"""What a node says about itself: one record a tick, and diagnostics."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from orbimpc_ros.mpc.outcome import Fallback, Status
from orbimpc_ros.mpc.sensitivity.constraints import explained
from orbimpc_ros.ros.messages import header

if TYPE_CHECKING:  # the simulator reports without a solver, and starts sooner for it
    from orbimpc_ros.mpc.loop.controller import Tick

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
AFRESH = 'starting afresh'  # why: inputs and plan were forgotten
ANOTHER_PLAN = 0.01  # unexplained share of the gradient beyond which a plan is no optimum
LONGEST = 60  # steps; prices of longer plans take milliseconds


@dataclass(frozen=True)
class Report:
    """What one tick came to; the fields are the keys on the topic ``tick``.

    Attributes:
        status: ``optimal``, ``feasible``, ``infeasible`` or ``failed``.
        reason: why it is not ``optimal``, and what was done about a goal too far away or a measured
            speed that the model does not know; else empty.
        objective: of the commanded plan; NaN without one, as are the next two.
        lower_bound: proved below any plan's objective.
        gap: (objective - lower bound) / max(1e-9, |objective|).
        nodes: relaxations solved.
        solve_time_ms: of the whole tick, check included [ms].
        speed_fraction: |R_k e1| along the plan, k = 0..N.
        projection_distance: largest Frobenius distance from R_k to its rotation, k = 1..N.
        fallback: empty, ``shifted plan``, ``soft arrival`` or ``safe command``.
        binding: price of each constraint that keeps the plan from being better, dearest first, by
            its name and step, such as ``floor@3``; empty if none does or the plan is no optimum.
        advanced: by how much the measured state was moved on before planning [s].
        goal_stamps: of the goals known, by topic: the messages that the plan is made of [ns].
        goal_counts: goals taken in so far, by topic: some may be lost on the way, and a replay
            has to know.
    """

    status: Status
    reason: str = ''
    objective: float = math.nan
    lower_bound: float = math.nan
    gap: float = math.nan
    nodes: int = 0
    solve_time_ms: float = 0.0
    speed_fraction: tuple[float, ...] = ()
    projection_distance: float = math.nan
    fallback: Fallback = Fallback.NONE
    binding: Mapping[str, float] = field(default_factory=dict)
    advanced: float = 0.0
    goal_stamps: Mapping[str, int] = field(default_factory=dict)
    goal_counts: Mapping[str, int] = field(default_factory=dict)

    @property
    def level(self) -> bytes:
        """Return how bad it is, in diagnostics' terms."""
        if self.fallback is Fallback.SAFE_COMMAND:
            return ERROR
        return WARN if self.fallback or self.reason or self.status is not Status.OPTIMAL else OK


def report_of(tick: Tick, solve_time_ms: float) -> Report:
    """Return the report of a controller's tick."""
    if tick.plan is None:
        return Report(
            tick.status, tick.reason, solve_time_ms=solve_time_ms, fallback=Fallback.SAFE_COMMAND
        )
    plan = tick.plan
    return Report(
        tick.status,
        tick.reason,
        plan.objective,
        plan.lower_bound,
        plan.gap,
        plan.nodes,
        solve_time_ms,
        tuple(plan.speed_fraction.tolist()),
        float(plan.projection_distance[1:].max()),
        tick.fallback,
    )


def prices(tick: Tick) -> dict[str, float]:
    """Return what binds at a tick's plan: apart, for the vehicle must not wait for it."""
    problem, goals, plan = tick.problem, tick.goals, tick.plan
    if problem is None or goals is None or plan is None or plan.horizon > LONGEST:
        return {}
    told = explained(problem, tick.state, goals, plan)
    if told.unexplained > ANOTHER_PLAN:
        return {}
    return {str(each): each.price for each in told.binding}


def safe_report(reason: str) -> Report:
    """Return the report of a tick on which nothing was planned."""
    return Report(Status.FAILED, reason, fallback=Fallback.SAFE_COMMAND)


def tick_message(at: int, node: str, report: Report) -> DiagnosticArray:
    """Return a report as the message on ``tick``; ``at`` is the stamp [ns]."""
    values = {each.name: getattr(report, each.name) for each in fields(report)}
    return diagnostics(at, f'{node}: tick', report.level, report.reason or report.status, values)


def diagnostics(
    at: int, name: str, level: bytes, message: str, values: Mapping[str, object]
) -> DiagnosticArray:
    """Return one diagnostic status, stamped ``at`` [ns]."""
    pairs = [KeyValue(key=key, value=_text(value)) for key, value in values.items()]
    status = DiagnosticStatus(name=name, level=level, message=message, values=pairs)
    return DiagnosticArray(header=header(at, ''), status=[status])


def _text(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value)
