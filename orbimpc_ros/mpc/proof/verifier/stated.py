# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The problem that a certificate states, with its state and goals, in exact numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from typing import Any, NamedTuple

from .exact import ONE, ZERO, Vector, size_above
from .limits import (
    Cone,
    GlideSlope,
    StatedFloor,
    Tether,
    cones,
    floor,
    glide_slope,
    speeds,
    tether,
)  # fmt: skip
from .motion import Begin, Place, StatedModel, Step, flown, model, steps
from .reading import Refused, fields, items, rows, vector, weight, whole, word
from .regions import Speeds
from .walls import BoxWall, DiscWall, wall

MOST_STEPS = 500
WEIGHTS = ('position', 'input', 'length', 'terminal', 'attitude', 'arrival')
STATE = ('position', 'rotation', 'velocity', 'rotation_rate', 'attitude', 'coasted',
         'disturbance', 'wanted')  # fmt: skip
PROBLEM = ('dimension', 'rotation_order', 'translation_order', 'discretisation', 'horizon', 'step',
           'forward', 'weights', 'terminal', 'floor', 'max_rate')  # fmt: skip
ANY_SPEED = {'entry': 0.0, 'change': 1.0}


class StatedWeights(NamedTuple):
    """Of |s_k - g_k|^2, shape (N,); of inputs; of the last attitude; of p_N; of |z_0|..|z_N|."""

    position: Vector
    input: Fraction
    attitude: Fraction
    braking: Fraction
    length: Vector


class StatedState(NamedTuple):
    """Where plans start: rotations are as many of their columns' numbers as the cost sees."""

    position: Vector
    velocity: Vector
    disturbance: Vector
    first: Vector  # R_0
    second: Vector  # R_0 + h dR_0, at rotation order 2
    ahead: Vector  # the attitude
    coasted: Vector | None
    wanted: Vector

    @property
    def begins(self) -> list[Begin]:
        """Return s_0, p_0 and w along each axis."""
        return list(zip(self.position, self.velocity, self.disturbance, strict=True))


class StatedLimits(NamedTuple):
    """Of each step its cones, and what they are least at; its speeds, and how much they change.

    Then tethers, the cone above the goal, and walls.
    """

    cones: list[list[Cone]]
    least: Vector
    speeds: tuple[Speeds, ...]
    change: Fraction
    tether: Tether | None
    slope: GlideSlope | None
    walls: list[BoxWall | DiscWall]


@dataclass(frozen=True, eq=False)
class StatedProblem:
    """A problem with its state and goals.

    Attributes:
        n: dimension.
        order: of rotations.
        horizon: N.
        width: how many numbers a rotation is: its thrust axis alone where the cost sees no more.
        positions: s_0..s_N.
        velocities: at those times.
        arrives: whether trajectories have to end at the goal.
        turn: angle that directions that are split turn by in a step at most [rad]; 0 for any.
        radius: within which s_N is of g_N [m]; None where it may be anywhere.
    """

    n: int
    order: int
    horizon: int
    width: int
    model: StatedModel
    positions: list[Place]
    velocities: list[Place]
    weights: StatedWeights
    arrives: bool
    floor: StatedFloor
    state: StatedState
    goals: list[Vector]
    limits: StatedLimits
    turn: Fraction
    radius: Fraction | None = None


