# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A guide path among balls and moving obstacles, by beam search.

From every state reached, a few headings are flown in each step. Of the new states the most
promising are kept, one for each cell of a grid of positions and velocities. They are rated by their
cost so far plus an estimate of the remaining cost without obstacles. The path only starts a search
and proves nothing.

Mathematics: docs/mathematics.md, 4.11.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.model.dynamics import input_weight, position_weights, velocity_weight
from orbimpc_ros.mpc.model.translation import step_of
from orbimpc_ros.mpc.problem import Ball, Box, Problem, State
from orbimpc_ros.mpc.problem.leaving import directions
from orbimpc_ros.mpc.problem.obstacle import Traffic

BEAM = 64
SPEEDS = (1.0, 0.5)  # shares of the range from the least to the full speed
STEERED = (1.0, 2 / 3, 1 / 3, 0.01)  # speeds; not 0, which would leave no heading to turn
TURNS = (0.0, -1.0, 1.0, -0.5, 0.5)  # in units of the widest turn
WITHIN = 1.0 - 1e-6
CELL = 0.25  # in units of a step's length, and of a step's change of velocity
LARGEST = 1.5  # squared length up to which a heading is scaled back to full speed
STILL = 1e-9  # length below which a heading has no direction
FACTOR = 1_000_003  # of the hash that numbers cells


class Reached(NamedTuple):
    """The beam after a step: B states.

    Attributes:
        y: positions and velocities, shape (B, 2, n).
        z: headings, shape (B, n).
        units: their directions, or the last directions before they vanished, shape (B, n).
        costs: so far, shape (B,).
        origins: index of the predecessor in the beam before, shape (B,).
    """

    y: Array
    z: Array
    units: Array
    costs: Array
    origins: np.ndarray


class Scout:
    """Beam search for guide paths at rotation order 1.

    Args:
        problem: what to solve.
        steered: whether turns are limited to ``max_rate`` at any speed, in the plane, although the
            problem limits chords.
    """

    def __init__(self, problem: Problem, *, steered: bool = False) -> None:
        self._problem, n = problem, problem.dimension
        self._widest = WITHIN * problem.chord if steered else np.inf
        self._follow = _turned(problem, STEERED) if steered else _moves(problem)
        self._weights = position_weights(problem)
        once = step_of(problem.translation, problem.step, problem.forward)
        m = len(once.push)
        self._transition, self._blow = np.zeros((2, 2)), np.zeros(2)
        self._push, self._steer = np.zeros(2), np.zeros(2)
        self._transition[:m, :m], self._blow[:m] = once.transition, once.blow
        self._push[:m], self._steer[:m] = once.push, once.follow
        swift = CELL * problem.step * problem.forward if problem.inertial else 1e9
        self._cells = np.repeat([CELL * problem.length_unit * (1 + (n == 3)), swift], n)

    def way(
        self,
        state: State,
        goals: Array,
        traffic: Traffic,
        out_of_time: Callable[[], bool] | None = None,
    ) -> Array | None:
        """Return headings R_1 e1..R_N e1, shape (N, n); None if no path was found in time."""
        if self._problem.rotation_order == 2 or self._follow is None:
            return None
        pairs = [_ball(body) for body in traffic.bodies]
        centres = np.array([centre for centre, _ in pairs])[:, None] + traffic.shifts
        radii = np.array([radius for _, radius in pairs])[:, None] + traffic.grown
        start = np.array([[state.position, state.velocity]])
        known = start, state.rotation[None, :, 0], state.attitude[None, :, 0]
        trail = [Reached(*known, np.zeros(1), np.zeros(1, int))]
        blown = np.outer(self._blow, state.disturbance)
        for k in range(self._problem.horizon):
            late = out_of_time is not None and out_of_time()
            begin, end, size = centres[:, k], centres[:, k + 1], np.maximum(radii[:, k], 0.0)
            step = None if late else self._flown(k, trail[-1], goals, blown, (begin, end, size))
            if step is None:
                return None
            trail.append(step)
        return _traced(trail)

    def _flown(
        self, k: int, at: Reached, goals: Array, blown: Array, balls: tuple[Array, Array, Array]
    ) -> Reached | None:
        """Return the beam after one more step; None if every move hits an obstacle.

        Args:
            k: number of steps so far.
            at: the beam before.
            goals: shape (N, n).
            blown: effect of the disturbance in a step, shape (2, n).
            balls: centres before and after the step, and radii: (J, n), (J, n), (J,).
        """
        assert self._follow is not None
        after, allowed = self._follow(at)
        changed = ((after - at.z[:, None]) ** 2).sum(axis=-1)
        coasted = self._transition @ at.y + blown
        pushed = coasted + self._push[:, None] * at.z[:, None]
        places = pushed[:, None] + self._steer[:, None] * after[:, :, None]
        allowed = allowed & (changed <= self._widest**2)
        allowed &= ~_hits(at.y[:, 0], places[:, :, 0], balls)
        origins, moves = np.nonzero(allowed)
        if not len(origins):
            return None
        y, z = places[origins, moves], after[origins, moves]
        costs = at.costs[origins] + self._weights[k] * ((y[:, 0] - goals[k]) ** 2).sum(axis=-1)
        turning = input_weight(self._problem) / self._problem.step**2
        costs += turning * changed[origins, moves]
        if k + 1 == len(goals):
            costs += velocity_weight(self._problem) * (y[:, 1] ** 2).sum(axis=-1)
        onward = self._transition @ y + blown + (self._push + self._steer)[:, None] * z[:, None]
        kept = self._kept(costs + self._left(k + 1, onward, goals[-1]), onward)
        sizes = np.linalg.norm(z[kept], axis=1)[:, None]
        units = np.where(sizes > STILL, z[kept] / np.maximum(sizes, STILL), at.units[origins[kept]])
        return Reached(y[kept], z[kept], units, costs[kept], origins[kept])

    def _left(self, k: int, onward: Array, goal: Array) -> Array:
        """Return an estimate of the cost of steps k and later, straight to a goal, shape (M,).

        Args:
            k: first of these steps.
            onward: positions and velocities one step ahead, shape (M, 2, n).
            goal: shape (n,).
        """
        ahead, weights = np.arange(len(self._weights) - k), self._weights[k:]
        braking = self._push[1] + self._steer[1] if self._problem.inertial else 0.0
        halt = onward[:, 0]  # where the vehicle comes to rest if it brakes at once
        if braking:
            speeds = np.linalg.norm(onward[:, 1], axis=1, keepdims=True)
            halt = halt + speeds / (2.0 * braking) * onward[:, 1]
        away = np.linalg.norm(halt - goal, axis=1)[:, None]
        if not braking:
            left = np.maximum(0.0, away - ahead * (self._push[0] + self._steer[0]))
        else:
            half = np.sqrt(away / braking)  # steps until it has to brake
            late = 0.5 * braking * np.maximum(0.0, 2.0 * half - ahead) ** 2
            left = np.where(ahead <= half, away - 0.5 * braking * ahead**2, late)
        return left**2 @ weights

    def _kept(self, promises: Array, onward: Array) -> np.ndarray:
        """Return indices of the most promising states, one per cell of ``onward``, shape (B,)."""
        order = np.argsort(promises, kind='stable')
        cells = np.floor(onward.reshape(len(onward), -1) / self._cells)[order].astype(np.int64)
        keys = np.zeros(len(order), np.int64)
        for column in cells.T:
            keys = keys * FACTOR + column
        return order[np.sort(np.unique(keys, return_index=True)[1])[:BEAM]]


