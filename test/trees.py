# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Random problems with a trajectory of each, and random trees of splits and multipliers."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.model.dynamics import translation_rollout
from orbimpc_ros.mpc.model.trajectory import trajectory_of
from orbimpc_ros.mpc.problem import (
    Approach,
    Ball,
    Box,
    Floor,
    MovingObstacle,
    Problem,
    State,
    Weights,
)
from orbimpc_ros.mpc.proof import tree as trees
from orbimpc_ros.mpc.proof.limits import STEP, limits_of
from orbimpc_ros.mpc.proof.stated import Statement
from orbimpc_ros.mpc.proof.tree import ProofTree

ROUND, SQUARE = Floor('circle', fraction=0.6), Floor('polygon', 4, 0.5)
ARRIVES = {'terminal': 'constraint'}
KINDS: dict[str, dict[str, Any]] = {
    'hull': {},
    'hull, exact, length': {'discretisation': 'exact', 'length': 0.3},
    'hull, inertia': {'translation_order': 2, 'discretisation': 'exact'},
    'hull, held': {'translation_order': 2, 'discretisation': 'held'},
    'hull, arrival': ARRIVES,
    'hull, inertia, arrival': {'translation_order': 2, **ARRIVES},
    'hull, turn rate': {'max_rate': 0.5},
    'hull, acceleration': {'max_acceleration': 0.1},
    'hull, approach': {'aims': True},
    'coasting': {'rotation_order': 2, 'translation_order': 2},
    'coasting, round': {'rotation_order': 2, 'floor': ROUND, 'max_rate': 0.7},
    'decided': {'rotation_order': 2, 'decided': True, 'length': 0.2},
    'polygon': {'floor': SQUARE},
    'polygon, length': {'floor': SQUARE, 'length': 0.4},
    'polygon, turn rate': {'floor': Floor('polygon', 8, 0.6), 'max_rate': 0.6},
    'lengths alone': {
        'floor': SQUARE,
        'length': 1.0,
        'input': 0.0,
        'position': 0.0,
        **ARRIVES,
    },
    'round': {'floor': ROUND},
    'constant speed': {'floor': Floor('circle', fraction=1.0)},
    'round, length, arrival': {'floor': ROUND, 'length': 0.3, **ARRIVES},
    'round, inertia, arrival': {'floor': ROUND, 'translation_order': 2, **ARRIVES},
    'round, turn rate': {'floor': ROUND, 'max_rate': 0.5},
    'round, turn rate, approach': {'floor': ROUND, 'max_rate': 0.9, 'aims': True},
    'round, acceleration': {'floor': ROUND, 'max_acceleration': 0.1},
    'wing': {'floor': ROUND, 'max_acceleration': 0.05, 'max_rate': 0.4, 'discretisation': 'exact'},
    'boxes': {'boxes': 2},
    'boxes, shared': {'boxes': 2, 'no_corner_cutting': True, 'floor': ROUND},
    'discs': {'balls': 2, 'discretisation': 'exact'},
    'what moves': {'balls': 1, 'hazards': 2, 'translation_order': 2},
    'space': {'dimension': 3},
    'space, coasting': {'dimension': 3, 'rotation_order': 2, 'translation_order': 2},
    'space, length, arrival': {'dimension': 3, 'length': 0.3, **ARRIVES},
    'space, attitude': {'dimension': 3, 'attitude': 0.5},
    'space, cube': {'dimension': 3, 'floor': Floor('polygon', 6, 0.5)},
    'axes, dodecahedron': {'dimension': 3, 'floor': Floor('polygon', 12, 0.6), 'input': 0.0},
    'shell': {'dimension': 3, 'floor': ROUND, 'input': 0.0},
    'shell, turn rate': {'dimension': 3, 'floor': ROUND, 'input': 0.0, 'max_rate': 0.6},
    'shell over SO(3)': {'dimension': 3, 'floor': ROUND, 'length': 0.1},
    'space, approach': {'dimension': 3, 'aims': True, 'input': 0.0},
    'cones': {
        'dimension': 3,
        'translation_order': 2,
        'tilt': 0.5,
        'glide_slope': 0.4,
        'floor': Floor('circle', fraction=0.1),
        'input': 0.0,
    },
    'space, boxes': {'dimension': 3, 'boxes': 1, 'hazards': 1},
    'space, balls': {'dimension': 3, 'balls': 2, 'input': 0.0},
}


class Flown(NamedTuple):
    """A problem from a state, with a trajectory that its limits allow, and what that costs."""

    problem: Problem
    state: State
    goals: np.ndarray
    x: np.ndarray
    cost: float


