r"""The planning problem: its weights, floor and obstacles, and the state it starts from.

The problem (Huang, Horowitz, Burdick, *Convex Model Predictive Control for Vehicular Systems*):

.. math::
    \min\; q \sum_{k=1}^{N} \|s_k - g_k\|^2 + r \sum_{k=0}^{N-1} \|u_k\|_F^2
         + \ell \sum_{k=0}^{N-1} h z \|R_k e_1\| + m \|s_N - g_N\|^2

over trajectories of the discrete dynamics with :math:`R_k \in \operatorname{conv} SO(n)`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from orbimpc_ros.mpc.arrays import Array, frozen, number, whole
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.faces import normals
from orbimpc_ros.mpc.geometry.orbitopes import MEMBERSHIP_TOLERANCE, margin
from orbimpc_ros.mpc.geometry.rotations import nearest

FLOOR_SHAPES = ('none', 'polygon', 'circle')
TERMINALS = ('penalty', 'constraint')
SOLID_FACES = (6, 12, 20)  # cube, dodecahedron, icosahedron
MAX_HORIZON = 500
MAX_OBSTACLES = 64
WIDEST_CONE = 1.4  # [rad] beyond it the cone of a turn is nearly a half-space, and ill-conditioned


@dataclass(frozen=True)
class Weights:
    """Weights of the objective, all >= 0.

    Attributes:
        position: q, on squared distance to the goal at every step [1/m^2].
        input: r, on the squared Frobenius norm of the inputs [s^2 or s^4].
        length: l, on the distance flown (order 1) or the thrust spent (order 2) [1/m].
        terminal: m, on the squared distance at the last step [1/m^2].
    """

    position: float = 1.0
    input: float = 0.05
    length: float = 0.0
    terminal: float = 10.0

    def __post_init__(self) -> None:
        for each in fields(self):
            number(getattr(self, each.name), f'weights.{each.name}', 0.0)


@dataclass(frozen=True)
class Floor:
    """Minimum speed fraction: |R_k e1| >= fraction, k = 1..N.

    Attributes:
        shape: ``none``; ``polygon``, the paper's: R e1 beyond one of the faces of a regular
            polygon or solid; ``circle``, the true floor.
        faces: of the polygon, >= 3 (n = 2), or of the solid, 6, 12 or 20 (n = 3).
        fraction: of full speed, in (0, 1]. The paper's det R > 0.3 is sqrt(0.3) for n = 2.
    """

    shape: str = 'none'
    faces: int = 4
    fraction: float = math.sqrt(0.3)

    def __post_init__(self) -> None:
        if self.shape not in FLOOR_SHAPES:
            raise BadInput('floor.shape', self.shape, ' | '.join(FLOOR_SHAPES))
        whole(self.faces, 'floor.faces', 3, 64)
        number(self.fraction, 'floor.fraction', 0.0, 1.0, above=True)

    def least(self, axis: Array) -> float:
        """Return the least speed fraction along a unit vector, shape (n,); 0 without a floor."""
        if self.shape == 'none':
            return 0.0
        if self.shape == 'circle':
            return self.fraction
        return self.fraction / float((normals(len(axis), self.faces) @ axis).max())


class ByContent:
    """Equality and hash of a frozen dataclass with arrays, which have neither: by their numbers."""

    def _content(self) -> tuple[object, ...]:
        values = (getattr(self, each.name) for each in fields(self))  # type: ignore[arg-type]
        # Adding zero makes -0.0 the 0.0 that it equals.
        return tuple((v + 0.0).tobytes() if isinstance(v, np.ndarray) else v for v in values)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, ByContent) or type(self) is not type(other):
            return NotImplemented
        return self._content() == other._content()

    def __hash__(self) -> int:
        return hash((type(self), self._content()))


@dataclass(frozen=True, eq=False)
class Box(ByContent):
    """An axis-aligned obstacle that every s_k, k = 1..N, stays outside of.

    Attributes:
        minimum: lower corner, shape (n,) [m].
        maximum: upper corner, shape (n,) [m], above ``minimum`` in every axis.
    """

    minimum: Array
    maximum: Array

    def __post_init__(self) -> None:
        shape = np.shape(self.minimum)
        object.__setattr__(self, 'minimum', frozen(self.minimum, shape, 'obstacles.min'))
        object.__setattr__(self, 'maximum', frozen(self.maximum, shape, 'obstacles.max'))
        if not np.all(self.minimum < self.maximum):
            raise BadInput('obstacles.max', self.maximum.tolist(), f'above {self.minimum.tolist()}')

    def depth(self, points: Array) -> Array:
        """Return how deep points, shape (..., n), are inside [m]; <= 0 outside."""
        return np.minimum(points - self.minimum, self.maximum - points).min(axis=-1)


@dataclass(frozen=True)
class Problem:
    """A planning problem without its state and goal: the part that stays from tick to tick.

    Attributes:
        dimension: n, 2 or 3.
        rotation_order: 1, inputs are rates of R; 2, inputs are accelerations of R.
        translation_order: 1, R e1 is a velocity; 2, an acceleration.
        horizon: N, steps.
        step: h [s].
        forward: z, full speed [m/s] (translation order 1) or thrust acceleration [m/s^2] (2).
        weights: of the objective.
        terminal: ``penalty``, or ``constraint``: s_N = g_N (and p_N = 0 at order 2).
        floor: minimum speed fraction.
        max_rate: limit on the body rate [rad/s], 0 for none. Without a floor it bounds the chord
            |R_{k+1} e1 - R_k e1|. With one it turns the vehicle and never brakes it: see
            :attr:`first_turn_is_an_angle`.
        obstacles: boxes to stay outside of.
        no_corner_cutting: whether consecutive points must share a free face of every box.
        arrival_weight: adds this times |s_N - g_N|^2 (and h^2 |p_N|^2 at translation order 2) to
            the objective: what stands in for an arrival that has become impossible [1/m^2].
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
    obstacles: tuple[Box, ...] = ()
    no_corner_cutting: bool = False
    arrival_weight: float = 0.0

    def __post_init__(self) -> None:
        _instance(self.weights, Weights, 'weights')
        _instance(self.floor, Floor, 'floor')
        for box in _instance(self.obstacles, tuple, 'obstacles'):
            _instance(box, Box, 'obstacles')
        whole(self.dimension, 'dimension', 2, 3)
        whole(self.rotation_order, 'rotation_order', 1, 2)
        whole(self.translation_order, 'translation_order', 1, 2)
        whole(self.horizon, 'horizon', 1, MAX_HORIZON)
        number(self.step, 'step', 0.0, 1e3, above=True)
        number(self.forward, 'forward', 0.0, 1e3, above=True)
        if self.terminal not in TERMINALS:
            raise BadInput('terminal', self.terminal, ' | '.join(TERMINALS))
        # Beyond half a turn in a step the direction of turning is lost.
        number(self.max_rate, 'max_rate', 0.0, math.pi / self.step)
        number(self.arrival_weight, 'arrival_weight', 0.0)
        self._check_floor()
        if len(self.obstacles) > MAX_OBSTACLES:
            raise BadInput('obstacles', len(self.obstacles), f'at most {MAX_OBSTACLES} boxes')
        for box in self.obstacles:
            if box.minimum.shape != (self.dimension,):
                raise BadInput('obstacles.min', box.minimum.tolist(), f'{self.dimension} numbers')

    @property
    def chord(self) -> float:
        """Return how far R e1 may move in a step: 2 sin(h max_rate / 2), infinity without one."""
        return 2.0 * math.sin(0.5 * self.step * self.max_rate) if self.max_rate else math.inf

    @property
    def first_turn_is_decided(self) -> bool:
        """Return whether ``max_rate`` has no say in the first step.

        At rotation order 2 the body rate it starts with carries the vehicle through it, and what
        the limit could still do is to brake, which nothing with a floor may be asked to.
        """
        return self.rotation_order == 2 and self.floor.shape != 'none'

    @property
    def first_turn_is_an_angle(self) -> bool:
        """Return whether ``max_rate`` bounds the angle from Q_0 e1 to R_1 e1, whatever the speed.

        With a floor it must: against the measured R_0 e1 a chord would limit the change of speed
        too, and a vehicle measured to be slow would be told to fly slowly. A cone is convex up to
        a quarter turn; a wider turn than that is bounded by the chord from R_0 e1.
        """
        return (
            self.rotation_order == 1
            and self.floor.shape != 'none'
            and 0.0 < self.step * self.max_rate < WIDEST_CONE
        )

    @property
    def length_unit(self) -> float:
        """Return h z, at translation order 2 h^2 z: what a step moves a vehicle at most [m]."""
        return self.forward * self.step**self.translation_order

    def _check_floor(self) -> None:
        floor = self.floor
        if floor.shape != 'polygon':
            return
        if self.dimension == 3 and floor.faces not in SOLID_FACES:
            raise BadInput('floor.faces', floor.faces, '6, 12 or 20 when dimension is 3')
        limit = largest_fraction(self.dimension, floor.faces)
        if floor.fraction > limit:
            where = 'floor.fraction'
            raise BadInput(
                where, floor.fraction, f'at most {limit:.6g} with floor.faces {floor.faces}'
            )


