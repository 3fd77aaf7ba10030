# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The problem that a certificate states, with its state and goals, in exact numbers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import Any, NamedTuple

from . import limits
from .exact import ONE, ZERO, Matrix, Vector, size_above
from .motion import Place, StatedModel, flown, model, steps
from .reading import Refused, fields, items, rows, vector, weight, whole, word
from .regions import Speeds
from .walls import BoxWall, DiscWall, wall

MOST_STEPS = 500
MOST_WALLS = 100_000  # times steps
ROTATED = 10**6  # within a part of one so small planar matrices have to be of their form
WEIGHTS = ('position', 'input', 'length', 'terminal', 'attitude', 'arrival')
STATE = ('position', 'rotation', 'velocity', 'rotation_rate', 'attitude', 'coasted',
         'disturbance', 'wanted')  # fmt: skip
PROBLEM = ('dimension', 'rotation_order', 'translation_order', 'discretisation', 'horizon', 'step',
           'forward', 'weights', 'terminal', 'floor', 'max_rate')  # fmt: skip
ANY_SPEED = {'entry': 0.0, 'change': 1.0}


class StatedWeights(NamedTuple):
    """Of the squares of what is flown, of how it turns, and of where it points; and of lengths.

    Attributes:
        flown: of s_k - g_k, and of p_N where there is inertia.
        turned: of differences of rotations.
        attitude: of the last rotation, less what is wanted.
        length: of |z_0|..|z_N|.
    """

    flown: list[Fraction]
    turned: Fraction
    attitude: Fraction
    length: list[Fraction]


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


class StatedLimits(NamedTuple):
    """Of each step its cones; its speeds, and how much they change.

    Then tethers, the cone above the goal, and walls.
    """

    cones: list[list[limits.Cone]]
    speeds: tuple[Speeds, ...]
    change: Fraction
    tether: limits.Tether | None
    slope: limits.GlideSlope | None
    walls: list[BoxWall | DiscWall]

    @property
    def least(self) -> list[Fraction]:
        """Return the greatest of the least speeds of each step's cones."""
        return [max((each.slowest for each in own), default=ZERO) for own in self.cones]


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
    floor: limits.StatedFloor
    state: StatedState
    goals: list[Vector]
    limits: StatedLimits
    turn: Fraction
    radius: Fraction | None = None

    def axis(self, rotation: Vector) -> Vector:
        """Return the thrust axis of a rotation."""
        return rotation.pieces(self.n)[0]

    @cached_property
    def costless(self) -> StatedProblem:
        """The same where nothing costs anything: no term of a cost is below that."""
        free, state = [ZERO] * (self.horizon + 1), self.state
        weights = StatedWeights(free[: len(self.weights.flown)], ZERO, ZERO, free)
        coasted = None if state.coasted is None else self.axis(state.coasted)
        first, second, wanted = map(self.axis, (state.first, state.second, state.wanted))
        state = state._replace(first=first, second=second, coasted=coasted, wanted=wanted)
        return replace(self, width=self.n, weights=weights, state=state)


