# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Decisions as messages: commands first, then what they were made of."""

from __future__ import annotations

from array import array
from collections.abc import Collection
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import QuaternionStamped, TwistStamped, Vector3Stamped, WrenchStamped
from nav_msgs.msg import Path
from std_msgs.msg import UInt8MultiArray
from visualization_msgs.msg import MarkerArray

from orbimpc_ros.loop.planner import Decision
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.command import Command
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.model.dynamics import translation_rollout
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.proof.document import Certificate, Refutation
from orbimpc_ros.mpc.proof.prove import certificate_of
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.markers import plan_markers
from orbimpc_ros.ros.messages import Stamp
from orbimpc_ros.ros.parameters.planner import PlannerSettings
from orbimpc_ros.ros.reports import Report, tick_message

KINDS: dict[str, type] = {
    'plan': Path,
    'plan_markers': MarkerArray,
    'tick': DiagnosticArray,
}
COMMANDS: dict[str, type] = {'cmd_vel': TwistStamped, 'rotation': QuaternionStamped}
FORCES: dict[str, type] = {'cmd_thrust': WrenchStamped}
PROOFS: dict[str, type] = {'certificate': UInt8MultiArray}
SHARES: dict[str, type] = {'thrust': Vector3Stamped}
COMMANDED = frozenset(COMMANDS | FORCES | SHARES)
TOPICS = frozenset(KINDS | COMMANDS | PROOFS)
CLAIMS = frozenset({'tick', 'certificate'})  # which wait for proofs
# On ~/distance [m], ~/solve_time [s] and so on.
NUMBERS = ('distance', 'gap', 'lower_bound', 'objective', 'solve_time')


def outputs(settings: PlannerSettings) -> dict[str, type]:
    """Return the topics that a planner publishes, with their types: no commands on a dry run."""
    kinds = KINDS | (PROOFS if settings.publish_certificate else {})
    if settings.dry_run:
        return kinds
    forces = FORCES if settings.problem.inertial else {}
    return kinds | COMMANDS | forces | (SHARES if settings.hover_thrust else {})


def command_messages(settings: PlannerSettings, stamp: Stamp, command: Command) -> dict[str, Any]:
    """Return the messages to the vehicle, by topic; it waits for them, so they are sent first."""
    problem = settings.problem
    pushed = problem.forward * command.speed_fraction  # [m/s] or [m/s^2]
    if problem.translation_order == 1:
        return {'cmd_vel': messages.twist_message(stamp, pushed, command.body_rate)}
    found = {
        'cmd_thrust': messages.wrench_message(stamp, settings.mass * pushed),
        'cmd_vel': messages.twist_message(stamp, 0.0, command.body_rate),
    }
    if settings.hover_thrust:
        share = settings.hover_thrust * pushed / settings.gravity
        head = messages.header(stamp.nanoseconds, stamp.frames.body)
        found['thrust'] = Vector3Stamped(header=head, vector=messages.pushing(share, stamp.frames))
    return found


def report_messages(
    settings: PlannerSettings,
    stamp: Stamp,
    report: Report,
    node: str,
    *,
    oriented: bool,
    heard: Collection[str] = TOPICS,
) -> dict[str, Any]:
    """Return the messages to everybody else, by topic.

    Args:
        settings: give the problem.
        stamp: of the odometry that is answered.
        report: on the tick.
        node: name of the planner.
        oriented: whether the vehicle's attitude is known, so that one can be commanded.
        heard: topics that somebody listens to: others are not worth the work.
    """
    decision, made = report.decision, dict[str, Any]()
    if 'tick' in heard:
        made['tick'] = tick_message(stamp.nanoseconds, node, report)
    if 'plan' in heard:
        made['plan'] = _path(settings, stamp, decision)
    if 'plan_markers' in heard and decision.plan is not None and decision.state is not None:
        known = settings.problem, decision.plan, decision.state.hazards
        made['plan_markers'] = plan_markers(stamp, *known)
    if 'certificate' in heard and settings.publish_certificate:
        made['certificate'] = _certificate(decision)
    if 'rotation' in heard and oriented:
        made['rotation'] = messages.rotation_message(stamp, decision.command)
    return {topic: message for topic, message in made.items() if message is not None}


def _path(settings: PlannerSettings, stamp: Stamp, decision: Decision) -> Path | None:
    """Return where the vehicle will be; without a plan only whoever avoids it has to know."""
    problem, start = settings.problem, decision.advanced + decision.led
    if decision.plan is not None:
        step = (decision.problem or problem).step
        return messages.plan_message(stamp, decision.plan, step, start)
    if not settings.avoid or decision.state is None:
        return None
    flown = obeyed(problem, decision.state, decision.command)
    poses = [messages.pose(place, stamp.frames.own(turned)) for place, turned in flown]
    return messages.path_message(stamp, problem.step, poses, start)


def _certificate(decision: Decision) -> UInt8MultiArray | None:
    """Return what proves the plan's bound, where there is a form of it."""
    case, plan = decision.case, decision.plan
    if case is None or plan is None or plan.proof.tree is None or plan.proof.lower_bound <= 0.0:
        return None
    return _proof(certificate_of(*case, plan.proof))


def refutation_messages(report: Report) -> dict[str, Any]:
    """Return by topic what refutes that anything is feasible, or caught, where that is proved."""
    made = report.decision.refutation
    return {} if made is None else {'certificate': _proof(made)}


def _proof(made: Certificate | Refutation) -> UInt8MultiArray:
    return UInt8MultiArray(data=array('B', made.text().encode()))


def obeyed(problem: Problem, state: State, command: Command) -> list[tuple[Array, Array]]:
    """Return N + 1 positions and attitudes of a vehicle that obeys one command for a horizon."""
    turn = exp(problem.step * command.body_rate)
    attitudes = [state.attitude]
    for step in range(problem.horizon):  # of second order, it turns from the second step on
        still = step == 0 and problem.rotation_order == 2
        attitudes.append(attitudes[-1] if still else attitudes[-1] @ turn)
    fractions = np.full(problem.horizon + 1, command.speed_fraction)
    fractions[0] = min(1.0, float(np.linalg.norm(state.rotation[:, 0])))
    headings = fractions[:, None] * np.array(attitudes)[:, :, 0]
    positions, _ = translation_rollout(problem, state, headings)
    return list(zip(positions, attitudes, strict=True))