def _instance(value: Any, kind: type, culprit: str) -> Any:
    if not isinstance(value, kind):
        raise BadInput(culprit, f'a {type(value).__name__}', f'a {kind.__name__}')
    return value


def largest_fraction(dimension: int, faces: int) -> float:
    """Return the largest fraction whose polygon or solid still lies inside the unit ball.

    The ratio of inscribed to circumscribed sphere: cos(pi/m) for a polygon of m faces. Above it
    the faces leave gaps and the union of half-spaces no longer surrounds the forbidden region.
    """
    if dimension == 2:
        return math.cos(math.pi / faces)
    return 1.0 / math.sqrt(3.0) if faces == 6 else math.sqrt((5.0 + 2.0 * math.sqrt(5.0)) / 15.0)


@dataclass(frozen=True, eq=False)
class State(ByContent):
    """Where the vehicle is when the plan starts.

    Attributes:
        position: s_0, shape (n,) [m].
        rotation: R_0 in conv SO(n), shape (n, n): the attitude scaled by the speed fraction.
        velocity: p_0, shape (n,) [m/s]; zero unless translation is of order 2.
        rotation_rate: W_0, shape (n, n) [1/s]; zero unless rotation is of order 2.
        attitude: Q_0, shape (n, n), the rotation R_0 was scaled from; by default the nearest one.
        coasted: the rotation, shape (n, n), that the present body rate turns the attitude into
            during the first step. With it (rotation order 2), R_1 = rho * coasted with the
            thrust fraction rho in [0, 1] free, instead of R_1 = R_0 + h W_0, which would
            leave the manifold.
    """

    position: Array
    rotation: Array
    velocity: Array
    rotation_rate: Array
    attitude: Array
    coasted: Array | None = None

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
    ) -> State:
        """Return the state at a position and rotation, at rest where nothing else is said.

        Raises:
            BadInput: an array of the wrong shape, not finite, or outside its set.
        """
        n = np.size(position)
        if n not in (2, 3):
            raise BadInput('state.position', n, '2 or 3 numbers')
        placed = frozen(rotation, (n, n), 'state.rotation')
        return cls(
            frozen(position, (n,), 'state.position'),
            placed,
            frozen(np.zeros(n) if velocity is None else velocity, (n,), 'state.velocity'),
            frozen(
                np.zeros((n, n)) if rotation_rate is None else rotation_rate,
                (n, n),
                'state.rotation_rate',
            ),
            _rotation(nearest(placed) if attitude is None else attitude, n, 'state.attitude'),
            None if coasted is None else _rotation(coasted, n, 'state.coasted'),
        )

    def __post_init__(self) -> None:
        _require_structure(self.rotation, 'state.rotation')
        _require_structure(self.rotation_rate, 'state.rotation_rate')
        if margin(self.rotation) < -MEMBERSHIP_TOLERANCE:
            allowed = f'a matrix in conv SO({self.dimension})'
            raise BadInput('state.rotation', self.rotation.tolist(), allowed)

    @property
    def dimension(self) -> int:
        """Return n."""
        return len(self.position)


def _rotation(value: ArrayLike, n: int, culprit: str) -> Array:
    matrix = frozen(value, (n, n), culprit)
    if np.abs(matrix.T @ matrix - np.eye(n)).max() > 1e-9 or np.linalg.det(matrix) < 0.0:
        raise BadInput(culprit, matrix.tolist(), f'a rotation in SO({n})')
    return matrix


def _require_structure(matrix: Array, culprit: str) -> None:
    if len(matrix) == 2:
        (a, b), (c, d) = matrix.tolist()
        if abs(a - d) > 1e-6 or abs(b + c) > 1e-6:
            raise BadInput(culprit, matrix.tolist(), '[[a, -b], [b, a]]')
