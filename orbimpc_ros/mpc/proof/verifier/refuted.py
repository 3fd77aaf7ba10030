# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Refutations: that no trajectory is feasible, or that none catches its goal in the first steps.

Where nothing costs anything, the bound of whatever is feasible is at most zero: one above it
refutes. A catch at step k is a trajectory of k steps that ends within a radius of g_k, and with its
last heading inside a cone if there is one.

Derivation: docs/proofs.md.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any, NamedTuple

from .bound import bound
from .reading import Refused, fields, items, weight, whole
from .splits import leaves, root
from .stated import MOST_STEPS, WEIGHTS, StatedProblem, posed_by

WALL = ('min', 'max', 'centre', 'radius', 'of', 'shifts', 'grown')


class Refuted(NamedTuple):
    """What refutations come to.

    Attributes:
        trees: how many there are.
        whole: how many from the first on refute.
        leaves: of all.
        step: of a catch [s]; None where nothing is to be caught.
    """

    trees: int
    whole: int
    leaves: int
    step: Fraction | None


def refuted(document: dict[str, Any]) -> Refuted:
    """Return what the refutations of a document come to."""
    fields(document['refuted'], 'refuted', ('trees',), ('radius', 'cone'))
    trees = items(document['refuted']['trees'], 'trees')
    catches = 'radius' in document['refuted']
    if not trees or (len(trees) > 1 and not catches):
        raise Refused('there are not as many trees as there is to refute')
    bounds = [_bounds(document, k, tree) for k, tree in enumerate(trees, 1)]
    holds = [min(each) > 0 for each in bounds]
    first = holds.index(False) if False in holds else len(holds)
    step = weight(document['problem']['step'], 'step') if catches else None
    return Refuted(len(trees), first, sum(map(len, bounds)), step)


def _bounds(document: dict[str, Any], k: int, tree: Any) -> list[Fraction]:
    """Return the bounds of a tree's leaves, of a catch at step k or of all steps."""
    posed, origins = refuted_by(document, k), document.get('origins')
    begun = origins if origins is None else items(origins, 'origins')[: posed.horizon]
    parts = leaves(posed, tree, root(posed, begun))
    found = [bound(posed, leaf, part) for leaf, part in parts]
    if not found:
        raise Refused('the tree has no leaf')
    return found


def refuted_by(document: dict[str, Any], k: int) -> StatedProblem:
    """Return the problem of which nothing is feasible: of a catch at step k, or of all steps."""
    claim, limits = document['refuted'], document.get('limits', {})
    if not isinstance(document['problem'], dict):
        raise Refused('problem is not a mapping')
    free = {**document['problem'], 'weights': dict.fromkeys(WEIGHTS, 0.0)}
    if 'radius' not in claim:
        if 'cone' in claim:
            raise Refused('there is a cone, but nothing to catch')
        return posed_by({**document, 'problem': free}, refutes=True)
    goals = items(document['goals'], 'goals')
    whole(k, 'the number of trees', 1, len(goals))
    begun = {
        **document,
        'problem': {**free, 'horizon': k, 'terminal': 'penalty'},
        'goals': goals[:k],
        'limits': _first_steps(limits, k, _last_cones(claim, k)),
    }
    return posed_by(begun, weight(claim['radius'], 'radius'), refutes=True)


def _last_cones(claim: dict[str, Any], k: int) -> list[dict[str, Any]]:
    """Return the cone that the last of k headings is in, if there is one."""
    if 'cone' not in claim:
        return []
    fields(claim['cone'], 'cone', ('axis', 'angle', 'least'))
    return [{**claim['cone'], 'steps': [k]}]


def _first_steps(limits: Any, k: int, last: list[dict[str, Any]]) -> dict[str, Any]:
    """Return what limits say of the first k steps, and a cone of the last one."""
    fields(limits, 'limits', (), ('cones', 'glide_slope', 'walls', 'speeds'))
    cones = [_cone(each, k) for each in items(limits.get('cones', []), 'cones')]
    walls = [_wall(each, k) for each in items(limits.get('walls', []), 'walls')]
    found: dict[str, Any] = {**limits, 'cones': [*cones, *last], 'walls': walls}
    if 'glide_slope' in limits:
        slope = limits['glide_slope']
        fields(slope, 'glide_slope', ('angle', 'eased'))
        found['glide_slope'] = {**slope, 'eased': items(slope['eased'], 'eased')[:k]}
    return found


def _cone(stated: Any, k: int) -> dict[str, Any]:
    fields(stated, 'a cone', ('axis', 'angle', 'least', 'steps'))
    steps = [whole(each, 'steps', 1, MOST_STEPS) for each in items(stated['steps'], 'steps')]
    return {**stated, 'steps': [each for each in steps if each <= k]}


def _wall(stated: Any, k: int) -> dict[str, Any]:
    fields(stated, 'a wall', (), WALL)
    lengths = {'shifts': k + 1, 'grown': k}
    begun = {
        name: items(stated[name], name)[:count] for name, count in lengths.items() if name in stated
    }
    return {**stated, **begun}
