"""The constraint to blame where no trajectory exists, as far as that shows at once.

Mathematics: docs/mathematics.md, 5.3.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.model import dynamics
from orbimpc_ros.mpc.problem import Problem, State


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
    together = ', '.join(constraints_in_force(problem)) or 'the dynamics'
    return f'no trajectory satisfies {together}'


def constraints_in_force(problem: Problem) -> list[str]:
    """Return the names of a problem's constraints beside the dynamics and the orbitope."""
    floor = problem.floor
    named = {
        'terminal: constraint': problem.terminal == 'constraint',
        f'the {floor.shape} floor of {floor.fraction:.4g}': floor.exists,
        f'max_rate {problem.max_rate:.4g}': problem.max_rate > 0.0,
        f'{len(problem.obstacles)} obstacles': bool(problem.obstacles),
        f'tilt {problem.tilt:.4g}': problem.tilt > 0.0,
        f'glide_slope {problem.glide_slope:.4g}': problem.glide_slope > 0.0,
    }
    return [name for name, in_force in named.items() if in_force]


def _out_of_reach(problem: Problem, state: State, goals: Array) -> Iterator[str]:
    """At full thrust all the way, no point is farther from the coasting one than this."""
    if problem.terminal != 'constraint':
        return
    reach = problem.maps.reach[-1]
    coasted = dynamics.drift(problem, state)[-1] + reach[0] * state.rotation[:, 0]
    beyond = float(np.linalg.norm(goals[-1] - coasted) - reach[1:].sum())
    if beyond > 0.0:
        yield (
            f'terminal: constraint asks for a goal {beyond:.4g} m beyond what '
            f'{problem.horizon} steps can reach'
        )


def _boxed_in(problem: Problem, state: State) -> Iterator[str]:
    """The state alone decides s_1, and s_2 too of an inertial vehicle."""
    reach = problem.maps.reach
    decided = dynamics.drift(problem, state) + np.outer(reach[:, 0], state.rotation[:, 0])
    known = int((reach[:, 1:] == 0.0).all(axis=1).sum())
    for i, box in enumerate(problem.obstacles):
        inside = np.flatnonzero(box.depth(decided[:known]) > 0.0)
        if inside.size:
            yield f'obstacle {i} holds s_{inside[0] + 1}, which the state already decides'
