# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Certificates in JSON: a problem with its limits, a claim about it, and trees that prove it.

The claim is a lower bound, infeasibility, or that nothing catches the goal at the first steps.
Numbers are read back exactly as they were written. Files are not trusted.

Format: docs/proofs.md.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import compress
from typing import Any, NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array, fields_of, frozen, number, numbers_of, whole, word
from orbimpc_ros.mpc.errors import BadInput, OrbimpcError
from orbimpc_ros.mpc.plan import Proof
from orbimpc_ros.mpc.problem import Approach, Ball, Floor, Problem, State, Weights
from orbimpc_ros.mpc.problem.case import WEIGHTS, Case, body_of
from orbimpc_ros.mpc.proof.stated import PARTS, Body, Cone, Limits, Statement
from orbimpc_ros.mpc.proof.tree import ARRAYS, EMPTY, INTEGERS, LEAF, OPTIONAL, ProofTree
from orbimpc_ros.mpc.proof.verify import Verifier, rounded_down

FORMAT = 'orbimpc certificate 2'
RELATIVE = Fraction(1, 10**9)  # by which a published bound may exceed the proved one
MODEL = ('dimension', 'rotation_order', 'translation_order', 'discretisation', 'horizon', 'step',
         'forward', 'terminal', 'max_rate')  # fmt: skip
STATE = ('position', 'velocity', 'disturbance', 'rotation', 'rotation_rate', 'attitude')
MAYBE = ('coasted', 'wanted')  # of the state, or null
EACH, TERM, PLACE = 100, 12, 60  # [us] of work per number of, or cone at, a leaf; term; place
LEAST_WORK, WORK = 2_000_000, 40  # [us] allowed in any case, and per character of a document
WORD = 'not proved: claimed by the method only'
OutOfTime = Callable[[], bool]
Document = dict[str, Any]  # a certificate as the plain values of its format


class Refused(ValueError):
    """A document is no certificate, or no sound one; the message is the reason, in one line."""


class Unproved(OrbimpcError):
    """There is no certificate: for a class of problems, or for a claim."""


class Posed(NamedTuple):
    """A problem, from a state to goals, with a claim about its trajectories.

    Attributes:
        problem: as far as it is in a document.
        state: where trajectories start.
        goals: g_1..g_N, shape (N, n) [m].
        limits: in addition to the problem's own.
        cost: claimed to be exceeded by all trajectories; infinity if there must be none.
    """

    problem: Problem
    state: State
    goals: Array
    limits: Limits
    cost: Fraction | float = math.inf

    def is_exceeded(self, bound: float) -> bool:
        """Return whether a bound proves the claim."""
        return bound == math.inf or bound > self.cost


class Verdict(NamedTuple):
    """The verdict on a certificate.

    Attributes:
        claimed: published bound; for refutations infinity, which is infeasibility, or the end of
            the first step that may have a catch [s].
        proved: proved bound, rounded down.
        leaves: number of leaves of the trees.
        holds: whether the published bound, less 1e-9 of it, does not exceed the proved one; for
            refutations, whether every tree proves its claim.
    """

    claimed: float
    proved: float
    leaves: int
    holds: bool


def verified(document: Any) -> Verdict:
    """Return the verdict on a certificate, parsed from JSON, in exact arithmetic.

    Raises:
        Refused: it is malformed, takes too much work for its length, or is of a problem that
            cannot be stated in fractions.
    """
    try:
        return _verdict(document)
    except (BadInput, TypeError, OverflowError, RecursionError) as error:
        raise Refused(str(error)) from None