def posed_by(document: dict[str, Any]) -> StatedProblem:
    """Return the problem that a certificate is of.

    Raises:
        Refused: it is malformed, or of a kind that the format has no proofs for.
    """
    problem = document['problem']
    fields(problem, 'problem', PROBLEM)
    n = whole(problem['dimension'], 'dimension', 2, 3)
    order = whole(problem['rotation_order'], 'rotation_order', 1, 2)
    horizon = whole(problem['horizon'], 'horizon', 1, MOST_STEPS)
    motion = model(problem, horizon)
    weights = _weights(problem['weights'], n, order, motion)
    seen = weights.turned or weights.attitude or order == 2
    width = 2 if n == 2 else 9 if seen else 3
    state = _state(document['state'], n, width, motion.step)
    if weights.attitude and document['state']['wanted'] is None:
        raise Refused('state.wanted is missing')
    made = limits.floor(problem['floor'])
    if made.slowest > 1:
        raise Refused('floor.fraction is above 1')
    if order == 2 or (made.faces and n == 3):  # of which the format has no proofs
        made = made._replace(slowest=ZERO, faces=0)
    turn = motion.step * weight(problem['max_rate'], 'max_rate')
    arrives = word(problem['terminal'], 'terminal', ('penalty', 'constraint')) == 'constraint'
    goals = rows(document['goals'], 'goals', horizon, n)
    first = state.first.pieces(n)[0]
    tied, led = limits.tether(turn, made, first), flown(motion, state[:3], first, horizon)
    held = _limits(document.get('limits', {}), made, tied, state, motion, led)
    turn = turn if n == 2 and made.slowest else ZERO
    return StatedProblem(
        n, order, horizon, width, motion, *led, weights, arrives, made, state, goals, held,
        turn,
    )  # fmt: skip


def _weights(stated: Any, n: int, order: int, model: StatedModel) -> StatedWeights:
    fields(stated, 'weights', WEIGHTS)
    q, r, length, last, attitude, arrival = (weight(stated[name], name) for name in WEIGHTS)
    double = 2 if n == 2 else 1  # coordinates of R that are there twice
    braking = [arrival * model.step * model.step] if model.inertial else []
    flown = [*[q] * (len(model.flown) - 2), q + last + arrival, *braking]
    lengths = [length * each for each in model.flown]
    turned = double * r / model.step ** (2 * order)
    return StatedWeights(flown, turned, double * attitude, lengths)


def _state(stated: Any, n: int, width: int, step: Fraction) -> StatedState:
    fields(stated, 'state', STATE)

    def rotation(name: str) -> Vector:
        """Return a matrix column by column, as far as it is seen."""
        columns = Matrix.of(rows(stated[name], f'state.{name}', n, n)).columns
        (a, b), (c, d) = (each[:2] for each in columns.rows[:2])
        if n == 2 and max(abs(a - d), abs(b + c)) * ROTATED > columns.unit:
            raise Refused(f'state.{name} is not [[a, -b], [b, a]]')
        return Vector([x for each in columns.rows for x in each][:width], columns.unit)

    def place(name: str) -> Vector:
        return vector(stated[name], f'state.{name}', n)

    first, rate = rotation('rotation'), rotation('rotation_rate')
    return StatedState(
        position=place('position'),
        velocity=place('velocity'),
        disturbance=place('disturbance'),
        first=first,
        second=first + rate * step,
        ahead=rotation('attitude'),
        coasted=None if stated['coasted'] is None else rotation('coasted'),
        wanted=Vector([0] * width) if stated['wanted'] is None else rotation('wanted'),
    )


def _limits(
    stated: Any,
    made: limits.StatedFloor,
    tied: limits.Tether | None,
    state: StatedState,
    model: StatedModel,
    led: tuple[list[Place], list[Place]],
) -> StatedLimits:
    fields(stated, 'limits', (), ('cones', 'glide_slope', 'walls', 'speeds'))
    n, horizon = len(state.position), len(model.flown) - 1
    sloping = 'glide_slope' in stated and n == 3
    bodies = items(stated.get('walls', []), 'walls')
    if len(bodies) * horizon > MOST_WALLS:
        raise Refused(f'walls are more than {MOST_WALLS} in all steps together')
    places = steps(model, *led) if bodies else []
    decided = state.second if state.coasted is None else state.coasted
    fastest = max(ONE, size_above(decided.pieces(n)[0]))  # what a body rate decides may be longer
    return StatedLimits(
        limits.cones(stated.get('cones', []), n, horizon),
        *limits.speeds(stated.get('speeds', ANY_SPEED), made.slowest, horizon),
        tied,
        limits.glide_slope(stated['glide_slope'], horizon) if sloping else None,
        [wall(each, n, places, fastest) for each in bodies],
    )
