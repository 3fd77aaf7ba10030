# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Random problems of every kind that certificates are of, and mutants of certificates."""

from __future__ import annotations

import copy
import itertools
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import problems

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

ARRIVES = {'terminal': 'constraint'}
KINDS: dict[str, dict[str, Any]] = {
    'hull': {},
    'hull, exact': {'discretisation': 'exact'},
    'hull, inertia': {'translation_order': 2},
    'hull, coasting': {'rotation_order': 2, 'translation_order': 2},
    'hull, length': {'length': 0.3},
    'hull, arrival': ARRIVES,
    'hull, inertia, arrival': {'translation_order': 2, **ARRIVES},
    'hull, inertia, soft arrival': {'translation_order': 2, 'arrival_weight': 5.0},
    'polygon': {'floor': Floor('polygon', 4, 0.5)},
    'circle': {'floor': Floor('circle', fraction=0.6)},
    'circle, constant speed': {'floor': Floor('circle', fraction=1.0)},
    'circle, length': {'floor': Floor('circle', fraction=0.6), 'length': 0.3},
    'circle, turn rate': {'floor': Floor('circle', fraction=0.6), 'max_rate': 0.7},
    'shell': {'dimension': 3, 'floor': Floor('circle', fraction=0.6), 'input': 0.0},
    'space': {'dimension': 3},
    'space, coasting': {'dimension': 3, 'rotation_order': 2, 'translation_order': 2},
    'space, arrival': {'dimension': 3, **ARRIVES},
}
# Beside bodies, and within cones.
LIMITED: dict[str, dict[str, Any]] = {
    'boxes': {'bodies': 3},
    'boxes, shared faces': {'bodies': 3, 'no_corner_cutting': True},
    'boxes, inertia': {'bodies': 2, 'translation_order': 2},
    'boxes that move': {'hazards': 2},
    'discs': {'discs': 2},
    'discs that move': {'discs': 2, 'hazards': 1},
    'space, boxes': {'dimension': 3, 'bodies': 2},
    'axes, boxes': {'dimension': 3, 'bodies': 2, 'input': 0.0},
    'approach': {'approach': Approach(0.3, (1.0, 0.5))},
    'space, approach': {'dimension': 3, 'approach': Approach(0.2, (1.0, 0.5, 0.1))},
    'cones': {
        'dimension': 3,
        'translation_order': 2,
        'tilt': 0.3,
        'glide_slope': 0.4,
        'length': 0.05,
        'floor': Floor('circle', fraction=0.1),
    },
}
# Turns and changes of speed, but for floors in the plane.
TIED: dict[str, dict[str, Any]] = {
    'turn rate': {'max_rate': 0.5},
    'turn rate, inertia': {'translation_order': 2, 'max_rate': 0.5},
    'turn rate, exact': {'discretisation': 'exact', 'max_rate': 0.3},
    'turn rate, length': {'max_rate': 0.5, 'length': 0.3},
    'turn rate, arrival': {'max_rate': 1.2, **ARRIVES},
    'turn rate, boxes': {'max_rate': 1.0, 'bodies': 2},
    'space, turn rate': {'dimension': 3, 'max_rate': 0.5},
    'axes, turn rate': {'dimension': 3, 'max_rate': 0.5, 'input': 0.0},
    'space, turn rate, inertia': {'dimension': 3, 'translation_order': 2, 'max_rate': 0.5},
    'acceleration': {'max_acceleration': 0.2},
    'space, acceleration': {'dimension': 3, 'max_acceleration': 0.2},
}
# Certificates of these take what a method leaves of its proof.
LEFT: dict[str, dict[str, Any]] = {
    'polygon, turn rate': {'floor': Floor('polygon', 6, 0.6), 'max_rate': 0.7},
    'circle, arrival': {'floor': Floor('circle', fraction=0.6), **ARRIVES},
    'circle, length, arrival': {'floor': Floor('circle', fraction=0.6), 'length': 0.3, **ARRIVES},
    'circle, arrival, acceleration': {
        'floor': Floor('circle', fraction=0.6),
        'max_acceleration': 0.2,
        **ARRIVES,
    },
    'shell, arrival': {
        'dimension': 3,
        'floor': Floor('circle', fraction=0.6),
        'input': 0.0,
        **ARRIVES,
    },
    'space, coasting, length': {
        'dimension': 3,
        'rotation_order': 2,
        'translation_order': 2,
        'length': 0.3,
    },
}
# Changes of speed above a floor in the plane, and ways round to a cone: what one search splits.
PACED: dict[str, dict[str, Any]] = {
    'circle, acceleration': {
        'floor': Floor('circle', fraction=0.8),
        'max_acceleration': 0.05,
        'horizon': 4,
    },
    'circle, turn rate, acceleration': {
        'floor': Floor('circle', fraction=0.7),
        'max_rate': 0.4,
        'max_acceleration': 0.03,
    },
    'circle, turn rate, approach': {
        'floor': Floor('circle', fraction=0.6),
        'max_rate': 0.9,
        'approach': Approach(0.4, (1.0, 0.5)),
    },
    'polygon, turn rate, approach': {
        'floor': Floor('polygon', 6, 0.6),
        'max_rate': 0.9,
        'approach': Approach(0.4, (1.0, 0.5)),
    },
    'wing': {
        'floor': Floor('circle', fraction=0.7),
        'max_rate': 0.5,
        'max_acceleration': 0.03,
        'approach': Approach(0.5, (1.0, 0.5)),
    },
}


