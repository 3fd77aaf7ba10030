# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Certificates: a problem with its limits, what is claimed of it, and trees that prove it, in JSON.

That is a bound; that nothing is feasible; or that nothing catches a goal at the first steps.
Numbers are written so that they are read back as they were.

Format: docs/proofs.md.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.cells import STEEPEST_CAP
from orbimpc_ros.mpc.problem import Approach, Floor, Problem, State, Weights
from orbimpc_ros.mpc.problem.sought import Sought
from orbimpc_ros.mpc.proof import reading as strict
from orbimpc_ros.mpc.proof.limits import END, ENDS, STEP, Body, Cone, Limits, limits_of
from orbimpc_ros.mpc.proof.reading import Refused
from orbimpc_ros.mpc.proof.stated import UP
from orbimpc_ros.mpc.proof.tree import EMPTY, LEAF, MULTIPLIERS, NOTHING, NOWHERE, ProofTree
from orbimpc_ros.mpc.proof.verify import exact_bound, rounded_down

FORMAT, OLD = 'orbimpc certificate 2', 'orbimpc certificate 1'
RELATIVE = Fraction(1, 10**9)  # by which a published bound may exceed what is proved
OF = {'end': END, 'ends': ENDS, 'step': STEP}
MODEL = ('dimension', 'rotation_order', 'translation_order', 'discretisation', 'horizon', 'step',
         'forward', 'terminal', 'max_rate')  # fmt: skip
WEIGHTS = ('position', 'input', 'length', 'terminal', 'attitude')
VECTORS, MAYBE = ('position', 'velocity', 'disturbance'), ('coasted', 'wanted')
STATE = (*VECTORS, 'rotation', 'rotation_rate', 'attitude', *MAYBE)
SOUGHT = ('problem', 'state', 'goals', 'radius')
ARRAYS = ('nodes', 'at', 'point', 'shor', 'press_end', 'press_row', 'press')
INTEGERS = ('nodes', 'press_end', 'press_row')
MOST_NODES = 1_000_000
EACH, TERM = 100, 12  # microseconds that a number of a leaf takes, and a term of a Hessian
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
        return _line(self.document())


@dataclass(frozen=True, eq=False)
class Refutation:
    """What proves that no trajectory of a problem is feasible, or that none catches its goal.

    Attributes:
        sought: in what.
        trees: one; of catches one for each step from the first on at whose end there is none.
    """

    sought: Sought
    trees: tuple[ProofTree, ...]

    def document(self) -> dict[str, Any]:
        """Return the refutation as the plain values of its format."""
        problem, state, goals, radius = (getattr(self.sought, name) for name in SOUGHT)
        refuted: dict[str, Any] = {'trees': [_plain_tree(each) for each in self.trees]}
        if radius:
            refuted['radius'] = radius
            if problem.approach.exists:
                last = limits_of(problem, state, goals).cones[-1]
                refuted['cone'] = {
                    'axis': list(last.axis),
                    'angle': last.angle,
                    'least': last.least,
                }
            problem = replace(problem, approach=Approach())
        return {'format': FORMAT, **statement(problem, state, goals), 'refuted': refuted}

    def text(self) -> str:
        """Return the refutation as JSON on one line."""
        return _line(self.document())


class Posed(NamedTuple):
    """A problem that trajectories are looked for in, from a state to goals.

    Attributes:
        problem: what a document has of it.
        state: where trajectories start.
        goals: g_1..g_N, shape (N, n) [m].
        limits: beside the problem's own.
        radius: within which s_N is of g_N [m]; negative where it may be anywhere.
    """

    problem: Problem
    state: State
    goals: Array
    limits: Limits
    radius: float = -1.0


class Verdict(NamedTuple):
    """What a certificate comes to.

    Attributes:
        claimed: the bound that was published; of refutations infinity, where nothing is feasible,
            or else the end of the first step that may have a catch [s].
        proved: the bound that holds, rounded down.
        leaves: how many bounds it is the least of.
        holds: whether what was published exceeds what holds by no more than 1e-9 of it; of
            refutations, whether each does refute.
    """

    claimed: float
    proved: float
    leaves: int
    holds: bool


