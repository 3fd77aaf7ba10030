"""What the planner publishes on a tick, by topic: pure functions of what the tick came to."""

from __future__ import annotations

from typing import Any

from orbimpc_ros.mpc.command import Command
from orbimpc_ros.mpc.plan import Plan
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.markers import plan_markers
from orbimpc_ros.ros.messages import Stamp
from orbimpc_ros.ros.parameters.planner import PlannerSettings
from orbimpc_ros.ros.reports import Report, tick_message


def orders(settings: PlannerSettings, stamp: Stamp, command: Command) -> dict[str, Any]:
    """Return what the vehicle is told; it waits for this, so it is made and sent first."""
    problem = settings.problem
    pushed = problem.forward * command.speed_fraction  # [m/s] or [m/s^2]
    if problem.translation_order == 1:
        return {'cmd_vel': messages.twist_message(stamp, pushed, command.body_rate)}
    return {
        'cmd_thrust': messages.wrench_message(stamp, settings.mass * pushed),
        'cmd_vel': messages.twist_message(stamp, 0.0, command.body_rate),
    }


def reports(
    settings: PlannerSettings, stamp: Stamp, report: Report, plan: Plan | None, node: str
) -> dict[str, Any]:
    """Return what everybody else is told.

    Args:
        settings: give the step.
        stamp: of the odometry that is answered.
        report: what the tick came to.
        plan: behind the command; None if there is none.
        node: name of the planner.
    """
    told: dict[str, Any] = {'tick': tick_message(stamp.nanoseconds, node, report)}
    if plan is not None:
        told['plan'] = messages.plan_message(stamp, plan, settings.problem.step, report.advanced)
        told['plan_markers'] = plan_markers(stamp, settings.problem, plan)
    return told
