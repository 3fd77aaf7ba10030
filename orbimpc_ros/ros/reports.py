# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A node's reports on itself: one record a tick, and diagnostics."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from orbimpc_ros.loop.traffic.nearest import clearance
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.check import margins
from orbimpc_ros.mpc.outcome import Cause, Fallback, Reason, Status
from orbimpc_ros.mpc.sensitivity.constraints import explained
from orbimpc_ros.ros.messages import header

if TYPE_CHECKING:  # the simulator reports without a solver, and starts sooner for it
    from orbimpc_ros.loop.controller import Tick
    from orbimpc_ros.mpc.plan import Plan
    from orbimpc_ros.mpc.proof.certificate import Certificate, Refutation

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
AFRESH = Reason(Cause.AFRESH, 'starting afresh')
RESET = Reason(Cause.RESET, 'reset')
DISABLED = Reason(Cause.DISABLED, 'disabled')
INACTIVE = Reason(Cause.DISABLED, 'inactive')  # as a managed node
ANOTHER_PLAN = 0.01  # unexplained share of the gradient beyond which a plan is no optimum
LONGEST = 60  # steps; prices of longer plans take milliseconds


@dataclass(frozen=True)
class Report:
    """A tick, and what belongs to it on the topic ``tick``.

    Attributes:
        tick: the decision itself.
        solve_time_ms: of the whole tick, check included [ms].
        binding: price of each constraint that keeps the plan from being better, dearest first, by
            its name and step, such as ``floor@3``; empty if none does or the plan is no optimum.
        advanced: how far the measured state was moved on before planning, for its age [s].
        led: how far on top of that, for the vehicle's lag [s].
        disturbance: that was planned with, shape (n,) [m/s] or [m/s^2].
        innovation: how far odometry was from what was expected, in standard deviations; None
            where no disturbance is estimated.
        goal_stamps: of the goals known, by topic: the messages that the plan is made of [ns].
        goal_counts: goals taken in so far, by topic: some may be lost on the way, and a replay
            has to know.
        goal_model: how the forecast takes the goal to move; empty unless it chooses.
        left_out: moving obstacles within reach that were too many to plan with.
        traffic_stamps: of what was heard last of obstacles and of other vehicles, by topic [ns].
        certificate: what proves in exact arithmetic a bound that was not counted again; None where
            that is not proved, or need not be.
        refutation: what proves that nothing is feasible, or is caught before a time, where the
            tick says so; None where that is not proved.
    """

    tick: Tick
    solve_time_ms: float = 0.0
    binding: Mapping[str, float] = field(default_factory=dict)
    advanced: float = 0.0
    led: float = 0.0
    disturbance: Array | None = None
    innovation: float | None = None
    goal_stamps: Mapping[str, int] = field(default_factory=dict)
    goal_counts: Mapping[str, int] = field(default_factory=dict)
    goal_model: str = ''
    left_out: int = 0
    traffic_stamps: Mapping[str, int] = field(default_factory=dict)
    certificate: Certificate | None = None
    refutation: Refutation | None = None

    @property
    def level(self) -> bytes:
        """Return how bad it is, in diagnostics' terms."""
        tick = self.tick
        if tick.fallback is Fallback.SAFE_COMMAND:
            return ERROR
        return WARN if tick.fallback or tick.reason or tick.status is not Status.OPTIMAL else OK

    @property
    def _catch_checked(self) -> bool:
        """Return whether what is said of catches was counted again, or refuted."""
        catch = self.tick.catch
        return catch is not None and (catch.checked or self.refutation is not None)

    @property
    def _catch(self) -> dict[str, object]:
        """Return when the plan catches the goal, and before when nothing can, from its start [s].

        Before when nothing can is said as far as it was counted again, or refuted.
        """
        catch = self.tick.catch
        if catch is None:
            return {'earliest_catch': math.nan, 'catch_bound': math.nan}
        bound = catch.bound if self._catch_checked else catch.counted
        return {'earliest_catch': catch.time, 'catch_bound': bound}

    @property
    def values(self) -> dict[str, object]:
        """Return the values on the topic ``tick``, by key.

        Attributes of the plan are NaN or empty without one. ``speed_fraction`` is |R_k e1| along
        the plan, k = 0..N; ``projection_distance`` the largest Frobenius distance from R_k to its
        rotation, k = 1..N.
        """
        tick, plan = self.tick, self.tick.plan
        fractions = () if plan is None else tuple(plan.speed_fraction.tolist())
        return {
            'status': tick.status,
            'reason': tick.reason,
            'objective': math.nan if plan is None else plan.objective,
            'lower_bound': math.nan if plan is None else plan.lower_bound,
            'gap': math.nan if plan is None else plan.gap,
            'bound_checked': plan is not None and plan.proof.checked,
            'infeasible_checked': tick.infeasible is not None and self.refutation is not None,
            'nodes': 0 if plan is None else plan.nodes,
            'solve_time_ms': self.solve_time_ms,
            'speed_fraction': fractions,
            'projection_distance': math.nan if plan is None else _farthest(plan),
            'fallback': tick.fallback,
            'cause': tick.cause,
            'binding': self.binding,
            'advanced': self.advanced,
            **self._catch,
            'catch_checked': self._catch_checked,
            'disturbance': () if self.disturbance is None else tuple(self.disturbance.tolist()),
            'innovation': math.nan if self.innovation is None else self.innovation,
            'goal_stamps': self.goal_stamps,
            'goal_counts': self.goal_counts,
            **({'goal_model': self.goal_model} if self.goal_model else {}),
            **_traffic(tick),
            'margins': _margins(tick),
            'obstacles_left_out': self.left_out,
            'traffic_stamps': self.traffic_stamps,
        }


def _traffic(tick: Tick) -> dict[str, object]:
    """Return how many moving obstacles are planned with, and how clear the plan is of any."""
    count = 0 if tick.state is None else len(tick.state.hazards)
    least = math.nan
    if tick.problem is not None and tick.state is not None and tick.plan is not None:
        least = clearance(tick.problem, tick.state, tick.plan.positions)
    return {'obstacles': count, 'clearance': least}


def _margins(tick: Tick) -> dict[str, float]:
    """Return how far inside of each limit the plan stays, by name."""
    return {} if tick.case is None or tick.plan is None else margins(*tick.case, tick.plan)


def _farthest(plan: Plan) -> float:
    return float(plan.projection_distance[1:].max())


def prices(tick: Tick) -> dict[str, float]:
    """Return what binds at a tick's plan: apart, for the vehicle must not wait for it."""
    case, plan = tick.case, tick.plan
    if case is None or plan is None or plan.horizon > LONGEST:
        return {}
    explanation = explained(*case, plan)
    if explanation.unexplained > ANOTHER_PLAN:
        return {}
    return {str(each): each.price for each in explanation.binding}


def tick_message(at: int, node: str, report: Report) -> DiagnosticArray:
    """Return a report as the message on ``tick``; ``at`` is the stamp [ns]."""
    message = report.tick.reason or report.tick.status
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