def case(kind: str, rng: np.random.Generator, longest: int = 7) -> Case:
    """Return a problem of a kind with a state and goals within its reach.

    The state is at full speed, but where plans know that speeds change slowly.
    """
    given = dict((KINDS | LIMITED | TIED | LEFT | PACED)[kind])
    bodies, hazards = given.pop('bodies', 0), given.pop('hazards', 0)
    discs = given.pop('discs', 0)
    weights = Weights(1.0, given.pop('input', 0.05), given.pop('length', 0.0), 10.0)
    horizon = int(rng.integers(4, longest + 1))
    horizon = given.pop('horizon', horizon)
    step, forward = 10.0 ** rng.uniform(-1, 0), 10.0 ** rng.uniform(-0.5, 1)
    if 'max_rate' in given:
        given['max_rate'] = given['max_rate'] / step
    if 'max_acceleration' in given:
        given['max_acceleration'] = given['max_acceleration'] * forward / step
    problem = Problem(horizon=horizon, step=step, forward=forward, weights=weights, **given)
    n, unit = problem.dimension, problem.length_unit
    attitude = problems.rotation(rng, n)
    extra: dict[str, Any] = {'velocity': 0.1 * rng.normal(size=n) * unit / step}
    coasted = attitude @ problems.rotation(rng, n, 0.2) if problem.rotation_order == 2 else None
    speed = rng.uniform(problem.floor.fraction, 1.0) if kind in PACED else 1.0
    state = State.at(
        rng.normal(size=n) * unit,
        speed * attitude,
        coasted=coasted,
        disturbance=0.05 * rng.normal(size=n) * unit / step ** (2 if problem.inertial else 1),
        **(extra if problem.inertial else {}),
    )
    way = rng.normal(size=n)
    reach = horizon * unit * (0.25 * horizon if problem.inertial else 1.0)
    near = 0.2 if problem.inertial else 0.5
    target = state.position + rng.uniform(0.1, near) * reach * way / np.linalg.norm(way)
    boxes = [_box(rng, state.position, target) for _ in range(bodies + hazards + discs)]
    every = [*map(_disc, boxes[:discs]), *boxes[discs:]]
    problem = replace(problem, obstacles=tuple(every[hazards:]))
    drift = 0.1 * unit / step * rng.normal(size=(hazards, n))
    moving = zip(every[:hazards], drift, strict=True)
    state = replace(state, hazards=tuple(itertools.starmap(MovingObstacle.drifting, moving)))
    return Case(problem, state, np.tile(target, (horizon, 1)))


def _box(rng: np.random.Generator, begin: np.ndarray, end: np.ndarray) -> Box:
    """Return a box on the way, that neither end is in."""
    apart = np.linalg.norm(end - begin)
    middle = begin + rng.uniform(0.4, 0.7) * (end - begin)
    size = rng.uniform(0.15, 0.25, len(begin)) * apart
    middle = middle + 0.05 * apart * rng.normal(size=len(begin)) / np.sqrt(len(begin))
    return Box(middle - size, middle + size)


