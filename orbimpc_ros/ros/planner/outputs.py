# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Reports of decisions as messages, and a summary of the configured vehicle and task."""

from __future__ import annotations

import math
from array import array
from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from std_msgs.msg import Float64, UInt8MultiArray

from orbimpc_ros.loop.planner import Decision
from orbimpc_ros.loop.traffic import clearance
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.check import margins
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.model.dynamics import translation_rollout
from orbimpc_ros.mpc.outcome import Fallback, Status
from orbimpc_ros.mpc.plan import Command, stop
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.proof.document import certificate_of, text_of
from orbimpc_ros.mpc.sensitivity import explained
from orbimpc_ros.ros import messages
from orbimpc_ros.ros.messages import ERROR, OK, WARN, Stamp, diagnostics, plan_markers
from orbimpc_ros.ros.parameters.planner import PLANNER, PlannerSettings

REPORTS = ('plan', 'plan_markers', 'tick')  # topics of every planner
DECIDED = ('status', 'reason', 'cause', 'fallback', 'solve_time_ms', 'advanced')
COSTS = ('objective', 'lower_bound', 'gap')
NO_PLAN: dict[str, object] = {'nodes': 0, 'speed_fraction': (), 'margins': {}}
NO_PLAN |= dict.fromkeys(('projection_distance', 'clearance'), math.nan)
UNHEARD: dict[str, Any] = {'goal_stamps': {}, 'goal_counts': {}, 'traffic_stamps': {}}
ANOTHER_PLAN = 0.01  # unexplained share of the gradient above which a plan is not optimal
LONGEST = 60  # steps; prices of longer plans take milliseconds
NORMAL = 'ready', 'planning'  # conditions before and after the first decision


def level(decision: Decision) -> bytes:
    """Return the diagnostic level of a decision."""
    if decision.fallback is Fallback.SAFE_COMMAND:
        return ERROR
    good = decision.status is Status.OPTIMAL and not (decision.fallback or decision.reason)
    return OK if good else WARN


def values(decision: Decision) -> dict[str, object]:
    """Return the values on the topic ``tick``, by key.

    Attributes of the plan are NaN or empty without one. ``speed_fraction`` is |R_k e1| along the
    plan, k = 0..N; ``projection_distance`` the largest Frobenius distance from R_k to its rotation,
    k = 1..N. ``catch_bound`` is the time before which no catch is possible, as far as that has been
    verified or proved by a refutation.
    """
    plan, catch, case = decision.plan, decision.catch, decision.case
    refuted, wind = decision.refutation is not None, decision.disturbance
    caught = catch is not None and (catch.checked or refuted)
    of_plan = NO_PLAN
    if plan is not None and case is not None:
        of_plan = {
            'nodes': plan.proof.nodes,
            'speed_fraction': tuple(plan.speed_fraction.tolist()),
            'margins': margins(*case.parts, plan),
            'projection_distance': float(plan.projection_distance[1:].max()),
            'clearance': clearance(case.problem, case.state, plan.positions),
        }
    return {
        **{name: getattr(decision, name) for name in DECIDED},
        **{name: getattr(plan, name, math.nan) for name in COSTS},
        'bound_checked': plan is not None and plan.proof.checked,
        'infeasible_checked': decision.infeasible is not None and refuted,
        **of_plan,
        'binding': prices(decision),
        'earliest_catch': getattr(catch, 'time', math.nan),
        'catch_bound': getattr(catch, 'bound' if caught else 'counted', math.nan),
        'catch_checked': caught,
        'disturbance': () if wind is None else tuple(wind.tolist()),
        'innovation': math.nan if decision.innovation is None else decision.innovation,
        **UNHEARD,
        **decision.heard,
        'obstacles': 0 if decision.state is None else len(decision.state.hazards),
        'obstacles_left_out': decision.left_out,
    }


def prices(decision: Decision) -> dict[str, float]:
    """Return the shadow price of each constraint that is active in a decision's plan.

    Largest first, by name and step, such as ``floor@3``; empty if there is none, if the plan is not
    optimal, or if it is long.
    """
    case, plan = decision.case, decision.plan
    if case is None or plan is None or plan.horizon > LONGEST:
        return {}
    explanation = explained(*case.parts, plan)
    if explanation.unexplained > ANOTHER_PLAN:
        return {}
    return {str(each): each.price for each in explanation.binding}


def condition(
    wrong: Iterable[str], waiting: str, decision: Decision | None, notices: Iterable[str]
) -> tuple[bytes, list[str]]:
    """Return a planner's condition, a level and its reasons, after its last decision, if any.

    External problems may be ``wrong``; ``waiting`` says why it does not plan, ``notices`` are
    warnings in normal operation. Empty strings are ignored.
    """
    errors, warnings = [*filter(None, wrong)], [*filter(None, notices)]
    if errors:
        return ERROR, errors
    if waiting:
        return WARN, [waiting, *warnings]
    worst, message = OK, NORMAL[0]
    if decision is not None:
        worst, message = level(decision), decision.reason or NORMAL[1]
    return WARN if worst == OK and warnings else worst, [message, *warnings]


