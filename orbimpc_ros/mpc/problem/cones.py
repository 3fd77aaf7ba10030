# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The cones of a descent: the tilt limit of the thrust axis, and the glide slope above the goal.

Both hold at every step of a plan. A state outside of a cone, or one that cannot avoid leaving it,
must not make the problem infeasible: such a vehicle needs a plan the most. The cones are then
relaxed by the violations of a *climb*, a rollout at full thrust that turns upright as fast as the
vehicle can, but for a lean that brings it above the goal: no step may be farther outside than that
step of the climb. From the step on at which the climb is back inside, the cone itself holds; it is
not relaxed at all if the climb never leaves it. ``goals`` are g_1..g_N, shape (N, 3) [m].

Mathematics: docs/mathematics.md, 3.9.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.geometry.rotations import HEADING_UNDEFINED, aside_of
from orbimpc_ros.mpc.model import dynamics
from orbimpc_ros.mpc.model.translation import step_of
from orbimpc_ros.mpc.problem.problem import Problem, State

if TYPE_CHECKING:
    from orbimpc_ros.mpc.plan import Plan

ROUNDING = 1e-9  # smaller violations of a climb are rounding errors
SPARE = 1e-3  # slack beyond the climb's violation, in units of a step's length or of full thrust
NOTHING = 2e-6  # smaller violations do not count, in units of full thrust or of a step's length
SETTLING = 4.0  # time constant of the climb's horizontal motion towards the goal, in steps
LEAN = 0.5  # [rad] largest lean of a climb if the tilt is not limited
ONCE = np.ones(1)


class Relief(NamedTuple):
    """The violations of its cones that each step of a plan is allowed.

    Attributes:
        tilt: of the tilt limit by R_1 e1..R_N e1, as computed by :func:`leaning`, shape (N,).
        slope: of the glide slope by s_1..s_N, as computed by :func:`strayed`, shape (N,) [m].
    """

    tilt: Array
    slope: Array


def leaning(problem: Problem, headings: Array) -> Array:
    """Return the tilt violations cos(tilt) |z| - z_3, (...,), of headings z, shape (..., 3)."""
    sizes = np.sqrt(np.einsum('...c,...c->...', headings, headings))
    return np.asarray(math.cos(problem.tilt) * sizes - headings[..., 2])


def strayed(problem: Problem, away: Array) -> Array:
    """Return distances beyond the glide slope, (...,), < 0 inside, of s_k - g_k, (..., 3) [m]."""
    aside = np.hypot(away[..., 0], away[..., 1])
    return np.asarray(
        math.sin(problem.glide_slope) * aside - math.cos(problem.glide_slope) * away[..., 2]
    )


def slope_sides(problem: Problem) -> Array:
    """Return scales of x, y and z, shape (3,), in which the glide slope is |(x, y)| <= z."""
    sine, cosine = math.sin(problem.glide_slope), math.cos(problem.glide_slope)
    return np.array([sine, sine, cosine])


def relief(problem: Problem, state: State, goals: Array) -> Relief:
    """Return the violations that each step is allowed: those of the climb, and some slack."""
    headings = climb(problem, state, goals)
    positions, _ = dynamics.translation_rollout(problem, state, headings)
    away = positions[1:] - goals
    tilt, slope = leaning(problem, headings[1:]), strayed(problem, away)
    unit = problem.maps.unit
    return Relief(_spared(tilt), unit * _spared(slope / unit))


def _spared(outside: Array) -> Array:
    """Return the violations allowed for those of a climb, both in natural units."""
    return np.where(outside > ROUNDING, outside + SPARE, 0.0)


def climb(problem: Problem, state: State, goals: Array) -> Array:
    """Return the headings R_0 e1..R_N e1 of the climb, shape (N + 1, 3).

    Thrust is full unless the state decides it, or ``max_rate`` limits it without a floor.
    """
    key = 'climb', problem, goals.tobytes()
    return state.once(key, lambda: sealed(_climbed(problem, state, goals)))


def _climbed(problem: Problem, state: State, goals: Array) -> Array:
    z, (decided, pointing) = np.empty((problem.horizon + 1, 3)), begun(problem, state)
    z[: len(decided)] = decided
    once = step_of(problem.translation, problem.step, problem.forward)
    blown = np.outer(once.blow, state.disturbance)
    y = np.array([state.position, state.velocity][: len(once.push)])
    for k in range(problem.horizon):
        if k + 1 >= len(decided):
            wanted = _upward(problem, y[0] - goals[max(k - 1, 0)], y[1:])
            pointing = z[k + 1] = turned_towards(problem, pointing, wanted[None], ONCE)[0, 0]
        pushed = np.outer(once.push, z[k]) + np.outer(once.follow, z[k + 1])
        y = once.transition @ y + pushed + blown
    return z