def flown(kind: dict[str, Any], rng: np.random.Generator) -> Flown:
    """Return a problem around a trajectory: what it is to obey is made to fit it."""
    kind = dict(kind)
    n, order = kind.pop('dimension', 2), kind.pop('rotation_order', 1)
    names = 'position', 'input', 'length', 'attitude'
    weights = {each: kind.pop(each) for each in names if each in kind}
    made = Weights(**{'input': 0.1 * rng.uniform(), 'terminal': rng.uniform(0, 5)} | weights)
    counts = {each: kind.pop(each, 0) for each in ('boxes', 'balls', 'hazards')}
    aims, decided = kind.pop('aims', False), kind.pop('decided', False)
    known = n, order, kind.pop('translation_order', 1), int(rng.integers(2, 6))
    problem = Problem(*known, rng.uniform(0.3, 1.5), rng.uniform(0.5, 2.0), made, **kind)
    attitude = exp(rng.normal(size=1 if n == 2 else 3))
    if problem.tilt:
        attitude = _turned(np.array([0.0, 0.0, 1.0]), 0.3, rng)
    headings = _headings(problem, attitude, rng)
    coasted = None
    if order == 2:
        coasted = _carrying(headings[0] / max(np.linalg.norm(headings[0]), 1e-9), attitude)
        if decided:
            coasted = None
    rotations = _rotations(problem, headings, attitude, coasted)
    bare = bool(problem.max_rate) and not problem.floor.exists
    state = State.at(
        rng.normal(size=n),
        (float(np.linalg.norm(headings[0])) if bare else rng.uniform(0.6, 1.0)) * attitude,
        attitude=attitude,
        velocity=rng.normal(size=n) if problem.inertial else None,
        disturbance=0.2 * rng.normal(size=n),
        coasted=coasted,
        wanted=exp(rng.normal(size=1 if n == 2 else 3)),
    )
    if decided:
        rate = (rotations[0] - state.rotation) / problem.step
        state = replace(state, rotation_rate=rate)
    if problem.max_acceleration:
        state = replace(state, commanded=float(np.linalg.norm(headings[0])))
    if aims:
        last = headings[-1] + 0.1 * np.linalg.norm(headings[-1]) * rng.normal(size=n)
        problem = replace(problem, approach=Approach(rng.uniform(0.4, 1.3), tuple(last.tolist())))
    x = coordinates(rotations)
    return _beside(problem, state, x, counts, rng)


def _beside(problem: Problem, state: State, x: np.ndarray, counts: dict, rng: Any) -> Flown:
    """Return what was flown, with goals that it arrives at, and bodies that it does not enter."""
    n, count = problem.dimension, problem.horizon
    z = np.vstack([state.rotation[:, 0], x[:, :n]])
    positions, velocities = translation_rollout(problem, state, z)
    goals = positions[-1] + rng.normal(size=(count, n)) * rng.choice([0.01, 1.0, 5.0])
    if problem.terminal == 'constraint':
        goals = goals - goals[-1] + positions[-1]
        if problem.inertial:  # it stops: begun as fast as it takes
            begun = state.velocity - velocities[-1] / problem.maps.carried[-1, 0]
            state = replace(state, velocity=begun)
            positions, velocities = translation_rollout(problem, state, z)
            goals = goals - goals[-1] + positions[-1]
    if problem.glide_slope:  # goals below
        goals = positions[1:] - rng.uniform(1.0, 3.0, size=(count, 1)) * [0.0, 0.0, 1.0]
        goals[:, :2] += 0.3 * rng.normal(size=(count, 2))
    bodies: list[Box | Ball] = []
    points = np.vstack([positions, _within(positions)])
    for number in range(counts['boxes'] + counts['balls']):
        ball = number >= counts['boxes']
        for _ in range(50):
            middle = positions[rng.integers(len(positions))] + rng.normal(size=n)
            size = rng.uniform(0.1, 1.0)
            body = Ball(middle, size) if ball else Box(middle - size, middle + size)
            gap = max(1.0, problem.length_unit)
            wide = (
                Ball(middle, size + gap) if ball else Box(middle - size - gap, middle + size + gap)
            )
            if (wide.depth(points) < 0.0).all():
                bodies.append(body)
                break
    hazards = []
    for _ in range(counts['hazards']):
        middle = positions[0] + rng.normal(size=n)
        body = Ball(middle + 10.0, 1.0) if rng.integers(2) else Box(middle - 12.0, middle - 9.0)
        hazards.append(MovingObstacle.drifting(body, 0.3 * rng.normal(size=n)))
    problem = replace(problem, obstacles=tuple(bodies))
    state = replace(state, hazards=tuple(hazards))
    cost = trajectory_of(problem, state, goals, x).cost
    return Flown(problem, state, goals, x, cost)