def _verdict(document: Any) -> Verdict:
    refutes = isinstance(document, dict) and 'refuted' in document
    claim = ('refuted',) if refutes else ('lower_bound', 'tree')
    fields_of(document, 'certificate', ('format', 'problem', 'state', 'goals', *claim), ('limits',))
    if document['format'] != FORMAT:
        raise BadInput('format', document['format'], FORMAT)
    if refutes:
        return _refuting(document)
    tree, posed = _tree(document['tree']), _posed(document)
    claimed = number(document['lower_bound'], 'lower_bound')
    (proved,) = _proved([posed], [tree], document['tree'])
    holds = claimed <= 0.0 or Fraction(claimed) * (1 - RELATIVE) <= proved
    return Verdict(claimed, proved, _leaves([tree], LEAF), holds)


def _refuting(document: Any) -> Verdict:
    claim = fields_of(document['refuted'], 'refuted', ('trees',), ('radius', 'cone'))
    trees = [_tree(each) for each in _items(claim['trees'], 'trees')]
    problems = refuted_by(document, len(trees))
    proved = zip(problems, _proved(problems, trees, claim['trees']), strict=True)
    failed = (k for k, (posed, bound) in enumerate(proved) if not posed.is_exceeded(bound))
    upheld = next(failed, len(trees))
    leaves, holds = _leaves(trees, LEAF, EMPTY), upheld == len(trees)
    if 'radius' not in claim:
        return Verdict(math.inf, math.inf if holds else 0.0, leaves, holds)
    step = Fraction(problems[0].problem.step)
    ends = [rounded_down((k + 1) * step) for k in (len(trees), upheld)]
    return Verdict(ends[0], ends[1], leaves, holds)


def _proved(problems: Sequence[Posed], trees: Sequence[ProofTree], stated: Any) -> Iterator[float]:
    """Yield the bounds that trees prove, unless this takes too much work for their length in JSON.

    Raises:
        Refused: it takes too much work.
    """
    work = sum(_work(tree, posed) for posed, tree in zip(problems, trees, strict=True))
    if work > LEAST_WORK + WORK * len(json.dumps(stated)):
        raise Refused('it takes more work than its length allows')
    for posed, tree in zip(problems, trees, strict=True):
        exact = Verifier(posed.problem, Fraction)
        yield exact.bound(posed.state, posed.goals, tree, None, posed.limits)


def _leaves(trees: Sequence[ProofTree], *kinds: int) -> int:
    return sum(int(np.isin(tree.nodes[:, 0], kinds).sum()) for tree in trees)


def _work(tree: ProofTree, posed: Posed) -> int:
    """Return an upper bound on the time to verify a tree [us], whose arrays may not fit."""
    count, bodies = posed.problem.horizon, len(posed.limits.bodies)
    cones = sum(len(each.steps) for each in posed.limits.cones)
    stated = TERM * count**2 + PLACE * bodies * count + EACH * cones
    if tree.shor.ndim != 2 or tree.press_end.shape != tree.shor.shape[:1]:
        return stated  # it proves nothing
    rows = tree.nodes[(tree.nodes[:, 0] == LEAF) | (tree.nodes[:, 0] == EMPTY), -1]
    rows = rows[(rows >= 0) & (rows < len(tree.shor))]  # which leaves may share
    pressed = np.clip(np.diff(tree.press_end, prepend=0), 0, tree.press.size)
    numbers = len(rows) * (math.prod(tree.point.shape[1:]) + cones) + int(pressed[rows].sum())
    bent = int(np.count_nonzero(np.any(tree.shor[rows] > 0.0, axis=1)))
    work = EACH * numbers + TERM * (bent + (bent > 0)) * count**3 // 6
    return stated + work + len(tree.nodes) * (2 + bodies) * count // 2


# --- refuted claims