def begun(problem: Problem, state: State) -> tuple[Array, Array]:
    """Return R_0 e1 (at rotation order 2 also R_1 e1) in rows, and the heading turns start from."""
    decided = state.rotation[None, :, 0]
    if problem.rotation_order == 2:
        decided = np.vstack([decided, _coasted(problem, state)])
    elif problem.turns_are_angles:
        return decided, state.attitude[:, 0]
    return decided, decided[-1]


def _coasted(problem: Problem, state: State) -> Array:
    """Return R_1 e1, which the body rate decides except for its length, at the largest length."""
    if state.coasted is None:
        return np.asarray((state.rotation + problem.step * state.rotation_rate)[:, 0])
    unit, heading = state.coasted[:, 0], state.rotation[:, 0]
    if not problem.max_rate or problem.floor.exists:
        return unit
    along = float(unit @ heading)  # the farthest point along unit that the chord allows
    more = math.sqrt(max(0.0, problem.chord**2 - _size(heading - along * unit) ** 2))
    return np.asarray(min(1.0, along + more) * unit)


def _upward(problem: Problem, away: Array, velocity: Array) -> Array:
    """Return the direction of the climb: up, leaning against horizontal offset and velocity, (3,).

    ``away`` is from the goal, shape (3,) [m]; without inertia, the velocity has shape (0, 3)
    instead of (1, 3) [m/s], and the climb is vertical.
    """
    if not len(velocity):
        return np.array([0.0, 0.0, 1.0])
    time = SETTLING * problem.step
    wanted = -(away[:2] / time + 2.0 * velocity[0, :2]) / (time * problem.forward)
    lean = wanted * min(1.0, math.sin(problem.tilt or LEAN) / max(_size(wanted), NOTHING))
    return np.array([*lean, math.sqrt(1.0 - lean @ lean)])


def turned_towards(problem: Problem, pointing: Array, targets: Array, steps: Array) -> Array:
    """Return headings that turn towards unit vectors at the largest rate, shape (A, K, n).

    They start from ``pointing``, shape (n,), towards ``targets``, shape (A, n), and are those after
    ``steps``, shape (K,). Without a floor ``max_rate`` limits chords: they move along the chord.
    """
    if not problem.max_rate:
        return np.repeat(targets[:, None], len(steps), axis=1)
    if not problem.floor.exists:
        left = targets - pointing
        sizes = np.maximum(np.linalg.norm(left, axis=1), NOTHING)
        shares = np.minimum(1.0, steps * problem.chord / sizes[:, None])
        return np.asarray(pointing + shares[..., None] * left[:, None])
    unit = pointing / max(_size(pointing), HEADING_UNDEFINED)
    asides = np.array([aside_of(unit, target) for target in targets])
    off, along = (np.linalg.norm(targets + sign * unit, axis=1) for sign in (-1.0, 1.0))
    angles = np.minimum(2.0 * np.arctan2(off, along)[:, None], steps * problem.widest_turn)
    turned = angles[..., None]
    return np.asarray(np.cos(turned) * unit + np.sin(turned) * asides[:, None])


def _size(vector: Array) -> float:
    return float(np.linalg.norm(vector))


def cone_violations(problem: Problem, goals: Array, plan: Plan) -> str:
    """Return a message that says how far a plan is outside of the cones; empty if it is inside."""
    texts, small = [], NOTHING * problem.maps.unit
    tilt = leaning(problem, plan.rotations[1:, :, 0])
    slope = strayed(problem, plan.positions[1:] - goals)
    if problem.tilt and tilt.max() > NOTHING:
        texts.append(f'tilted too far {_until(tilt, NOTHING)}')
    if problem.glide_slope and slope.max() > small:
        texts.append(f'{slope.max():.2g} m outside the glide slope {_until(slope, small)}')
    return '; '.join(texts)


def _until(outside: Array, nothing: float) -> str:
    last = int(np.flatnonzero(outside > nothing)[-1]) + 1
    return f'until step {last}' if last < len(outside) else 'to the end of the plan'
