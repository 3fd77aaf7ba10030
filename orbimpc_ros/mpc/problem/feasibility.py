# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The constraint to blame where no trajectory exists, as far as that shows at once.

Mathematics: docs/mathematics.md, 5.3.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.model import dynamics
from orbimpc_ros.mpc.problem import Ball, Box, Problem, State


def reason(problem: Problem, state: State, goals: Array) -> str:
    """Return why a problem that was proved infeasible is so, as far as can be told cheaply.

    Args:
        problem: what was to be solved.
        state: from where.
        goals: g_1..g_N, shape (N, n) [m].
    """
    found = [
        *_out_of_reach(problem, state, goals),
        *_boxed_in(problem, state),
    ]
    if found:
        return '; '.join(found)
    together = ', '.join(constraints_in_force(problem, state)) or 'the dynamics'
    return f'no trajectory satisfies {together}'


def constraints_in_force(problem: Problem, state: State) -> list[str]:
    """Return the names of the constraints from a state, beside the dynamics and the orbitope."""
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
    """Return by how far a goal that is to be arrived at is out of reach [m]; below 0 if it is not.

    At full thrust all the way, no point is farther from the coasting one than this.
    """
    if problem.terminal != 'constraint':
        return -np.inf
    reach = problem.maps.reach[-1]
    coasted = dynamics.drift(problem, state)[-1] + reach[0] * state.rotation[:, 0]
    return float(np.linalg.norm(goals[-1] - coasted) - reach[1:].sum())


def _out_of_reach(problem: Problem, state: State, goals: Array) -> Iterator[str]:
    beyond = beyond_reach(problem, state, goals)
    if beyond > 0.0:
        yield (
            f'terminal: constraint asks for a goal {beyond:.4g} m beyond what '
            f'{problem.horizon} steps can reach'
        )


def _boxed_in(problem: Problem, state: State) -> Iterator[str]:
    """The state alone decides s_1, and s_2 too of an inertial vehicle; a step leads so far only."""
    reach = problem.maps.reach
    decided = dynamics.drift(problem, state) + np.outer(reach[:, 0], state.rotation[:, 0])
    known, free = problem.decided_steps, reach[:, 1:].sum(axis=1)
    for i, body in enumerate(problem.obstacles):
        deep = body.depth(decided)
        held = np.flatnonzero(deep > free)
        if not held.size:
            continue
        if held[0] < known:
            why = 'which the state already decides'
        else:
            why = f'{deep[held[0]]:.4g} m inside, where plans reach {free[held[0]]:.4g} m'
        yield f'obstacle {i} holds s_{held[0] + 1}, {why}{_way_out(body, state)}'
    for i, hazard in enumerate(state.hazards):
        moved = hazard.moved(problem.step * np.arange(1, known + 1))
        inside = np.flatnonzero(hazard.body.depth(decided[:known] - moved) > 0.0)
        if inside.size:
            yield f'hazard {i} holds s_{inside[0] + 1}, which the state already decides'


def _way_out(body: Box | Ball, state: State) -> str:
    """Return what would let a plan begin inside of a body, in words; empty if none does."""
    if not isinstance(body, Box) or body.depth(state.position[None])[0] <= 0.0:
        return ''
    return '; a box has no way out for who begins inside, unless it is a hazard'
