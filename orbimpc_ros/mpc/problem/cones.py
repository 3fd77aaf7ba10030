# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The cones of a descent: how far the thrust axis may lean, and the glide slope above the goal.

Both are demanded of every step of a plan. A state that is outside already, or is bound to leave the
cone, must not make a problem infeasible: such a vehicle needs a plan the most. What is demanded of
it is what a *climb* achieves, which thrusts fully and turns upright as fast as the vehicle can, but
for a lean that brings it above the goal: no step may be farther outside than the climb's. That is
the cone itself from the step on at which the climb is back inside, and all along for a state whose
climb never leaves it.

Mathematics: docs/mathematics.md, 3.9.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array, sealed
from orbimpc_ros.mpc.geometry.rotations import HEADING_UNDEFINED
from orbimpc_ros.mpc.model import dynamics
from orbimpc_ros.mpc.model.translation import step_of
from orbimpc_ros.mpc.problem.problem import Problem
from orbimpc_ros.mpc.problem.state import State

if TYPE_CHECKING:
    from orbimpc_ros.mpc.plan import Plan

ROUNDING = 1e-9  # of a climb along a side of a cone
SPARE = 1e-3  # by so much of a step's length, or of full thrust, more than the climb's is allowed
NOTHING = 2e-6  # outside by less, as fractions and in lengths of a step, is inside
SETTLING = 4.0  # steps in which a climb comes above the goal, as far as its lean allows
LEAN = 0.5  # [rad] of a climb, where the tilt is not limited
ONCE = np.ones(1)


class Relief(NamedTuple):
    """How far outside of its cones each step of a plan may be.

    Attributes:
        tilt: of R_1 e1..R_N e1, shape (N,), as :func:`leaning` has it.
        slope: of s_1..s_N, shape (N,), as :func:`strayed` has it [m].
    """

    tilt: Array
    slope: Array


def leaning(problem: Problem, headings: Array) -> Array:
    """Return how far headings, shape (K, 3), lean too much, shape (K,): cos(tilt) |z| - z_3."""
    sizes = np.sqrt(np.einsum('kc,kc->k', headings, headings))
    return np.asarray(math.cos(problem.tilt) * sizes - headings[:, 2])


def strayed(problem: Problem, away: Array) -> Array:
    """Return the distance to the cone above the goal, shape (K,), < 0 inside [m].

    Args:
        problem: gives its angle.
        away: s_k - g_k, shape (K, 3) [m].
    """
    aside = np.hypot(away[:, 0], away[:, 1])
    return np.asarray(
        math.sin(problem.glide_slope) * aside - math.cos(problem.glide_slope) * away[:, 2]
    )


def slope_sides(problem: Problem) -> Array:
    """Return what a glide slope scales x, y and z by: then |(x, y)| <= z, shape (3,)."""
    sine, cosine = math.sin(problem.glide_slope), math.cos(problem.glide_slope)
    return np.array([sine, sine, cosine])


def relief(problem: Problem, state: State, goals: Array) -> Relief:
    """Return how far outside of its cones each step may be: as far as the climb's.

    Args:
        problem: with a tilt or a glide slope.
        state: where the plan starts.
        goals: g_1..g_N, shape (N, 3) [m].
    """
    headings = climb(problem, state, goals)
    positions, _ = dynamics.translation_rollout(problem, state, headings)
    away = positions[1:] - goals
    tilt, slope = leaning(problem, headings[1:]), strayed(problem, away)
    unit = problem.length_unit
    return Relief(_spared(tilt), unit * _spared(slope / unit))


def _spared(outside: Array) -> Array:
    """Return what is allowed where a climb is outside by so much, in units of a step."""
    return np.where(outside > ROUNDING, outside + SPARE, 0.0)


def climb(problem: Problem, state: State, goals: Array) -> Array:
    """Return R_0 e1..R_N e1, shape (N + 1, 3), of a climb above the goal, as steep as may be.

    At full thrust, but for what the state decides and what ``max_rate`` allows without a floor.
    """
    asked = 'climb', problem, goals.tobytes()
    return state.once(asked, lambda: sealed(_climbed(problem, state, goals)))


def _climbed(problem: Problem, state: State, goals: Array) -> Array:
    z, (given, pointing) = np.empty((problem.horizon + 1, 3)), begun(problem, state)
    z[: len(given)] = given
    once = step_of(problem.translation, problem.step, problem.forward)
    blown = np.outer(once.blow, state.disturbance)
    y = np.array([state.position, state.velocity][: len(once.push)])
    for k in range(problem.horizon):
        if k + 1 >= len(given):
            wanted = _upward(problem, y[0] - goals[max(k - 1, 0)], y[1:])
            pointing = z[k + 1] = turned_towards(problem, pointing, wanted[None], ONCE)[0, 0]
        pushed = np.outer(once.push, z[k]) + np.outer(once.follow, z[k + 1])
        y = once.transition @ y + pushed + blown
    return z


