# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The reach of a horizon and of a step, and explanations of infeasibility that are cheap to find.

``goals`` are g_1..g_N, shape (N, n) [m], and plans start from ``state``.

Mathematics: docs/mathematics.md, 3.10, 5.2, 7.5.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import TypeVar

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.model.dynamics import translation_rollout
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.obstacle import reserves

SURE = 1e-12  # relative margin for rounding: farther away is surely out of reach
WITHIN = 1.0 - 1e-9  # share of the largest change of speed, so that rounding does not exceed it
BEYOND = 100.0  # times the reach: goals farther away are moved to this distance
LIMITS = 'max_rate', 'max_acceleration', 'tilt', 'glide_slope'  # fields that are 0 for no limit
T = TypeVar('T', float, Array)


def decided(problem: Problem, state: State) -> tuple[Array, Array]:
    """Return s_0..s_N and p_0..p_N for R_1 e1 = .. = R_N e1 = 0: what the state alone decides."""
    ahead = np.outer(np.eye(problem.horizon + 1)[0], state.rotation[:, 0])
    return translation_rollout(problem, state, ahead)


def reach(problem: Problem, state: State) -> float:
    """Return an upper bound of the distance reached within the horizon [m]."""
    blown = math.sqrt(state.disturbance @ state.disturbance)
    speed = math.sqrt(state.velocity @ state.velocity)
    return farthest(problem, speed, blown, problem.horizon * problem.step)


def farthest(problem: Problem, speed: float, blown: float, time: T) -> T:
    """Return an upper bound of the distance reached within a time [s], or each of times [m].

    The ``speed`` at the start [m/s] counts for inertial vehicles only; ``blown`` is the size of the
    disturbance [m/s] or [m/s^2].
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
    """
    away = goals - state.position
    largest = BEYOND * reach(problem, state)
    distances = np.sqrt(np.einsum('kc,kc->k', away, away))
    farthest = distances.max(initial=0.0)
    if farthest <= largest or problem.terminal == 'constraint':
        return goals, ''
    shares = np.minimum(1.0, largest / np.maximum(distances, largest))
    message = f'the goal is {farthest:.3g} m away: planned to {largest:.3g} m towards it'
    return sealed(state.position + shares[:, None] * away), message


def held_goal(problem: Problem, state: State, goals: Array) -> str:
    """Return a message naming the bodies around the goal at every step; empty if there are none."""
    held = [name for name, deep in depths(problem, state, goals).items() if (deep > 0.0).all()]
    return f'the goal is inside of {" and ".join(held)}' if held else ''


def depths(problem: Problem, state: State, places: Array, first: int = 1) -> dict[str, Array]:
    """Return how deep s_first.., shape (K, n), are inside of each body, shape (K,) [m]."""
    times = problem.step * np.arange(first, first + len(places))
    still = {f'obstacle {i}': body.depth(places) for i, body in enumerate(problem.obstacles)}
    moving = {f'hazard {i}': each.depth(places, times) for i, each in enumerate(state.hazards)}
    return still | moving


def reason(problem: Problem, state: State, goals: Array) -> str:
    """Return the reason why a problem is infeasible, as far as it can be found cheaply."""
    reasons = [*_boxed_in(problem, state)]
    beyond = beyond_reach(problem, state, goals)
    if beyond > 0.0:
        clause = f'terminal: constraint asks for a goal {beyond:.4g} m beyond'
        reasons.insert(0, f'{clause} what {problem.horizon} steps can reach')
    if reasons:
        return '; '.join(reasons)
    together = ', '.join(constraints_in_force(problem, state)) or 'the dynamics'
    return f'no trajectory satisfies {together}'


def constraints_in_force(problem: Problem, state: State) -> list[str]:
    """Return the names of the constraints other than the dynamics and the orbitope."""
    limits = {f'the {problem.floor.shape} floor of': problem.least_speed}
    limits |= {name: getattr(problem, name) for name in LIMITS}
    limits['approach.cone'] = problem.approach.cone
    counts = {'obstacles': len(problem.obstacles), 'hazards': len(state.hazards)}
    return [
        *(['terminal: constraint'] if problem.terminal == 'constraint' else []),
        *(f'{name} {value:.4g}' for name, value in limits.items() if value),
        *(f'{count} {name}' for name, count in counts.items() if count),
    ]


def beyond_reach(problem: Problem, state: State, goals: Array) -> float:
    """Return the distance of a terminal constraint beyond reach [m]; < 0 within reach.

    The reach is measured from the coasting position, with full thrust in one direction.
    """
    arrives = problem.terminal == 'constraint'
    return float(_beyond(problem, state, goals)[-1]) if arrives else -math.inf


def _beyond(problem: Problem, state: State, goals: Array) -> Array:
    """Return the distances of goals beyond the reach of all headings, shape (N,) [m] (7.10b)."""
    off, reach = goals - decided(problem, state)[0][1:], problem.maps.reach
    return np.asarray(np.sqrt(np.einsum('kc,kc->k', off, off)) - np.abs(reach[:, 1:]).sum(axis=1))


def missed(problem: Problem, state: State, goals: Array, radius: Array | float) -> np.ndarray:
    """Return for which k no headings lead s_k to within a radius of the goal, shape (..., N).

    True is certain, in spite of rounding. There may be several radii, shape (..., 1) [m].
    """
    sizes = np.abs(state.position).sum() + np.abs(goals).sum(axis=1)
    rounding = SURE * (problem.maps.unit * (1.0 + len(goals) ** 2) + sizes + radius)
    return np.asarray(_beyond(problem, state, goals) > radius + rounding)


def beyond_turning(problem: Problem, state: State) -> float:
    """Return the angle of the cone of approach beyond the largest turn [rad]; < 0 within reach."""
    if not (problem.turned_cones and problem.approach.exists):
        return -np.inf
    ahead = float(np.clip(state.attitude[:, 0] @ problem.approach.axis(state), -1.0, 1.0))
    turned = problem.horizon * problem.widest_turn
    return math.acos(ahead) - turned - problem.approach.cone


def _boxed_in(problem: Problem, state: State) -> Iterator[str]:
    """Yield messages about bodies that contain s_k for all headings."""
    free = problem.maps.reach[:, 1:].sum(axis=1)
    for name, deep in depths(problem, state, decided(problem, state)[0][1:]).items():
        held = np.flatnonzero(deep > free)
        if not held.size:
            continue
        why, first = 'which the state already determines', int(held[0])
        if first >= problem.decided_steps:
            why = f'{deep[first]:.4g} m inside; plans move that by at most {free[first]:.4g} m'
        yield f'{name} contains s_{first + 1}, {why}'


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
    """Return the share of full speed nearest to a wanted one within reach of ``before``."""
    most = steps * problem.speed_change
    return max(before - most, min(before + most, wanted))
