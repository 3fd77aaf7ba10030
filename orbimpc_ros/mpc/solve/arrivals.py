# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Arcs, bent so that they arrive: within floor, turn rate and approach, without a search.

A terminal constraint is linear in the headings z_k = R_k e1. Its residual is removed by Newton
steps of least norm in their speeds and turns, within the limits of both; and likewise what the last
heading misses of a cone of approach.

Mathematics: docs/mathematics.md, 7.6.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.geometry.rotations import HEADING_UNDEFINED, aside_of, exp, turned_within
from orbimpc_ros.mpc.problem import Problem, State
from orbimpc_ros.mpc.problem.reach import decided

WITHIN = 1.0 - 1e-9  # share of the widest turn
WITHIN_CONE = 0.99  # share of the cone of approach that corrections turn into
CORRECTIONS = 20
LARGEST = 0.5  # change of a heading in one correction
PROGRESS = 0.95  # a correction ends if it leaves more of the residual
MET = 1e-10  # in units of a step's length: residual of an arrival that counts as zero
Begun = tuple[Array, Array | None]  # the rotation from which turns start, and a given R_1


class Arc(NamedTuple):
    """A path of turns one after another; one in the plane is in a plane of space.

    Attributes:
        frame: at its start: ahead, aside and the axis of the arc, its columns, shape (3, 3).
        speeds: shares of full speed, shape (N,).
        turns: rotation vectors of steps, in the frame of each, shape (N, 3) [rad].
        fixed: number of first steps that the state decides.
    """

    frame: Array
    speeds: Array
    turns: Array
    fixed: int


def arc_of(problem: Problem, begun: Begun, towards: Array, speed: float, turn: float) -> Arc:
    """Return the arc with a turn over the horizon [rad] to the side of a point, shape (n,)."""
    count, fixed, frame = problem.horizon, problem.rotation_order - 1, np.zeros((3, 3))
    (ahead, first), speeds, turns = begun, np.full(count, speed), np.zeros((count, 3))
    axis = ahead[:, 0]
    if first is not None:
        speeds[0] = np.linalg.norm(first[:, 0])
        axis = first[:, 0] / max(float(speeds[0]), HEADING_UNDEFINED)
    frame[: len(axis), 0], frame[: len(axis), 1] = axis, aside_of(axis, towards)
    frame[:, 2] = np.cross(frame[:, 0], frame[:, 1])
    turns[fixed:, 2] = turn / count
    return Arc(frame, speeds, turns, fixed)


def _arrival(problem: Problem, state: State, goals: Array) -> tuple[Array, Array]:
    """Return an arrival's rows over R_1 e1..R_N e1, shape (m, N), and their values, (m, n)."""
    rows, (places, velocities) = problem.maps.arrival[:, 1:], decided(problem, state)
    return rows, np.array([goals[-1] - places[-1], -velocities[-1]][: len(rows)])


def least_arriving(problem: Problem, state: State, goals: Array) -> Array:
    """Return the least headings that arrive, shape (N, n), those beyond full speed cut to it."""
    rows, wanted = _arrival(problem, state, goals)
    headings, free = np.zeros((problem.horizon, problem.dimension)), rows.any(axis=0)
    while free.any():
        missing = wanted - rows[:, ~free] @ headings[~free]
        headings[free] = np.linalg.pinv(rows[:, free]) @ missing
        sizes = np.linalg.norm(headings, axis=1)
        fast = free & (sizes > 1.0)
        if not fast.any():
            break
        headings[fast] /= sizes[fast, None]
        free &= ~fast
    return headings


def flown(problem: Problem, state: State, goals: Array, arc: Arc) -> Iterator[Array | None]:
    """Yield None before each correction of an arc, and last, if it arrives, headings, (N, n).

    Without a terminal constraint they are those of the arc, no slower than the floor.
    """
    n, (rows, wanted) = problem.dimension, _arrival(problem, state, goals)
    scale, best = np.maximum(np.abs(rows).max(axis=1), HEADING_UNDEFINED)[:, None], math.inf
    for _ in range(CORRECTIONS):
        frames = np.array([*accumulate([arc.frame, *map(exp, arc.turns)], np.matmul)][1:])
        least: Array = np.full(len(frames), -1.0)  # backwards, without a floor
        if problem.floor.exists:
            least = np.minimum(1.0, problem.floor.least(frames[:, :n, 0]))
        arc = arc._replace(speeds=np.clip(arc.speeds, least, 1.0))
        headings = np.asarray(arc.speeds[:, None] * frames[:, :n, 0])
        missing = wanted - rows @ headings
        aside = _turned_aside(problem, state, frames[-1, :n, 0])
        missed = max(np.abs(missing[0]).max(), problem.step * np.abs(missing[1:]).max(initial=0.0))
        missed = max(missed, problem.maps.unit * np.abs(aside).max(initial=0.0))
        arrived = problem.terminal != 'constraint' or missed <= MET * problem.maps.unit
        if arrived:
            yield headings
        if arrived or not missed < PROGRESS * best:
            return
        yield None
        best = missed
        arc = _bent(problem, arc, frames, (rows / scale, missing / scale, aside, least))


