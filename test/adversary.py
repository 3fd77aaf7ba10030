# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Random flights with problems built around them, and random certificates of those problems.

A flight is drawn first: headings, often at the edge of what is allowed. Limits are then set so that
it keeps them, many by a hair, and the check says that it does. Numbers are dyadic, so that it also
arrives exactly. Whatever multipliers, points and splits a certificate of such a problem has, the
part that the flight is in proves no more than the flight costs.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import problems

from orbimpc_ros.mpc.check import margins, violations
from orbimpc_ros.mpc.errors import OrbimpcError
from orbimpc_ros.mpc.geometry.faces import normals
from orbimpc_ros.mpc.geometry.orbitopes import coordinates
from orbimpc_ros.mpc.geometry.rotations import nearest
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
from orbimpc_ros.mpc.problem.sought import Sought
from orbimpc_ros.mpc.proof.certificate import Certificate, Leaf, Refutation
from orbimpc_ros.mpc.proof.verifier import Refused, posed_by, refuted_by
from orbimpc_ros.mpc.proof.verifier.bound import bound
from orbimpc_ros.mpc.proof.verifier.regions import Region
from orbimpc_ros.mpc.proof.verifier.splits import leaves, root
from orbimpc_ros.mpc.proof.verifier.stated import StatedProblem

HAIR = 1e-7  # by which a flight keeps a limit, of what it limits
FINE = 2.0**-30  # headings are multiples of it
ROUNDING = 1e-9  # of a cost in floats
Rng = np.random.Generator


class Flight(NamedTuple):
    """A flight of a problem, and within which radius of the last goal it ends; 0 of no catch."""

    case: Case
    plan: Plan
    radius: float


Part = tuple[dict[str, Any], int, int]  # a split, which of its parts, and of how many


class Judged(NamedTuple):
    """What a part proves that a flight is in, and what the flight costs there."""

    proved: float
    cost: float
    document: dict[str, Any]

    @property
    def is_false(self) -> bool:
        """Return whether more is proved than there is."""
        return self.proved > self.cost * (1.0 + ROUNDING)


def _dyadic(values: Any, unit: float = FINE) -> np.ndarray:
    return np.asarray(np.round(np.asarray(values) / unit) * unit)


def _sometimes(rng: Rng, share: float) -> bool:
    return bool(rng.random() < share)


def _loose(rng: Rng) -> float:
    """Return by how much a limit is looser than the flight needs, often by a hair."""
    return HAIR if _sometimes(rng, 0.5) else float(10.0 ** rng.uniform(-3, 0))