def verified(document: Any) -> Verdict:
    """Return what a certificate, as JSON has it, comes to in exact arithmetic.

    Raises:
        Refused: it is malformed, or too much work for its length.
    """
    if isinstance(document, dict) and document.get('format') == OLD:
        raise Refused(f'format is {OLD!r}, which is read no more: {FORMAT!r} is')
    refutes = isinstance(document, dict) and 'refuted' in document
    claim = ('refuted',) if refutes else ('lower_bound', 'tree')
    strict.fields(
        document, 'certificate', ('format', 'problem', 'state', 'goals', *claim), ('limits',)
    )
    if document['format'] != FORMAT:
        raise Refused(f'format is not {FORMAT!r}')
    if refutes:
        return _refuting(document)
    posed, tree = _posed(document), _tree(document['tree'])
    claimed = strict.number(document['lower_bound'], 'bound')
    (proved,) = _proved([posed], [tree], document['tree'])
    holds = claimed <= 0.0 or Fraction(claimed) * (1 - RELATIVE) <= proved
    return Verdict(claimed, proved, _leaves(tree, LEAF), holds)


def _refuting(document: Any) -> Verdict:
    claim = document['refuted']
    strict.fields(claim, 'refuted', ('trees',), ('radius', 'cone'))
    trees = [_tree(each) for each in strict.items(claim['trees'], 'trees')]
    problems = refuted_by(document, len(trees))
    proved = _proved(problems, trees, claim['trees'])
    whole = next((k for k, each in enumerate(proved) if each < math.inf), len(trees))
    leaves, holds = sum(_leaves(tree, EMPTY) for tree in trees), whole == len(trees)
    if 'radius' not in claim:
        return Verdict(math.inf, math.inf if holds else 0.0, leaves, holds)
    step = Fraction(problems[0].problem.step)
    ends = [rounded_down((k + 1) * step) for k in (len(trees), whole)]
    return Verdict(ends[0], ends[1], leaves, holds)


def _proved(problems: Sequence[Posed], trees: Sequence[ProofTree], stated: Any) -> list[float]:
    """Return what trees prove, unless that is too much work for their length as JSON has them.

    Raises:
        Refused: it is, or a problem is none that can be stated in fractions.
    """
    work = sum(_work(tree, posed.problem) for posed, tree in zip(problems, trees, strict=True))
    if work > LEAST_WORK + WORK * len(json.dumps(stated)):
        raise Refused('it takes more work than a document of its length may')
    try:
        return [
            exact_bound(posed.problem, posed.state, posed.goals, tree, *posed[3:])
            for posed, tree in zip(problems, trees, strict=True)
        ]
    except BadInput as error:
        raise Refused(str(error)) from None


def _leaves(tree: ProofTree, kind: int) -> int:
    return int((tree.nodes[:, 0] == kind).sum())


def _work(tree: ProofTree, problem: Problem) -> int:
    """Return how long it takes to go through a tree, at most [us]; whose arrays may not fit."""
    if tree.shor.ndim != 2 or tree.press_end.shape != tree.shor.shape[:1]:
        return 0  # it proves nothing
    rows = tree.nodes[(tree.nodes[:, 0] == LEAF) | (tree.nodes[:, 0] == EMPTY), -1]
    rows = rows[(rows >= 0) & (rows < len(tree.shor))]  # which leaves may share
    pressed = np.clip(np.diff(tree.press_end, prepend=0), 0, tree.press.size)
    numbers = len(rows) * math.prod(tree.point.shape[1:]) + int(pressed[rows].sum())
    bent = int(np.count_nonzero(np.any(tree.shor[rows] > 0.0, axis=1)))
    work = EACH * numbers + TERM * (bent + (bent > 0)) * problem.horizon**3 // 6
    return work + len(tree.nodes) * problem.horizon + TERM * problem.horizon**2


# --- what is refuted


def refuted_by(document: Any, count: int) -> list[Posed]:
    """Return what nothing is feasible of: catches at so many steps from the first on, or all.

    Nothing costs anything there, so that rotations are no more than their axes.

    Raises:
        Refused: it is malformed.
    """
    claim, posed = document['refuted'], _posed(document)
    weights = replace(posed.problem.weights, input=0.0, attitude=0.0)
    posed = posed._replace(problem=replace(posed.problem, weights=weights))
    if 'radius' not in claim:
        if 'cone' in claim or count != 1:
            raise Refused('there is a cone, or not one tree, but nothing to catch')
        return [posed]
    strict.whole(count, 'the number of trees', 1, posed.problem.horizon)
    radius = _number(claim['radius'])
    if radius < 0.0:
        raise Refused('radius is negative')
    last = claim.get('cone')
    if last is not None:
        strict.fields(last, 'cone', ('axis', 'angle', 'least'))
    return [_catch(posed, k, radius, last) for k in range(1, count + 1)]