def _disc(box: Box) -> Ball:
    """Return the largest disc in the middle of a box."""
    size = box.maximum - box.minimum
    return Ball(box.minimum + 0.5 * size, 0.5 * float(size.min()))


# --- mutants

Document = dict[str, Any]


def mutant(known: Document, rng: np.random.Generator) -> tuple[str, str]:
    """Return the name of a change and a certificate's text with it, no longer a proof."""
    made = copy.deepcopy(known)
    # Who may not stop, or is to end within a cone, may have to leave a goal where it is.
    stays = known['problem']['floor']['shape'] == 'none' and 'cones' not in known.get('limits', {})
    names = [name for name, change in CHANGES.items() if stays or change is not _near]
    name = names[int(rng.integers(len(names)))]
    return name, CHANGES[name](made, rng)


def leaves(node: Document) -> Iterator[Document]:
    """Yield the leaves of a tree."""
    for part in node.get('parts', ()):
        yield from leaves(part)
    if 'parts' not in node:
        yield node


def _a_leaf(known: Document, rng: np.random.Generator) -> Document:
    """Return a leaf with a tangent."""
    found = [leaf for leaf in leaves(known['tree']) if 'point' in leaf]
    return found[int(rng.integers(len(found)))]


def _raised(known: Document, rng: np.random.Generator) -> str:
    known['lower_bound'] *= 1.0 + 10.0 ** rng.uniform(-2, 1)
    return json.dumps(known)


def _near(known: Document, rng: np.random.Generator) -> str:
    """Take the goals to where the vehicle is, and with them most of the cost away."""
    known['goals'] = [known['state']['position']] * len(known['goals'])
    known['state']['disturbance'] = [0.0 * x for x in known['state']['disturbance']]
    known['state']['velocity'] = [0.0 * x for x in known['state']['velocity']]
    known['problem']['terminal'] = 'penalty'
    for leaf in leaves(known['tree']):
        leaf.pop('pull', None)
        leaf.pop('stiffness', None)
    return json.dumps(known)


def _moved(known: Document, rng: np.random.Generator) -> str:
    """Have a leaf's tangent touch far away, where it is steep."""
    for leaf in leaves(known['tree']):
        leaf.setdefault('point', [[0.0] * len(known['goals'][0])] * len(known['goals']))
        leaf['point'] = [[x + 30.0 for x in row] for row in leaf['point']]
    return json.dumps(known)


def _truncated(known: Document, rng: np.random.Generator) -> str:
    text = json.dumps(known)
    return text[: int(rng.integers(len(text)))]


def _no_number(known: Document, rng: np.random.Generator) -> str:
    _a_leaf(known, rng)['point'][0][0] = float(rng.choice([np.nan, np.inf, -np.inf]))
    return json.dumps(known)


def _without_a_leaf(known: Document, rng: np.random.Generator) -> str:
    if 'parts' in known['tree']:
        known['tree']['parts'].pop(int(rng.integers(len(known['tree']['parts']))))
    else:
        del known['tree']
    return json.dumps(known)


def _with_a_leaf_twice(known: Document, rng: np.random.Generator) -> str:
    if 'parts' in known['tree']:
        known['tree']['parts'].append(_a_leaf(known, rng))
    else:
        known['tree'] = [known['tree'], known['tree']]
    return json.dumps(known)


def _shorter(known: Document, rng: np.random.Generator) -> str:
    _a_leaf(known, rng)['point'].pop()
    return json.dumps(known)


def _another_length(known: Document, rng: np.random.Generator) -> str:
    known['problem']['horizon'] += int(rng.choice([-1, 1]))
    return json.dumps(known)


def _named_twice(known: Document, rng: np.random.Generator) -> str:
    return json.dumps(known)[:-1] + ', "lower_bound": 0.0}'


CHANGES: dict[str, Callable[[Document, np.random.Generator], str]] = {
    'a higher bound': _raised,
    'goals where the vehicle is': _near,
    'tangents from far away': _moved,
    'truncated': _truncated,
    'not a number': _no_number,
    'a leaf missing': _without_a_leaf,
    'a leaf twice': _with_a_leaf_twice,
    'a point too short': _shorter,
    'another horizon': _another_length,
    'a name twice': _named_twice,
}