def _within(positions: np.ndarray) -> np.ndarray:
    shares = np.linspace(0.0, 1.0, 9)[1:-1, None, None]
    return (positions[:-1] + shares * np.diff(positions, axis=0)).reshape(-1, positions.shape[1])


def _headings(problem: Problem, attitude: np.ndarray, rng: Any) -> np.ndarray:
    """Return headings that the floor, turns, and speeds allow, shape (N, n)."""
    n, found, axis = problem.dimension, [], attitude[:, 0]
    least = problem.floor.circling(n) if problem.floor.exists else 0.0
    speed, turn = rng.uniform(least, 1.0), min(problem.widest_turn, 3.0)
    bare = bool(problem.max_rate) and not problem.floor.exists
    for k in range(problem.horizon):
        if not (k == 0 and problem.first_turn_is_decided):
            axis = _aside(axis, rng.uniform(0.0, 0.03 if bare else turn), rng)
        change = min(problem.speed_change, 0.02 if bare else 2.0)
        speed = min(1.0, max(least, 0.02, speed + rng.uniform(-change, change)))
        if problem.tilt:
            axis = _turned(np.array([0.0, 0.0, 1.0]), 0.9 * problem.tilt, rng)[:, 0]
        found.append(speed * axis)
    return np.array(found)


def _aside(axis: np.ndarray, angle: float, rng: Any) -> np.ndarray:
    across = rng.normal(size=len(axis))
    across -= axis * (axis @ across)
    return math.cos(angle) * axis + math.sin(angle) * across / np.linalg.norm(across)


def _turned(axis: np.ndarray, most: float, rng: Any) -> np.ndarray:
    return _carrying(_aside(axis, rng.uniform(0.0, most), rng), np.eye(3))


