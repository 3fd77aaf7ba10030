# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Certificates: what proves a lower bound, as plain data that a file holds.

Format: docs/proofs.md. Numbers are written so that they are read back as they were.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.problem import Approach, Box, Problem, State
from orbimpc_ros.mpc.problem.cones import relief
from orbimpc_ros.mpc.problem.pace import entry_speed
from orbimpc_ros.mpc.problem.sought import Sought
from orbimpc_ros.mpc.problem.traffic import traffic_of
from orbimpc_ros.mpc.problem.units import Units
from orbimpc_ros.mpc.proof.verifier import FORMAT


@dataclass(frozen=True, eq=False)
class Leaf:
    """A tangent of the cost, whose least value over the leaf's region is a bound.

    Attributes:
        point: where it touches, shape (N, d); None of multipliers that the cost adds nothing to.
        bends: what is added to the curvature of each step, shape (N,); zero where None.
        pull: multiplier of the arrival, shape (m,); (0,) without one.
        stiffness: weight on the square of what the arrival misses.
        tops: over SO(3), the largest value of each step's -<G, R>, shape (N,); None otherwise.
        shares: over SO(3), what of G is held by what R e1 alone is subject to, shape (N, n).
        presses: multipliers of what is known of positions in the part, in the order of the splits.
        slides: multipliers of the cone above the goal, shape (N, n).
        tethers: multipliers of how far R e1 moves in a step, shape (N, n).
        meets: of a refutation, multiplier of that s_N is within a radius of g_N, shape (n,).
    """

    point: Array | None = None
    bends: Array | None = None
    pull: Array | None = None
    stiffness: float = 0.0
    tops: Array | None = None
    shares: Array | None = None
    presses: Array | None = None
    slides: Array | None = None
    tethers: Array | None = None
    meets: Array | None = None


@dataclass(frozen=True, eq=False)
class Split:
    """Parts that together hold whatever their whole does.

    Attributes:
        step: k >= 1, whose z_k, or s_k, tells them apart.
        parts: beyond each of a floor's faces, or the directions below and above an angle, or the
            sides of a wall, or the speeds below and above one.
        at: that angle [rad]; None for faces, for the sides of a box, and for speeds.
        wall: number of the wall on whose sides s_k is; None for what is not split by one.
        speed: a share of full speed; None for what is not split by one.
    """

    step: int
    parts: tuple[Tree, ...]
    at: float | None = None
    wall: int | None = None
    speed: float | None = None


Tree = Leaf | Split


def split_into(
    parts: Iterable[Tree | None], step: int, at: float | None = None, wall: int | None = None
) -> Split | None:
    """Return a split into parts; None as soon as one of them has no proof."""
    proved: list[Tree] = []
    for part in parts:
        if part is None:
            return None
        proved.append(part)
    return Split(step, tuple(proved), at, wall)


@dataclass(frozen=True, eq=False)
class Certificate:
    """What proves that no trajectory of a problem costs less than a bound.

    Attributes:
        problem: what was solved.
        state: where plans start.
        goals: g_1..g_N, shape (N, n) [m].
        lower_bound: as published.
        tree: leaves, each with a bound, and the splits that they are the parts of.
        origins: from where directions are counted, shape (N,) [rad]; None where none are split.
    """

    problem: Problem
    state: State
    goals: Array
    lower_bound: float
    tree: Tree
    origins: Array | None = None

    def document(self) -> dict[str, Any]:
        """Return the certificate as the plain values of its format."""
        made = {
            'format': FORMAT,
            **statement(self.problem, self.state, self.goals),
            'lower_bound': self.lower_bound,
            'tree': plain(self.tree),
        }
        return made if self.origins is None else {**made, 'origins': self.origins.tolist()}

    def text(self) -> str:
        """Return the certificate as JSON on one line."""
        return _line(self.document())


@dataclass(frozen=True, eq=False)
class Refutation:
    """What proves that no trajectory of a problem is feasible, or that none catches its goal.

    Attributes:
        sought: in what, with those limits only that certificates can state.
        trees: one; of catches one for each step from the first on at whose end there is none.
        origins: from where directions are counted, shape (N,) [rad]; None where none are split.
    """

    sought: Sought
    trees: tuple[Tree, ...]
    origins: Array | None = None

    def document(self) -> dict[str, Any]:
        """Return the refutation as the plain values of its format."""
        problem, state, goals = self.sought.problem, self.sought.state, self.sought.goals
        refuted: dict[str, Any] = {'trees': [plain(each) for each in self.trees]}
        if self.sought.radius:
            refuted |= {'radius': self.sought.radius, **_last_cone(problem, state)}
            problem = replace(problem, approach=Approach())
        made = {'format': FORMAT, **statement(problem, state, goals), 'refuted': refuted}
        return made if self.origins is None else {**made, 'origins': self.origins.tolist()}

    def text(self) -> str:
        """Return the refutation as JSON on one line."""
        return _line(self.document())


def _last_cone(problem: Problem, state: State) -> dict[str, Any]:
    """Return the cone that the last heading of a catch is in, where there is one."""
    if not problem.approach.exists:
        return {}
    axis = problem.approach.axis(state).tolist()
    cone = {'axis': axis, 'angle': problem.approach.cone, 'least': problem.least_heading}
    return {'cone': cone}


