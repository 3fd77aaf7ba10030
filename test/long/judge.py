# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planning problem stated once more, in plain NumPy: what a plan costs, and what it violates.

Written from the problem's definition alone. It shares no code with the package: whatever the
package believes about its own plans is measured against this file.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import Any

import numpy as np

Array = np.ndarray
GOLDEN = (1.0 + np.sqrt(5.0)) / 2.0


@dataclass(frozen=True)
class PosedProblem:
    """One problem, from the mapping that ``orbimpc solve`` takes.

    Beyond that mapping its state may have an ``attitude`` and a ``coasted`` rotation.
    """

    mapping: dict[str, Any]
    n: int
    rotation_order: int
    translation_order: int
    horizon: int
    step: float
    forward: float
    position: Array
    rotation: Array
    attitude: Array
    velocity: Array
    rotation_rate: Array
    coasted: Array | None
    goals: Array
    weights: dict[str, float]
    arrives: bool
    floor: dict[str, Any]
    max_rate: float
    boxes: list[tuple[Array, Array]] = field(default_factory=list)
    shares_faces: bool = False
    disturbance: Array | float = 0.0
    exact: bool = False

    @property
    def unit(self) -> float:
        """The length flown, or gained by thrust, in a step [m]."""
        return self.forward * self.step**self.translation_order

    @property
    def has_floor(self) -> bool:
        return self.floor['shape'] != 'none'

    @property
    def first_free(self) -> int:
        """The first k whose R_k the inputs decide."""
        return 1 if self.rotation_order == 1 else 2

    @property
    def natural_cost(self) -> float:
        """A size of the cost: of standing still, and of turning and flying at the full rate."""
        w, steps = self.weights, self.horizon
        away = np.sum((self.goals - self.position) ** 2, axis=1) + self.unit**2
        turning = steps * self.n / self.step ** (2 * self.rotation_order)
        return (
            w['position'] * away.sum()
            + w['terminal'] * away[-1]
            + w['input'] * turning
            + w['length'] * steps * self.step * self.forward
        )


def case_of(mapping: dict[str, Any]) -> PosedProblem:
    state, n, steps = mapping['state'], mapping['dimension'], mapping['horizon']
    rotation = np.array(state['rotation'], dtype=float)
    goal = np.array(mapping['goal'], dtype=float)
    coasted = state.get('coasted')
    return PosedProblem(
        mapping=mapping,
        n=n,
        rotation_order=mapping['rotation_order'],
        translation_order=mapping['translation_order'],
        horizon=steps,
        step=mapping['step'],
        forward=mapping['forward'],
        position=np.array(state['position'], dtype=float),
        rotation=rotation,
        attitude=np.array(state.get('attitude', nearest_rotation(rotation))),
        velocity=np.array(state.get('velocity', np.zeros(n)), dtype=float),
        rotation_rate=np.array(state.get('rotation_rate', np.zeros((n, n))), dtype=float),
        coasted=None if coasted is None else np.array(coasted),
        goals=np.tile(goal, (steps, 1)) if goal.ndim == 1 else goal,
        weights={**dict.fromkeys(('position', 'input', 'length', 'terminal'), 0.0)}
        | mapping['weights'],
        arrives=mapping.get('terminal', 'penalty') == 'constraint',
        floor=mapping.get('floor', {'shape': 'none'}),
        max_rate=mapping.get('max_rate', 0.0),
        boxes=[(np.array(b['min']), np.array(b['max'])) for b in mapping.get('obstacles', [])],
        shares_faces=mapping.get('no_corner_cutting', False),
        disturbance=np.array(state.get('disturbance', np.zeros(n)), dtype=float),
        exact=mapping.get('discretisation') == 'exact',
    )


def nearest_rotation(matrix: Array) -> Array:
    """The rotation nearest to a matrix: its polar factor, with determinant +1."""
    u, _, vt = np.linalg.svd(matrix)
    signs = np.ones(len(matrix))
    signs[-1] = np.sign(np.linalg.det(u @ vt))
    return u @ np.diag(signs) @ vt


# --- dynamics and cost