def _carrying(axis: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Return the rotation with a first axis that is nearest to another, about."""
    if len(axis) == 2:
        return np.array([[axis[0], -axis[1]], [axis[1], axis[0]]])
    second = before[:, 1] - axis * (axis @ before[:, 1])
    if np.linalg.norm(second) < 1e-6:
        second = np.roll(axis, 1) - axis * (axis @ np.roll(axis, 1))
    second /= np.linalg.norm(second)
    return np.column_stack([axis, second, np.cross(axis, second)])


def _rotations(problem: Problem, headings: np.ndarray, attitude: Any, coasted: Any) -> np.ndarray:
    found = []
    for k, each in enumerate(headings):
        size = np.linalg.norm(each)
        whole = _carrying(each / max(size, 1e-12), attitude)
        if k == 0 and coasted is not None:
            whole = coasted
        found.append(size * whole)
    return np.array(found)


# --- trees


class Growing:
    """Grows a random tree that a problem allows.

    Args:
        case: what was flown.
        rng: of what is random.
    """

    def __init__(self, case: Flown, rng: np.random.Generator) -> None:
        self.case, self.rng = case, rng
        problem = case.problem
        limits = limits_of(problem, case.state, case.goals)
        self.stated = Statement(problem).of(case.state, case.goals, limits)
        self.bodies = limits.bodies
        self.nodes: list[list[int]] = []
        self.parents: list[int] = []
        self.at: list[float] = []
        self.leaves = 0
        self.rows: list[list[tuple[int, float]]] = []

    def tree(self, splits: int) -> ProofTree:
        """Return a tree of about so many splits."""
        count = self.case.problem.horizon
        self.nodes, self.at, self.parents = [[trees.LEAF, 0, 0, 0, -1]], [0.0], [-1]
        known: list[dict[int, Any]] = [{}]
        for _ in range(splits):
            leaf = int(self.rng.choice([t for t, n in enumerate(self.nodes) if n[0] == trees.LEAF]))
            self._split(leaf, known, count)
        for t, node in enumerate(self.nodes):
            if node[0] == trees.LEAF:
                node[4] = self.leaves
                self.leaves += 1
                self.rows.append(self._pressed(t, known))
                if self.rng.uniform() < 0.02:
                    node[0] = trees.EMPTY
        return self._made()

    def _split(self, t: int, known: list[dict], count: int) -> None:
        choice = int(self.rng.integers((2 + len(self.bodies)) * count))
        told, stated, n = known[t].get(choice), self.stated, self.case.problem.dimension
        at, parts, limit = (
            0.0,
            0,
            stated.root.turn >= 0.0 or (stated.root.aside >= 0.0 and choice == count - 1),
        )
        if choice < count:
            if choice == 0 and self.case.problem.rotation_order == 2:
                return
            solid = len(stated.sets.faces)
            kind, parts, at, told = self._directed(choice, told, bool(limit), solid)
        elif choice < 2 * count:
            low, high = told or tuple(stated.root.span[2:, choice - count])
            kind, parts, at = trees.SPEED, 2, float(self.rng.uniform(low, high))
            told = [(low, at), (at, high)]
        else:
            body = self.bodies[choice // count - 2]
            if body.radius:
                kind, parts, at, told = self._directed(choice, told, False, 0)
            elif told is None:
                kind, parts, told = trees.SIDES, 2 * n, list(range(2 * n))
            else:
                return
        if not parts:
            return
        self.nodes[t] = [kind, choice, len(self.nodes), parts, -1]
        self.at[t] = at
        for i in range(parts):
            self.nodes.append([trees.LEAF, 0, 0, 0, -1])
            self.at.append(0.0)
            self.parents.append(t)
            known.append({**known[t], choice: told[i]})

    def _directed(self, choice: int, told: Any, limited: bool, solid: int) -> tuple:
        rng, n = self.rng, self.case.problem.dimension
        if n == 2:
            if told is None and not limited:
                parts, at = int(rng.integers(2, 6)), float(rng.normal())
                step = self.stated.sets.full / parts
                return (
                    trees.ARCS,
                    parts,
                    at,
                    [(at + i * step, at + (i + 1) * step) for i in range(parts)],
                )
            low, high = told or tuple(self.stated.root.span[:2, choice])
            if limited and told is None and self.stated.root.turn < 0.0:
                low, high = (self.stated.root.aim + s * self.stated.root.aside for s in (-1, 1))
            at = float(rng.uniform(low, high))
            return trees.CUT, 2, at, [(low, at), (at, high)]
        if solid:
            return (trees.FACES, solid if told is None else 0, 0.0, list(range(solid)))
        if told is None:
            return trees.PATCHES, 20, 0.0, [True] * 20
        return trees.QUARTERS, 4, 0.0, [True] * 4

    def _pressed(self, t: int, known: list[dict]) -> list[tuple[int, float]]:
        count, degree = self.case.problem.horizon, self.case.problem.translation.degree
        found = []
        for choice in known[t]:
            if choice < 2 * count:
                continue
            body, place, levels = self.bodies[choice // count - 2], t, 0
            while choice in known[max(0, self.parents[place])] and self.rng.integers(2):
                place, levels = self.parents[place], levels + 1
            told = known[place][choice]
            if body.radius and self.case.problem.dimension == 2 and told[1] - told[0] > 3.0:
                continue
            last = degree if body.of == STEP else 0
            number = 4 * (choice - 2 * count) + int(self.rng.integers(last + 1))
            found.append((number + 4 * count * len(self.bodies) * levels, self._size()))
        return found

    def _size(self) -> float:
        return float(abs(self.rng.normal()) * 10.0 ** self.rng.uniform(-3, 1))

    def _made(self) -> ProofTree:
        case, rng, stated = self.case, self.rng, self.stated
        problem, leaves, n = case.problem, self.leaves, case.problem.dimension
        count = problem.horizon
        noise = rng.normal(size=(leaves, count, stated.width)) * 10.0 ** rng.uniform(-4, 0)
        point = case.x[:, : stated.width] + noise
        shor = rng.normal(size=(leaves, count)) * rng.choice([0.0, 0.01, 1.0], size=(leaves, 1))
        if stated.ends.arrives:
            point[:] = case.x[:, : stated.width]
        ends = np.cumsum([len(each) for each in self.rows]).astype(np.int64)
        rows = [each for leaf in self.rows for each in leaf]
        none = np.zeros((0, 0, 0))

        def some(*shape: int) -> np.ndarray:
            return rng.normal(size=(leaves, *shape)) * self._size()

        slide = some(count, 3) if problem.glide_slope else none
        if problem.glide_slope:
            down = np.hypot(slide[..., 0], slide[..., 1]) / math.tan(problem.glide_slope)
            slide[..., 2] = -1.001 * down
        tied = stated.ends.chord > 0.0
        tether = some(count, n) if tied else none
        if tied and stated.ends.begun:
            tether[:, 0] = 0.0
        return ProofTree(
            np.array(self.nodes, np.int64),
            np.array(self.at),
            np.ascontiguousarray(point),
            shor,
            ends,
            np.array([row for row, _ in rows], np.int64),
            np.array([y for _, y in rows], float),
            some(stated.ends.arrives, n) if stated.ends.arrives else none,
            slide,
            tether,
            some(count, n) if rng.integers(2) else none,
            np.zeros((0, 0)),
        )