def _hits(begin: Array, ends: Array, balls: tuple[Array, Array, Array]) -> np.ndarray:
    """Return which straight motions hit balls that move at constant velocity, shape (B, A).

    Args:
        begin: positions before, shape (B, n).
        ends: positions after, shape (B, A, n).
        balls: centres before and after, and radii: (J, n), (J, n), (J,).
    """
    before, after, radii = balls
    a = (begin[:, None] - before)[:, None]
    d = ends[:, :, None] - after - a
    along, squared = (a * d).sum(axis=-1), (d * d).sum(axis=-1)
    share = np.clip(-along / np.maximum(squared, np.finfo(float).tiny), 0.0, 1.0)
    near = (a * a).sum(axis=-1) + share * (2.0 * along + share * squared)
    return np.asarray((near < radii**2).any(axis=-1))


def _traced(trail: Sequence[Reached]) -> Array:
    """Return the headings R_1 e1..R_N e1, shape (N, n), of the cheapest path in the beams."""
    at, found = int(np.argmin(trail[-1].costs)), list[Array]()
    for reached in trail[:0:-1]:
        found.append(reached.z[at])
        at = int(reached.origins[at])
    return np.array(found[::-1])


def _ball(body: Box | Ball) -> tuple[Array, float]:
    """Return centre and radius of the smallest ball around a body."""
    if isinstance(body, Box):
        size = float(np.linalg.norm(0.5 * (body.maximum - body.minimum)))
        return 0.5 * (body.minimum + body.maximum), size
    return body.centre, body.radius


# --- successors of a heading: candidates, shape (B, A, n), and which of them are allowed

Follow = Callable[[Reached], tuple[Array, np.ndarray]]


def _moves(problem: Problem) -> Follow | None:
    """Return the successors of headings in a problem; None if they are not implemented."""
    n = problem.dimension
    least = problem.floor.circling(n) if problem.floor.exists else 0.0
    speeds = [least + share * (1.0 - least) for share in SPEEDS]
    if problem.turns_are_angles:
        return _turned(problem, speeds) if n == 2 else None
    units, still = directions(n), np.zeros((1, n))
    if problem.max_rate:
        changes = [share * WITHIN * problem.chord * units for share in (1.0, 0.5)]
        return _changed(np.vstack([still, *changes]))
    every = np.vstack([*(speed * units for speed in speeds), *([] if least else [still])])
    return lambda at: (np.repeat(every[None], len(at.z), axis=0), np.ones((1, 1), bool))


def _changed(moves: Array) -> Follow:
    """Return successors that differ by moves, shape (A, n), and are no longer than 1."""

    def follow(at: Reached) -> tuple[Array, np.ndarray]:
        after = at.z[:, None] + moves
        sizes = np.linalg.norm(after, axis=-1)
        return after / np.maximum(sizes, 1.0)[:, :, None], sizes**2 <= LARGEST

    return follow


def _turned(problem: Problem, speeds: Sequence[float]) -> Follow:
    """Return planar successors at given speeds, turned by shares of the widest turn."""
    angles = WITHIN * problem.widest_turn * np.tile(TURNS, len(speeds))
    fast = np.repeat(speeds, len(TURNS))
    along, aside = fast * np.cos(angles), fast * np.sin(angles)

    def follow(at: Reached) -> tuple[Array, np.ndarray]:
        across = np.column_stack([-at.units[:, 1], at.units[:, 0]])
        after = along[:, None] * at.units[:, None] + aside[:, None] * across[:, None]
        return after, np.ones((1, 1), bool)

    return follow
