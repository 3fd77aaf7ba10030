"""The cones of a descent: how far the thrust axis may lean, and the glide slope above the goal.

Both are demanded of every step of a plan. A state that is outside already, or that is bound to leave
the cone, must not make a problem infeasible: such a vehicle needs a plan the most. What is demanded
of it is what a *climb* achieves, which turns upright as fast as the vehicle can and thrusts fully:
no step may be farther outside than the climb's. That is nothing less than the cone from the step on
at which the climb is back inside, and all along for a state whose climb never leaves it.

Mathematics: docs/mathematics.md, 3.9.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.rotations import HEADING_UNDEFINED
from orbimpc_ros.mpc.model import dynamics
from orbimpc_ros.mpc.problem.problem import Problem
from orbimpc_ros.mpc.problem.state import State

ROUNDING = 1e-9  # relative, of the climb: it is itself to be allowed
NOTHING = 1e-6  # outside by less, as fractions and in lengths of a step, is inside


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


def relief(problem: Problem, state: State, goals: Array) -> Relief:
    """Return how far outside of its cones each step may be: as far as the climb's.

    Args:
        problem: with a tilt or a glide slope.
        state: where the plan starts.
        goals: g_1..g_N, shape (N, 3) [m].
    """
    headings = climb(problem, state)
    positions, _ = dynamics.translation_rollout(problem, state, headings)
    away = positions[1:] - goals
    tilt, slope = leaning(problem, headings[1:]), strayed(problem, away)
    rounding = ROUNDING * (problem.length_unit + np.abs(away).max(axis=1))
    return Relief(
        np.where(tilt > 0.0, tilt + ROUNDING, 0.0), np.where(slope > 0.0, slope + rounding, 0.0)
    )


def climb(problem: Problem, state: State) -> Array:
    """Return R_0 e1..R_N e1, shape (N + 1, 3), that turn upright at once, as far as they can.

    With full thrust, but for what the state decides and what ``max_rate`` allows without a floor.
    """
    z = np.empty((problem.horizon + 1, 3))
    z[0], decided = state.rotation[:, 0], problem.rotation_order - 1
    if decided:
        first = state.coasted
        z[1] = (state.rotation + problem.step * state.rotation_rate if first is None else first)[
            :, 0
        ]
    begin = z[1] if decided else z[0] if not problem.turns_are_angles else state.attitude[:, 0]
    for k in range(1 + decided, problem.horizon + 1):
        begin = z[k] = _raised(problem, begin)
    return z


def _raised(problem: Problem, heading: Array) -> Array:
    """Return the heading that is upright, or nearest to it within one step's turn."""
    up = np.array([0.0, 0.0, 1.0])
    if not problem.max_rate:
        return up
    if not problem.floor.exists:  # the chord limits changes of speed as well
        way = up - heading
        return np.asarray(heading + way * min(1.0, problem.chord / max(_size(way), NOTHING)))
    return _turned(heading / max(_size(heading), HEADING_UNDEFINED), up, problem.widest_turn)


def _turned(unit: Array, towards: Array, most: float) -> Array:
    """Return a unit vector turned towards another, by an angle at most."""
    aside = towards - unit * (unit @ towards)
    if _size(aside) < HEADING_UNDEFINED:  # there, or opposite: about any axis across
        aside = np.cross(unit, np.eye(3)[np.argmin(np.abs(unit))])
    angle = 2.0 * math.atan2(_size(towards - unit), _size(towards + unit))
    if angle <= most:
        return towards
    return np.asarray(math.cos(most) * unit + math.sin(most) * aside / _size(aside))


def _size(vector: Array) -> float:
    return float(np.linalg.norm(vector))


def told(problem: Problem, state: State, goals: Array) -> str:
    """Return in words what is demanded less of a state that is outside; empty if nothing is."""
    if not problem.has_cones:
        return ''
    eased = relief(problem, state, goals)
    found = []
    if problem.tilt and eased.tilt.max() > NOTHING:
        found.append(f'tilted too far: the limit holds from {_since(eased.tilt, NOTHING)} on')
    small = NOTHING * problem.length_unit
    if problem.glide_slope and eased.slope.max() > small:
        outside = f'up to {eased.slope.max():.2g} m outside the glide slope'
        found.append(f'{outside}, which holds from {_since(eased.slope, small)} on')
    return '; '.join(found)


def _since(eased: Array, nothing: float) -> str:
    last = int(np.flatnonzero(eased > nothing)[-1]) + 1
    return f'step {last + 1}' if last < len(eased) else 'beyond the horizon'