def refuted_by(document: Any, count: int) -> list[Posed]:
    """Return the claims of a refutation: infeasibility, or no catch at each of the first steps.

    The only cost there is the squared miss distance of a catch, which is claimed to exceed the
    squared radius.

    Raises:
        BadInput: the document is malformed.
    """
    claim, posed = document['refuted'], _posed(document)
    weights = Weights(0.0, 0.0, 0.0, float('radius' in claim), 0.0)
    free = replace(posed.problem, weights=weights, arrival_weight=0.0)
    posed = posed._replace(problem=free)
    if 'radius' not in claim:
        if 'cone' in claim or count != 1:
            raise BadInput.stating(
                'refuted', 'a cone, or not one tree', 'allowed only with a radius'
            )
        return [posed]
    whole(count, 'the number of trees', 1, posed.problem.horizon)
    radius, last = number(claim['radius'], 'refuted.radius', 0.0), claim.get('cone')
    if last is not None:
        fields_of(last, 'refuted.cone', ('axis', 'angle', 'least'))
    return [_catch(posed, k, radius, last) for k in range(1, count + 1)]


def _catch(posed: Posed, k: int, radius: float, last: Any) -> Posed:
    """Return the problem of a catch at step k: the first k steps, with a cone at the last one."""
    limits = posed.limits
    cones = [each._replace(steps=[i for i in each.steps if i <= k]) for each in limits.cones]
    if last is not None:
        cones.append(_cone({**last, 'steps': [k]}, posed.problem.dimension, k))
    bodies = [
        each._replace(shifts=each.shifts[: k + 1], grown=each.grown[:k]) for each in limits.bodies
    ]
    fewer = limits._replace(cones=tuple(cones), bodies=tuple(bodies), eased=limits.eased[:k])
    problem = replace(posed.problem, horizon=k, terminal='penalty')
    return Posed(problem, posed.state, posed.goals[:k], fewer, Fraction(radius) ** 2)


# --- certificates


def certificate_of(problem: Problem, state: State, goals: Array, proof: Proof) -> Document:
    """Return a proof that no trajectory costs less than a plan's bound, by its search's tree.

    Args:
        problem: that was solved.
        state: where the plan starts.
        goals: g_1..g_N, shape (N, n) [m].
        proof: of the plan.

    Raises:
        Unproved: the search left no tree.
    """
    if proof.tree is None:
        raise Unproved('no certificate: the search left no proof of its bound')
    claim = {'lower_bound': max(0.0, proof.lower_bound), 'tree': _plain_tree(proof.tree)}
    return {'format': FORMAT, **statement(problem, state, goals), **claim}


def refutation(sought: Case, trees: Sequence[ProofTree]) -> Document:
    """Return a proof that no trajectory of a problem is feasible, or that none catches its goal.

    Args:
        sought: the problem, state, goals and the radius of a catch.
        trees: one; for catches, one for the end of each step from the first on.
    """
    problem, state, goals = sought.parts
    refuted: dict[str, Any] = {'trees': [_plain_tree(each) for each in trees]}
    if sought.radius:
        refuted['radius'] = sought.radius
        if problem.approach.exists:
            refuted['cone'] = Statement(problem).limits(state, goals).cones[-1]._asdict()
            del refuted['cone']['steps']
        problem = replace(problem, approach=Approach())
    return {'format': FORMAT, **statement(problem, state, goals), 'refuted': refuted}


def text_of(document: Document) -> str:
    """Return a certificate as JSON on one line."""
    plain = np.generic.item  # of NumPy's numbers, which problems accept
    return json.dumps(document, allow_nan=False, separators=(',', ':'), default=plain)


# --- problems


def statement(problem: Problem, state: State, goals: Array) -> Document:
    """Return a certificate's problem, state, goals and limits as plain values."""
    weights, floor = problem.weights, problem.floor
    made: dict[str, Any] = {name: getattr(problem, name) for name in MODEL}
    made['weights'] = {name: float(getattr(weights, name)) for name in WEIGHTS}
    made['weights']['arrival'] = float(problem.arrival_weight)
    parameters = {name: getattr(floor, name) for name in floor.parameters}
    made['floor'] = {'shape': floor.shape, **parameters}
    values = {name: getattr(state, name) for name in STATE + MAYBE}
    plain = {name: None if value is None else value.tolist() for name, value in values.items()}
    limits = _plain_limits(Statement(problem).limits(state, goals))
    document = {'problem': made, 'state': plain, 'goals': goals.tolist()}
    return {**document, 'limits': limits} if limits else document