def _catch(posed: Posed, k: int, radius: float, last: Any) -> Posed:
    """Return the problem of a catch at step k, in the first k steps, with its last cone."""
    limits = posed.limits
    cones = [each._replace(steps=tuple(i for i in each.steps if i <= k)) for each in limits.cones]
    if last is not None:
        cones.append(_cone({**last, 'steps': [k]}, posed.problem.dimension, k))
    bodies = [
        each._replace(shifts=each.shifts[: k + 1], grown=each.grown[:k]) for each in limits.bodies
    ]
    fewer = limits._replace(cones=tuple(cones), bodies=tuple(bodies), eased=limits.eased[:k])
    problem = replace(posed.problem, horizon=k, terminal='penalty')
    return Posed(problem, posed.state, posed.goals[:k], fewer, radius)


# --- what was solved


def statement(problem: Problem, state: State, goals: Array) -> dict[str, Any]:
    """Return what a certificate says of what was solved, as plain values."""
    weights, floor = problem.weights, problem.floor
    made: dict[str, Any] = {name: getattr(problem, name) for name in MODEL}
    made['weights'] = {name: float(getattr(weights, name)) for name in WEIGHTS}
    made['weights']['arrival'] = float(problem.arrival_weight)
    told = {name: getattr(floor, name) for name in floor.parameters}
    made['floor'] = {'shape': floor.shape, **told}
    values = {name: getattr(state, name) for name in STATE}
    known = {name: None if value is None else value.tolist() for name, value in values.items()}
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


def _line(document: dict[str, Any]) -> str:
    return json.dumps(document, allow_nan=False, separators=(',', ':'))


def _posed(document: Any) -> Posed:
    """Return the problem that is stated, the state, goals and limits.

    Raises:
        Refused: it is none.
    """
    stated = document['problem']
    strict.fields(stated, 'problem', (*MODEL, 'weights', 'floor'))
    strict.fields(stated['weights'], 'weights', (*WEIGHTS, 'arrival'))
    strict.fields(stated['floor'], 'floor', ('shape',), ('faces', 'fraction'))
    strict.fields(document['state'], 'state', STATE)
    known = {name: stated[name] for name in MODEL}
    weights = {name: stated['weights'][name] for name in WEIGHTS}
    more = {'arrival_weight': stated['weights']['arrival']}
    try:
        floor = Floor(**stated['floor'])
        problem = Problem(**known, weights=Weights(**weights), floor=floor, **more)
        goals = _array(document['goals'], 'goals', (problem.horizon, problem.dimension))
        made = State.at(**_state(document['state'], problem.dimension))
    except (BadInput, TypeError, OverflowError) as error:
        raise Refused(str(error)) from None
    if made.wanted is None and problem.weights.attitude:
        raise Refused('state.wanted is missing')
    limits = _limits(document.get('limits', {}), problem)
    tilt = next((each.angle for each in limits.cones if each.axis == UP), 0.0)
    if problem.inertial and tilt <= STEEPEST_CAP:  # splits may begin with patches of its cap
        problem = replace(problem, tilt=tilt)
    return Posed(problem, made, goals, limits)


def _state(stated: Any, n: int) -> dict[str, Any]:
    """Return what is known of a state: vectors and matrices, some of which may be none."""
    known: dict[str, Any] = {
        name: stated[name] for name in STATE if name in MAYBE and stated[name] is None
    }
    for name in STATE:
        if name not in known:
            shape = (n,) if name in VECTORS else (n, n)
            known[name] = _array(stated[name], f'state.{name}', shape)
    return known


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
    return strict.number(value, 'a limit')


def _array(value: Any, name: str, shape: tuple[int, ...], kind: type = float) -> Array:
    """Return nested lists of numbers as an array of a shape, whose first size may be -1 for any."""

    def checked(part: Any, sizes: tuple[int, ...]) -> Any:
        if not sizes:
            if kind is int:
                return strict.whole(part, name, -1, 1 << 40)
            return strict.number(part, name)
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
