# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The planning problem: its model, weights and limits; and the state that a plan starts from.

The objective is that of Huang, Horowitz, Burdick, *Convex Model Predictive Control for Vehicular
Systems*, extended: (1.2a), over trajectories (1.1a) with R_k in conv SO(n). Its sums have another
meaning for each step and speed; weights of integrals over the horizon (1.6a) do not.

Mathematics: docs/mathematics.md, 1 and 3.6 to 3.11.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, lru_cache
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from orbimpc_ros.mpc.arrays import Array, ByContent, frozen, number, sealed, whole, word
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import MEMBERSHIP_TOLERANCE, margin, nearest
from orbimpc_ros.mpc.model.translation import (
    DISCRETISATIONS,
    TRANSLATIONS,
    Maps,
    Translation,
    maps_of,
)
from orbimpc_ros.mpc.problem.floor import Floor
from orbimpc_ros.mpc.problem.obstacle import MAX_HAZARDS, Ball, Box, MovingObstacle

TERMINALS = ('penalty', 'constraint')
SCALINGS = ('paper', 'time')
TIMES = 20  # units of time in a horizon: the default weights smooth headings over a fortieth of it
MAX_HORIZON = 500
LEAST = 1e-6  # [s] and [m/s]: products of far smaller ones underflow
MAX_OBSTACLES = 64
SLOWEST = 0.01  # speed fraction below which a heading has no direction
LEEWAY = 3e-7  # [rad] tolerance of the cone in the plane, for plans that only just reach it
STEEPEST_GLIDE = 1.5  # [rad]: 14 m up per horizontal metre
WIDEST_CONE = 1.4  # [rad] beyond it a cone is nearly a half-space, and ill-conditioned
T = TypeVar('T')
COUNTS = {'dimension': (2, 3), 'rotation_order': (1, 2), 'horizon': (1, MAX_HORIZON)}
RANGES = {
    'step': (LEAST, 1e3),
    'forward': (LEAST, 1e3),
    'max_acceleration': (0.0, math.inf),
    'arrival_weight': (0.0, math.inf),
    'tilt': (0.0, 0.5 * math.pi),
    'glide_slope': (0.0, STEEPEST_GLIDE),
}


@dataclass(frozen=True)
class Weights:
    """Weights of the objective, all >= 0.

    Attributes:
        position: q, on squared distance to the goal at every step [1/m^2].
        input: r, on the squared Frobenius norm of the inputs [s^2 or s^4].
        length: l, on the distance flown (order 1) or the thrust spent (order 2) [1/m].
        terminal: m, on the squared distance at the last step [1/m^2].
        attitude: a, on the squared Frobenius distance between the last rotation and R_g, which the
            state then has to give.
    """

    position: float = 1.0
    input: float = 0.05
    length: float = 0.0
    terminal: float = 10.0
    attitude: float = 0.0

    def __post_init__(self) -> None:
        for each in fields(self):
            number(getattr(self, each.name), f'weights.{each.name}', 0.0)


@dataclass(frozen=True)
class Approach:
    """The cone of directions in which a goal may be approached, about an axis d.

    It constrains the direction R_N e1 that the vehicle finally points in, not a velocity, be it its
    own or relative to the goal. Headings shorter than ``least``, the larger of ``SLOWEST`` and the
    floor, have no well-defined direction: they need the same component along d as one of that
    length. The constraint is convex:

        R_N e1 . d >= cos(cone) max(|R_N e1|, least).

    Attributes:
        cone: largest angle between the last heading and the direction [rad]; 0: unconstrained.
        direction: axis of the cone in the world frame, n numbers, not necessarily a unit vector;
            empty: the first axis of the goal's attitude, ``State.wanted``.
    """

    cone: float = 0.0
    direction: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        number(self.cone, 'approach.cone', 0.0, WIDEST_CONE)
        for each in self.direction:
            number(each, 'approach.direction')

    @cached_property
    def exists(self) -> bool:
        """Return True if the last heading is constrained."""
        return self.cone > 0.0

    @cached_property
    def is_the_goals(self) -> bool:
        """Return True if the goal's attitude gives the direction."""
        return self.exists and not self.direction

    def validate(self, dimension: int) -> None:
        """Check the direction for a dimension.

        Raises:
            BadInput: not n numbers, or a vector too short or too long.
        """
        direction = self.direction
        if direction and not (len(direction) == dimension and 1e-6 < math.hypot(*direction) < 1e6):
            wanted = f'{dimension} numbers, not all of them 0, or none'
            raise BadInput('approach.direction', list(direction), wanted)

    def axis(self, state: State) -> Array:
        """Return the direction d of approach, a unit vector of shape (n,)."""
        if self.direction:
            return np.array(self.direction) / math.hypot(*self.direction)
        assert state.wanted is not None
        return state.wanted[:, 0]