def flight(rng: Rng) -> Flight | None:
    """Return a flight that keeps all limits of its problem; None if a draw has none."""
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
    if _sometimes(rng, 0.2):  # which a cone of approach has no direction for
        rotations[-1] = _dyadic(10.0 ** rng.uniform(-3, -2) * rotations[-1])
    plain = Problem(**given)
    state: dict[str, Any] = {
        'rotation': rotations[0],
        'attitude': nearest(rotations[0]),
        'position': np.zeros(n)
        if level or _sometimes(rng, 0.5)
        else _dyadic(rng.normal(size=n), 2.0**-8),
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
        state['velocity'] = -flown(plain).velocities[-1]  # and arrives at rest
    places = flown(plain).positions[1:]
    goals, given['glide_slope'] = _goals(rng, places, level)
    given |= _limits(rng, plain, rotations[:, :, 0], state['attitude'][:, 0])
    if _sometimes(rng, 0.4) or (n == 3 and _sometimes(rng, 0.3)):
        given['terminal'], goals[-1] = 'constraint', places[-1]
    given['obstacles'] = tuple(_body(rng, places, n) for _ in range(int(rng.integers(3))))
    given['no_corner_cutting'] = _sometimes(rng, 0.3)
    if _sometimes(rng, 0.5):  # one limit alone
        limits = [
            'floor',
            'max_rate',
            'max_acceleration',
            'approach',
            'tilt',
            'glide_slope',
            'obstacles',
        ]
        for name in rng.permutation([each for each in limits if given.get(each)])[1:]:
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
        if violations(*case, plan) or not _strictly(margins(*case, plan)):
            return None
    except OrbimpcError:
        return None
    return Flight(case, plan, radius)


def _strictly(kept: dict[str, float]) -> bool:
    return all(each >= (0.0 if name == 'glide_slope' else 1e-13) for name, each in kept.items())


def _rotations(rng: Rng, n: int, horizon: int, level: bool) -> np.ndarray:
    """Return R_0..R_N that turn a little or much, at speeds from nearly none to nearly the most."""
    turn = 10.0 ** rng.uniform(-2, 0.5)
    made, q = np.zeros((horizon + 1, n, n)), problems.rotation(rng, n)
    if level:
        q = np.eye(3)
    for k in range(horizon + 1):
        if k:
            q = q @ (
                _about_z(rng.uniform(-turn, turn)) if level else problems.rotation(rng, n, turn)
            )
        slow = float(
            rng.choice([rng.uniform(), 10.0 ** rng.uniform(-3, 0), 1.0, 0.0][: 3 + (k == 0)])
        )
        rest = rng.uniform() if n == 3 and _sometimes(rng, 0.3) else 1.0
        scale = slow * np.array([1.0, *[rest] * (n - 1)])
        made[k] = _dyadic((1.0 - HAIR) * q * scale)
        if n == 2:
            made[k, :, 1] = [-made[k, 1, 0], made[k, 0, 0]]
    return made


def _about_z(angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _goals(rng: Rng, places: np.ndarray, level: bool) -> tuple[np.ndarray, float]:
    """Return goals near places, and a glide slope that these are just above, or 0."""
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
    """Return limits that headings R_0 e1..R_N e1 keep, R_0's own direction being another."""
    n, found = problem.dimension, {}
    speeds = np.linalg.norm(headings, axis=1)
    if _sometimes(rng, 0.4):
        shape = str(rng.choice(['circle', 'polygon']))
        faces = int(rng.choice([6, 12, 20])) if n == 3 else int(rng.integers(3, 9))
        beyond = (
            (headings[1:] @ normals(n, faces).T).max(axis=1) if shape == 'polygon' else speeds[1:]
        )
        found['floor'] = Floor(shape, faces, float(max(1e-9, beyond.min()) / (1.0 + _loose(rng))))
    if _sometimes(rng, 0.4):
        if 'floor' in found:
            units = headings / np.maximum(speeds, 1e-12)[:, None]
            units[0] = ahead
            before, after = units[:-1], units[1:]
            turn = 2.0 * np.arctan2(
                *(np.linalg.norm(each, axis=1) for each in (after - before, after + before))
            )
            turn = turn.max()
        else:
            moved = np.linalg.norm(np.diff(headings, axis=0), axis=1).max()
            turn = 2.0 * math.asin(min(1.0, 0.5 * moved))
        found['max_rate'] = min(math.pi, float(turn) * (1.0 + _loose(rng))) / problem.step
    if not problem.inertial and _sometimes(rng, 0.3):
        change = (np.abs(np.diff(speeds)).max() + HAIR) * (1.0 + _loose(rng))
        found['max_acceleration'] = float(change) * problem.forward / problem.step
    if _sometimes(rng, 0.4):
        found['approach'] = _approach(rng, headings[-1], found.get('floor', Floor()).clearance(n))
    if n == 3 and problem.inertial and _sometimes(rng, 0.4):
        lean = np.arctan2(np.linalg.norm(headings[1:, :2], axis=1), headings[1:, 2]).max()
        if lean < 1.5:
            found['tilt'] = float(lean) * (1.0 + HAIR) + HAIR
    return found


def _approach(rng: Rng, heading: np.ndarray, floor: float) -> Approach:
    """Return a cone that a heading is in, often at its edge or its flat end."""
    size = float(np.linalg.norm(heading))
    off = rng.normal(size=len(heading)) * rng.choice([1.0, 0.1])
    axis = heading / max(size, 1e-9) + off
    axis /= np.linalg.norm(axis)
    along = float(heading @ axis) / max(size, 0.01, floor)
    cone = math.acos(min(1.0, max(-1.0, along))) * (1.0 + _loose(rng)) + HAIR
    return Approach(cone, tuple(axis)) if cone <= 1.4 else Approach()


def _body(rng: Rng, places: np.ndarray, n: int) -> Box | Ball:
    """Return a body beside a place."""
    place, size = places[int(rng.integers(len(places)))], 10.0 ** rng.uniform(-1, 0.5)
    way = rng.normal(size=n)
    way /= np.linalg.norm(way)
    apart = size * (1.0 + _loose(rng))
    if _sometimes(rng, 0.5):
        return Ball(place + apart * way, size)
    middle = place + apart * way / np.abs(way).max()
    return Box(middle - size, middle + size)


# --- certificates


def judged(drawn: Flight, rng: Rng) -> Judged | None:
    """Return what the part of a random certificate that holds a flight proves; None if refused.

    Raises:
        AssertionError: no part of a split holds the flight.
    """
    planar = drawn.case.problem.dimension == 2
    sectors = planar and not _turns(drawn.case.problem) and _sometimes(rng, 0.6)
    origins = rng.uniform(-4.0, 4.0, drawn.case.problem.horizon) if sectors else None
    refutes = drawn.radius > 0.0 or _sometimes(rng, 0.4)
    if refutes:
        sought = Sought(*drawn.case, radius=drawn.radius)
        known = Refutation(sought, (), origins).document()
    else:
        known = Certificate(*drawn.case, 0.0, Leaf(), origins).document()
    count = drawn.case.problem.horizon if drawn.radius else 1
    posed = refuted_by(known, count)[-1] if refutes else posed_by(known)
    splits = _focused(drawn, known, rng) if planar and _sometimes(rng, 0.7) else []
    splits += [each for _ in range(int(rng.integers(5))) for each in _split(drawn, known, rng)]
    leaf: dict[str, Any] = {}
    (tree, region), made = _held(posed, known, [], leaf), []
    for each in splits:
        try:
            tree, region = _held(posed, known, [*made, each], leaf)
        except Refused:  # of what it splits nothing is left on one side
            continue
        made.append(each)
    leaf |= _leaf(drawn, posed, region, rng, refutes)
    try:
        proved = bound(posed, leaf, region)
    except Refused:
        return None
    if refutes:
        known['refuted']['trees'] = [*[{}] * (count - 1), tree]
    else:
        known['tree'] = tree
    return Judged(float(proved), 0.0 if refutes else drawn.plan.objective, known)


def _turns(problem: Problem) -> bool:
    """Return whether directions are counted from the attitude's."""
    turns = problem.rotation_order == 1 and problem.turns_are_angles
    return turns and problem.dimension == 2


def _held(
    posed: StatedProblem, known: dict[str, Any], splits: list[Part], leaf: dict[str, Any]
) -> tuple[dict[str, Any], Region]:
    """Return a tree of splits, and the region of its leaf that a flight is in."""
    tree, everything = _tree(splits, leaf), root(posed, known.get('origins'))
    found = [region for node, region in leaves(posed, tree, everything) if node is leaf]
    assert len(found) == 1, 'the part that a flight is in is left out'
    return tree, found[0]


def _tree(splits: list[Part], leaf: dict[str, Any]) -> dict[str, Any]:
    """Return nested splits, of which one part each is split again, and the last is a leaf."""
    made = leaf
    for node, i, count in reversed(splits):
        made = {**node, 'parts': [made if j == i else {} for j in range(count)]}
    return made


def _focused(drawn: Flight, known: dict[str, Any], rng: Rng) -> list[Part]:
    """Return splits that leave no more than the flight of all steps but one."""
    found, free = [], int(rng.integers(drawn.case.problem.horizon))
    for k, heading in enumerate(drawn.plan.rotations[1:, :, 0]):
        near, speed = 10.0 ** rng.uniform(-9, -4), float(np.linalg.norm(heading))
        if k != free and speed > 1e-6:
            found += _bracketed({'split': k + 1, 'at': _lifted(drawn, known)[k]}, near, near)
            found += _bracketed({'split': k + 1, 'speed': speed}, near, near)
    return found


def _bracketed(node: dict[str, Any], below: float, above: float) -> list[Part]:
    """Return two splits, between which a flight is."""
    name = 'at' if 'at' in node else 'speed'
    return [({**node, name: float(node[name] + off)}, i, 2) for i, off in ((1, -below), (0, above))]


def _split(drawn: Flight, known: dict[str, Any], rng: Rng) -> list[Part]:
    """Return a split, with which of its parts a flight is in, and how many there are; or none."""
    problem = drawn.case.problem
    k, off = int(rng.integers(problem.horizon)), 10.0 ** rng.uniform(-6, 0.5) * rng.choice([-1, 1])
    heading, node = drawn.plan.rotations[k + 1, :, 0], {'split': k + 1}
    speed, kind = float(np.linalg.norm(heading)), int(rng.choice(4, p=[0.4, 0.2, 0.2, 0.2]))
    if kind == 0 and problem.dimension == 2 and speed > 1e-6:
        both = abs(off) * rng.uniform(), abs(off)
        return _bracketed({**node, 'at': _lifted(drawn, known)[k]}, *rng.permutation(both))
    if kind == 1:
        return [({**node, 'speed': float(speed + 0.1 * off)}, int(off < 0), 2)]
    if kind == 2 and problem.floor.shape == 'polygon' and problem.dimension == 2:
        ways = normals(2, problem.floor.faces) @ heading
        inside = np.flatnonzero(ways >= problem.floor.fraction)
        return [(node, int(rng.choice(inside)), problem.floor.faces)] if len(inside) else []
    walls = known.get('limits', {}).get('walls', [])
    return _beside(drawn, walls, k, off, rng) if kind == 3 and walls else []


def _lifted(drawn: Flight, known: dict[str, Any]) -> np.ndarray:
    """Return the directions of R_1 e1..R_N e1 as they are counted."""
    z = drawn.plan.rotations[:, :, 0]
    angles = np.arctan2(z[1:, 1], z[1:, 0])
    if 'origins' in known:
        origins = np.array(known['origins'])
        return np.asarray(origins + (angles - origins) % (2.0 * np.pi))
    ahead = drawn.case.state.attitude[:, 0]
    turns = np.diff(np.concatenate([[math.atan2(ahead[1], ahead[0])], angles]))
    return np.asarray(
        math.atan2(ahead[1], ahead[0]) + np.cumsum((turns + np.pi) % (2 * np.pi) - np.pi)
    )


def _beside(drawn: Flight, walls: list[dict[str, Any]], k: int, off: float, rng: Rng) -> list[Part]:
    """Return a split by the sides of a body, where a flight is on one."""
    j, n = int(rng.integers(len(walls))), drawn.case.problem.dimension
    wall, node = walls[j], {'split': k + 1, 'wall': j}
    points = _points(drawn, wall, k)
    grown = wall['grown'][k] if 'grown' in wall else 0.0
    if 'min' in wall:
        low, high = np.array(wall['min']) - grown, np.array(wall['max']) + grown
        outside = np.concatenate([low - points, points - high], axis=1).min(axis=0)
        sides = np.flatnonzero(outside > 1e-12)
        return [(node, int(rng.choice(sides)), 2 * n)] if len(sides) else []
    if n == 3:
        return []
    nearest_one = _nearest(points - np.array(wall['centre']))
    if np.linalg.norm(nearest_one) < wall['radius'] + grown + 1e-12:
        return []
    angle = math.atan2(nearest_one[1], nearest_one[0]) % (2.0 * np.pi)
    return [({**node, 'at': float(angle + off)}, int(off < 0), 2)]


def _points(drawn: Flight, wall: dict[str, Any], k: int) -> np.ndarray:
    """Return the places of a step that are on one side of a wall, as seen from it."""
    plan, problem = drawn.plan, drawn.case.problem
    degree = problem.translation.degree
    (begin, end), (out, back) = plan.positions[k : k + 2], plan.velocities[k : k + 2]
    lead = problem.step / degree
    inner = [[], [begin + lead * out], [begin + lead * out, end - lead * back]][degree - 1]
    points = np.array([begin, *inner, end])
    if 'shifts' in wall:
        first, last = np.array(wall['shifts'])[k : k + 2]
        points = points - first - np.linspace(0.0, 1.0, len(points))[:, None] * (last - first)
    return {'end': points[-1:], 'ends': points[[0, -1]] if k else points[-1:], 'step': points}[
        wall['of']
    ]


def _nearest(points: np.ndarray) -> np.ndarray:
    """Return the point of a hull in the plane that is nearest to 0, which is outside of it."""
    found = []
    for a in points:
        for b in points:
            way = b - a
            share = np.clip(-(a @ way) / max(way @ way, 1e-300), 0.0, 1.0)
            found.append(a + share * way)
    return min(found, key=lambda each: float(each @ each))


def _leaf(
    drawn: Flight,
    posed: StatedProblem,
    region: Region,
    rng: Rng,
    refutes: bool,
) -> dict[str, Any]:
    """Return a leaf with some multipliers, each of any size."""
    horizon, n, width, made = posed.horizon, posed.n, posed.width, {}

    def some(*shape: int) -> np.ndarray:
        few = rng.random(shape[:1] + (1,) * (len(shape) - 1)) < 0.6
        return np.asarray(10.0 ** rng.uniform(-3, 3) * few * rng.normal(size=shape))

    if not refutes and _sometimes(rng, 0.8):
        x = np.array([coordinates(each)[:width] for each in drawn.plan.rotations[1:]])
        off = rng.choice([0.0, 1e-4, 1e-2, 1.0]) * rng.normal(size=x.shape)
        made['point'] = (x + off) if not _sometimes(rng, 0.1) else off
    if _sometimes(rng, 0.3):
        made['bends'] = some(horizon)
    if posed.arrives and _sometimes(rng, 0.7):
        made['pull'] = some(n * (1 + posed.model.inertial))
    if posed.arrives and _sometimes(rng, 0.2):
        made['stiffness'] = abs(some(1)[0])
    if width == 9:
        made['tops'] = np.abs(some(horizon))
    if _sometimes(rng, 0.4):
        held = [
            bool(posed.limits.cones[k]) or region.faces[k] is not None or width == 9
            for k in range(horizon)
        ]
        made['shares'] = np.array(held)[:, None] * some(horizon, n)
    if region.rows and _sometimes(rng, 0.7):
        made['presses'] = np.abs(some(len(region.rows)))
    if posed.limits.slope and _sometimes(rng, 0.8):
        made['slides'] = _slides(rng, drawn, horizon)
    if posed.limits.tether and _sometimes(rng, 0.5):
        made['tethers'] = some(horizon, n)
    if posed.radius is not None and _sometimes(rng, 0.5):
        made['meets'] = some(n)
    return {name: np.asarray(each).tolist() for name, each in made.items()}


def _slides(rng: Rng, drawn: Flight, horizon: int) -> np.ndarray:
    """Return vectors that are as steep as a glide slope asks for, or by any factor less so."""
    down, way = 10.0 ** rng.uniform(-3, 3, (horizon, 1)), rng.normal(size=(horizon, 2))
    if _sometimes(rng, 0.5):  # to where a flight is from the goal
        way = (drawn.plan.positions[1:] - drawn.case.goals)[:horizon, :2] + 1e-12
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    steep = math.tan(drawn.case.problem.glide_slope)
    steep *= rng.choice([1.0 - HAIR, 10.0 ** rng.uniform(-3, 5)])
    return down * np.concatenate([steep * way, -np.ones((horizon, 1))], axis=1)
