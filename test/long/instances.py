# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Random planning problems, each from a seed and an index alone."""

from __future__ import annotations

import itertools
from typing import Any

import judge
import numpy as np

Array = np.ndarray
ROUTES = [
    {'dimension': n, 'rotation_order': r, 'translation_order': t, 'shape': shape}
    for shape, n, r, t in itertools.product(('none', 'polygon', 'circle'), (2, 3), (1, 2), (1, 2))
]
DEFAULTS = {'position': 1.0, 'input': 0.05, 'length': 0.0, 'terminal': 10.0}
DEADLINES = (0.05, 0.2, 1.0)  # [s]


def draw(seed: int, index: int, *, file: bool = False) -> dict[str, Any]:
    """The mapping of one problem; ``file`` leaves out what ``orbimpc solve`` does not take."""
    rng = np.random.default_rng([seed, index])
    route = ROUTES[index % len(ROUTES)]
    mapping = {
        **{name: route[name] for name in route if name != 'shape'},
        'horizon': round(10.0 ** rng.uniform(0.0, 2.0)),
        'step': log_uniform(rng, 0.02, 2.0),
        'forward': log_uniform(rng, 0.1, 1000.0),
        'weights': weights(rng),
        'floor': floor(rng, route),
    }
    if rng.random() < 0.35:
        mapping['max_rate'] = log_uniform(rng, 0.02, np.pi * 0.999) / mapping['step']
    mapping['state'] = state(rng, mapping, file=file)
    disturb(np.random.default_rng([seed, index, 2]), mapping)
    mapping['goal'] = [0.0] * route['dimension']
    aim(rng, mapping)
    return mapping


def deadline(seed: int, index: int) -> float:
    """How long the solver may take [s]."""
    return float(np.random.default_rng([seed, index, 1]).choice(DEADLINES))


def route_of(mapping: dict[str, Any]) -> str:
    """A problem's kind in a few letters."""
    shape = mapping['floor']['shape']
    extras = {
        'rate': mapping.get('max_rate'),
        'boxes': mapping.get('obstacles'),
        'arrival': mapping.get('terminal') == 'constraint',
        'exact': mapping.get('discretisation') == 'exact',
        'disturbed': 'disturbance' in mapping['state'],
    }
    orders = f'{mapping["rotation_order"]}{mapping["translation_order"]}'
    return '+'.join(
        [f'{mapping["dimension"]}D {orders} {shape}', *(e for e in extras if extras[e])]
    )


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def weights(rng: np.random.Generator) -> dict[str, float]:
    if rng.random() < 0.25:
        return dict(DEFAULTS)
    return {name: weight(rng, usual) for name, usual in DEFAULTS.items()}


def weight(rng: np.random.Generator, usual: float) -> float:
    kind = rng.random()
    if kind < 0.15:
        return 0.0
    return usual if kind < 0.35 else log_uniform(rng, 1e-6, 1e6)


def floor(rng: np.random.Generator, route: dict[str, Any]) -> dict[str, Any]:
    shape = route['shape']
    if shape == 'none':
        return {'shape': 'none'}
    known: dict[str, Any] = {'shape': shape, 'fraction': 1.0}
    if shape == 'polygon':
        solids = (6, 12, 20)
        known['faces'] = int(rng.choice((3, 4, 5, 6, 8, 16) if route['dimension'] == 2 else solids))
    # Against the widest case: a fraction f of what is possible.
    probe = judge.widest(_bare(route['dimension'], known))
    most = 1.0 if shape == 'circle' else 0.9
    share = rng.choice([rng.uniform(0.02, 1.0), rng.uniform(0.3, 0.8), most])
    known['fraction'] = float(share / probe)
    return known


def _bare(n: int, known: dict[str, Any]) -> judge.PosedProblem:
    """A case that has a floor and nothing else."""
    return judge.case_of(
        {
            'dimension': n,
            'rotation_order': 1,
            'translation_order': 1,
            'horizon': 1,
            'step': 1.0,
            'forward': 1.0,
            'weights': {},
            'floor': known,
            'state': {'position': [0.0] * n, 'rotation': np.eye(n).tolist()},
            'goal': [0.0] * n,
        }
    )


# --- where the vehicle is


def rotation(rng: np.random.Generator, n: int, largest: float = np.pi) -> Array:
    """A rotation by a random angle about a random axis."""
    return turn(rng.normal(size=1 if n == 2 else 3), rng.uniform(0.0, largest))


def turn(axis: Array, angle: float) -> Array:
    """The rotation by an angle [rad] about an axis, shape (1,) (a sign) or (3,)."""
    c, s = np.cos(angle), np.sin(angle)
    if len(axis) == 1:
        s = s * (1.0 if axis[0] >= 0.0 else -1.0)
        return np.array([[c, -s], [s, c]])
    x, y, z = axis / np.linalg.norm(axis)
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return judge.nearest_rotation(np.eye(3) + s * k + (1.0 - c) * (k @ k))


def state(rng: np.random.Generator, mapping: dict[str, Any], *, file: bool) -> dict[str, Any]:
    n, h, z = mapping['dimension'], mapping['step'], mapping['forward']
    attitude = rotation(rng, n)
    speed = float(rng.choice([1.0, rng.uniform(0.3, 1.0), rng.uniform(0.001, 1.0)]))
    if not file and rng.random() < 0.1:
        speed = 0.0
    away = float(rng.choice([0.0, 1.0, 100.0 * mapping['horizon']]))
    unit = z * h ** mapping['translation_order']
    known = {
        'position': (away * unit * rng.normal(size=n)).tolist(),
        'rotation': (speed * attitude).tolist(),
    }
    if speed == 0.0:  # else the rotation says it
        known['attitude'] = attitude.tolist()
    if mapping['translation_order'] == 2:
        known['velocity'] = (rng.uniform(0.0, 2.0) * h * z * rng.normal(size=n)).tolist()
    if mapping['rotation_order'] == 2:
        known |= _turning(rng, mapping, attitude, speed, file=file)
    return known


