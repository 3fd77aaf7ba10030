# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The reach of a horizon, and goals that no plan gets to: too far away, or inside of something.

Mathematics: docs/mathematics.md, 7.5.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.obstacle import reserves

BEYOND = 100.0  # times the reach: goals farther away are pulled in to there


def reach(problem: Problem, state: State) -> float:
    """Return a distance that no point within the horizon exceeds [m]."""
    blown = math.sqrt(state.disturbance @ state.disturbance)
    speed = math.sqrt(state.velocity @ state.velocity)
    return farthest(problem, speed, blown, problem.horizon * problem.step)


def farthest(problem: Problem, speed: float, blown: float, time: float) -> float:
    """Return a distance that no point within a time exceeds [m].

    Args:
        problem: gives the full speed or thrust, and whether the vehicle coasts.
        speed: at the start, which counts if it does [m/s].
        blown: size of the disturbance [m/s] or [m/s^2].
        time: from the start [s].
    """
    fastest = problem.forward + blown
    if not problem.inertial:
        return fastest * time
    return speed * time + 0.5 * fastest * time**2


def clear_of_hazards(problem: Problem, state: State) -> State:
    """Return a state without its hazards, if the vehicle can meet none of them in the horizon."""
    end, far = problem.step * problem.horizon, reach(problem, state)
    kept = reserves(state.hazards, problem.horizon, problem.step).max(axis=1, initial=0.0)
    for hazard, reserve in zip(state.hazards, kept.tolist(), strict=True):
        moved = hazard.moved(np.append(hazard.turns[hazard.turns < end], end))
        nearest = -float(hazard.body.depth(state.position[None])[0])
        if nearest <= far + reserve + float(np.linalg.norm(moved, axis=1).max()):
            return state
    return replace(state, hazards=())


def clamp_goal(problem: Problem, state: State, goals: Array) -> tuple[Array, str]:
    """Return goals no farther away than counts, and what was done about them in words, if anything.

    The cost of a goal at distance d is of the order of d^2, and what plans differ by of the order
    of d: far out every plan would count as proved optimal within a relative gap. A terminal
    constraint is left alone: it cannot be met, which the solver proves.

    Args:
        problem: gives the reach.
        state: where the vehicle is.
        goals: g_1..g_N, shape (N, n) [m].
    """
    away = goals - state.position
    largest = BEYOND * reach(problem, state)
    distances = np.sqrt(np.einsum('kc,kc->k', away, away))
    farthest = distances.max(initial=0.0)
    if farthest <= largest or problem.terminal == 'constraint':
        return goals, ''
    shares = np.minimum(1.0, largest / np.maximum(distances, largest))
    told = f'the goal is {farthest:.3g} m away: aimed {largest:.3g} m towards it'
    return sealed(state.position + shares[:, None] * away), told


def held_goal(problem: Problem, state: State, goals: Array) -> str:
    """Return what the goal is inside of throughout the horizon, in words; empty if of nothing.

    Args:
        problem: gives the obstacles.
        state: gives the hazards.
        goals: g_1..g_N, shape (N, n) [m].
    """
    times = problem.step * np.arange(1, len(goals) + 1)
    still = {f'obstacle {i}': body.depth(goals) for i, body in enumerate(problem.obstacles)}
    moving = {
        f'hazard {i}': hazard.body.depth(goals - hazard.moved(times))
        for i, hazard in enumerate(state.hazards)
    }
    held = [name for name, deep in (still | moving).items() if (deep > 0.0).all()]
    return f'the goal is inside of {" and ".join(held)}' if held else ''