def posed_by(
    document: dict[str, Any], radius: Fraction | None = None, *, refutes: bool = False
) -> StatedProblem:
    """Return the problem that a certificate is of; what refutes sees thrust axes alone.

    Raises:
        Refused: it is malformed, or of a kind that the format has no proofs for.
    """
    problem = document['problem']
    fields(problem, 'problem', PROBLEM)
    n = whole(problem['dimension'], 'dimension', 2, 3)
    order = whole(problem['rotation_order'], 'rotation_order', 1, 2)
    horizon = whole(problem['horizon'], 'horizon', 1, MOST_STEPS)
    motion = model(problem, horizon)
    weights = _weights(problem['weights'], n, motion)
    seen = weights.input or weights.attitude or not (refutes or order == 1)
    width = 2 if n == 2 else 9 if seen else 3
    state = _state(document['state'], n, width, motion.step)
    if weights.attitude and document['state']['wanted'] is None:
        raise Refused('state.wanted is missing')
    made = floor(problem['floor'])
    if made.slowest > 1 or (made.exists and order == 2) or (made.faces and n == 3):
        raise Refused('the floor is beyond this format')
    turn = motion.step * weight(problem['max_rate'], 'max_rate')
    arrives = word(problem['terminal'], 'terminal', ('penalty', 'constraint')) == 'constraint'
    goals = rows(document['goals'], 'goals', horizon, n)
    tied = tether(turn, made, state.first[:n])
    led = flown(motion, state.begins, state.first[:n], horizon)

    def within() -> list[Step]:
        return steps(motion, *led)

    limits = _limits(document.get('limits', {}), made, tied, state, horizon, within)
    turn = turn if n == 2 and made.slowest else ZERO
    return StatedProblem(
        n, order, horizon, width, motion, *led, weights, arrives, made, state, goals, limits,
        turn, radius,
    )  # fmt: skip


def _weights(stated: Any, n: int, model: StatedModel) -> StatedWeights:
    fields(stated, 'weights', WEIGHTS)
    q, r, length, last, attitude, arrival = (weight(stated[name], name) for name in WEIGHTS)
    double = 2 if n == 2 else 1  # coordinates of R that are there twice
    position = [q] * (len(model.flown) - 2) + [q + last + arrival]
    braking = arrival * model.step * model.step if model.inertial else ZERO
    lengths = [length * each for each in model.flown]
    return StatedWeights(position, double * r, double * attitude, braking, lengths)


def _state(stated: Any, n: int, width: int, step: Fraction) -> StatedState:
    fields(stated, 'state', STATE)

    def rotation(name: str) -> Vector:
        """Return a matrix column by column, as far as it is seen."""
        matrix = rows(stated[name], f'state.{name}', n, n)
        return [row[i] for i in range(n) for row in matrix][:width]

    def place(name: str) -> Vector:
        return vector(stated[name], f'state.{name}', n)

    first, rate = rotation('rotation'), rotation('rotation_rate')
    return StatedState(
        position=place('position'),
        velocity=place('velocity'),
        disturbance=place('disturbance'),
        first=first,
        second=[x + step * y for x, y in zip(first, rate, strict=True)],
        ahead=rotation('attitude'),
        coasted=None if stated['coasted'] is None else rotation('coasted'),
        wanted=[ZERO] * width if stated['wanted'] is None else rotation('wanted'),
    )


def _limits(
    stated: Any,
    made: StatedFloor,
    tied: Tether | None,
    state: StatedState,
    horizon: int,
    within: Callable[[], list[Step]],
) -> StatedLimits:
    fields(stated, 'limits', (), ('cones', 'glide_slope', 'walls', 'speeds'))
    n = len(state.position)
    sloping = 'glide_slope' in stated and n == 3
    bodies = items(stated.get('walls', []), 'walls')
    places = within() if bodies else []
    decided = state.second if state.coasted is None else state.coasted
    fastest = max(ONE, size_above(decided[:n]))  # what a body rate decides may be longer
    directed, slowest = cones(stated.get('cones', []), n, made.slowest, horizon)
    return StatedLimits(
        directed,
        slowest,
        *speeds(stated.get('speeds', ANY_SPEED), made.slowest, horizon),
        tied,
        glide_slope(stated['glide_slope'], horizon) if sloping else None,
        [wall(each, n, places, fastest) for each in bodies],
    )


@lru_cache(maxsize=4)
def costless(posed: StatedProblem) -> StatedProblem:
    """Return a problem of which nothing costs anything: no term of a cost is below that."""
    free = [ZERO] * posed.horizon
    weights = StatedWeights(free, ZERO, ZERO, ZERO, [*free, ZERO])
    state, n = posed.state, posed.n
    first, second, coasted = state.first[:n], state.second[:n], state.coasted
    state = state._replace(first=first, second=second, coasted=coasted and coasted[:n])
    return replace(posed, width=n, weights=weights, state=state)