def _turning(
    rng: np.random.Generator, mapping: dict[str, Any], attitude: Array, speed: float, *, file: bool
) -> dict[str, Any]:
    """What the body's rate makes of R_1: of its direction alone, or of all of it."""
    n, h = mapping['dimension'], mapping['step']
    largest = min(0.5, h * mapping.get('max_rate', 1e9))
    turned = attitude @ rotation(rng, n, largest)
    if not file and rng.random() < 0.7:
        return {'coasted': turned.tolist()}
    least = min(1.0, judge.widest(_bare(n, mapping['floor'])))
    following = min(1.0, max(speed, least * (1.0 + 1e-6)))  # decided, so no closer than that
    return {'rotation_rate': ((following * turned - speed * attitude) / h).tolist()}


def disturb(rng: np.random.Generator, mapping: dict[str, Any]) -> None:
    """Give some problems a wind or an acceleration, and others exact integration, or both."""
    if rng.random() < 0.4:
        size = mapping['forward'] * rng.choice([rng.uniform(0.0, 0.5), rng.uniform(0.5, 1.5)])
        axis = rng.normal(size=mapping['dimension'])
        mapping['state']['disturbance'] = (size * axis / np.linalg.norm(axis)).tolist()
    if rng.random() < 0.4:
        mapping['discretisation'] = 'exact'


# --- where it should go, and what is in the way


def witness(rng: np.random.Generator, case: judge.PosedProblem) -> Array:
    """A trajectory that turns at random within its limits, shape (N + 1, n, n)."""
    now = float(np.linalg.norm(case.rotation[:, 0]))
    speed = min(1.0, max(now, judge.widest(case)))
    limit = min(case.step * case.max_rate or np.pi, rng.choice([0.1, 0.7])) * 0.999
    axis = rng.normal(size=1 if case.n == 2 else 3)
    rotations = [case.rotation, judge.first_rotation(case, speed)][: case.rotation_order]
    turned = case.attitude
    if case.rotation_order == 2:
        turned, speed = _split(rotations[-1], turned)
    while len(rotations) <= case.horizon:
        axis = axis + 0.5 * rng.normal(size=axis.shape)
        turned = turned @ turn(axis, limit * rng.random())
        rotations.append(speed * turned)
    return np.array(rotations)


def _split(matrix: Array, otherwise: Array) -> tuple[Array, float]:
    """A scaled rotation as its rotation and its scale."""
    scale = float(np.linalg.norm(matrix[:, 0]))
    return (judge.nearest_rotation(matrix), scale) if scale > 1e-12 else (otherwise, scale)


def aim(rng: np.random.Generator, mapping: dict[str, Any]) -> None:
    """Give a problem its goal, its terminal constraint and its boxes."""
    case = judge.case_of(mapping)
    path = witness(rng, case)
    if rng.random() < 0.2:
        _arrive(rng, mapping, path)
    else:
        _go(rng, mapping)
    if rng.random() < 0.25:
        obstruct(rng, mapping, path)


def _arrive(rng: np.random.Generator, mapping: dict[str, Any], path: Array) -> None:
    mapping['terminal'] = 'constraint'
    if mapping['translation_order'] == 2:  # at rest at the end: start as fast as that needs
        case = judge.case_of(mapping)
        gained = judge.rollout(case, path)[1][-1] - case.velocity
        mapping['state']['velocity'] = (-gained).tolist()
    mapping['goal'] = judge.rollout(judge.case_of(mapping), path)[0][-1].tolist()
    if rng.random() < 0.1:
        far = 100.0 * mapping['horizon'] * mapping['forward'] * mapping['step']
        mapping['goal'] = [mapping['goal'][0] + far, *mapping['goal'][1:]]


def _go(rng: np.random.Generator, mapping: dict[str, Any]) -> None:
    n, steps = mapping['dimension'], mapping['horizon']
    time = steps * mapping['step']
    reach = mapping['forward'] * (time if mapping['translation_order'] == 1 else 0.5 * time**2)
    direction = rng.normal(size=n)
    direction /= np.linalg.norm(direction)
    distance = reach * rng.choice([0.0, rng.uniform(0.0, 0.3), rng.uniform(0.5, 1.2), 3.0, 100.0])
    goal = np.array(mapping['state']['position']) + distance * direction
    if rng.random() < 0.3:
        drift = reach / steps * 0.3 * rng.normal(size=(steps, n))
        mapping['goal'] = (goal + np.cumsum(drift, axis=0)).tolist()
    else:
        mapping['goal'] = goal.tolist()


def obstruct(rng: np.random.Generator, mapping: dict[str, Any], path: Array) -> None:
    """Put boxes beside the way, or onto it, with what the state decides mostly left free."""
    case = judge.case_of(mapping)
    positions, boxes = judge.rollout(case, path)[0], []
    decided = positions[: 1 + case.translation_order]
    reach = float(np.linalg.norm(positions - positions[0], axis=1).max()) + case.unit
    for _ in range(rng.integers(1, 4)):
        half = reach * rng.uniform(0.02, 0.3, size=case.n)
        onto = positions[rng.integers(len(positions))] + 2.0 * half * rng.normal(size=case.n)
        box = (onto - half, onto + half)
        if judge.clearances(box, decided).max(axis=1).min() > 0.0 or rng.random() < 0.05:
            boxes.append({'min': box[0].tolist(), 'max': box[1].tolist()})
    if boxes:
        mapping['obstacles'] = boxes
        mapping['no_corner_cutting'] = bool(rng.random() < 0.4)
