# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Fallbacks where there is no new plan: a clear way among hazards, or the safe command.

Without a floor ``max_rate`` bounds chords, and at a low speed a short chord is a wide angle: a plan
may pass a body by a turn that is cut when it is flown. So each plan is *steered*: its headings are
followed as fast as the vehicle turns. Where its first steps then meet a hazard, a clear way that
takes no search is flown instead; without any plan, the clearest of these ways.

Mathematics: docs/mathematics.md, 7.7 and 7.12.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain
from operator import attrgetter

import numpy as np

from orbimpc_ros.loop.task import Task
from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.check import holds
from orbimpc_ros.mpc.clearance import clearances
from orbimpc_ros.mpc.geometry.rotations import coordinates, exp
from orbimpc_ros.mpc.plan import UNPROVED, Command, Plan, Proof, assemble, stop
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.pace import moved_towards
from orbimpc_ros.mpc.solve.stand_ins import in_time, straight, turning

SURE_STEPS = 4  # of a steered plan, that have to be clear
TOUCHING = 1e-6  # of a step's length
SAME = 1e-2  # of a step's length: ways that differ by less stay out as far
SAFE_COMMANDS = ('auto', 'stop', 'hold_rate_zero', 'loiter', 'hover')
CIRCLE_STEPS = 16  # a loitering vehicle closes its circle in so many steps


def is_clear(task: Task, plan: Plan) -> bool:
    """Return whether the first steps of a checked plan stay clear of hazards with turns cut."""
    if not cuts_turns(task.problem):
        return True
    return _suffices(task.problem, _room(task, plan, SURE_STEPS))


def cheapest_clear(task: Task, plans: Iterable[Plan]) -> Plan | None:
    """Return the cheapest of some plans that pass their check and are clear; None if none is."""
    for each in sorted(plans, key=attrgetter('objective')):
        if holds(*task.known, each) and is_clear(task, each):
            return each
    return None


def clear_instead(task: Task, plan: Plan) -> Plan:
    """Return the cheapest way that is clear when steered instead of a plan that is not.

    Where none is, that way or plan whose first steps stay the farthest out of hazards. The bound of
    the plan holds for what takes its place.
    """
    ways = [*_ways(task, plan.proof)]
    found = cheapest_clear(task, ways)
    if found is not None:
        return found
    sound = [each for each in ways if holds(*task.known, each)]
    return max([*sound, plan], key=lambda each: _room(task, each, SURE_STEPS))


def clearest(task: Task) -> tuple[Plan | None, float]:
    """Return the way that stays out of hazards the most, and how far outside of them it is [m].

    Of ways that meet all else: the rest of the plan before, straight ones and turns to all sides;
    None if none does. The longest clear comes first, since what is met late can still be passed by
    a later plan. From inside of a hazard all ways are as far out as their start: then where they
    end decides.
    """
    problem, alone = task.problem, replace(task, state=replace(task.state, hazards=()))
    rest = [] if task.rest is None else [replace(task.rest, proof=UNPROVED)]
    found = [
        (_room(task, each, problem.horizon), each)
        for each in chain(rest, _ways(task, UNPROVED))
        if holds(*alone.known, each)
    ]
    if not found:
        return None, 0.0
    if not any(_suffices(problem, room) for room, _ in found):
        lasting = [_clear_steps(task, each) for _, each in found]
        found = [each for each, n in zip(found, lasting, strict=True) if n == max(lasting)]
    unit = SAME * problem.length_unit
    room, plan = max(found, key=lambda each: (round(each[0] / unit), _end(task, each[1])))
    return plan, room


def _clear_steps(task: Task, plan: Plan) -> int:
    """Return how many of a plan's first steps are clear of hazards."""
    steps = range(1, plan.horizon + 1)
    return bisect_left(steps, True, key=lambda n: not _suffices(task.problem, _room(task, plan, n)))


def _suffices(problem: Problem, room: float) -> bool:
    """Return whether a distance out of hazards [m] counts as clear of them."""
    return room >= -TOUCHING * problem.length_unit


def _end(task: Task, plan: Plan) -> float:
    """Return how far outside of hazards a plan ends [m]."""
    over, place = np.array([task.problem.step * plan.horizon]), plan.positions[-1:]
    return min(-float(each.body.depth(place - each.moved(over))[0]) for each in task.state.hazards)


def _ways(task: Task, proof: Proof) -> Iterator[Plan]:
    """Yield plans that take no search, held against a proof; turns first, which lead aside."""
    for rotations in in_time(chain(turning(*task.known), straight(*task.known)), task.late):
        x = coordinates(rotations)
        yield assemble(*task.known, x, projection=task.projection, proof=proof)


