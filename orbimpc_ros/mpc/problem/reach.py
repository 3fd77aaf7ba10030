# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The reach of a horizon and of a step, and explanations of infeasibility that are cheap to find.

Mathematics: docs/mathematics.md, 3.10, 5.2, 7.5.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import TypeVar

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.model.translation import STARTED
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.obstacle import reserves

SURE = 1e-12  # relative margin for rounding: farther away is surely out of reach
WITHIN = 1.0 - 1e-9  # share of the largest change of speed, so that rounding does not exceed it
T = TypeVar('T', float, Array)
BEYOND = 100.0  # times the reach: goals farther away are moved to this distance


def decided(problem: Problem, state: State) -> tuple[Array, Array]:
    """Return s_0..s_N and p_0..p_N for R_1 e1 = .. = R_N e1 = 0: what the state alone decides."""
    maps, given = problem.maps, np.zeros((problem.horizon + 3, problem.dimension))
    given[STARTED] = state.rotation[:, 0], state.velocity, state.disturbance
    return maps.places @ given + state.position, maps.speeds @ given


def reach(problem: Problem, state: State) -> float:
    """Return an upper bound of the distance reached within the horizon [m]."""
    blown = math.sqrt(state.disturbance @ state.disturbance)
    speed = math.sqrt(state.velocity @ state.velocity)
    return farthest(problem, speed, blown, problem.horizon * problem.step)


def farthest(problem: Problem, speed: float, blown: float, time: T) -> T:
    """Return an upper bound of the distance reached within a time, or within each of times [m].

    Args:
        problem: gives the full speed or thrust, and whether the vehicle is inertial.
        speed: at the start, used for inertial vehicles only [m/s].
        blown: size of the disturbance [m/s] or [m/s^2].
        time: from the start [s].
    """
    fastest = problem.forward + blown
    if not problem.inertial:
        return fastest * time
    return speed * time + 0.5 * fastest * time**2


def clear_of_hazards(problem: Problem, state: State) -> State:
    """Return the state, without hazards if none of them can be met within the horizon."""
    end, far = problem.step * problem.horizon, reach(problem, state)
    kept = reserves(state.hazards, problem.horizon, problem.step).max(axis=1, initial=0.0)
    for hazard, reserve in zip(state.hazards, kept.tolist(), strict=True):
        moved = hazard.moved(np.append(hazard.turns[hazard.turns < end], end))
        nearest = -float(hazard.body.depth(state.position[None])[0])
        if nearest <= far + reserve + float(np.linalg.norm(moved, axis=1).max()):
            return state
    return replace(state, hazards=())


def clamp_goal(problem: Problem, state: State, goals: Array) -> tuple[Array, str]:
    """Return goals moved to within ``BEYOND`` times the reach, and a message if any was moved.

    The cost of a goal at distance d is of the order of d^2, cost differences between plans of the
    order of d: for distant goals every plan would count as optimal within a relative gap. Goals of
    a terminal constraint are left alone: the solver proves that it cannot be met.

    Args:
        problem: gives the reach.
        state: where the plan starts.
        goals: g_1..g_N, shape (N, n) [m].
    """
    away = goals - state.position
    largest = BEYOND * reach(problem, state)
    distances = np.sqrt(np.einsum('kc,kc->k', away, away))
    farthest = distances.max(initial=0.0)
    if farthest <= largest or problem.terminal == 'constraint':
        return goals, ''
    shares = np.minimum(1.0, largest / np.maximum(distances, largest))
    told = f'the goal is {farthest:.3g} m away: planned to {largest:.3g} m towards it'
    return sealed(state.position + shares[:, None] * away), told


def held_goal(problem: Problem, state: State, goals: Array) -> str:
    """Return a message naming the bodies that contain the goal at every step; empty if none does.

    Args:
        problem: gives the obstacles.
        state: gives the hazards.
        goals: g_1..g_N, shape (N, n) [m].
    """
    times = problem.step * np.arange(1, len(goals) + 1)
    still = {f'obstacle {i}': body.depth(goals) for i, body in enumerate(problem.obstacles)}
    moving = {f'hazard {i}': each.depth(goals, times) for i, each in enumerate(state.hazards)}
    held = [name for name, deep in (still | moving).items() if (deep > 0.0).all()]
    return f'the goal is inside of {" and ".join(held)}' if held else ''


def reason(problem: Problem, state: State, goals: Array) -> str:
    """Return the reason why a problem is infeasible, as far as it can be found cheaply.

    Args:
        problem: proved infeasible.
        state: where plans start.
        goals: g_1..g_N, shape (N, n) [m].
    """
    found = [*_boxed_in(problem, state)]
    beyond = beyond_reach(problem, state, goals)
    if beyond > 0.0:
        asked = f'terminal: constraint asks for a goal {beyond:.4g} m beyond'
        found.insert(0, f'{asked} what {problem.horizon} steps can reach')
    if found:
        return '; '.join(found)
    together = ', '.join(constraints_in_force(problem, state)) or 'the dynamics'
    return f'no trajectory satisfies {together}'


