# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Planning problems with state and goals, also from the plain mappings of case files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from orbimpc_ros.mpc.arrays import Array, ByContent, fields_of, frozen, numbers_of, sealed
from orbimpc_ros.mpc.errors import BadInput
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
from orbimpc_ros.mpc.problem.problem import weighed

MODEL = ('dimension', 'rotation_order', 'translation_order', 'horizon', 'step', 'forward')
EXTRAS = ('terminal', 'max_rate', 'max_acceleration', 'no_corner_cutting', 'discretisation',
          'tilt', 'glide_slope')  # fmt: skip
BODIES = 'boxes {min, max} and balls {centre, radius}'
T = TypeVar('T')
Names = tuple[str, ...]
WEIGHTS = tuple(vars(Weights()))


@dataclass(frozen=True, eq=False)
class Case(ByContent):
    """A problem with a state and goals, to be solved once.

    Attributes:
        problem: model, weights and constraints.
        state: where the plan starts.
        goals: g_1..g_N, shape (N, n) [m].
        radius: of a catch, the largest distance |s_k - g_k| at any of the steps [m]; 0 without.
    """

    problem: Problem
    state: State
    goals: Array
    radius: float = 0.0

    @property
    def parts(self) -> tuple[Problem, State, Array]:
        """Return problem, state and goals."""
        return self.problem, self.state, self.goals


def case_of(mapping: Any) -> Case:
    """Return the case that a mapping describes.

    Required are ``dimension``, ``rotation_order``, ``translation_order``, ``horizon``, ``step``,
    ``forward``, ``weights``, ``state`` and ``goal``: one point, or one for each step. Weights
    default to 0 and their ``scaling`` to ``paper``
    (:func:`~orbimpc_ros.mpc.problem.problem.weighed`), ``terminal`` to ``penalty``,
    ``discretisation`` to ``euler``, and the state's ``disturbance`` to zero; ``floor``,
    ``max_rate``, ``max_acceleration``, ``obstacles``, ``tilt``, ``glide_slope`` and ``approach``
    (``cone``, and a ``direction`` unless it is the goal's) are optional limits. ``hazards`` are
    bodies like ``obstacles``, each with a ``velocity``, or with ``shifts`` at ``times`` after the
    start of the plan (:class:`~orbimpc_ros.mpc.problem.MovingObstacle`). A weight on ``attitude``,
    or an approach along the goal's own axis, requires ``goal_attitude``, the desired final
    rotation.

    Raises:
        BadInput: a field is unknown, missing, of another type or out of range.
    """
    needed = (*MODEL, 'weights', 'state', 'goal')
    optional = (*EXTRAS, 'floor', 'obstacles', 'approach', 'hazards', 'goal_attitude')
    entries = fields_of(mapping, 'problem', needed, optional)
    problem = _problem(entries)
    hazards = _each(entries.get('hazards', []), 'hazards', _hazard)
    state = _state(problem, entries['state'], entries.get('goal_attitude'), hazards)
    return Case(problem, state, _goals(problem, entries['goal']))


def _problem(entries: Mapping[str, Any]) -> Problem:
    weights = dict(fields_of(entries['weights'], 'weights', (), (*WEIGHTS, 'scaling')))
    scaling = weights.pop('scaling', 'paper')
    cone = fields_of(entries.get('approach', {'cone': 0.0}), 'approach', ('cone',), ('direction',))
    direction = numbers_of(cone.get('direction', []), 'approach.direction')
    plain = {name: entries[name] for name in (*MODEL, *EXTRAS) if name in entries}
    problem = Problem(
        **plain,
        weights=Weights(**{**dict.fromkeys(WEIGHTS, 0.0), **weights}),
        floor=_floor(entries.get('floor', {'shape': 'none'})),
        obstacles=_each(entries.get('obstacles', []), 'obstacles', body_of),
        approach=Approach(cone['cone'], tuple(direction)),
    )
    return weighed(problem, scaling)


def _floor(value: Any) -> Floor:
    entries = fields_of(value, 'floor', ('shape',), ('faces', 'fraction'))
    needed = Floor(entries['shape']).parameters  # raises BadInput for an unknown shape
    return Floor(**fields_of(entries, 'floor', ('shape', *needed), tuple(entries)))


def _each(value: Any, culprit: str, made: Callable[[Any, str], T]) -> tuple[T, ...]:
    if not isinstance(value, list):
        raise BadInput(culprit, value, f'a list of {BODIES}')
    try:
        return tuple(made(each, name := f'{culprit}[{i}]') for i, each in enumerate(value))
    except BadInput as error:  # a body's own errors do not tell which it is
        text = str(error).replace('obstacles.', f'{name}.', 1)
        raise BadInput(error.culprit, error.value, error.allowed, text) from None


def body_of(value: Any, culprit: str, needed: Names = (), optional: Names = ()) -> Box | Ball:
    """Return the body that a mapping describes, whose other fields are ``needed`` or ``optional``.

    Raises:
        BadInput: a field is unknown, missing, of another type or out of range.
    """
    if isinstance(value, dict) and ('centre' in value or 'radius' in value):
        ball = fields_of(value, culprit, ('centre', 'radius', *needed), optional)
        return Ball(ball['centre'], ball['radius'])
    box = fields_of(value, culprit, ('min', 'max', *needed), optional)
    return Box(box['min'], box['max'])


def _hazard(value: Any, culprit: str) -> MovingObstacle:
    moves = ('times', 'shifts') if isinstance(value, dict) and 'times' in value else ('velocity',)
    body = body_of(value, culprit, moves)
    track = [numbers_of(value[name], f'{culprit}.{name}') for name in moves]
    if len(track) == 2:
        return MovingObstacle(body, *track)
    return MovingObstacle.drifting(body, frozen(track[0], (body.dimension,), f'{culprit}.velocity'))


def _state(problem: Problem, value: Any, wanted: Any, hazards: tuple[MovingObstacle, ...]) -> State:
    rates = ['velocity'] * problem.inertial + ['rotation_rate'] * (problem.rotation_order == 2)
    entries = fields_of(value, 'state', ('position', 'rotation'), ('disturbance', *rates))
    n = problem.dimension
    arrays = {name: numbers_of(each, f'state.{name}') for name, each in entries.items()}
    # The state takes its dimension from the position: settle that first.
    arrays['position'] = frozen(arrays['position'], (n,), 'state.position')
    if wanted is not None:
        arrays['wanted'] = frozen(wanted, (n, n), 'goal_attitude')
    return State.at(**arrays, hazards=hazards)


def _goals(problem: Problem, value: Any) -> Array:
    """Return g_1..g_N, from a list of N goals or from a single one."""
    n, horizon = problem.dimension, problem.horizon
    numbers_of(value, 'goal')
    if value and isinstance(value[0], list):
        return frozen(value, (horizon, n), 'goal')
    return sealed(np.tile(frozen(value, (n,), 'goal'), (horizon, 1)))