@dataclass(frozen=True)
class Problem:
    """A planning problem without its state and goal: the part that is the same at every tick.

    Attributes:
        dimension: n, 2 or 3.
        rotation_order: 1, inputs are rates of R; 2, inputs are accelerations of R.
        translation_order: 1, R e1 is a velocity; 2, an acceleration; or the number of another
            registered :class:`~orbimpc_ros.mpc.model.translation.Translation`.
        horizon: N, number of steps.
        step: h [s].
        forward: z, full speed [m/s] (translation order 1) or thrust acceleration [m/s^2] (2).
        weights: of the objective.
        terminal: ``penalty``, or ``constraint``: s_N = g_N (and p_N = 0 at order 2).
        floor: minimum speed fraction.
        max_rate: limit on the body rate [rad/s], 0 for none. Without a floor it bounds the chord
            |R_{k+1} e1 - R_k e1|. With one it bounds the angle from R_k e1 to R_{k+1} e1, at all
            speeds: see :attr:`turns_are_angles`; at rotation order 2 from the second turn on.
        max_acceleration: limit on the change of speed at translation order 1 [m/s^2], 0 for none:
            ||R_{k+1} e1| - |R_k e1|| <= h max_acceleration / z. For initial speeds below the floor
            see :func:`orbimpc_ros.mpc.problem.reach.entry_speed`.
        obstacles: bodies to stay outside of: boxes at every s_k, balls at all times.
        no_corner_cutting: whether consecutive points must share a free face of every box.
        arrival_weight: weight on |s_N - g_N|^2 (and on h^2 |p_N|^2 at translation order 2), which
            replaces a terminal constraint that has become infeasible [1/m^2].
        discretisation: ``euler``, the paper's, or ``exact``: the thrust axis moves on the chord
            from R_k e1 to R_{k+1} e1 during a step, and its effect is integrated exactly; or, at
            translation order 2, ``held``: the thrust R_{k+1} e1 is held throughout the step.
        tilt: largest angle of the thrust axis R_k e1 from the vertical, +z [rad], 0 for none;
            dimension 3, translation order 2.
        glide_slope: angle between the horizontal and the side of a cone above the goal that
            contains every s_k [rad], 0 for none; dimension 3. For states outside of the tilt or
            glide-slope cone see :mod:`orbimpc_ros.mpc.problem.cones`.
        approach: cone of directions that contains the last heading R_N e1.
    """

    dimension: int = 2
    rotation_order: int = 1
    translation_order: int = 1
    horizon: int = 5
    step: float = 1.0
    forward: float = 1.0
    weights: Weights = field(default_factory=Weights)
    terminal: str = 'penalty'
    floor: Floor = field(default_factory=Floor)
    max_rate: float = 0.0
    max_acceleration: float = 0.0
    obstacles: tuple[Box | Ball, ...] = ()
    no_corner_cutting: bool = False
    arrival_weight: float = 0.0
    discretisation: str = 'euler'
    tilt: float = 0.0
    glide_slope: float = 0.0
    approach: Approach = field(default_factory=Approach)

    def __post_init__(self) -> None:
        _instance(self.weights, Weights, 'weights')
        _instance(self.floor, Floor, 'floor')
        _instance(self.approach, Approach, 'approach')
        for each in _instance(self.obstacles, tuple, 'obstacles'):
            if not isinstance(each, (Box, Ball)):
                raise BadInput('obstacles', f'a {type(each).__name__}', 'a Box or a Ball')
        for name, limits in COUNTS.items():
            whole(getattr(self, name), name, *limits)
        for name, ends in RANGES.items():
            number(getattr(self, name), name, *ends)
        whole(self.translation_order, 'translation_order', 1, max(TRANSLATIONS))
        word(self.terminal, 'terminal', TERMINALS)
        word(self.discretisation, 'discretisation', DISCRETISATIONS)
        if not isinstance(self.no_corner_cutting, bool):
            raise BadInput('no_corner_cutting', self.no_corner_cutting, 'true | false')
        if self.translation_order not in DISCRETISATIONS[self.discretisation]:
            allowed = f'euler at translation_order {self.translation_order}'
            raise BadInput('discretisation', self.discretisation, allowed)
        # Beyond half a turn in a step the direction of turning is ambiguous.
        number(self.max_rate, 'max_rate', 0.0, math.pi / self.step)
        if self.floor.shape == 'polygon':
            self.floor.validate(self.dimension)
        self.approach.validate(self.dimension)
        self._validate_kind()
        if len(self.obstacles) > MAX_OBSTACLES:
            raise BadInput('obstacles', len(self.obstacles), f'at most {MAX_OBSTACLES}')
        for each in self.obstacles:
            if each.dimension != self.dimension:
                name, corner = (
                    ('centre', each.centre) if isinstance(each, Ball) else ('min', each.minimum)
                )
                raise BadInput(f'obstacles.{name}', corner.tolist(), f'{self.dimension} numbers')

    def _validate_kind(self) -> None:
        """Refuse limits that do not apply to the dimension or translation order."""
        flat, order = '0 when dimension is 2', f'0 at translation_order {self.translation_order}'
        for name, none, allowed in (
            ('max_acceleration', self.inertial, order),  # thrust is acceleration, and limited
            ('tilt', self.dimension == 2, flat),
            ('glide_slope', self.dimension == 2, flat),
            ('tilt', not self.inertial, order),  # R e1 is then a velocity, not a tilted thrust
        ):
            if none and getattr(self, name):
                raise BadInput(name, getattr(self, name), allowed)

    @cached_property
    def boxes(self) -> tuple[Box, ...]:
        """Return the obstacles that are boxes."""
        return tuple(each for each in self.obstacles if isinstance(each, Box))

    @cached_property
    def weighs_rotations(self) -> bool:
        """Return True if the cost has more of R than R e1: that of inputs, or of the last R."""
        return self.weights.input > 0.0 or self.weights.attitude > 0.0

    @cached_property
    def wants_attitude(self) -> bool:
        """Return True if the state has to give the desired final rotation."""
        return self.weights.attitude > 0.0 or self.approach.is_the_goals

    @cached_property
    def least_speed(self) -> float:
        """Return the least share of full speed that the floor allows; 0 without a floor."""
        return self.floor.fraction if self.floor.exists else 0.0

    @property
    def least_heading(self) -> float:
        """Return the least length that the cone of approach assumes for R_N e1."""
        return max(SLOWEST, self.least_speed)

    @cached_property
    def floor_normals(self) -> Array | None:
        """Return the unit normals of the floor's half-spaces, shape (m, n); None if it is round."""
        return self.floor.normals(self.dimension)

    @cached_property
    def has_cones(self) -> bool:
        """Return True if there is a tilt limit or a glide slope."""
        return self.tilt > 0.0 or self.glide_slope > 0.0

    @cached_property
    def turns_are_angles(self) -> bool:
        """Return True if ``max_rate`` bounds the angle of each turn, at all speeds.

        With a floor it does, so vehicles can follow plans exactly. Without one, R e1 may vanish,
        and it bounds the chord |R_{k+1} e1 - R_k e1|, which limits changes of speed as well.
        """
        return self.floor.exists and self.max_rate > 0.0

    @cached_property
    def widest_turn(self) -> float:
        """Return the largest angle of a turn, h max_rate <= pi [rad]; pi without a limit."""
        return min(math.pi, self.step * self.max_rate) if self.max_rate else math.pi

    @cached_property
    def chord(self) -> float:
        """Return the largest |R_{k+1} e1 - R_k e1| for k >= 1; infinity without a limit.

        It is 2 sin(h max_rate / 2), or with a floor f the chord of a turn by h max_rate between the
        speeds f and 1, if that is longer.
        """
        if not self.max_rate:
            return math.inf
        turned, least = self.widest_turn, self.least_speed
        uneven = 1.0 + least * least - 2.0 * least * math.cos(turned)
        at_speed = 2.0 * math.sin(0.5 * turned)
        return max(at_speed, math.sqrt(uneven)) if self.floor.exists else at_speed

    @cached_property
    def speed_change(self) -> float:
        """Return the largest change of |R e1| in a step; infinity without a limit."""
        if not self.max_acceleration:
            return math.inf
        return self.step * self.max_acceleration / self.forward

    @cached_property
    def turned_cones(self) -> dict[int, float]:
        """Return by step k the angle of the cone about Q_0 e1 that holds R_k e1 [rad] (3.6c)."""
        limited = self.turns_are_angles and self.rotation_order == 1
        angles = {k: k * self.widest_turn for k in range(1, self.horizon + 1) if limited}
        return {k: angle for k, angle in angles.items() if angle < math.pi}

    @cached_property
    def first_turn_is_a_cone(self) -> bool:
        """Return True if R_1 e1 has such a cone that is convex: below a quarter turn."""
        return self.turned_cones.get(1, math.pi) < WIDEST_CONE

    @cached_property
    def maps(self) -> Maps:
        """Return the maps of the translation model over the horizon."""
        return maps_of(self.translation, self.horizon, self.step, self.forward)

    @cached_property
    def decided_steps(self) -> int:
        """Return how many of s_1..s_N the state alone decides."""
        return int((self.maps.reach[:, 1:] == 0.0).all(axis=1).sum())

    @cached_property
    def translation(self) -> Translation:
        """Return the model of how R e1 moves the vehicle."""
        return DISCRETISATIONS[self.discretisation][self.translation_order]

    @cached_property
    def inertial(self) -> bool:
        """Return True if R e1 is a thrust, which changes the velocity, instead of the velocity."""
        return self.translation.inertial