def constraints_in_force(problem: Problem, state: State) -> list[str]:
    """Return the names of the constraints other than the dynamics and the orbitope."""
    floor = problem.floor
    named = {
        'terminal: constraint': problem.terminal == 'constraint',
        f'the {floor.shape} floor of {floor.fraction:.4g}': floor.exists,
        f'max_rate {problem.max_rate:.4g}': problem.max_rate > 0.0,
        f'max_acceleration {problem.max_acceleration:.4g}': problem.max_acceleration > 0.0,
        f'{len(problem.obstacles)} obstacles': bool(problem.obstacles),
        f'{len(state.hazards)} hazards': bool(state.hazards),
        f'tilt {problem.tilt:.4g}': problem.tilt > 0.0,
        f'glide_slope {problem.glide_slope:.4g}': problem.glide_slope > 0.0,
        f'approach.cone {problem.approach.cone:.4g}': problem.approach.exists,
    }
    return [name for name, in_force in named.items() if in_force]


def beyond_reach(problem: Problem, state: State, goals: Array) -> float:
    """Return the distance of a terminal constraint beyond reach [m]; < 0 within reach.

    The reach is measured from the coasting position, with full thrust in one direction.
    """
    return (
        float(_beyond(problem, state, goals)[-1]) if problem.terminal == 'constraint' else -np.inf
    )


def _beyond(problem: Problem, state: State, goals: Array) -> Array:
    """Return the distances of goals beyond the reach of all headings, shape (N,) [m] (7.10b)."""
    off, reach = goals - decided(problem, state)[0][1:], problem.maps.reach
    return np.asarray(np.sqrt(np.einsum('kc,kc->k', off, off)) - np.abs(reach[:, 1:]).sum(axis=1))


def missed(problem: Problem, state: State, goals: Array, radius: Array | float) -> np.ndarray:
    """Return for which k no headings lead s_k to within a radius of the goal, shape (..., N).

    True is certain, in spite of rounding.

    Args:
        problem: gives the model.
        state: where the vehicle starts.
        goals: g_1..g_N, shape (N, n) [m].
        radius: of a catch, or several, shape (..., 1) [m].
    """
    sizes = np.abs(state.position).sum() + np.abs(goals).sum(axis=1)
    rounding = SURE * (problem.maps.unit * (1.0 + len(goals) ** 2) + sizes + radius)
    return np.asarray(_beyond(problem, state, goals) > radius + rounding)


def beyond_turning(problem: Problem, state: State) -> float:
    """Return the angle of the cone of approach beyond the largest turn [rad]; < 0 within reach."""
    limited = problem.turns_are_angles and not problem.first_turn_is_decided
    if not (limited and problem.approach.exists):
        return -np.inf
    ahead = float(np.clip(state.attitude[:, 0] @ problem.approach.axis(state), -1.0, 1.0))
    turned = problem.horizon * problem.widest_turn
    return math.acos(ahead) - turned - problem.approach.cone


def _boxed_in(problem: Problem, state: State) -> Iterator[str]:
    """Yield messages about bodies that contain s_k for all headings."""
    reached, reach = decided(problem, state)[0][1:], problem.maps.reach
    known, free = problem.decided_steps, reach[:, 1:].sum(axis=1)
    for i, body in enumerate(problem.obstacles):
        deep = body.depth(reached)
        held = np.flatnonzero(deep > free)
        if not held.size:
            continue
        if held[0] < known:
            why = 'which the state already determines'
        else:
            why = f'{deep[held[0]]:.4g} m inside; plans move that by at most {free[held[0]]:.4g} m'
        yield f'obstacle {i} contains s_{held[0] + 1}, {why}'
    for i, hazard in enumerate(state.hazards):
        times = problem.step * np.arange(1, known + 1)
        inside = np.flatnonzero(hazard.depth(reached[:known], times) > 0.0)
        if inside.size:
            yield f'hazard {i} contains s_{inside[0] + 1}, which the state already determines'


# --- limited changes of speed


def entry_speed(problem: Problem, state: State) -> float:
    """Return the share of full speed that the first change starts from, in [0, 1].

    That is the last command, or |R_0 e1| without one, and at least the floor: a vehicle below its
    floor is commanded the least speed at once, since that keeps it in the air.
    """
    before = state.commanded
    if before is None:
        before = math.hypot(*state.rotation[:, 0].tolist())
    least = float(problem.floor.least(state.attitude[:, 0]))
    return min(1.0, max(before, least))


def first_change_is_decided(problem: Problem, state: State) -> bool:
    """Return True if the state decides |R_1 e1|: at rotation order 2 without ``coasted``."""
    return problem.rotation_order == 2 and state.coasted is None


def moved_towards(problem: Problem, before: float, wanted: float, steps: float = 1.0) -> float:
    """Return the share of full speed nearest to a wanted one among those within reach.

    Args:
        problem: gives the limit.
        before: initial share of full speed.
        wanted: share of full speed.
        steps: time available, in steps.
    """
    most = steps * problem.speed_change
    return max(before - most, min(before + most, wanted))
