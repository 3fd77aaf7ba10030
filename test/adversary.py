# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Random flights with problems built around them, and random certificates of those problems.

A flight is drawn first, its headings often at the edge of their limits. The limits are then chosen
such that the flight satisfies them, many by a tiny margin; the plan checker confirms it. Numbers
are dyadic, so that terminal constraints hold exactly. With any multipliers, points and splits, the
lower bound that a certificate proves on the part with the flight must not exceed the flight's cost.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
import problems

from orbimpc_ros.mpc.check import margins, violations
from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.mpc.geometry.faces import normals
from orbimpc_ros.mpc.geometry.rotations import coordinates, exp, nearest
from orbimpc_ros.mpc.geometry.separation import separation
from orbimpc_ros.mpc.plan import UNPROVED, Plan, assemble
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
from orbimpc_ros.mpc.problem.case import Case
from orbimpc_ros.mpc.proof import tree as trees
from orbimpc_ros.mpc.proof.bound import leaf_bound, work_of
from orbimpc_ros.mpc.proof.document import Posed, certificate_of, refutation, refuted_by
from orbimpc_ros.mpc.proof.splits import HELD, WHOLE, WRONG, begin, part_of
from orbimpc_ros.mpc.proof.stated import Body, Statement, rows_of
from orbimpc_ros.mpc.proof.tree import ProofTree, one
from orbimpc_ros.mpc.proof.verify import region_of, tree_in_fractions

HAIR = 1e-7  # smallest relative margin of a flight to a limit
FINE = 2.0**-30  # resolution of headings
ROUNDING = 1e-9  # relative, of costs in floats
LIMITS = ['floor', 'max_rate', 'max_acceleration', 'approach', 'tilt', 'glide_slope', 'obstacles']
Rng = np.random.Generator


class Flight(NamedTuple):
    """A flight of a problem, and the capture radius around the last goal; 0 without a capture."""

    case: Case
    plan: Plan
    radius: float


class Judged(NamedTuple):
    """Bound proved for the part that contains a flight, the flight's cost, and the certificate.

    ``tree`` is the certificate's tree; ``posed`` is its problem as the verifier reads it.
    """

    proved: float
    cost: float
    document: dict[str, Any]
    tree: ProofTree
    posed: Posed

    @property
    def is_false(self) -> bool:
        """Return True if the bound exceeds the flight's cost."""
        return self.proved > self.cost * (1.0 + ROUNDING)


def _dyadic(values: Any, unit: float = FINE) -> np.ndarray:
    return np.asarray(np.round(np.asarray(values) / unit) * unit)


def _sometimes(rng: Rng, share: float) -> bool:
    return bool(rng.random() < share)


def _loose(rng: Rng) -> float:
    """Return the relative slack of a limit over what the flight needs, often tiny."""
    return HAIR if _sometimes(rng, 0.5) else float(10.0 ** rng.uniform(-3, 0))