def rollout(case: PosedProblem, rotations: Array) -> tuple[Array, Array]:
    """s_0..s_N and p_0..p_N of rotations R_0..R_N.

    Explicit Euler, old values on the right; or, exact, the integrals over steps in which the thrust
    axis moves on the chord from the old to the new, by Gauss's rule, which is exact for parabolas.
    """
    h, z, w = case.step, case.forward, case.disturbance
    s, p = [case.position], [case.velocity]
    for old, new in itertools.pairwise(rotations[:, :, 0]):
        if not case.exact:
            pushed = z * old + w
            s.append(s[-1] + h * (pushed if case.translation_order == 1 else p[-1]))
            p.append(p[-1] + h * pushed)
            continue
        points = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)
        pushes = [z * ((1.0 - share) * old + share * new) + w for share in points]
        gained = 0.5 * h * sum(pushes)
        if case.translation_order == 1:
            s.append(s[-1] + gained)
        else:
            late = [(1.0 - share) * push for share, push in zip(points, pushes, strict=True)]
            s.append(s[-1] + h * p[-1] + 0.5 * h * h * sum(late))
        p.append(p[-1] + gained)
    return np.array(s), np.array(p)


def inputs(case: PosedProblem, rotations: Array) -> Array:
    """u_k. At rotation order 2 the last one moves nothing that is seen: it is zero, and absent."""
    rates = np.diff(rotations, axis=0) / case.step
    return rates if case.rotation_order == 1 else np.diff(rates, axis=0) / case.step


def cost(case: PosedProblem, rotations: Array) -> float:
    """The objective of rotations R_0..R_N, shape (N + 1, n, n)."""
    w = case.weights
    miss = np.sum((rollout(case, rotations)[0][1:] - case.goals) ** 2, axis=1)
    speeds = np.linalg.norm(rotations[:, :, 0], axis=1)
    speeds = 0.5 * (speeds[:-1] + speeds[1:]) if case.exact else speeds[:-1]
    return float(
        w['position'] * miss.sum()
        + w['input'] * np.sum(inputs(case, rotations) ** 2)
        + w['length'] * case.step * case.forward * speeds.sum()
        + w['terminal'] * miss[-1]
    )


# --- constraints: every margin is negative by as much as it is violated


def orbitope_margin(rotation: Array) -> float:
    """How far a matrix lies inside conv SO(n)."""
    if len(rotation) == 2:
        (a, c), (b, d) = rotation
        askew = max(abs(a - d), abs(b + c))
        return min(1.0 - float(np.hypot(a, b)), 1e-12 - askew if askew > 1e-12 else np.inf)
    return float(np.linalg.eigvalsh(4.0 * quaternion_moments(rotation))[0])


def quaternion_moments(r: Array) -> Array:
    """Z with trace 1 that is q q^T for a rotation by q = (w, x, y, z); PSD exactly on the hull."""
    t = np.trace(r)
    z = np.zeros((4, 4))
    z[0, 0] = 1.0 + t
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        z[i + 1, i + 1] = 1.0 - t + 2.0 * r[i, i]
        z[0, i + 1] = z[i + 1, 0] = r[k, j] - r[j, k]
        z[j + 1, k + 1] = z[k + 1, j + 1] = r[j, k] + r[k, j]
    return z / 4.0


def faces(case: PosedProblem) -> Array:
    """The unit normals of the floor's faces."""
    if case.n == 2:
        angles = 2.0 * np.pi * np.arange(case.floor['faces']) / case.floor['faces']
        return np.stack([np.cos(angles), np.sin(angles)], axis=1)
    corners = {
        6: [s * e for s in (-1.0, 1.0) for e in np.eye(3)],
        12: [np.roll((0.0, a, b * GOLDEN), i) for i in range(3) for a in (-1, 1) for b in (-1, 1)],
        20: [(a, b, c) for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)]
        + [
            np.roll((0.0, a / GOLDEN, b * GOLDEN), i)
            for i in range(3)
            for a in (-1, 1)
            for b in (-1, 1)
        ],
    }[case.floor['faces']]
    return np.array([np.array(c) / np.linalg.norm(c) for c in corners])


def widest(case: PosedProblem) -> float:
    """The speed at which every heading is beyond the floor: fraction, or fraction / inradius."""
    if case.floor['shape'] != 'polygon':
        return case.floor.get('fraction', 0.0)
    if case.n == 2:
        return case.floor['fraction'] / np.cos(np.pi / case.floor['faces'])
    ratio = {6: np.sqrt(1.0 / 3.0)}.get(
        case.floor['faces'], np.sqrt((5.0 + 2.0 * np.sqrt(5.0)) / 15.0)
    )
    return case.floor['fraction'] / ratio


def floor_margin(case: PosedProblem, heading: Array) -> float:
    if not case.has_floor:
        return np.inf
    if case.floor['shape'] == 'circle':
        return float(np.linalg.norm(heading)) - case.floor['fraction']
    return float((faces(case) @ heading).max()) - case.floor['fraction']


