# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Planning problems with state and goals, also from the plain mappings of case files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from orbimpc_ros.mpc.arrays import Array, ByContent, fields_of, frozen, numbers_of
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
from orbimpc_ros.mpc.problem.obstacle import tracked
from orbimpc_ros.mpc.problem.problem import weighed

MODEL = ('dimension', 'rotation_order', 'translation_order', 'horizon', 'step', 'forward')
EXTRAS = ('terminal', 'max_rate', 'max_acceleration', 'no_corner_cutting', 'discretisation',
          'tilt', 'glide_slope')  # fmt: skip
PARTS = ('floor', 'obstacles', 'approach')
BODIES = 'boxes {min, max} and balls {centre, radius}'
WEIGHTS = ('position', 'input', 'length', 'terminal', 'attitude')


class Case(NamedTuple):
    """A problem with a state and goals, to be solved once.

    Attributes:
        problem: model, weights and constraints.
        state: where the plan starts.
        goals: g_1..g_N, shape (N, n) [m].
    """

    problem: Problem
    state: State
    goals: Array


@dataclass(frozen=True, eq=False)
class Sought(ByContent):
    """A problem and the kind of trajectory to find in it.

    Attributes:
        problem: model and constraints, with the cone of approach of a catch.
        state: where plans start.
        goals: g_1..g_N, shape (N, n) [m].
        radius: largest distance |s_k - g_k| at which the goal is caught at step k [m]; 0 to find
            any feasible trajectory.
    """

    problem: Problem
    state: State
    goals: Array
    radius: float = 0.0


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
    optional = (*EXTRAS, *PARTS, 'hazards', 'goal_attitude')
    known = fields_of(mapping, 'case', needed, optional)
    problem = _problem(known)
    state = _state(problem, known['state'], known.get('goal_attitude'))
    hazards = _hazards(problem, known.get('hazards', []))
    return Case(problem, replace(state, hazards=hazards), _goals(problem, known['goal']))


def _problem(known: Mapping[str, Any]) -> Problem:
    weights = dict(fields_of(known['weights'], 'weights', (), (*WEIGHTS, 'scaling')))
    scaling = weights.pop('scaling', 'paper')
    plain = {name: known[name] for name in (*MODEL, *EXTRAS) if name in known}
    problem = Problem(
        **plain,
        weights=Weights(**{**dict.fromkeys(WEIGHTS, 0.0), **weights}),
        floor=_floor(known.get('floor', {'shape': 'none'})),
        obstacles=_obstacles(known.get('obstacles', [])),
        approach=_approach(known.get('approach', {'cone': 0.0})),
    )
    return weighed(problem, scaling)


def _floor(value: Any) -> Floor:
    known = fields_of(value, 'floor', ('shape',), ('faces', 'fraction'))
    needed = Floor(known['shape']).parameters  # raises BadInput for an unknown shape
    return Floor(**fields_of(known, 'floor', ('shape', *needed), tuple(known)))


def _approach(value: Any) -> Approach:
    known = fields_of(value, 'approach', ('cone',), ('direction',))
    direction = numbers_of(known.get('direction', []), 'approach.direction')
    return Approach(known['cone'], tuple(direction))


def _obstacles(value: Any) -> tuple[Box | Ball, ...]:
    if not isinstance(value, list):
        raise BadInput('obstacles', value, f'a list of {BODIES}')
    return tuple(_obstacle(each, f'obstacles[{i}]') for i, each in enumerate(value))


def _obstacle(value: Any, culprit: str) -> Box | Ball:
    if isinstance(value, dict) and ('centre' in value or 'radius' in value):
        ball = fields_of(value, culprit, ('centre', 'radius'))
        return Ball(numbers_of(ball['centre'], 'obstacles.centre'), ball['radius'])
    box = fields_of(value, culprit, ('min', 'max'))
    return Box(numbers_of(box['min'], 'obstacles.min'), numbers_of(box['max'], 'obstacles.max'))


def _hazards(problem: Problem, value: Any) -> tuple[MovingObstacle, ...]:
    if not isinstance(value, list):
        raise BadInput('hazards', value, f'a list of {BODIES} that move')
    made = tuple(_hazard(each, f'hazards[{i}]') for i, each in enumerate(value))
    return tracked(made, problem.dimension)


def _hazard(value: Any, culprit: str) -> MovingObstacle:
    moves = ('times', 'shifts') if isinstance(value, dict) and 'times' in value else ('velocity',)
    kind = ('centre', 'radius') if isinstance(value, dict) and 'centre' in value else ('min', 'max')
    known = fields_of(value, culprit, (*kind, *moves))
    body = _obstacle({name: known[name] for name in kind}, culprit)
    given = [numbers_of(known[name], f'{culprit}.{name}') for name in moves]
    if len(given) == 2:
        return MovingObstacle(body, *given)
    return MovingObstacle.drifting(body, frozen(given[0], (body.dimension,), f'{culprit}.velocity'))


def _state(problem: Problem, value: Any, wanted: Any) -> State:
    optional = [
        'disturbance',
        *(['velocity'] if problem.inertial else []),
        *(['rotation_rate'] if problem.rotation_order == 2 else []),
    ]
    known = fields_of(value, 'state', ('position', 'rotation'), optional)
    arrays = {name: numbers_of(known[name], f'state.{name}') for name in known}
    # The state takes its dimension from the position: settle that first.
    arrays['position'] = frozen(arrays['position'], (problem.dimension,), 'state.position')
    if wanted is not None:
        n = problem.dimension
        arrays['wanted'] = frozen(numbers_of(wanted, 'goal_attitude'), (n, n), 'goal_attitude')
    return State.at(**arrays)


def _goals(problem: Problem, value: Any) -> Array:
    """Return g_1..g_N, from a list of N goals or from a single one."""
    n, horizon = problem.dimension, problem.horizon
    numbers_of(value, 'goal')
    if value and isinstance(value[0], list):
        return frozen(value, (horizon, n), 'goal')
    return frozen(np.tile(frozen(value, (n,), 'goal'), (horizon, 1)), (horizon, n), 'goal')