def flight(rng: Rng) -> Flight | None:
    """Return a flight that satisfies all limits of its problem; None if the draw has none."""
    n, order = int(rng.integers(2, 4)), 1 + _sometimes(rng, 0.25)
    inertia = 1 + _sometimes(rng, 0.4)
    horizon, step = int(rng.choice([1, 1, 2, 3, 4])), 2.0 ** -int(rng.integers(3))
    level = n == 3 and _sometimes(rng, 0.3)
    kinds = ('euler', 'exact', 'held')[: 2 + (inertia == 2)]
    given: dict[str, Any] = {
        'dimension': n,
        'rotation_order': order,
        'translation_order': inertia,
        'horizon': horizon,
        'step': step,
        'forward': 3.0 * 2.0 ** int(rng.integers(-1, 2)),
        'discretisation': str(rng.choice(kinds)),
        'weights': Weights(*(10.0 ** rng.uniform(-2, 1) * _sometimes(rng, 0.5) for _ in range(5))),
    }  # fmt: skip
    rotations = _rotations(rng, n, horizon, level)
    if _sometimes(rng, 0.2):  # too slow to have a direction within an approach cone
        rotations[-1] = _dyadic(10.0 ** rng.uniform(-3, -2) * rotations[-1])
    plain = Problem(**given)
    at_origin = level or _sometimes(rng, 0.5)
    state: dict[str, Any] = {
        'rotation': rotations[0],
        'attitude': nearest(rotations[0]),
        'position': _dyadic(np.zeros(n) if at_origin else rng.normal(size=n), 2.0**-8),
        'disturbance': _dyadic(rng.normal(size=n), 2.0**-8) * _sometimes(rng, 0.3 - 0.3 * level),
        'wanted': problems.rotation(rng, n),
    }
    if order == 2 and _sometimes(rng, 0.5):
        state['coasted'] = np.eye(n)[:, [1, 2, 0][:n]] if n == 3 else np.array([[0.0, -1], [1, 0]])
        rotations[1] = rng.integers(1, 256) / 256.0 * state['coasted']
    elif order == 2:
        state['rotation_rate'] = (rotations[1] - rotations[0]) / step
    goals = np.zeros((horizon, n))
    x = np.array([coordinates(each) for each in rotations[1:]])

    def flown(problem: Problem) -> Plan:
        return assemble(problem, State.at(**state), goals, x, projection='nearest', proof=UNPROVED)

    if plain.inertial:
        state['velocity'] = -flown(plain).velocities[-1]  # so that it arrives at rest
    places = flown(plain).positions[1:]
    goals, given['glide_slope'] = _goals(rng, places, level)
    given |= _limits(rng, plain, rotations[:, :, 0], state['attitude'][:, 0])
    if _sometimes(rng, 0.4) or (n == 3 and _sometimes(rng, 0.3)):
        given['terminal'], goals[-1] = 'constraint', places[-1]
    given['obstacles'] = tuple(_body(rng, places, n) for _ in range(int(rng.integers(3))))
    given['no_corner_cutting'] = _sometimes(rng, 0.3)
    if _sometimes(rng, 0.5):  # only one limit
        for name in rng.permutation([each for each in LIMITS if given.get(each)])[1:]:
            del given[name]
    radius = 0.0
    if given.get('terminal') != 'constraint' and _sometimes(rng, 0.4):
        radius = float(np.linalg.norm(places[-1] - goals[-1]) * (1.0 + _loose(rng)))
    elif _sometimes(rng, 0.3):
        drift = 0.2 * rng.normal(size=n)
        state['hazards'] = (MovingObstacle.drifting(_body(rng, places, n), drift),)
    try:
        problem = Problem(**given)
        plan = flown(problem)
        case = Case(problem, State.at(**state), goals)
        kept = margins(*case.parts, plan)
        strictly = all(kept[name] >= 1e-13 * (name != 'glide_slope') for name in kept)
        return None if violations(*case.parts, plan) or not strictly else Flight(case, plan, radius)
    except OrbimpcError:
        return None


def flights(seed: int, count: int) -> Iterator[tuple[Flight, Rng]]:
    """Yield the flights of ``count`` draws, each with the generator for its certificates."""
    for index in range(count):
        rng = np.random.default_rng([seed, index])
        drawn = flight(rng)
        if drawn is not None:
            yield drawn, rng


def plans(seed: int, count: int) -> Iterator[Flight]:
    """Yield the flights of ``count`` draws that are feasible plans.

    Curved steps among bodies are left out: their control points need not be clear.
    """
    for drawn, _ in flights(seed, count):
        problem, state, _ = drawn.case.parts
        if problem.translation.degree == 1 or not (problem.obstacles or state.hazards):
            yield drawn


def _rotations(rng: Rng, n: int, horizon: int, level: bool) -> np.ndarray:
    """Return R_0..R_N with small to large turns, at speeds from nearly zero to nearly full."""
    turn = 10.0 ** rng.uniform(-2, 0.5)
    made, q = np.zeros((horizon + 1, n, n)), problems.rotation(rng, n)
    if level:
        q = np.eye(3)
    for k in range(horizon + 1):
        if k:
            about_z = rng.uniform(-turn, turn) * np.eye(3)[2] if level else None
            q = q @ (problems.rotation(rng, n, turn) if about_z is None else exp(about_z))
        sizes = [rng.uniform(), 10.0 ** rng.uniform(-3, 0), 1.0, 0.0]
        slow = float(rng.choice(sizes[: 3 + (k == 0)]))
        rest = rng.uniform() if n == 3 and _sometimes(rng, 0.3) else 1.0
        scale = slow * np.array([1.0, *[rest] * (n - 1)])
        made[k] = _dyadic((1.0 - HAIR) * q * scale)
        if n == 2:
            made[k, :, 1] = [-made[k, 1, 0], made[k, 0, 0]]
    return made