def _turned_aside(problem: Problem, state: State, unit: Array) -> Array:
    """Return the change of the last direction, shape (n,), into the approach; (0,) if inside."""
    if not problem.approach.exists:
        return unit[:0]
    aimed = turned_within(problem.approach.axis(state), unit, WITHIN_CONE * problem.approach.cone)
    return unit[:0] if aimed is unit else aimed - unit


def _bent(
    problem: Problem, arc: Arc, frames: Array, demands: tuple[Array, Array, Array, Array]
) -> Arc:
    """Return an arc with the least change of speeds and turns that arrives to first order.

    Args:
        problem: what to solve.
        arc: to change, within the limits of its speeds and turns.
        frames: of its steps, shape (N, 3, 3).
        demands: rows of the arrival, shape (m, N); what it misses, shape (m, n); the change of the
            last direction, shape (n,) or (0,); least speeds, (N,).
    """
    (rows, missing, aside, least), n, count = demands, problem.dimension, len(arc.turns)
    widest = WITHIN * problem.widest_turn if problem.turns_are_angles else math.inf
    angles = np.linalg.norm(arc.turns, axis=1)
    own = np.where((angles > 0.0)[:, None], arc.turns, [0.0, 0.0, 1.0])
    own /= np.linalg.norm(own, axis=1)[:, None]
    axes = np.array([own, np.cross([1.0, 0.0, 0.0], own)])[: n - 1]  # in space also across
    units = frames[:, :, 0]
    about = np.einsum('kcd,akd->akc', frames, axes)[:, :, None]  # in the world
    pushed = np.eye(count)[:, :, None] * units
    swung = np.tri(count).T[:, :, None] * np.cross(about, arc.speeds[:, None] * units)
    moved = np.concatenate([pushed, *swung])
    matrix = np.einsum('mk,vkc->mcv', rows, moved[:, :, :n]).reshape(missing.size, -1)
    turned = np.cross(about[:, :, 0], units[-1]).reshape(-1, 3)[:, : len(aside)].T
    matrix = np.vstack([matrix, np.hstack([np.zeros((len(aside), count)), turned])])
    low, high = np.full((2, n, count), math.inf)
    low[0], high[0] = arc.speeds - least, 1.0 - arc.speeds
    low[1], high[1] = widest + angles, widest - angles
    low[:, : arc.fixed] = high[:, : arc.fixed] = 0.0
    limits = -low.ravel(), high.ravel()
    change = _least_change(matrix, np.concatenate([missing.ravel(), aside]), limits)
    change *= min(1.0, LARGEST / np.abs(change).max(initial=LARGEST))
    more = change[count:].reshape(n - 1, count)
    turns = arc.turns + np.einsum('ak,akc->kc', more, axes)
    sizes = np.linalg.norm(turns, axis=1)
    turns *= np.minimum(1.0, widest / np.maximum(sizes, HEADING_UNDEFINED))[:, None]
    return arc._replace(speeds=arc.speeds + change[:count], turns=turns)


def _least_change(matrix: Array, missing: Array, limits: tuple[Array, Array]) -> Array:
    """Return the least change of variables within limits that removes a residual, shape (V,).

    Variables whose change would exceed a limit stay at it, and the others make up for that.

    Args:
        matrix: derivatives, shape (M, V).
        missing: the residual, shape (M,).
        limits: least and greatest change of each variable, shape (V,).
    """
    change, free = np.zeros(matrix.shape[1]), limits[1] > limits[0]
    while free.any():
        left = missing - matrix[:, ~free] @ change[~free]
        change[free] = np.linalg.lstsq(matrix[:, free], left, rcond=None)[0]
        kept = np.clip(change, *limits)
        beyond = free & (kept != change)
        if not beyond.any():
            break
        change[beyond], free = kept[beyond], free & ~beyond
    return change
