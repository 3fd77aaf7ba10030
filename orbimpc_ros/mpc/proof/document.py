# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Certificates of bounds: a problem with its limits, a bound, and the tree that proves it, in JSON.

Numbers are written so that they are read back as they were.

Format: docs/proofs.md.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.problem import Floor, Problem, State, Weights
from orbimpc_ros.mpc.proof import verifier
from orbimpc_ros.mpc.proof.limits import END, ENDS, STEP, Body, Cone, Limits, limits_of
from orbimpc_ros.mpc.proof.tree import LEAF, MULTIPLIERS, NOTHING, NOWHERE, ProofTree
from orbimpc_ros.mpc.proof.verifier import RELATIVE, Refused, Verdict
from orbimpc_ros.mpc.proof.verifier import reading as strict
from orbimpc_ros.mpc.proof.verify import exact_bound

FORMAT = 'orbimpc certificate 2'
OF = {'end': END, 'ends': ENDS, 'step': STEP}
MODEL = ('dimension', 'rotation_order', 'translation_order', 'discretisation', 'horizon', 'step',
         'forward', 'terminal', 'max_rate')  # fmt: skip
WEIGHTS = ('position', 'input', 'length', 'terminal', 'attitude')
STATE = ('position', 'rotation', 'velocity', 'rotation_rate', 'attitude', 'disturbance')
MAYBE = ('coasted', 'wanted')
ARRAYS = ('nodes', 'at', 'point', 'shor', 'press_end', 'press_row', 'press')
INTEGERS = ('nodes', 'press_end', 'press_row')
MOST_NODES = 1_000_000
EACH = 12  # microseconds that a number of a leaf takes, about
LEAST_WORK, WORK = 2_000_000, 40  # microseconds, and for each character of a document


@dataclass(frozen=True, eq=False)
class Certificate:
    """What proves that no trajectory of a problem costs less than a bound.

    Attributes:
        problem: what was solved.
        state: where plans start.
        goals: g_1..g_N, shape (N, n) [m].
        lower_bound: as published.
        tree: that proves it.
    """

    problem: Problem
    state: State
    goals: Array
    lower_bound: float
    tree: ProofTree

    def document(self) -> dict[str, Any]:
        """Return the certificate as the plain values of its format."""
        known = statement(self.problem, self.state, self.goals)
        claim = {'lower_bound': self.lower_bound, 'tree': _plain_tree(self.tree)}
        return {'format': FORMAT, **known, **claim}

    def text(self) -> str:
        """Return the certificate as JSON on one line."""
        return json.dumps(self.document(), allow_nan=False, separators=(',', ':'))


def verified(document: Any) -> Verdict:
    """Return what a certificate, as JSON has it, comes to in exact arithmetic.

    Raises:
        Refused: it is malformed, or too much work for its length.
    """
    if isinstance(document, dict) and document.get('format') == verifier.FORMAT:
        return verifier.verified(document)
    strict.fields(
        document, 'certificate',
        ('format', 'problem', 'state', 'goals', 'lower_bound', 'tree'), ('limits',),
    )  # fmt: skip
    if document['format'] != FORMAT:
        raise Refused(f'format is not {FORMAT!r}')
    problem, state, goals = _case(document)
    limits = _limits(document.get('limits', {}), problem)
    tree, claimed = _tree(document['tree']), float(strict.number(document['lower_bound'], 'bound'))
    _spend(document, tree, problem)
    try:
        proved = exact_bound(problem, state, goals, tree, limits)
    except BadInput as error:
        raise Refused(str(error)) from None
    leaves = int((tree.nodes[:, 0] == LEAF).sum())
    holds = claimed <= 0.0 or Fraction(claimed) * (1 - RELATIVE) <= proved
    return Verdict(claimed, proved, leaves, holds)