def _goals(rng: Rng, places: np.ndarray, level: bool) -> tuple[np.ndarray, float]:
    """Return goals near places, and a glide slope just below the places, or 0."""
    away = _dyadic(10.0 ** rng.uniform(-2, 0.5) * rng.normal(size=places.shape), 2.0**-16)
    if places.shape[1] == 2 or _sometimes(rng, 0.5):
        return places - away, 0.0
    steep = math.tan(10.0 ** rng.uniform(-45, 0) if level else rng.uniform(0.0, 1.4))
    aside = np.linalg.norm(away[:, :2], axis=1)
    away[:, 2] = steep * aside * (1.0 + rng.uniform(size=len(away)))
    goals = places - away
    away = places - goals
    return goals, min(1.5, (1.0 - 1e-9) * max(0.0, np.arctan2(away[:, 2], aside).min()))


def _limits(rng: Rng, problem: Problem, headings: np.ndarray, ahead: np.ndarray) -> dict[str, Any]:
    """Return limits that headings R_0 e1..R_N e1 satisfy, with ``ahead`` as R_0's direction."""
    n, found = problem.dimension, {}
    speeds = np.linalg.norm(headings, axis=1)
    if _sometimes(rng, 0.4):
        shape = str(rng.choice(['circle', 'polygon']))
        faces = int(rng.choice([6, 12, 20])) if n == 3 else int(rng.integers(3, 9))
        along = (headings[1:] @ normals(n, faces).T).max(axis=1)
        beyond = along if shape == 'polygon' else speeds[1:]
        found['floor'] = Floor(shape, faces, float(max(1e-9, beyond.min()) / (1.0 + _loose(rng))))
    if _sometimes(rng, 0.4):
        if 'floor' in found:
            units = headings / np.maximum(speeds, 1e-12)[:, None]
            units[0] = ahead
            before, after = units[:-1], units[1:]
            sides = (np.linalg.norm(each, axis=1) for each in (after - before, after + before))
            turn = 2.0 * np.arctan2(*sides).max()
        else:
            moved = np.linalg.norm(np.diff(headings, axis=0), axis=1).max()
            turn = 2.0 * math.asin(min(1.0, 0.5 * moved))
        found['max_rate'] = min(math.pi, float(turn) * (1.0 + _loose(rng))) / problem.step
    if not problem.inertial and _sometimes(rng, 0.3):
        change = (np.abs(np.diff(speeds)).max() + HAIR) * (1.0 + _loose(rng))
        found['max_acceleration'] = float(change) * problem.forward / problem.step
    if _sometimes(rng, 0.4):
        least = found['floor'].fraction if 'floor' in found else 0.0
        found['approach'] = _approach(rng, headings[-1], least)
    if n == 3 and problem.inertial and _sometimes(rng, 0.4):
        lean = np.arctan2(np.linalg.norm(headings[1:, :2], axis=1), headings[1:, 2]).max()
        if lean < 1.5:
            found['tilt'] = float(lean) * (1.0 + HAIR) + HAIR
    return found


def _approach(rng: Rng, heading: np.ndarray, floor: float) -> Approach:
    """Return an approach cone that contains a heading, often at its edge or its flat end."""
    size = float(np.linalg.norm(heading))
    off = rng.normal(size=len(heading)) * rng.choice([1.0, 0.1])
    axis = heading / max(size, 1e-9) + off
    axis /= np.linalg.norm(axis)
    along = float(heading @ axis) / max(size, 0.01, floor)
    cone = math.acos(min(1.0, max(-1.0, along))) * (1.0 + _loose(rng)) + HAIR
    return Approach(cone, tuple(axis)) if cone <= 1.4 else Approach()


def _body(rng: Rng, places: np.ndarray, n: int) -> Box | Ball:
    """Return a body next to a random one of the places."""
    place, size = places[int(rng.integers(len(places)))], 10.0 ** rng.uniform(-1, 0.5)
    way = rng.normal(size=n)
    way /= np.linalg.norm(way)
    apart = size * (1.0 + _loose(rng))
    if _sometimes(rng, 0.5):
        return Ball(place + apart * way, size)
    middle = place + apart * way / np.abs(way).max()
    return Box(middle - size, middle + size)


# --- certificates

DEEP = 60  # most splits