def _plain_limits(limits: Limits) -> dict[str, Any]:
    fields = {
        'cones': [each._asdict() for each in limits.cones],
        'glide_slope': {'angle': limits.glide_slope, 'eased': limits.eased.tolist()},
        'speeds': {'entry': limits.entry, 'change': limits.change},
        'bodies': [_plain_body(each) for each in limits.bodies],
    }
    there = limits.cones, limits.glide_slope, limits.change < math.inf, limits.bodies
    return dict(compress(fields.items(), there))


def _plain_body(body: Body) -> dict[str, Any]:
    shape, made = body.shape, dict[str, Any](of=body.of)
    if isinstance(shape, Ball):
        made |= {'centre': shape.centre.tolist(), 'radius': shape.radius}
    else:
        made |= {'min': shape.minimum.tolist(), 'max': shape.maximum.tolist()}
    if body.shifts.any() or body.grown.any():
        made |= {'shifts': body.shifts.tolist(), 'grown': body.grown.tolist()}
    return made


def _posed(document: Any) -> Posed:
    """Return the problem, state, goals and limits in a document.

    Raises:
        BadInput: they are malformed.
    """
    stated = fields_of(document['problem'], 'problem', (*MODEL, 'weights', 'floor'))
    weights = dict(fields_of(stated['weights'], 'weights', (*WEIGHTS, 'arrival')))
    floor = fields_of(stated['floor'], 'floor', ('shape',), ('faces', 'fraction'))
    more = {'arrival_weight': weights.pop('arrival')}
    model = {name: stated[name] for name in MODEL}
    problem = Problem(**model, weights=Weights(**weights), floor=Floor(**floor), **more)
    n, count = problem.dimension, problem.horizon
    values = dict(fields_of(document['state'], 'state', STATE + MAYBE))
    for name in STATE:
        numbers_of(values[name], f'state.{name}')
    values['position'] = frozen(values['position'], (n,), 'state.position')
    state, goals = State.at(**values), frozen(document['goals'], (count, n), 'goals')
    if state.wanted is None and problem.weights.attitude:
        raise BadInput('state.wanted', None, 'a rotation')
    limits = _limits(document.get('limits', {}), n, count)
    return Posed(problem, state, goals, limits)


def _limits(stated: Any, n: int, count: int) -> Limits:
    """Return the limits in a document, for dimension n and ``count`` steps.

    Raises:
        BadInput: they are malformed.
    """
    fields_of(stated, 'limits', (), ('cones', 'glide_slope', 'bodies', 'speeds'))
    cones = tuple(_cone(each, n, count) for each in _items(stated.get('cones', []), 'cones'))
    bodies = tuple(_body(each, n, count) for each in _items(stated.get('bodies', []), 'bodies'))
    made = Limits(cones=cones, bodies=bodies)
    if 'glide_slope' in stated:
        slope = fields_of(stated['glide_slope'], 'glide_slope', ('angle', 'eased'))
        angle = number(slope['angle'], 'glide_slope', 0.0, 1.55 * (n == 3), above=True)
        eased = frozen(slope['eased'], (count,), 'glide_slope.eased')
        number(float(eased.min()), 'glide_slope.eased', 0.0)
        made = made._replace(glide_slope=angle, eased=eased)
    if 'speeds' in stated:
        speeds = fields_of(stated['speeds'], 'speeds', ('entry', 'change'))
        entry = number(speeds['entry'], 'speeds.entry', 0.0, 1.0)
        made = made._replace(entry=entry, change=number(speeds['change'], 'speeds.change', 0.0))
    return made


