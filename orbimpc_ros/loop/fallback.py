# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Fallbacks without a new plan: a clear path among hazards, or the safe command.

Without a floor, ``max_rate`` bounds chords, and at low speed a short chord spans a wide angle: a
plan may pass a body by a turn that the vehicle cannot complete. So each plan is *steered*: its
headings are followed at the vehicle's turn limit. If its first steps then meet a hazard, a clear
path found without search is flown instead; without any plan, the clearest of these paths.

Mathematics: docs/mathematics.md, 7.7 and 7.12.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from itertools import chain
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.check import holds
from orbimpc_ros.mpc.clearance import clearances
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.plan import UNPROVED, Command, Plan, Proof, assemble, followed, stop
from orbimpc_ros.mpc.problem import MAX_HAZARDS, Box, MovingObstacle, Problem
from orbimpc_ros.mpc.problem.reach import moved_towards
from orbimpc_ros.mpc.solve.stand_ins import in_time, straight, turning

if TYPE_CHECKING:  # slow to import, and the simulator, which reads these parameters, needs none
    from orbimpc_ros.mpc.solve.solver import Task

SURE_STEPS = 4  # first steps of a steered plan that must be clear
TOUCHING = 1e-6  # in units of a step's length
SAME = 1e-2  # in units of a step's length: smaller differences of distance count as equal
SAFE_COMMANDS = ('auto', 'stop', 'hold_rate_zero', 'loiter', 'hover')
CIRCLE_STEPS = 16  # steps in which a loitering vehicle completes its circle


def is_clear(task: Task, plan: Plan) -> bool:
    """Return True if the first steps of a checked plan, steered, stay clear of hazards."""
    return not _cuts_turns(task.problem) or _suffices(task, SURE_STEPS, plan)


def cheapest_clear(task: Task, plans: Iterable[Plan]) -> Plan | None:
    """Return the cheapest of the plans that pass their check and are clear, or None."""
    for each in sorted(plans, key=attrgetter('objective')):
        if holds(*task.parts, each) and is_clear(task, each):
            return each
    return None


def clear_instead(task: Task, plan: Plan) -> Plan:
    """Return the cheapest fallback path that is clear when steered, in place of a plan that is not.

    Without one, return the path or plan whose first steps keep farthest from hazards. The bound of
    the plan also holds for its replacement.
    """
    paths = [each for each in _fallback_paths(task, plan.proof) if holds(*task.parts, each)]
    farthest = partial(_room, task, SURE_STEPS)
    return cheapest_clear(task, paths) or max([*paths, plan], key=farthest)


def clearest(task: Task) -> tuple[Plan | None, float]:
    """Return the fallback path that keeps farthest from hazards, and its distance from them [m].

    Candidates meet all other constraints: the remainder of the previous plan, straight paths, and
    turns to all sides; None without any. The longest clear one comes first, since later plans can
    still avoid a later conflict. From inside a hazard, all paths are as far outside as their start;
    then the distance at their end decides.
    """
    problem, state, goals = task.parts
    alone = problem, replace(state, hazards=()), goals
    rest = [] if task.rest is None else [replace(task.rest, proof=UNPROVED)]
    paths = [each for each in chain(rest, _fallback_paths(task, UNPROVED)) if holds(*alone, each)]
    unit, over = SAME * problem.maps.unit, np.array([problem.step * problem.horizon])

    def rank(plan: Plan) -> tuple[int, int, float]:
        steps = range(1, plan.horizon + 1)
        clear = bisect_left(steps, True, key=lambda n: not _suffices(task, n, plan))
        room = round(_room(task, problem.horizon, plan) / unit)
        depths = [each.depth(plan.positions[-1:], over)[0] for each in state.hazards]
        return clear, room, -max(depths)

    best = max(paths, key=rank, default=None)
    return best, 0.0 if best is None else _room(task, problem.horizon, best)


def leaving(task: Task) -> Task | None:
    """Return the task with the boxes around the vehicle as hazards, if it is inside of any.

    A plan stays out of boxes, so that none starts deep inside; a hazard may be left.
    """
    problem, state, here = task.problem, task.state, task.state.position[None]
    boxes = (each for each in problem.obstacles if isinstance(each, Box))
    around = [each for each in boxes if each.depth(here)[0] > 0.0]
    others = tuple(each for each in problem.obstacles if each not in around)
    hazards = (*state.hazards, *map(MovingObstacle.drifting, around))[-MAX_HAZARDS:]
    problem, state = replace(problem, obstacles=others), replace(state, hazards=hazards)
    return replace(task, problem=problem, state=state) if around else None