def _line(document: dict[str, Any]) -> str:
    return json.dumps(document, allow_nan=False, separators=(',', ':'))


def statement(problem: Problem, state: State, goals: Array) -> dict[str, Any]:
    """Return what a certificate says of what was solved, as plain values."""
    made = {'problem': _problem(problem), 'state': _state(state), 'goals': goals.tolist()}
    limits = _limits(problem, state, goals)
    return {**made, 'limits': limits} if limits else made


def _limits(problem: Problem, state: State, goals: Array) -> dict[str, Any]:
    """Return the cones and walls, as they are for a state that may be outside of them."""
    found: dict[str, Any] = {}
    cones = []
    if problem.has_cones:
        eased = relief(problem, state, goals)
        if problem.tilt:
            steps = (1 + np.flatnonzero(eased.tilt == 0.0)).tolist()
            cones.append(_cone([0.0, 0.0, 1.0], problem.tilt, 0.0, steps))
        if problem.glide_slope:
            found['glide_slope'] = {'angle': problem.glide_slope, 'eased': eased.slope.tolist()}
    if problem.approach.exists:
        axis, least = problem.approach.axis(state).tolist(), problem.least_heading
        cones.append(_cone(axis, problem.approach.cone, least, [problem.horizon]))
    if problem.max_acceleration and problem.rotation_order == 1:
        entry, change = entry_speed(problem, state), problem.speed_change
        found['speeds'] = {'entry': entry, 'change': change}
    walls = [_wall(box, 'ends' if problem.no_corner_cutting else 'end') for box in problem.boxes]
    traffic = traffic_of(problem, state)
    for body, shifts, grown in zip(*traffic[1:3], traffic.grown, strict=True) if traffic else ():
        moving = {'shifts': shifts.tolist(), 'grown': grown.tolist()}
        if isinstance(body, Box):
            walls.append(_wall(body, 'step') | moving)
            continue
        disc = {'centre': body.centre.tolist(), 'radius': body.radius, **moving}
        walls += [{**disc, 'of': 'end'}, {**disc, 'of': 'step'}]  # an end alone is held closer
    return found | ({'cones': cones} if cones else {}) | ({'walls': walls} if walls else {})


def _cone(axis: list[float], angle: float, least: float, steps: list[int]) -> dict[str, Any]:
    return {'axis': axis, 'angle': angle, 'least': least, 'steps': steps}


def _wall(box: Box, of: str) -> dict[str, Any]:
    return {'min': box.minimum.tolist(), 'max': box.maximum.tolist(), 'of': of}


def _problem(problem: Problem) -> dict[str, Any]:
    weights, floor = problem.weights, problem.floor
    names = ('position', 'input', 'length', 'terminal', 'attitude')
    model = ('dimension', 'rotation_order', 'translation_order', 'discretisation')
    rest = ('horizon', 'step', 'forward', 'terminal', 'max_rate')
    return {
        **{name: getattr(problem, name) for name in (*model, *rest)},
        'weights': {
            **{name: float(getattr(weights, name)) for name in names},
            'arrival': float(problem.arrival_weight),
        },
        'floor': {
            'shape': floor.shape,
            **{name: getattr(floor, name) for name in floor.parameters},
        },
    }


def _state(state: State) -> dict[str, Any]:
    names = ('position', 'rotation', 'velocity', 'rotation_rate', 'attitude', 'disturbance')
    known = {name: getattr(state, name).tolist() for name in names}
    for name in ('coasted', 'wanted'):
        value = getattr(state, name)
        known[name] = None if value is None else value.tolist()
    return known


def plain(tree: Tree) -> dict[str, Any]:
    """Return a tree as the plain values of its format."""
    if isinstance(tree, Split):
        found = {'split': tree.step, 'parts': [plain(part) for part in tree.parts]}
        told = {'at': tree.at, 'wall': tree.wall, 'speed': tree.speed}
        return found | {name: value for name, value in told.items() if value is not None}
    leaf: dict[str, Any] = {}
    names = 'point', 'bends', 'pull', 'tops', 'shares', 'presses', 'slides', 'tethers', 'meets'
    for name in names:
        value = getattr(tree, name)
        if value is not None and len(value):
            leaf[name] = value.tolist()
    return {**leaf, 'stiffness': tree.stiffness} if tree.stiffness else leaf


def in_users_units(tree: Tree, units: Units) -> Tree:
    """Return a tree for the problem as it was posed."""
    if isinstance(tree, Split):
        return replace(tree, parts=tuple(in_users_units(part, units) for part in tree.parts))
    bends = None if tree.bends is None else units.cost * tree.bends
    pull = None if tree.pull is None else units.pulls(tree.pull)
    tops = None if tree.tops is None else units.cost * tree.tops
    force = units.cost / units.length
    return replace(
        tree,
        bends=bends,
        tops=tops,
        pull=pull,
        stiffness=tree.stiffness * force / units.length,
        shares=None if tree.shares is None else units.cost * tree.shares,
        presses=None if tree.presses is None else force * tree.presses,
        slides=None if tree.slides is None else force * tree.slides,
        tethers=None if tree.tethers is None else units.cost * tree.tethers,
    )