def rate_margin(case: PosedProblem, rotations: Array) -> float:
    """How far below the rate limit R_0..R_N turn.

    With a floor the limit turns and does not brake: steps may change the speed as they like, and
    only angles count, the first one from the attitude's own axis; at rotation order 2 the body's
    rate has decided that angle already.
    """
    if not case.max_rate:
        return np.inf
    angle = case.step * case.max_rate
    headings = rotations[:, :, 0]
    if not case.has_floor:
        chords = np.linalg.norm(np.diff(headings, axis=0), axis=1)
        return float(2.0 * np.sin(angle / 2.0) - chords.max())
    axes = [case.attitude[:, 0], *headings[1:]][case.rotation_order - 1 :]
    return min((angle - angle_between(a, b) for a, b in itertools.pairwise(axes)), default=np.inf)


def angle_between(a: Array, b: Array) -> float:
    """The angle of two vectors, exact where they are nearly parallel, too."""
    a, b = a / np.linalg.norm(a), b / max(np.linalg.norm(b), 1e-300)
    return 2.0 * float(np.arctan2(np.linalg.norm(a - b), np.linalg.norm(a + b)))


def clearances(box: tuple[Array, Array], points: Array) -> Array:
    """How far points, shape (K, n), are beyond each of a box's 2n sides, shape (K, 2n) [m]."""
    return np.concatenate([box[0] - points, points - box[1]], axis=1)


def box_margin(case: PosedProblem, positions: Array) -> float:
    """How far s_1..s_N stay outside of every box [m]."""
    margins = [np.inf]
    for box in case.boxes:
        beyond = clearances(box, positions[1:])
        margins.append(beyond.max(axis=1).min())
        if case.shares_faces and len(beyond) > 1:
            margins.append(np.minimum(beyond[:-1], beyond[1:]).max(axis=1).min())
    return float(min(margins))


def arrival_miss(case: PosedProblem, positions: Array, velocities: Array) -> Array:
    """s_N - g_N and, at translation order 2, h p_N [m]; empty without a terminal constraint."""
    if not case.arrives:
        return np.zeros(0)
    miss = positions[-1] - case.goals[-1]
    if case.translation_order == 1:
        return miss
    return np.concatenate([miss, case.step * velocities[-1]])


def start_error(case: PosedProblem, rotations: Array) -> float:
    """How far R_0, and R_1 at rotation order 2, are from what the state decides."""
    error = float(np.abs(rotations[0] - case.rotation).max())
    if case.rotation_order == 1:
        return error
    if case.coasted is None:
        decided = case.rotation + case.step * case.rotation_rate
    else:
        share = float(np.sum(rotations[1] * case.coasted)) / case.n
        decided = np.clip(share, 0.0, 1.0) * case.coasted
    return max(error, float(np.abs(rotations[1] - decided).max()))


def violations(case: PosedProblem, rotations: Array) -> dict[str, float]:
    """By how much rotations R_0..R_N break each constraint; lengths in units of a step's.

    Positions far from the origin cannot be known better than their last digit.
    """
    positions, velocities = rollout(case, rotations)
    unit, digit = case.unit, 1e-14 * (np.abs(positions).max() + np.abs(case.goals).max())
    miss = np.abs(arrival_miss(case, positions, velocities)).max(initial=0.0)
    return {
        'start': start_error(case, rotations),
        'orbitope': max(0.0, -min(orbitope_margin(r) for r in rotations[1:])),
        'floor': max(0.0, -min(floor_margin(case, r[:, 0]) for r in rotations[1:])),
        'max_rate': max(0.0, -rate_margin(case, rotations)),
        'obstacle': max(0.0, -box_margin(case, positions) - digit) / unit,
        'terminal': max(0.0, miss - digit) / unit,
    }


def worst(case: PosedProblem, rotations: Array) -> float:
    return max(violations(case, rotations).values())


# --- trajectories that need no solver


def first_rotation(case: PosedProblem, speed: float) -> Array:
    """R_1 where the state decides its direction: at rotation order 2."""
    if case.coasted is None:
        return case.rotation + case.step * case.rotation_rate
    return speed * case.coasted


def held(case: PosedProblem) -> list[Array]:
    """Trajectories that hold the present rotation, at its speed and at the floor's."""
    now = float(np.linalg.norm(case.rotation[:, 0]))
    found = []
    for speed in (now, max(now, min(1.0, widest(case))), 1.0):
        kept = case.rotation if speed == now else speed * case.attitude
        if case.rotation_order == 2:
            kept = first_rotation(case, speed)
        found.append(np.concatenate([case.rotation[None], np.tile(kept, (case.horizon, 1, 1))]))
    return found