def _suffices(task: Task, steps: int, plan: Plan) -> bool:
    """Return True if the first steps of a plan, when steered, count as clear of hazards."""
    return _room(task, steps, plan) >= -TOUCHING * task.problem.maps.unit


def _fallback_paths(task: Task, proof: Proof) -> Iterator[Plan]:
    """Yield plans found without search, given a proof of their bound; turns first, which evade."""
    for x in in_time(chain(turning(*task.parts), straight(*task.parts)), task.late):
        yield assemble(*task.parts, x, projection=task.projection, proof=proof)


def _room(task: Task, steps: int, plan: Plan) -> float:
    """Return the distance of the first steps of a plan, when steered, from hazards [m]."""
    steps, (problem, state, goals) = min(steps, plan.horizon), task.parts
    part, x = replace(problem, horizon=steps), plan.x[1 : steps + 1]
    if _cuts_turns(problem):
        x = followed(problem, state, x)
    begun = assemble(part, state, goals[:steps], x, projection=plan.projection, proof=UNPROVED)
    return min(clearances(part, state, begun).values())


def _cuts_turns(problem: Problem) -> bool:
    """Return True if commands in the plane may turn less than the plans of a problem."""
    planar = problem.dimension == 2 and problem.rotation_order == 1
    return planar and problem.max_rate > 0.0 and not problem.turns_are_angles


def decided(kind: str, problem: Problem, gravity: float = 0.0) -> str:
    """Return the kind of safe command that ``auto`` selects; return other kinds unchanged.

    A vehicle with a minimum speed circles. One with a minimum thrust does not: stopping its engine
    means coasting. Under gravity [m/s^2], coasting means falling, and the vehicle hovers instead.
    """
    if kind != 'auto':
        return kind
    if gravity and problem.inertial:
        return 'hover'
    return 'loiter' if problem.floor.exists and not problem.inertial else 'stop'


def may_stop(kind: str, problem: Problem) -> bool:
    """Return True if the safe command may be below the floor: it stops, or the vehicle coasts."""
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
        kind: ``auto``: see :func:`decided`; ``stop``: no speed or thrust, no turning;
            ``hold_rate_zero``: the present speed, at least the floor, no turning (translation order
            2: coasting); ``loiter``: a level circle at the least speed, or at full speed without a
            floor, to which the speed changes as ``max_acceleration`` allows; ``hover`` (order 2):
            the thrust of :func:`carrying`, no turning.
        problem: source of floor and limits.
        attitude: the present one, shape (n, n).
        fraction: last commanded share of full speed, in [0, 1].
        disturbance: acceleration to hover against, shape (n,) [m/s^2]; None for zero.
    """
    kind = decided(kind, problem)
    if kind == 'stop':  # without limit: a braking vehicle decelerates as fast as it can
        return stop(attitude)
    rate = np.zeros(1 if problem.dimension == 2 else 3)
    least = problem.least_speed
    if kind == 'hover':
        carried = 0.0 if disturbance is None else carrying(problem, attitude, disturbance)
        return Command(max(carried, least), rate, np.array(attitude))
    if kind == 'hold_rate_zero':
        kept = max(fraction, least) if not problem.inertial else 0.0
        return Command(kept, rate, np.array(attitude))
    rate[-1] = min(2.0 * math.pi / (CIRCLE_STEPS * problem.step), problem.max_rate or math.inf)
    circled = problem.floor.circling(problem.dimension)
    share = moved_towards(problem, entry_of_safety(problem, fraction), circled)
    return Command(share, rate, attitude @ exp(problem.step * rate))


def entry_of_safety(problem: Problem, fraction: float) -> float:
    """Return the share of full speed from which a safe command changes the speed.

    It is the last commanded share; with a floor, at least the share allowed in all headings.
    """
    if not problem.floor.exists:
        return fraction
    return max(fraction, problem.floor.circling(problem.dimension))


def carrying(problem: Problem, attitude: Array, acceleration: Array) -> float:
    """Return the share of full thrust that supports a vehicle against an acceleration, in [0, 1].

    The attitude is kept, since it may no longer be measured. The thrust cancels the acceleration,
    shape (n,) [m/s^2], along its own direction. If the tilt is too large for that even at full
    thrust, the total remaining acceleration is minimised instead.
    """
    weight = float(np.linalg.norm(acceleration))
    if weight == 0.0:
        return 0.0
    upright = -float(acceleration @ attitude[:, 0]) / weight
    if problem.forward * upright >= weight:
        return weight / (problem.forward * upright)
    return min(max(0.0, weight * upright / problem.forward), 1.0)