def _instance(value: Any, kind: type, culprit: str) -> Any:
    if not isinstance(value, kind):
        raise BadInput(culprit, f'a {type(value).__name__}', f'a {kind.__name__}')
    return value


def weighed(problem: Problem, scaling: str) -> Problem:
    """Return a problem with its weights converted to those of the paper's sums.

    With the ``scaling`` ``paper`` they are; with ``time`` they are dimensionless ones on integrals
    over the horizon (1.6a).

    Raises:
        BadInput: no such scaling.
    """
    word(scaling, 'weights.scaling', SCALINGS)
    if scaling == 'paper':
        return problem
    weights, time = problem.weights, problem.horizon * problem.step / TIMES
    speed = problem.forward * time if problem.inertial else problem.forward
    area, share = (speed * time) ** 2, problem.step / time
    summed = Weights(
        position=weights.position * share / area,
        input=weights.input * share * time ** (2 * problem.rotation_order),
        length=weights.length / (problem.forward * time),  # the sum adds h z |R e1| per step
        terminal=weights.terminal / area,
        attitude=weights.attitude,
    )
    return replace(problem, weights=summed)


@dataclass(frozen=True, eq=False)
class State(ByContent):
    """The vehicle's state at the start of a plan; :meth:`at` makes and validates it.

    Attributes:
        position: s_0, shape (n,) [m].
        rotation: R_0 in conv SO(n), shape (n, n): the attitude scaled by the speed fraction.
        velocity: p_0, shape (n,) [m/s]; zero unless translation is of order 2.
        rotation_rate: W_0, shape (n, n) [1/s]; zero unless rotation is of order 2.
        attitude: Q_0, shape (n, n), the rotation R_0 was scaled from; by default the nearest one.
        coasted: the rotation, shape (n, n), that the present body rate turns the attitude into
            during the first step (rotation order 2). With it R_1 = rho * coasted, the thrust
            fraction rho in [0, 1] free, instead of R_1 = R_0 + h W_0, which is off the manifold.
        disturbance: w, constant over the horizon, shape (n,); at translation order 1 a wind in the
            world frame [m/s], at order 2 an acceleration, gravity included [m/s^2].
        commanded: the share of full speed last commanded, in [0, 1], from which the first change of
            speed is limited; by default |R_0 e1|.
        hazards: moving obstacles to stay clear of, with times from the start of the plan.
        wanted: R_g, the desired final rotation, shape (n, n); None if it is unconstrained.
    """

    position: Array
    rotation: Array
    velocity: Array
    rotation_rate: Array
    attitude: Array
    coasted: Array | None
    disturbance: Array
    commanded: float | None = None
    hazards: tuple[MovingObstacle, ...] = ()
    wanted: Array | None = None

    @classmethod
    def at(
        cls,
        position: ArrayLike,
        rotation: ArrayLike,
        *,
        velocity: ArrayLike | None = None,
        rotation_rate: ArrayLike | None = None,
        attitude: ArrayLike | None = None,
        coasted: ArrayLike | None = None,
        disturbance: ArrayLike | None = None,
        commanded: float | None = None,
        hazards: tuple[MovingObstacle, ...] = (),
        wanted: ArrayLike | None = None,
    ) -> State:
        """Return the state at a position and rotation, at rest by default.

        Raises:
            BadInput: an array of the wrong shape, not finite, or outside its set; too many hazards,
                or one of another dimension.
        """
        n = np.size(position)
        if n not in (2, 3):
            raise BadInput('state.position', n, '2 or 3 numbers')
        line, square, still = (n,), (n, n), _zeros((n,))
        arrays: dict[str, tuple[Any, tuple[int, ...], Array | None]] = {
            'position': (position, line, None),
            'rotation': (rotation, square, None),
            'velocity': (velocity, line, still),
            'rotation_rate': (rotation_rate, square, _zeros(square)),
            'attitude': (attitude, square, None),
            'coasted': (coasted, square, None),
            'disturbance': (disturbance, line, still),
            'wanted': (wanted, square, None),
        }
        made: dict[str, Any] = {
            name: absent if value is None else frozen(value, shape, f'state.{name}')
            for name, (value, shape, absent) in arrays.items()
        }
        if attitude is None:
            made['attitude'] = sealed(nearest(made['rotation']))
        for name in ('attitude', 'coasted', 'wanted'):
            if made[name] is not None:
                _require_rotation(made[name], f'state.{name}')
        for name in ('rotation', 'rotation_rate'):
            _require_structure(made[name], f'state.{name}')
        if margin(made['rotation']) < -MEMBERSHIP_TOLERANCE:
            allowed = f'a matrix in conv SO({n})'
            raise BadInput('state.rotation', made['rotation'].tolist(), allowed)
        if commanded is not None:
            number(commanded, 'state.commanded', 0.0, 1.0)
        for each in _instance(hazards, tuple, 'state.hazards'):
            if _instance(each, MovingObstacle, 'state.hazards').body.dimension != n:
                raise BadInput('state.hazards', each.body.dimension, f'bodies of dimension {n}')
        if len(hazards) > MAX_HAZARDS:
            raise BadInput('state.hazards', len(hazards), f'at most {MAX_HAZARDS}')
        return cls(commanded=commanded, hazards=hazards, **made)

    @cached_property
    def _cache(self) -> list[tuple[Any, Any]]:
        return []

    def once(self, key: Any, work_out: Callable[[], T]) -> T:
        """Return the value cached for this state under a key; compute it at the first call."""
        for cached, value in self._cache:
            if cached == key:
                return cast('T', value)
        value = work_out()
        self._cache.append((key, value))
        return value


@lru_cache(maxsize=8)
def _zeros(shape: tuple[int, ...]) -> Array:
    """Return zeros shared by all states, since creating and checking arrays costs microseconds."""
    return sealed(np.zeros(shape))


def _require_rotation(matrix: Array, culprit: str) -> None:
    n, near = len(matrix), matrix.clip(-2.0, 2.0)  # squares of far larger numbers overflow
    if np.abs(near.T @ near - np.eye(n)).max() > 1e-9 or np.linalg.det(near) < 0.0:
        raise BadInput(culprit, matrix.tolist(), f'a rotation in SO({n})')


def _require_structure(matrix: Array, culprit: str) -> None:
    if len(matrix) == 2:
        (a, b), (c, d) = matrix.tolist()
        if abs(a - d) > 1e-6 or abs(b + c) > 1e-6:
            raise BadInput(culprit, matrix.tolist(), '[[a, -b], [b, a]]')