def _room(task: Task, plan: Plan, steps: int) -> float:
    """Return how far outside of hazards the first steps of a plan are when it is steered [m]."""
    steps, (problem, state, goals) = min(steps, plan.horizon), task.known
    part, x = replace(problem, horizon=steps), coordinates(plan.rotations[1 : steps + 1])
    if cuts_turns(problem):
        x = _steered(problem, state, x)
    begun = assemble(part, state, goals[:steps], x, projection=plan.projection, proof=UNPROVED)
    return min(clearances(part, state, begun).values())


def cuts_turns(problem: Problem) -> bool:
    """Return whether commands may turn less than plans of a problem, in the plane."""
    planar = problem.dimension == 2 and problem.rotation_order == 1
    return planar and problem.max_rate > 0.0 and not problem.turns_are_angles


def _steered(problem: Problem, state: State, x: Array) -> Array:
    """Return headings followed by turns that the vehicle can make, shape (N, 2); (7.2a)."""
    widest, followed = problem.max_rate * problem.step, np.zeros_like(x)
    angle = math.atan2(state.attitude[1, 0], state.attitude[0, 0])
    for k, (along, aside) in enumerate(x.tolist()):
        size = math.hypot(along, aside)
        wanted = math.remainder(math.atan2(aside, along) - angle, 2.0 * math.pi) if size else 0.0
        turn = min(max(wanted, -widest), widest)
        angle += turn
        share = size * max(0.0, math.cos(wanted - turn))
        followed[k] = share * math.cos(angle), share * math.sin(angle)
    return followed


def decided(kind: str, problem: Problem, gravity: float = 0.0) -> str:
    """Return the kind of safe command that ``auto`` stands for, and any other kind as it is.

    A vehicle with a minimum speed circles. A minimum thrust does not make it circle: stopping the
    engine is then what coasting is. Under gravity [m/s^2] that is to fall: there it hovers.
    """
    if kind != 'auto':
        return kind
    if gravity and problem.inertial:
        return 'hover'
    floored = problem.floor.exists and not problem.inertial
    return 'loiter' if floored else 'stop'


def may_stop(kind: str, problem: Problem) -> bool:
    """Return whether the safe command may be below the floor: as it was asked for, or coasts."""
    return decided(kind, problem) == 'stop' or problem.inertial


def safe_command(
    kind: str,
    problem: Problem,
    attitude: Array,
    fraction: float,
    disturbance: Array | None = None,
) -> Command:
    """Return a safe command.

    Args:
        kind: ``auto``: as :func:`decided`; ``stop``: no speed or thrust, no turning;
            ``hold_rate_zero``: the present speed, at least the floor, no turning (translation order
            2: to coast); ``loiter``: a level circle at the least speed, or at full speed without a
            floor, to which the speed changes as ``max_acceleration`` allows; ``hover`` (order 2):
            the thrust that :func:`carrying` has, no turning.
        problem: gives floor and limits.
        attitude: the present one, shape (n, n).
        fraction: share of full speed commanded last, in [0, 1].
        disturbance: the acceleration to hover against, shape (n,) [m/s^2]; None for none.
    """
    kind = decided(kind, problem)
    if kind == 'stop':  # at once: what brakes does so as fast as it can
        return stop(attitude)
    rate = np.zeros(1 if problem.dimension == 2 else 3)
    least = problem.least_speed
    if kind == 'hover':
        carried = 0.0 if disturbance is None else carrying(problem, attitude, disturbance)
        return Command(max(carried, least), rate, np.array(attitude))
    if kind == 'hold_rate_zero':
        kept = max(fraction, least) if not problem.inertial else 0.0
        return Command(kept, rate, np.array(attitude))
    circling = 2.0 * math.pi / (CIRCLE_STEPS * problem.step)
    rate[-1] = min(circling, problem.max_rate) if problem.max_rate > 0.0 else circling
    circled = problem.floor.circling(problem.dimension)
    told = moved_towards(problem, entry_of_safety(problem, fraction), circled)
    return Command(told, rate, attitude @ exp(problem.step * rate))


def entry_of_safety(problem: Problem, fraction: float) -> float:
    """Return the share of full speed that the change by a safe command counts from.

    That commanded last, or what every heading has at least with a floor: up to it, at once.
    """
    if not problem.floor.exists:
        return fraction
    return max(fraction, problem.floor.circling(problem.dimension))


def carrying(problem: Problem, attitude: Array, acceleration: Array) -> float:
    """Return the share of full thrust that carries a vehicle against an acceleration, in [0, 1].

    Not turned, since the attitude may not be measured any more: so much thrust that along the
    acceleration, shape (n,) [m/s^2], nothing is left. Tilted so far that full thrust would not do
    that, as much as leaves the least acceleration altogether.
    """
    weight = float(np.linalg.norm(acceleration))
    if weight == 0.0:
        return 0.0
    upright = -float(acceleration @ attitude[:, 0]) / weight
    if problem.forward * upright >= weight:
        return weight / (problem.forward * upright)
    return max(0.0, weight * upright / problem.forward)