def begun(problem: Problem, state: State) -> tuple[Array, Array]:
    """Return R_0 e1, and at rotation order 2 R_1 e1, in rows, and what later turns begin at."""
    given = state.rotation[None, :, 0]
    if problem.rotation_order == 2:
        given = np.vstack([given, _coasted(problem, state)])
    elif problem.turns_are_angles:
        return given, state.attitude[:, 0]
    return given, given[-1]


def _coasted(problem: Problem, state: State) -> Array:
    """Return R_1 e1, which a body rate decides but for its length, as long as it may be."""
    if state.coasted is None:
        return np.asarray((state.rotation + problem.step * state.rotation_rate)[:, 0])
    unit, heading = state.coasted[:, 0], state.rotation[:, 0]
    if not problem.max_rate or problem.floor.exists:
        return unit
    along = float(unit @ heading)  # and from there as far as the chord leads
    more = math.sqrt(max(0.0, problem.chord**2 - _size(heading - along * unit) ** 2))
    return np.asarray(min(1.0, along + more) * unit)


def _upward(problem: Problem, away: Array, velocity: Array) -> Array:
    """Return the direction to climb in, shape (3,): up, leaning against what leads aside.

    Args:
        problem: limits the lean.
        away: from the goal, shape (3,) [m].
        velocity: shape (1, 3) [m/s]; (0, 3) without inertia, where nothing leads aside for long.
    """
    if not len(velocity):
        return np.array([0.0, 0.0, 1.0])
    time = SETTLING * problem.step
    wanted = -(away[:2] / time + 2.0 * velocity[0, :2]) / (time * problem.forward)
    lean = wanted * min(1.0, math.sin(problem.tilt or LEAN) / max(_size(wanted), NOTHING))
    return np.array([*lean, math.sqrt(1.0 - lean @ lean)])


def turned_towards(problem: Problem, pointing: Array, ways: Array, steps: Array) -> Array:
    """Return headings that turn evenly towards unit vectors, as fast as may be: (A, K, n).

    Without a floor along the chord, which limits changes of speed as well.

    Args:
        problem: gives the limits.
        pointing: what the turns begin at, shape (n,).
        ways: unit vectors, shape (A, n).
        steps: of which the turns have had so many, shape (K,).
    """
    if not problem.max_rate:
        return np.repeat(ways[:, None], len(steps), axis=1)
    if not problem.floor.exists:
        left = ways - pointing
        sizes = np.maximum(np.linalg.norm(left, axis=1), NOTHING)
        shares = np.minimum(1.0, steps * problem.chord / sizes[:, None])
        return np.asarray(pointing + shares[..., None] * left[:, None])
    unit = pointing / max(_size(pointing), HEADING_UNDEFINED)
    asides, angles = zip(*(_turn(unit, way) for way in ways), strict=True)
    turned = np.minimum(np.array(angles)[:, None], steps * problem.widest_turn)[..., None]
    return np.asarray(np.cos(turned) * unit + np.sin(turned) * np.array(asides)[:, None])


def _turn(unit: Array, towards: Array) -> tuple[Array, float]:
    """Return the unit vector across ``unit`` that it turns to on its way, and the angle [rad]."""
    aside = towards - unit * (unit @ towards)
    if _size(aside) < HEADING_UNDEFINED:  # there, or opposite: about any axis across
        other = np.eye(len(unit))[np.argmin(np.abs(unit))]
        aside = other - unit * (unit @ other)
    return aside / _size(aside), 2.0 * math.atan2(_size(towards - unit), _size(towards + unit))


def _size(vector: Array) -> float:
    return float(np.linalg.norm(vector))


def told(problem: Problem, goals: Array, plan: Plan) -> str:
    """Return in words how far a plan is outside of the cones, where it has to be; else empty."""
    found, small = [], NOTHING * problem.length_unit
    tilt = leaning(problem, plan.rotations[1:, :, 0])
    slope = strayed(problem, plan.positions[1:] - goals)
    if problem.tilt and tilt.max() > NOTHING:
        found.append(f'tilted too far {_until(tilt, NOTHING)}')
    if problem.glide_slope and slope.max() > small:
        found.append(f'{slope.max():.2g} m outside the glide slope {_until(slope, small)}')
    return '; '.join(found)


def _until(outside: Array, nothing: float) -> str:
    last = int(np.flatnonzero(outside > nothing)[-1]) + 1
    return f'until step {last}' if last < len(outside) else 'to the end of the plan'