def _spend(document: Any, tree: ProofTree, problem: Problem) -> None:
    """Refuse what takes more work than a document of its length may."""
    leaves, count = tree.shor.shape
    own = tree.point[0].size if leaves else 0
    bent = int((tree.shor > 0.0).any(axis=1).sum()) if leaves else 0
    work = EACH * (leaves * (own + tree.press.size // max(1, leaves)) + bent * count**3 // 6)
    work += len(tree.nodes) * problem.horizon
    if work > LEAST_WORK + WORK * len(json.dumps(document['tree'])):
        raise Refused('it takes more work than a document of its length may')


# --- what was solved


def statement(problem: Problem, state: State, goals: Array) -> dict[str, Any]:
    """Return what a certificate says of what was solved, as plain values."""
    weights, floor = problem.weights, problem.floor
    made: dict[str, Any] = {name: getattr(problem, name) for name in MODEL}
    made['weights'] = {name: float(getattr(weights, name)) for name in WEIGHTS}
    made['weights']['arrival'] = float(problem.arrival_weight)
    told = {name: getattr(floor, name) for name in floor.parameters}
    made['floor'] = {'shape': floor.shape, **told}
    known: dict[str, Any] = {name: getattr(state, name).tolist() for name in STATE}
    for name in MAYBE:
        value = getattr(state, name)
        known[name] = None if value is None else value.tolist()
    limits = _plain_limits(limits_of(problem, state, goals))
    found = {'problem': made, 'state': known, 'goals': goals.tolist()}
    return {**found, 'limits': limits} if limits else found


def _plain_limits(limits: Limits) -> dict[str, Any]:
    found: dict[str, Any] = {}
    if limits.cones:
        found['cones'] = [
            {**each._asdict(), 'axis': list(each.axis), 'steps': list(each.steps)}
            for each in limits.cones
        ]
    if limits.glide_slope:
        found['glide_slope'] = {'angle': limits.glide_slope, 'eased': limits.eased.tolist()}
    if limits.change < math.inf:
        found['speeds'] = {'entry': limits.entry, 'change': limits.change}
    if limits.bodies:
        found['bodies'] = [_plain_body(each) for each in limits.bodies]
    return found


def _plain_body(body: Body) -> dict[str, Any]:
    made: dict[str, Any] = {'min': body.low.tolist(), 'max': body.high.tolist()}
    if body.radius:
        made = {'centre': body.low.tolist(), 'radius': body.radius}
    made['of'] = next(name for name, of in OF.items() if of == body.of)
    if body.shifts.any() or body.grown.any():
        made |= {'shifts': body.shifts.tolist(), 'grown': body.grown.tolist()}
    return made


def _case(document: Any) -> tuple[Problem, State, Array]:
    """Return the problem that is stated, the state and goals.

    Raises:
        Refused: it is none.
    """
    stated = document['problem']
    strict.fields(stated, 'problem', (*MODEL, 'weights', 'floor'))
    strict.fields(stated['weights'], 'weights', (*WEIGHTS, 'arrival'))
    strict.fields(stated['floor'], 'floor', ('shape',), ('faces', 'fraction'))
    strict.fields(document['state'], 'state', (*STATE, *MAYBE))
    known, state = {name: stated[name] for name in MODEL}, dict(document['state'])
    weights = {name: stated['weights'][name] for name in WEIGHTS}
    more = {'arrival_weight': stated['weights']['arrival']}
    try:
        floor = Floor(**stated['floor'])
        problem = Problem(**known, weights=Weights(**weights), floor=floor, **more)
        goals = _array(document['goals'], 'goals', (problem.horizon, problem.dimension))
        made = State.at(state.pop('position'), state.pop('rotation'), **state)
    except (BadInput, TypeError, OverflowError) as error:
        raise Refused(str(error)) from None
    if made.dimension != problem.dimension:
        raise Refused('state is of another dimension')
    if made.wanted is None and problem.weights.attitude:
        raise Refused('state.wanted is missing')
    return problem, made, goals


def _limits(stated: Any, problem: Problem) -> Limits:
    """Return limits as they are stated.

    Raises:
        Refused: they are none.
    """
    strict.fields(stated, 'limits', (), ('cones', 'glide_slope', 'bodies', 'speeds'))
    n, count = problem.dimension, problem.horizon
    cones = tuple(_cone(each, n, count) for each in strict.items(stated.get('cones', []), 'cones'))
    bodies = strict.items(stated.get('bodies', []), 'bodies')
    made = Limits(cones=cones, bodies=tuple(_body(each, n, count) for each in bodies))
    if 'glide_slope' in stated:
        slope = stated['glide_slope']
        strict.fields(slope, 'glide_slope', ('angle', 'eased'))
        angle, eased = _number(slope['angle']), _array(slope['eased'], 'eased', (count,))
        if n != 3 or not 0.0 < angle <= 1.55 or eased.min() < 0.0:
            raise Refused('glide_slope is none')
        made = made._replace(glide_slope=angle, eased=eased)
    if 'speeds' in stated:
        strict.fields(stated['speeds'], 'speeds', ('entry', 'change'))
        entry, change = (_number(stated['speeds'][name]) for name in ('entry', 'change'))
        if not 0.0 <= entry <= 1.0 or change < 0.0:
            raise Refused('speeds are none')
        made = made._replace(entry=entry, change=change)
    return made


def _cone(stated: Any, n: int, count: int) -> Cone:
    strict.fields(stated, 'a cone', ('axis', 'angle', 'least', 'steps'))
    axis = tuple(_array(stated['axis'], 'axis', (n,)).tolist())
    angle, least = _number(stated['angle']), _number(stated['least'])
    if not (1e-6 < math.hypot(*axis) < 1e6 and 0.0 < angle < math.pi / 2 and 0.0 <= least <= 1.0):
        raise Refused('a cone is none, or wider than half of space')
    steps = tuple(
        strict.whole(k, 'steps', 1, count) for k in strict.items(stated['steps'], 'steps')
    )
    return Cone(axis, angle, least, steps)


def _body(stated: Any, n: int, count: int) -> Body:
    ball = isinstance(stated, dict) and 'radius' in stated
    shape = ('centre', 'radius') if ball else ('min', 'max')
    strict.fields(stated, 'a body', (*shape, 'of'), ('shifts', 'grown'))
    still = [[0.0] * n] * (count + 1), [0.0] * count
    shifts = _array(stated.get('shifts', still[0]), 'shifts', (count + 1, n))
    grown = _array(stated.get('grown', still[1]), 'grown', (count,))
    of = OF[strict.word(stated['of'], 'of', tuple(OF))]
    if not ball:
        low, high = (_array(stated[name], name, (n,)) for name in shape)
        return Body(low, high, 0.0, of, shifts, grown)
    centre, radius = _array(stated['centre'], 'centre', (n,)), _number(stated['radius'])
    if not radius > 0.0:
        raise Refused('radius is not above 0')
    return Body(centre, centre, radius, of, shifts, grown)


def _number(value: Any) -> float:
    return float(strict.number(value, 'a limit'))


def _array(value: Any, name: str, shape: tuple[int, ...], kind: type = float) -> Array:
    """Return nested lists of numbers as an array of a shape, whose first size may be -1 for any."""

    def checked(part: Any, sizes: tuple[int, ...]) -> Any:
        if not sizes:
            if kind is int:
                return strict.whole(part, name, -1, 1 << 40)
            return float(strict.number(part, name))
        within = strict.items(part, name, None if sizes[0] < 0 else sizes[0])
        return [checked(each, sizes[1:]) for each in within]

    made = checked(value, shape)
    known = tuple(len(made) if size < 0 else size for size in shape)
    return np.array(made, np.int64 if kind is int else float).reshape(known)


# --- trees


def _plain_tree(tree: ProofTree) -> dict[str, Any]:
    """Return a tree as plain values: what it has no use for is left out."""
    made = {name: getattr(tree, name).tolist() for name in ARRAYS}
    for name in (*MULTIPLIERS, 'meet', 'origins'):
        if getattr(tree, name).size:
            made[name] = getattr(tree, name).tolist()
    return {**made, 'ordered': True} if tree.ordered else made


def _tree(stated: Any) -> ProofTree:
    """Return a tree; whether its arrays fit the problem is for the verifier to say.

    Raises:
        Refused: it is none.
    """
    strict.fields(stated, 'tree', ARRAYS, (*MULTIPLIERS, 'meet', 'origins', 'ordered'))
    if len(strict.items(stated['nodes'], 'nodes')) > MOST_NODES:
        raise Refused(f'the tree has more than {MOST_NODES} nodes')
    if stated.get('ordered', True) is not True:
        raise Refused('ordered is not true')
    found: dict[str, Any] = dict.fromkeys(MULTIPLIERS, NOTHING)
    found |= {'meet': np.zeros((0, 0)), 'origins': NOWHERE}
    for name, value in stated.items():
        if name == 'ordered':
            continue
        shape = (-1, 5) if name == 'nodes' else _shape(value) or (-1,)
        found[name] = _array(value, name, shape, int if name in INTEGERS else float)
    return ProofTree(**found, ordered='ordered' in stated)


def _shape(value: Any) -> tuple[int, ...]:
    """Return the sizes of nested lists, as their first ones have them; any number of the first."""
    sizes: list[int] = []
    while isinstance(value, list) and len(sizes) < 4:
        sizes.append(len(value) if sizes else -1)
        value = value[0] if value else None
    return tuple(sizes)