def _cone(stated: Any, n: int, count: int) -> Cone:
    fields_of(stated, 'cone', Cone._fields)
    axis = frozen(stated['axis'], (n,), 'cone.axis').tolist()
    number(math.hypot(*axis), 'the size of cone.axis', 1e-6, 1e6)
    angle = number(stated['angle'], 'cone.angle', 0.0, math.pi / 2, above=True)
    steps = [whole(k, 'cone.steps', 1, count) for k in _items(stated['steps'], 'cone.steps')]
    return Cone(axis, angle, number(stated['least'], 'cone.least', 0.0, 1.0), steps)


def _body(stated: Any, n: int, count: int) -> Body:
    shape = body_of(stated, 'body', ('of',), ('shifts', 'grown'))
    if shape.dimension != n:
        raise BadInput('body', stated, f'a body of dimension {n}')
    word(stated['of'], 'body.of', PARTS)
    shifts = frozen(stated.get('shifts', np.zeros((count + 1, n))), (count + 1, n), 'body.shifts')
    grown = frozen(stated.get('grown', np.zeros(count)), (count,), 'body.grown')
    return Body(shape, stated['of'], shifts, grown)


def _items(value: Any, name: str) -> list[Any]:
    if not isinstance(value, list):
        raise BadInput(name, value, 'a list')
    return value


# --- trees


def _plain_tree(tree: ProofTree) -> dict[str, Any]:
    """Return a tree as plain values, without unused arrays."""
    made = {n: value.tolist() for n, value in tree._asdict().items() if n in ARRAYS or value.size}
    return {**made, 'ordered': True} if tree.origins.size else made


def _tree(stated: Any) -> ProofTree:
    """Return the tree in a document; the verifier checks that its arrays fit the problem.

    Raises:
        BadInput: it is malformed.
    """
    raw, arrays = dict(fields_of(stated, 'tree', ARRAYS, (*OPTIONAL, 'ordered'))), dict[str, Any]()
    if raw.pop('ordered', True) is not True:
        raise BadInput('tree.ordered', stated['ordered'], 'true')
    for name, value in raw.items():
        made = np.array(numbers_of(value, f'tree.{name}'))
        if name in INTEGERS and made.size and made.dtype != np.int64:
            raise BadInput(f'tree.{name}', value, 'integers')
        if made.size or name in ARRAYS:
            arrays[name] = made.astype(np.int64 if name in INTEGERS else np.float64)
    if arrays['nodes'].shape[1:] != (5,):
        raise BadInput('tree.nodes', stated['nodes'], 'rows of 5')
    return ProofTree(**arrays)


# --- JSON: unique names, finite numbers


def parsed(text: bytes) -> Any:
    """Return the document in a file's content.

    Raises:
        Refused: it is not JSON with unique names and finite numbers.
    """
    try:
        return json.loads(text, object_pairs_hook=_without_doubles, parse_constant=_no_number)
    except (ValueError, RecursionError) as error:
        raise Refused(f'not JSON of a certificate: {error}') from None


def _without_doubles(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len(dict(pairs)) < len(pairs):
        raise Refused('a name is given twice')
    return dict(pairs)


def _no_number(word: str) -> Any:
    raise Refused(f'{word} is not a finite number')


# --- certificates with a deadline


def held_in_time(
    make: Callable[[OutOfTime], Document], clock: Callable[[], float], end: float
) -> Document | None:
    """Return a certificate that is made and holds; None if there is none in time.

    To verify a certificate takes no longer than to make it, which also verifies each leaf: each
    has half of the time. The deadline is exceeded by the time for a single leaf at most.

    Args:
        make: makes a certificate, unless its argument reports the end of its time.
        clock: of the deadline [s].
        end: deadline [s]; infinity for none.
    """
    now = clock()
    if now >= end:
        return None
    half = now + 0.5 * (end - now)
    try:
        made = make(lambda: clock() >= half)
        return made if verified(parsed(text_of(made).encode())).holds else None
    except (Unproved, Refused, BadInput):  # also a model without certificates, or no Clarabel
        return None