def judged(drawn: Flight, rng: Rng) -> Judged | None:
    """Return what a random certificate proves of the part with a flight; None if it is unsound."""
    case, count = drawn.case, drawn.case.problem.horizon
    catches, empty = drawn.radius > 0.0, _sometimes(rng, 0.4)
    sought = replace(case, radius=drawn.radius)
    posed = Posed(*case.parts, Statement(case.problem).limits(case.state, case.goals))
    if catches or empty:
        known = refutation(sought, ())
        posed = refuted_by(known, count if catches else 1)[-1]
    part = Part(drawn, posed, rng)
    if case.problem.dimension == 2 and _sometimes(rng, 0.7):
        part.focus()
    for _ in range(int(rng.integers(5))):
        part.split()
    leaf = part.leaf(empty)
    proved, sound = part.bound(leaf, empty)
    if not sound:
        return None
    tree, cost = part.tree(leaf, empty), drawn.radius**2 if catches else drawn.plan.objective
    known = certificate_of(*case.parts, replace(UNPROVED, lower_bound=1.0, tree=tree))
    if catches or empty:
        known = refutation(sought, (tree,) * (count if catches else 1))
    return Judged(proved, 0.0 if empty else cost, known, tree, posed)


class Part:
    """The part of random splits that contains a flight, in fractions.

    Args:
        drawn: the flight.
        posed: its problem, as the verifier reads it.
        rng: source of all random choices.
    """

    def __init__(self, drawn: Flight, posed: Posed, rng: Rng) -> None:
        self.drawn, self.posed, self.rng = drawn, posed, rng
        problem = posed.problem
        self.stated = Statement(problem, Fraction).of(*posed[1:4])
        self.n, self.count = problem.dimension, problem.horizon
        choices = (2 + len(posed.limits.bodies)) * self.count
        self.region = region_of(DEEP, choices, self.n, object)
        self.work, self.width = work_of(self.stated, object), self.stated.start.shape[1]
        self.depth, self.cuts = 0, list[tuple[list[int], float, int]]()
        begun = begin(self.stated, np.zeros(0), self.region.part[0], self.region.span[0])
        assert begun == HELD, 'a flight is left out from the beginning'

    def cut(self, kind: int, choice: int, parts: int, at: float, i: int) -> None:
        """Split the part, if the split is allowed, and continue with its child i.

        Raises:
            AssertionError: the child with the flight has been pruned.
        """
        if self.depth + 1 == DEEP:
            return
        node = [kind, choice, 0, parts, -1]
        made = part_of(self.stated, np.array(node), Fraction(at), i, self.depth + 1, self.region)
        if made == WRONG:
            return
        assert made == HELD, 'the part that a flight is in is left out'
        self.depth += 1
        self.cuts.append((node, at, i))

    def focus(self) -> None:
        """Narrow all steps but one to a small neighbourhood of the flight."""
        free = int(self.rng.integers(self.count))
        for k, heading in enumerate(self.drawn.plan.rotations[1:, :, 0]):
            near, speed = 10.0 ** self.rng.uniform(-9, -4), float(np.linalg.norm(heading))
            if k != free and speed > 1e-6:
                self._directed(k, self._lifted()[k], near, near)
                for at, i in ((speed - near, 1), (speed + near, 0)):
                    self.cut(trees.SPEED, self.count + k, 2, at, i)

    def split(self) -> None:
        """Try one random split of the part."""
        rng, k = self.rng, int(self.rng.integers(self.count))
        off = 10.0 ** rng.uniform(-6, 0.5) * rng.choice([-1, 1])
        heading = self.drawn.plan.rotations[k + 1, :, 0]
        speed, kind = float(np.linalg.norm(heading)), int(rng.choice(3, p=[0.5, 0.2, 0.3]))
        if kind == 0 and self.n == 2 and speed > 1e-6:
            sizes = rng.permutation([abs(off) * rng.uniform(), abs(off)])
            self._directed(k, self._lifted()[k], *sizes)
        elif kind == 0 and len(self.stated.faces):
            faces = np.array(self.stated.faces, float)
            inside = np.flatnonzero(faces @ heading >= self.posed.problem.floor.fraction)
            if len(inside):
                self.cut(trees.FACES, k, len(faces), 0.0, int(rng.choice(inside)))
        elif kind == 0 and speed > 1e-6:
            self._patched(k, heading)
        elif kind == 1:
            at = min(1.0, max(0.0, speed + 0.1 * off))
            self.cut(trees.SPEED, self.count + k, 2, at, int(at < speed))
        elif self.posed.limits.bodies:
            self._beside(k, off)

    def _lifted(self) -> np.ndarray:
        """Return the directions of R_1 e1..R_N e1; unwrapped if turns are limited [rad]."""
        z, state = self.drawn.plan.rotations[:, :, 0], self.posed.state
        angles = np.arctan2(z[1:, 1], z[1:, 0])
        if self.stated.turn < 0:
            return angles
        decided = self.posed.problem.rotation_order == 2 and state.coasted is not None
        ahead = (state.coasted if decided else state.attitude)[:, 0]
        return np.unwrap([math.atan2(ahead[1], ahead[0]), *angles])[1:]

    def _directed(self, choice: int, angle: float, below: float, above: float) -> None:
        """Split directions in the plane on both sides of one; into arcs if all are allowed."""
        if self.region.part[self.depth, choice] == WHOLE:
            parts, at = int(self.rng.integers(2, 6)), float(self.rng.normal())
            share = float(self.stated.full) / parts
            i, left = divmod((angle - at) % (2.0 * np.pi), share)
            if 1e-9 < left < share - 1e-9:
                self.cut(trees.ARCS, choice, parts, at, int(i))
            return
        low = float(self.region.span[self.depth, choice, 0])
        if choice >= self.count or self.stated.turn < 0:
            angle = low + (angle - low) % (2.0 * np.pi)
        self.cut(trees.CUT, choice, 2, float(angle - below), 1)
        self.cut(trees.CUT, choice, 2, float(angle + above), 0)

    def _patched(self, choice: int, way: np.ndarray) -> None:
        """Split directions in space, if one is strictly inside a triangle."""
        whole = self.region.part[self.depth, choice] == WHOLE
        caps = self.stated.patches[20:]
        triangles = caps if len(caps) and _sometimes(self.rng, 0.7) else self.stated.patches[:20]
        kind, parts = (trees.PATCHES, len(triangles)) if whole else (trees.QUARTERS, 4)
        if not whole:
            a, b, c = self.region.corners[self.depth, choice]
            ab, bc, ca = a + b, b + c, c + a
            triangles = [(2 * a, ab, ca), (ab, 2 * b, bc), (ca, bc, 2 * c), (ab, bc, ca)]
        for i, each in enumerate(triangles):
            if np.linalg.solve(np.array(each, float).T, way).min() > 1e-9:
                self.cut(kind, choice, parts, 0.0, i)
                return

    def _beside(self, k: int, off: float) -> None:
        """Split by the sides of a body, if the flight is on one of them."""
        j = int(self.rng.integers(len(self.posed.limits.bodies)))
        body, choice = self.posed.limits.bodies[j], (2 + j) * self.count + k
        points = self._points(body, k)
        if isinstance(body.shape, Box):
            outside = body.shape.clearances(points).min(axis=0)
            sides = np.flatnonzero(outside - body.grown[k] > 1e-12)
            if len(sides):
                self.cut(trees.SIDES, choice, 2 * self.n, 0.0, int(self.rng.choice(sides)))
            return
        way, away = separation(points - body.shape.centre)
        if away < body.shape.radius + body.grown[k] + 1e-12:
            return
        if self.n == 3:
            self._patched(choice, way)
            return
        below, above = self.rng.permutation([abs(off), abs(off) * self.rng.uniform()])
        self._directed(choice, math.atan2(way[1], way[0]), below, above)

    def _points(self, body: Body, k: int) -> np.ndarray:
        """Return the control points of a step on one side of a body, relative to the body."""
        plan, problem = self.drawn.plan, self.posed.problem
        degree = problem.translation.degree
        (start, end), (out, back) = plan.positions[k : k + 2], plan.velocities[k : k + 2]
        lead = problem.step / degree
        inner = [[], [start + lead * out], [start + lead * out, end - lead * back]][degree - 1]
        points = np.array([start, *inner, end])
        first, last = body.shifts[k : k + 2]
        points = points - first - np.linspace(0.0, 1.0, len(points))[:, None] * (last - first)
        return points[_on_side(body, k, degree)]

    def leaf(self, empty: bool) -> ProofTree:
        """Return a leaf with random multipliers of random magnitude."""
        rng, count, n, stated = self.rng, self.count, self.n, self.stated
        point, shor = np.zeros((count, self.width)), np.zeros(count)

        def some(*shape: int) -> np.ndarray:
            few = rng.random(shape[:1] + (1,) * (len(shape) - 1)) < 0.6
            return np.asarray(10.0 ** rng.uniform(-3, 3) * few * rng.normal(size=shape))

        if not empty and _sometimes(rng, 0.8):
            x = [coordinates(each)[: self.width] for each in self.drawn.plan.rotations[1:]]
            off = rng.choice([0.0, 1e-4, 1e-2, 1.0]) * rng.normal(size=point.shape)
            point = np.array(x) + off if not _sometimes(rng, 0.1) else off
        if not empty and _sometimes(rng, 0.3):
            shor = some(count)
        made: dict[str, np.ndarray] = {}
        if stated.arrives and _sometimes(rng, 0.7):
            made['pull'] = some(stated.arrives, n)
        if _sometimes(rng, 0.4):
            made['share'] = some(count, n)
        if stated.sine > 0 and _sometimes(rng, 0.8):
            made['slide'] = self._slides()
        if stated.chord >= 0 and _sometimes(rng, 0.5):
            made['tether'] = some(count, n)
            made['tether'][: stated.begun] = 0.0
        rows = self._rows() if _sometimes(rng, 0.7) else np.zeros(0, np.int64)
        press = np.abs(some(len(rows))) if len(rows) else np.zeros(0)
        leaf = one(point, shor, **made)
        return leaf._replace(press=press, press_row=rows, press_end=np.array([len(rows)]))

    def _rows(self) -> np.ndarray:
        """Return rows of constraints that hold next to bodies."""
        found, degree = list[int](), self.posed.problem.translation.degree
        for depth, ((_, choice, *_), _, _) in enumerate(self.cuts, 1):
            j, k = choice // self.count - 2, choice % self.count
            if j < 0:
                continue
            body, levels = self.posed.limits.bodies[j], self.depth - depth
            span, rows = self.region.span[depth, choice], _on_side(body, k, degree)
            if isinstance(body.shape, Ball) and self.n == 2 and span[1] - span[0] > 3:
                continue
            number = 4 * (choice - 2 * self.count) + int(self.rng.integers(len(rows)))
            found.append(number + 4 * self.count * len(self.posed.limits.bodies) * levels)
        return np.array(found, np.int64)

    def _slides(self) -> np.ndarray:
        """Return vectors as steep as the glide slope requires, or less steep by a random factor."""
        rng, count = self.rng, self.count
        down, way = 10.0 ** rng.uniform(-3, 3, (count, 1)), rng.normal(size=(count, 2))
        if _sometimes(rng, 0.5):  # along the flight's offset from the goal
            way = (self.drawn.plan.positions[1:] - self.drawn.case.goals)[:count, :2] + 1e-12
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        steep = math.tan(self.drawn.case.problem.glide_slope)
        steep *= rng.choice([1.0 - HAIR, 10.0 ** rng.uniform(-3, 5)])
        return np.asarray(down * np.concatenate([steep * way, -np.ones((count, 1))], axis=1))

    def bound(self, leaf: ProofTree, empty: bool) -> tuple[float, bool]:
        """Return the bound that a leaf proves on the part, and True if it is sound."""
        node = np.array([trees.EMPTY if empty else trees.LEAF, 0, 0, 0, 0])
        tree = tree_in_fractions(leaf)
        value, sound = leaf_bound(self.stated, self.region, self.depth, tree, node, self.work)
        return float(value), sound

    def tree(self, leaf: ProofTree, empty: bool) -> ProofTree:
        """Return the tree of the splits with the same leaf everywhere."""
        kind = trees.EMPTY if empty else trees.LEAF
        nodes, at, place = [[kind, 0, 0, 0, 0]], [0.0], 0
        for (split, choice, _, parts, row), angle, i in self.cuts:
            nodes[place], at[place] = [split, choice, len(nodes), parts, row], angle
            place = len(nodes) + i
            nodes += [[kind, 0, 0, 0, 0] for _ in range(parts)]
            at += parts * [0.0]
        return leaf._replace(nodes=np.array(nodes), at=np.array(at))


def _on_side(body: Body, k: int, degree: int) -> list[int]:
    """Return the control points of step k that are on one side of a body."""
    return [i for i in rows_of((body.of,), k + 1, degree)[0, k].tolist() if i >= 0]