def outputs(settings: PlannerSettings) -> list[str]:
    """Return the topics that a planner publishes: no commands on a dry run."""
    proofs = ['certificate'] if settings.publish_certificate else []
    if settings.dry_run:
        return [*REPORTS, *proofs]
    commands = messages.command_messages(settings, Stamp(0), stop(np.eye(settings.dimension)))
    return [*REPORTS, *proofs, *(topic for topic, _ in commands)]


def report_messages(
    settings: PlannerSettings,
    stamp: Stamp,
    decision: Decision,
    node: str,
    heard: Collection[str] | None = None,
) -> Iterator[tuple[str, Any]]:
    """Yield the messages to all receivers but the vehicle, with their topics.

    ``stamp`` is that of the answered odometry, ``node`` the name of the planner. Nothing is
    computed for topics that are not ``heard``; by default all are.
    """
    heard = outputs(settings) if heard is None else heard
    numbers = {'solve_time': 1e-3 * decision.solve_time_ms}
    if decision.plan is not None:
        numbers |= {name: getattr(decision.plan, name) for name in COSTS}
    for name in numbers:
        if f'~/{name}' in heard:
            yield f'~/{name}', Float64(data=float(numbers[name]))
    if 'tick' in heard:
        head = stamp.nanoseconds, f'{node}: tick', level(decision)
        yield 'tick', diagnostics(*head, decision.reason or decision.status, values(decision))
    if 'plan' in heard:
        yield from _plan_messages(settings, stamp, decision)
    if 'plan_markers' in heard and decision.plan is not None and decision.state is not None:
        still = settings.problem.obstacles  # hazards as well if a reserve is kept from them
        moving = tuple(each for each in decision.state.hazards if each.body not in still)
        yield 'plan_markers', plan_markers(stamp, settings.problem, decision.plan, moving)
    if 'certificate' in heard:  # of the plan's bound; of infeasibility, or of no earlier catch
        case, plan, proofs = decision.case, decision.plan, [decision.refutation]
        if case and plan and plan.proof.tree and plan.proof.lower_bound > 0.0:
            proofs.insert(0, certificate_of(*case.parts, plan.proof))
        for proof in filter(None, proofs):
            yield 'certificate', UInt8MultiArray(data=array('B', text_of(proof).encode()))


def _plan_messages(
    settings: PlannerSettings, stamp: Stamp, decision: Decision
) -> Iterator[tuple[str, Any]]:
    """Yield the plan, or what the safe command leads to if others avoid this vehicle."""
    flown: Iterable[tuple[Array, Array]] = ()
    if decision.plan is not None:
        flown = zip(decision.plan.positions, decision.plan.projected, strict=True)
    elif settings.avoid and decision.state is not None:
        flown = obeyed(settings.problem, decision.state, decision.command)
    if poses := [messages.pose(place, stamp.frames.own(turned)) for place, turned in flown]:
        step, after = (decision.problem or settings.problem).step, decision.advanced + decision.led
        yield 'plan', messages.path_message(stamp, step, poses, after)


def obeyed(problem: Problem, state: State, command: Command) -> list[tuple[Array, Array]]:
    """Return N + 1 positions and attitudes of a vehicle under one command for a horizon."""
    late = problem.rotation_order - 1  # at rotation order 2, it turns from the second step on
    turned = np.maximum(0.0, np.arange(problem.horizon + 1.0) - late) * problem.step
    attitudes = state.attitude @ np.array([exp(time * command.body_rate) for time in turned])
    fractions = np.full(problem.horizon + 1, command.speed_fraction)
    fractions[0] = min(1.0, float(np.linalg.norm(state.rotation[:, 0])))
    positions, _ = translation_rollout(problem, state, fractions[:, None] * attitudes[:, :, 0])
    return list(zip(positions, attitudes, strict=True))


BRISK = 2.0 * math.pi  # [rad/s] one turn per second: larger numbers are probably degrees
DEFAULTS = {spec.name: spec.default for spec in PLANNER}


def summary(settings: PlannerSettings, simulated: bool) -> str:
    """Return a one-line summary of vehicle and task; ``simulated`` time comes from /clock.

    It has limits, and influences that the vehicle cannot counteract, in units that people use.
    """
    problem, response, gravity = settings.problem, settings.response, settings.gravity
    thrust, kind = problem.translation_order == 2, settings.safe_command
    unit, least = 'm/s^2' if thrust else 'm/s', problem.least_speed * problem.forward
    rate, tilt, slope = np.degrees([problem.max_rate, problem.tilt, problem.glide_slope])
    hover = f'hovers at {gravity / problem.forward:.3g} of its thrust'
    if least > gravity:
        hover = f'cannot hover: its least thrust is {least:.4g}'
    disturbance, wind = settings.disturbance, settings.disturbance.copy()
    wind[-1] += gravity
    speed = float(np.linalg.norm(wind))
    needed = math.degrees(math.atan2(math.hypot(*disturbance[:2]), -disturbance[-1]))
    every = 'step' if settings.period == problem.step else f'{settings.period:g} s'
    planned = 'at each odometry' if settings.trigger == 'odom' else f'every {every}'
    ageing = f'goals stale after {settings.goal_timeout:g} s'
    if not settings.hand_sent_expire:
        ageing += ' once they stream'
    if gravity and kind in ('stop', 'hold_rate_zero'):
        kind += ' although the vehicle then falls'
    elif problem.floor.exists and kind == 'stop' and not thrust:
        kind += ' although that is below the floor'
    parts = {
        f'{problem.forward:g} {unit}': True,
        f'{settings.mass:g} kg': thrust,
        f'at least {least:.4g} {unit} ({problem.floor})': problem.floor.exists,
        f'at most {rate:.4g} deg/s': rate,
        f'at most {problem.max_acceleration:.4g} m/s^2': problem.max_acceleration,
        f'tilted by at most {tilt:.4g} deg': tilt,
        f'above a glide slope of {slope:.4g} deg': slope,
        f'gravity {gravity:g} {unit}: {hover}': gravity,
        f'sent as {settings.hover_thrust:g} on thrust': settings.hover_thrust,
        f'wind ({", ".join(f"{each:.4g}" for each in wind)}) {unit}': speed,
        f'{speed:.4g} {unit} in all: too much to stay at a goal': speed >= problem.forward,
        f'staying at a goal takes a tilt of {needed:.4g} deg: more than allowed':
            speed and needed > tilt > 0.0,
        'velocities in the world frame': settings.frames.velocity == 'world',
        'odometry through the air': settings.velocity_source == 'air',
        'with sideslip': settings.sideslip,
        f'{problem.step:g} s x {problem.horizon}': True,
        'integrated exactly': problem.discretisation == 'exact',
        f'{problem.dimension}D': True,
        f'rotation order {problem.rotation_order}': True,
        f'translation order {problem.translation_order}': True,
        f'planned {planned}': True,
        f'lags {response.speed:g} s (speed), {response.rate:g} s (rate)': response.lags,
        'disturbance estimated': settings.estimated,
        'time of /clock' if simulated else 'system time': True,
        'goals never stale' if settings.given_goal_timeout < 0.0 else ageing: True,
        f'safe command {kind}': True,
        'dry run: sends no commands': settings.dry_run,
        'sends no commands until engaged': settings.gated,
    }  # fmt: skip
    return ', '.join(text for text, holds in parts.items() if holds)


def doubts(settings: PlannerSettings, given: Mapping[str, Any]) -> list[str]:
    """Return warnings about settings that are allowed but probably unintended.

    ``given`` are the values given at the start, by parameter.
    """
    problem, floor = settings.problem, settings.problem.floor
    rate, ahead = problem.max_rate, problem.horizon * problem.step
    turned = math.degrees(ahead * rate)
    needed = np.ceil(math.pi / max(problem.step * rate, 1e-300))
    warnings = {
        f'max_rate is {rate:g} rad/s, {math.degrees(rate):.4g} deg/s: '
        f'{math.radians(rate):.4g} rad/s if {rate:g} deg/s is meant': rate > BRISK,
        'max_rate is not given: commands may turn by half a turn in a step; give the largest '
        'body rate that the autopilot allows [rad/s], or 0.0 for none':
            settings.thrust_axis == 'z' and problem.inertial and 'max_rate' not in given,
        'response.speed and response.rate are not given: the vehicle is taken to respond a '
        'step late; one that responds at once misses its goal by far: give lags, such as 0.001 '
        '[s], and discretisation exact':
            problem.rotation_order == 2 and not {'response.speed', 'response.rate'} & given.keys(),
        # Interception plans beyond the horizon.
        f'within {ahead:.4g} s of horizon the vehicle turns by at most {turned:.4g} deg: it may '
        f'never turn round to a goal behind it; half a turn takes a horizon of {needed:.7g}':
            settings.objective == 'track' and problem.turns_are_angles and turned < 180.0,
    }  # fmt: skip
    for name, used, beside in (
        ('approach.cone', settings.approach.exists, f'objective {settings.objective}'),
        ('floor.fraction', 'fraction' in floor.parameters, f'floor.shape {floor.shape}'),
        ('floor.faces', 'faces' in floor.parameters, f'floor.shape {floor.shape}'),
    ):
        value = given.get(name, DEFAULTS[name])
        odd = not used and value != DEFAULTS[name]
        warnings[f'{name} {value:g} has no effect with {beside}'] = odd
    return [text for text, holds in warnings.items() if holds]
