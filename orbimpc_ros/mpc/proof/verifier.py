# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Whether a certificate proves its lower bound: in exact arithmetic, from the standard library.

    python verifier.py CERTIFICATE.json

Nothing of the package is imported, and nothing is rounded: numbers of the file are doubles, and
what follows is computed with fractions. Square roots, sines and cosines are bracketed, and the side
taken on which a bound gets worse.

A bound rests on three facts. (1) The cost without lengths, f, is a sum of squares of affine
functions: it is convex, and so is f_t(x) = f(x) + sum_k t_k |x_k|^2 / 2 where its matrix is
positive semidefinite; any tangent of it is a lower bound. (2) What is left of the cost, lengths and
-t_k |x_k|^2 / 2, and the tangent are sums over steps: their least value over the sets C_k that the
x_k are in is a sum of least values, each known in closed form. (3) Splits are exhaustive: whatever
a trajectory does, it is in one of the parts; a floor's faces or the directions below and above an
angle. The bound of a split is the least of its parts'.

Format and derivation: docs/proofs.md.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

FORMAT = 'orbimpc certificate 1'
RELATIVE = Fraction(1, 10**9)  # by which a published bound may exceed what is proved
LARGEST = 64 << 20  # bytes of a file
DEEPEST, MOST_STEPS = 100_000, 500
BITS = 160  # after the point, of square roots and of what Cholesky's method works with
TINY = Fraction(1, 1 << 120)  # by which sines, cosines and PI may be off, and more than they are
PI = Fraction(3141592653589793238462643383279502884197169399375105820974944, 10**60)
TURN = Fraction(math.nextafter(2.0 * math.pi, 7.0))  # a double beyond 2 pi
SHIFTS = (Fraction(0), *(Fraction(1, 1 << bits) for bits in range(60, -1, -4)))

Vector = list[Fraction]


class Refused(ValueError):
    """What is no certificate, or none that is sound: with the reason, in one line."""


class Verdict(NamedTuple):
    """What a certificate comes to.

    Attributes:
        claimed: the bound that was published.
        proved: the bound that holds, rounded down.
        leaves: how many bounds it is the least of.
        holds: whether what was published exceeds what holds by no more than 1e-9 of it.
    """

    claimed: float
    proved: float
    leaves: int
    holds: bool


def verified(document: Any) -> Verdict:
    """Return what a certificate, as JSON has it, comes to.

    Raises:
        Refused: it is malformed, or not sound whatever the bound.
    """
    _fields(document, 'certificate', ('format', 'problem', 'state', 'goals', 'lower_bound', 'tree'),
            ('limits', 'origins'))  # fmt: skip
    if document['format'] != FORMAT:
        raise Refused(f'format is not {FORMAT!r}')
    posed = posed_by(document)
    claimed = _number(document['lower_bound'], 'lower_bound')
    root = posed.root(document.get('origins'))
    bounds = [posed.bound(leaf, region) for leaf, region in _leaves(posed, document['tree'], root)]
    if not bounds:
        raise Refused('the tree has no leaf')
    proved = min(bounds)
    holds = claimed <= 0 or proved >= claimed - RELATIVE * claimed  # no term of the cost is < 0
    return Verdict(float(claimed), _rounded_down(proved), len(bounds), holds)


def posed_by(document: dict[str, Any]) -> StatedProblem:
    """Return the problem that a certificate is of."""
    problem, state, goals = (document[name] for name in ('problem', 'state', 'goals'))
    return StatedProblem(problem, state, goals, document.get('limits', {}))


def read(path: str | Path) -> Any:
    """Return the document of a file.

    Raises:
        Refused: it is too large, or no JSON without doubled names and numbers that are none.
    """
    try:
        with Path(path).open('rb') as file:
            large = file.seek(0, 2) > LARGEST
            file.seek(0)
            text = b'' if large else file.read(LARGEST)
    except OSError as error:
        raise Refused(f'{path}: {error.strerror}') from None
    if large:
        raise Refused(f'{path}: larger than {LARGEST >> 20} MB')
    return parsed(text)


def parsed(text: bytes) -> Any:
    """Return the document of a file's content, as :func:`read` does."""
    try:
        return json.loads(text, object_pairs_hook=_without_doubles, parse_constant=_no_number)
    except (ValueError, RecursionError) as error:
        raise Refused(f'no JSON that is a certificate: {error}') from None


def _without_doubles(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len(dict(pairs)) < len(pairs):
        raise Refused('a name comes twice')
    return dict(pairs)


def _no_number(word: str) -> Any:
    raise Refused(f'{word} is not a finite number')


# --- reading


def _fields(value: Any, name: str, needed: tuple[str, ...], optional: tuple[str, ...] = ()) -> None:
    if not isinstance(value, dict):
        raise Refused(f'{name} is not a mapping')
    for each in needed:
        if each not in value:
            raise Refused(f'{name} lacks {each}')
    for each in value:
        if each not in (*needed, *optional):
            raise Refused(f'{name} has an unknown {each!r}')


def _number(value: Any, name: str) -> Fraction:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not _is_double(value):
        raise Refused(f'{name} is not a finite number')
    return Fraction(float(value))


def _is_double(value: float) -> bool:
    try:
        return math.isfinite(float(value))
    except OverflowError:
        return False


def _weight(value: Any, name: str) -> Fraction:
    found = _number(value, name)
    if found < 0:
        raise Refused(f'{name} is negative')
    return found


def _whole(value: Any, name: str, low: int, high: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise Refused(f'{name} is not a whole number from {low} to {high}')
    return value


def _list(value: Any, name: str) -> list[Any]:
    if not isinstance(value, list):
        raise Refused(f'{name} is not a list')
    return value


def _word(value: Any, name: str, words: tuple[str, ...]) -> str:
    if value not in words:
        raise Refused(f'{name} is not one of {", ".join(words)}')
    return str(value)


def _vector(value: Any, name: str, length: int) -> Vector:
    if not isinstance(value, list) or len(value) != length:
        raise Refused(f'{name} is not a list of {length}')
    return [_number(each, name) for each in value]


def _rows(value: Any, name: str, count: int, length: int) -> list[Vector]:
    if not isinstance(value, list) or len(value) != count:
        raise Refused(f'{name} is not a list of {count}')
    return [_vector(each, name, length) for each in value]


# --- brackets


def _root_below(x: Fraction) -> Fraction:
    """Return a number that is at most the square root, and hardly less."""
    return Fraction(math.isqrt((x.numerator << 2 * BITS) // x.denominator), 1 << BITS)


def _root_above(x: Fraction) -> Fraction:
    """Return a number that is at least the square root, and hardly more."""
    return Fraction(math.isqrt((x.numerator << 2 * BITS) // x.denominator) + 1, 1 << BITS)


def _size_above(vector: Vector) -> Fraction:
    return _root_above(sum((x * x for x in vector), Fraction(0)))


def _rounded_down(x: Fraction) -> float:
    nearest = float(x)
    return nearest if Fraction(nearest) <= x else math.nextafter(nearest, -math.inf)


@lru_cache(maxsize=65536)
def _direction(angle: Fraction) -> tuple[Fraction, Fraction]:
    """Return cosine and sine, each within TINY."""
    turned = angle - 2 * PI * round(angle / (2 * PI))
    unit = 1 << BITS
    x = round(turned * unit)
    cosine = sine = 0
    term, k = unit, 0
    while term:  # term = x^k / k!, with the signs of both series
        if k % 2:
            sine += term if k % 4 == 1 else -term
        else:
            cosine += term if k % 4 == 0 else -term
        k += 1
        term = term * x // (k * unit) if term * x >= 0 else -(-term * x // (k * unit))
    return Fraction(cosine, unit), Fraction(sine, unit)


def _lacking(matrix: list[Vector]) -> Fraction:
    """Return an e >= 0 such that matrix + e I is positive semidefinite.

    Cholesky's method on whole numbers, each division rounded down. What it factors differs from
    the matrix by at most 2 max(L) + 2 in each entry, in its unit. It succeeds at the latest where
    the diagonal dominates.
    """
    count = len(matrix)
    top = max(max(map(abs, row)) for row in matrix)
    for shift in (*SHIFTS, Fraction(2 * count)) if top else ():
        scale = (1 << 2 * BITS) / top
        entries = [[math.floor(matrix[i][j] * scale) for j in range(i + 1)] for i in range(count)]
        for k in range(count):
            entries[k][k] += math.floor(shift * (1 << 2 * BITS))
        largest = _factored(entries)
        if largest:
            return shift * top + count * (2 * largest + 2) / scale
    return Fraction(0)


def _factored(rows: list[list[int]]) -> int:
    """Put Cholesky's factor in a matrix's place; return its largest entry, 0 if it has none."""
    for i, row in enumerate(rows):
        for j in range(i):
            other = rows[j]
            row[j] = (row[j] - sum(map(_times, row[:j], other[:j]))) // other[j]
        square = row[i] - sum(map(_times, row[:i], row[:i]))
        if square <= 0:
            return 0
        row[i] = math.isqrt(square)
        if not row[i]:
            return 0
    return max(abs(entry) for row in rows for entry in row)


def _times(x: int, y: int) -> int:
    return x * y


# --- regions


class Sector(NamedTuple):
    """Directions from ``low`` to ``high`` [rad]."""

    low: Fraction
    high: Fraction


class Side(NamedTuple):
    """What is known of a position: normal . s_{k+1} is at least so much."""

    k: int
    normal: Vector
    least: Fraction


class Region(NamedTuple):
    """What is known in a part of a split: a face or a sector of each step, None if neither.

    And of positions, beside the bodies that tell the parts apart.
    """

    faces: tuple[int | None, ...]
    sectors: tuple[Sector | None, ...]
    rows: tuple[Side, ...] = ()
    passed: tuple[tuple[int, int, Sector], ...] = ()  # discs, at which step, and on which side


class Cone(NamedTuple):
    """Where axes point: u . axis is at least so much of each unit vector u along them."""

    axis: Vector
    least: Fraction


def _leaves(
    posed: StatedProblem, tree: Any, root: Region
) -> Iterator[tuple[dict[str, Any], Region]]:
    """Yield the leaves of a tree of splits, each with its region; the tree must be complete."""
    waiting = [(tree, root)]
    for _ in range(DEEPEST):
        if not waiting:
            return
        node, region = waiting.pop()
        if isinstance(node, dict) and 'split' in node:
            waiting += _parts(posed, node, region)
        else:
            yield node, region
    raise Refused(f'the tree has more than {DEEPEST} nodes')


def _parts(posed: StatedProblem, node: dict[str, Any], region: Region) -> list[tuple[Any, Region]]:
    _fields(node, 'a split', ('split', 'parts'), ('at', 'wall'))
    k = _whole(node['split'], 'split', 1, posed.horizon) - 1
    if 'wall' in node:
        regions = posed.beside(region, k, node['wall'], node.get('at'))
    elif 'at' in node:
        regions = posed.halves(region, k, _number(node['at'], 'at'))
    else:
        regions = posed.beyond(region, k)
    parts = node['parts']
    if not isinstance(parts, list) or len(parts) != len(regions):
        raise Refused(f'a split has not {len(regions)} parts')
    both = zip(parts, regions, strict=True)
    return [(part, made) for part, made in both if made is not None]


# --- the problem


class StatedProblem:
    """A problem with its state and goals, in exact numbers."""

    def __init__(self, problem: Any, state: Any, goals: Any, limits: Any) -> None:
        _fields(problem, 'problem', (
            'dimension', 'rotation_order', 'translation_order', 'discretisation', 'horizon', 'step',
            'forward', 'weights', 'terminal', 'floor', 'max_rate',
        ))  # fmt: skip
        self.n = _whole(problem['dimension'], 'dimension', 2, 3)
        self.order = _whole(problem['rotation_order'], 'rotation_order', 1, 2)
        self.horizon = _whole(problem['horizon'], 'horizon', 1, MOST_STEPS)
        self._set_model(problem)
        self._set_weights(problem['weights'])
        self.arrives = _word(problem['terminal'], 'terminal', ('penalty', 'constraint'))
        self._set_floor(problem['floor'])
        self._set_width()
        self._set_state(state)
        self.goals = _rows(goals, 'goals', self.horizon, self.n)
        self._set_limits(limits)
        self.turn = self.h * _weight(problem['max_rate'], 'max_rate')
        if self.turn and not (self.n == 2 and self.order == 1 and self.floor):
            raise Refused('max_rate is beyond this format, but in the plane with a floor')
        self._hessian: list[Vector] | None = None

    def _set_model(self, problem: dict[str, Any]) -> None:
        """Set s, p -> s + h p + b_s z_k + c_s z_{k+1} + e_s w, and so on; p stays 0 at order 1."""
        order = _whole(problem['translation_order'], 'translation_order', 1, 2)
        kind = _word(problem['discretisation'], 'discretisation', ('euler', 'exact', 'held'))
        h = self.h = _weight(problem['step'], 'step')
        z = _weight(problem['forward'], 'forward')
        none, self.inertial = Fraction(0), order == 2
        models = {
            (1, 'euler'): (h * z, none, none, none, h, none),
            (1, 'exact'): (h * z / 2, none, h * z / 2, none, h, none),
            (2, 'euler'): (none, h * z, none, none, none, h),
            (2, 'exact'): (h * h * z / 3, h * z / 2, h * h * z / 6, h * z / 2, h * h / 2, h),
            (2, 'held'): (none, none, h * h * z / 2, h * z, h * h / 2, h),
        }
        if not (h and z) or (order, kind) not in models:
            raise Refused('step, forward or discretisation is none that there is')
        self.model = models[order, kind]
        late = {'euler': none, 'exact': Fraction(1, 2), 'held': Fraction(1)}[kind]
        shares = [1 - late, *[Fraction(1)] * (self.horizon - 1), late]
        self.flown = [h * z * share for share in shares]  # that each z_k is flown along

    def _set_weights(self, weights: Any) -> None:
        names = ('position', 'input', 'length', 'terminal', 'attitude', 'arrival')
        _fields(weights, 'weights', names)
        q, r, length, last, attitude, arrival = (_weight(weights[name], name) for name in names)
        double = 2 if self.n == 2 else 1  # coordinates of R that are there twice
        self.q = [q] * (self.horizon - 1) + [q + last + arrival]
        self.r, self.attitude = double * r, double * attitude
        self.braking = arrival * self.h * self.h if self.inertial else Fraction(0)
        self.length = [length * each for each in self.flown]

    def _set_floor(self, floor: Any) -> None:
        _fields(floor, 'floor', ('shape',), ('faces', 'fraction'))
        shape = _word(floor['shape'], 'floor.shape', ('none', 'polygon', 'circle'))
        self.floor, self.faces = Fraction(0), 0
        if shape != 'none':
            self.floor = _weight(floor.get('fraction'), 'floor.fraction')
        if shape == 'polygon':
            self.faces = _whole(floor.get('faces'), 'floor.faces', 3, 64)
        if self.floor > 1 or (self.floor and self.order == 2) or (self.faces and self.n == 3):
            raise Refused('the floor is beyond this format')

    def _set_width(self) -> None:
        """Set how many numbers a rotation is: its thrust axis alone where the cost sees no more."""
        axes = self.order == 1 and not (self.r or self.attitude)
        self.width = 2 if self.n == 2 else 3 if axes else 9

    def _set_state(self, state: Any) -> None:
        n = self.n
        _fields(state, 'state', ('position', 'rotation', 'velocity', 'rotation_rate', 'attitude',
                                 'coasted', 'disturbance', 'wanted'))  # fmt: skip
        self.position = _vector(state['position'], 'state.position', n)
        self.velocity = _vector(state['velocity'], 'state.velocity', n)
        self.disturbance = _vector(state['disturbance'], 'state.disturbance', n)
        self.first, rate = (self._rotation(state, name) for name in ('rotation', 'rotation_rate'))
        self.ahead = self._rotation(state, 'attitude')
        self.coasted = None if state['coasted'] is None else self._rotation(state, 'coasted')
        self.second = [x + self.h * y for x, y in zip(self.first, rate, strict=True)]
        if self.attitude and state['wanted'] is None:
            raise Refused('state.wanted is missing')
        unseen = [Fraction(0)] * self.width
        self.wanted = self._rotation(state, 'wanted') if state['wanted'] is not None else unseen

    def _set_limits(self, limits: Any) -> None:
        """Set the cones that thrust axes are in, that of the positions, and the walls."""
        _fields(limits, 'limits', (), ('cones', 'glide_slope', 'walls'))
        self.cones: list[list[Cone]] = [[] for _ in range(self.horizon)]
        self.least = [self.floor] * self.horizon
        for each in _list(limits.get('cones', []), 'cones'):
            _fields(each, 'a cone', ('axis', 'angle', 'least', 'steps'))
            angle = _weight(each['angle'], 'angle')
            cone = Cone(_vector(each['axis'], 'axis', self.n), _direction(angle)[0] - TINY)
            if angle > PI / 2 or not any(cone.axis):
                raise Refused('a cone is none, or wider than half of space')
            for step in _list(each['steps'], 'steps'):
                k = _whole(step, 'steps', 1, self.horizon) - 1
                self.cones[k].append(cone)
                self.least[k] = max(self.least[k], _weight(each['least'], 'least'))
        if max(self.least) > 1:
            raise Refused('a least speed is above 1')
        self.slope, self.strays = (Fraction(0), Fraction(1)), [Fraction(0)] * self.horizon
        self.slides = 'glide_slope' in limits and self.n == 3
        if self.slides:
            _fields(limits['glide_slope'], 'glide_slope', ('angle', 'eased'))
            angle = _weight(limits['glide_slope']['angle'], 'angle')
            if not 0 < angle < PI / 2:
                raise Refused('the angle of glide_slope is none')
            self.slope = _direction(angle)
            self.strays = _vector(limits['glide_slope']['eased'], 'eased', self.horizon)
            if min(self.strays) < 0:
                raise Refused('eased is negative')
        walls = _list(limits.get('walls', []), 'walls')
        self.walls = [self._wall(each) for each in walls]

    def _wall(self, body: Any) -> BoxWall | DiscWall:
        if not isinstance(body, dict) or 'radius' not in body:
            return BoxWall(body, self.n, self.horizon)
        wall = DiscWall(body, self.n, self.horizon)
        push, add, follow, after, blow, gust = self.model
        if wall.shared and (follow or after or blow != (0 if self.inertial else self.h)):
            raise Refused('a disc is shared by the ends of steps that are no lines')
        for k in range(self.horizon if wall.shared else 0):
            known = [blow * w for w in self.disturbance]
            if self.inertial:
                both = zip(self.velocity, self.disturbance, strict=True)
                known = [self.h * (p + k * gust * w) for p, w in both]
            full = max(Fraction(1), _size_above(self.first[:2])) * (push + self.h * k * add)
            wall.spread[k] = full + _size_above(_less(known, wall.moved(k)))
        return wall

    def _rotation(self, state: dict[str, Any], name: str) -> Vector:
        """Return a matrix column by column, as far as it is seen."""
        rows = _rows(state[name], f'state.{name}', self.n, self.n)
        return [row[i] for i in range(self.n) for row in rows][: self.width]

    # --- splits

    def root(self, origins: Any) -> Region:
        """Return what is known of all trajectories.

        A turn limit says how far directions can be from that of the attitude. Without one, they
        are all directions, counted from an angle of the certificate's choice.
        """
        free: tuple[Any, ...] = (None,) * self.horizon
        if self.turn:
            if origins is not None:
                raise Refused('origins have no use where the attitude is one')
            low, high = self._heading()
            turns = [k * self.turn for k in range(1, self.horizon + 1)]
            return Region(free, tuple(Sector(low - each, high + each) for each in turns))
        if origins is None:
            return Region(free, free)
        starts = _vector(origins, 'origins', self.horizon)
        return Region(free, tuple(Sector(each, each + TURN) for each in starts))

    def _heading(self) -> tuple[Fraction, Fraction]:
        """Return angles just below and above the direction of the attitude."""
        x, y = self.ahead
        angle = Fraction(math.atan2(y, x))
        cosine, sine = _direction(angle)
        across, along = abs(cosine * y - sine * x) + 4 * TINY, cosine * x + sine * y
        if along <= 2 * across:
            raise Refused('state.attitude is no rotation')
        off = across / along  # the tangent of an angle, that is more than the angle
        return angle - off, angle + off

    def halves(self, region: Region, k: int, angle: Fraction) -> list[Region | None]:
        """Return what is known below and above an angle; None where nothing is left."""
        sector = region.sectors[k]
        if sector is None or not sector.low <= angle <= sector.high:
            raise Refused('a split is not within the directions that it splits')
        made = Sector(sector.low, angle), Sector(angle, sector.high)
        return [self._narrowed(region, k, each) for each in made]

    def _narrowed(self, region: Region, k: int, sector: Sector) -> Region | None:
        """Put a sector in, and what a turn limit makes of the others' for it."""
        sectors = list(region.sectors)
        sectors[k] = sector
        if self.turn:
            for way in (range(k + 1, self.horizon), range(k - 1, -1, -1)):
                near = sector
                for j in way:
                    own = sectors[j]
                    assert own is not None
                    near = Sector(max(own.low, near.low - self.turn),
                                  min(own.high, near.high + self.turn))  # fmt: skip
                    if near.low > near.high:
                        return None
                    sectors[j] = near
        return region._replace(sectors=tuple(sectors))

    def beyond(self, region: Region, k: int) -> list[Region | None]:
        """Return what is known beyond each face of a polygonal floor."""
        if not self.faces or region.faces[k] is not None:
            raise Refused('a split by faces has none to split by')
        before, after = region.faces[:k], region.faces[k + 1 :]
        return [region._replace(faces=(*before, i, *after)) for i in range(self.faces)]

    def beside(self, region: Region, k: int, wall: Any, at: Any) -> list[Region | None]:
        """Return what is known on each side of a wall that s_{k+1} can be on."""
        number = _whole(wall, 'wall', 0, len(self.walls) - 1)
        body, rows = self.walls[number], region.rows
        if isinstance(body, BoxWall):
            if at is not None:
                raise Refused('a split beside a box has no angle')
            return [region._replace(rows=(*rows, *body.side(i, k))) for i in range(2 * self.n)]
        known, angle = self.side_of(region, k, number), _number(at, 'at')
        if not known.low <= angle <= known.high:
            raise Refused('a split is not within the directions that it splits')
        return [
            region._replace(
                rows=(*rows, *body.side(each, k)), passed=(*region.passed, (number, k, each))
            )
            for each in (Sector(known.low, angle), Sector(angle, known.high))
        ]

    def side_of(self, region: Region, k: int, wall: int) -> Sector:
        """Return the directions in which s_{k+1} can be from a disc."""
        told = [each for number, step, each in region.passed if (number, step) == (wall, k)]
        return told[-1] if told else Sector(Fraction(0), TURN)

    # --- bounds

    def bound(self, leaf: Any, region: Region) -> Fraction:
        """Return the bound that a leaf proves: a tangent's least value over a region."""
        _fields(leaf, 'a leaf', ('point',), ('bends', 'pull', 'stiffness', 'tops', 'shares',
                                             'presses', 'slides'))  # fmt: skip
        point = _rows(leaf['point'], 'point', self.horizon, self.width)
        none = [0.0] * self.horizon
        bends = _vector(leaf.get('bends', none), 'bends', self.horizon)
        tops = _vector(leaf.get('tops', none), 'tops', self.horizon)
        size = self.n * (1 + self.inertial) if self.arrives == 'constraint' else 0
        pull = _vector(leaf.get('pull', [0.0] * size), 'pull', size)
        stiffness = _weight(leaf.get('stiffness', 0.0), 'stiffness') if size else Fraction(0)
        if self.width == 9 and any(bends):
            raise Refused('bends over SO(3) are beyond this format')
        nothing = [[0.0] * self.n] * self.horizon
        shares = _rows(leaf.get('shares', nothing), 'shares', self.horizon, self.n)
        push, paid = self._pushed(leaf, region)
        value, slopes = self.cost(point, pull, stiffness, push)
        value += paid + self.length[0] * _root_below(
            sum((x * x for x in self.first[: self.n]), Fraction(0))
        )
        if min(bends) < 0:
            if self.order == 2:
                raise Refused('negative bends at rotation order 2 are beyond this format')
            value -= self._lack(bends, stiffness) * sum(1 + _dot(x, x) for x in point)
        for k, (x, slope, bend) in enumerate(zip(point, slopes, bends, strict=True)):
            tangent = slope
            if bend:
                tangent = [s + bend * y for s, y in zip(slope, x, strict=True)]
                value += bend * _dot(x, x) / 2
            value -= _dot(tangent, x)
            if self.width == 9 and (k or self.order == 1):
                value += self._least_over_orbitope(_less(tangent, shares[k]), tops[k])
                tangent = shares[k]
            value += self._least(k, tangent, bend, region)
        return value

    def _pushed(self, leaf: dict[str, Any], region: Region) -> tuple[list[Vector] | None, Fraction]:
        """Return forces F, shape (N, n), and an a such that a + sum_k F_k . (s_k - g_k) <= 0.

        A row n . s >= b that is pressed by y >= 0 adds y (b - n . s). What slides along the cone
        above the goal is a c with c . d <= 0 for all d in it, and as much more as that is eased.
        """
        count = len(region.rows)
        presses = _vector(leaf.get('presses', [0.0] * count), 'presses', count)
        if not any(presses) and 'slides' not in leaf:
            return None, Fraction(0)
        push, paid = [[Fraction(0)] * self.n for _ in self.goals], Fraction(0)
        for y, (k, normal, least) in zip(presses, region.rows, strict=True):
            if y < 0:
                raise Refused('presses are negative')
            push[k] = _less(push[k], [y * x for x in normal])
            paid += y * (least - _dot(normal, self.goals[k]))
        if 'slides' not in leaf:
            return push, paid
        cosine, sine = self.slope[0] - TINY, self.slope[1] - TINY
        for k, c in enumerate(_rows(leaf['slides'], 'slides', self.horizon, 3)):
            aside = (c[0] * c[0] + c[1] * c[1]) * (self.slope[0] + TINY) ** 2
            if not self.slides or c[2] > 0 or aside > (c[2] * sine) ** 2:
                raise Refused('slides are not along the glide slope')
            push[k] = [x + y for x, y in zip(push[k], c, strict=True)]
            paid += c[2] * self.strays[k] / cosine
        return push, paid

    def _lack(self, bends: Vector, stiffness: Fraction) -> Fraction:
        """Return e such that the matrix of the cost with its bends, plus e I, is semidefinite.

        A tangent of a cost that lacks e is less than e |x - x'|^2 / 2 above it, and with
        |x_k| <= 1 that is at most e (1 + |x'_k|^2), added up.
        """
        if self._hessian is None or stiffness:
            zero = [[Fraction(0)] * self.width for _ in range(self.horizon)]
            pull = [Fraction(0)] * self.n * (1 + self.inertial)
            resting = self.cost(zero, pull, stiffness)[1]
            self._hessian = []
            for k in range(self.horizon):
                zero[k][0] = Fraction(1)
                moved = self.cost(zero, pull, stiffness)[1]
                zero[k][0] = Fraction(0)
                columns = zip(moved, resting, strict=True)
                self._hessian.append([a[0] - b[0] for a, b in columns])
        matrix = [row.copy() for row in self._hessian]
        for k, bend in enumerate(bends):
            matrix[k][k] += bend
        return _lacking(matrix)

    def cost(
        self, x: list[Vector], pull: Vector, stiffness: Fraction, push: list[Vector] | None = None
    ) -> tuple[Fraction, list[Vector]]:
        """Return the cost but for lengths at x_1..x_N, shape (N, d), and its gradient.

        Where a trajectory has to arrive, c = (s_N - g_N, p_N) vanishes, and pull . c and
        stiffness |c|^2 / 2 can be added. So is sum_k push_k . (s_k - g_k), shape (N, n).
        """
        value, slopes = self._turning([self.first, *x])
        for i in range(self.n):
            axis = [self.first[i], *(each[i] for each in x)]
            pushed = [each[i] for each in push] if push else [Fraction(0)] * self.horizon
            cost, on_axis = self._flight(i, axis, (pull[i :: self.n], stiffness), pushed)
            value += cost
            for slope, more in zip(slopes, on_axis, strict=True):
                slope[i] += more
        return value, slopes[1:]

    def _flight(
        self, i: int, axis: Vector, pulled: tuple[Vector, Fraction], pushed: Vector
    ) -> tuple[Fraction, Vector]:
        """Return the cost of positions along axis i, given z_0..z_N there, and its gradient."""
        pull, stiffness = pulled
        push, add, follow, after, blow, gust = self.model
        drift, p = self.h, self.velocity[i] if self.inertial else Fraction(0)
        s, missed = self.position[i], []
        blown, hastened = blow * self.disturbance[i], gust * self.disturbance[i]
        for k in range(self.horizon):
            s += push * axis[k] + follow * axis[k + 1] + blown
            if self.inertial:
                s += drift * p
                p += add * axis[k] + after * axis[k + 1] + hastened
            missed.append(s - self.goals[k][i])
        weighed = [weight * off for weight, off in zip(self.q, missed, strict=True)]
        value = _dot(weighed, missed) + _dot(pushed, missed) + self.braking * p * p
        forces = [Fraction(0), 2 * self.braking * p]  # what s_N and p_N weigh
        for j, (multiplier, off) in enumerate(zip(pull, (missed[-1], p), strict=False)):
            value += multiplier * off + stiffness * off * off / 2
            forces[j] += multiplier + stiffness * off
        slopes = [Fraction(0)] * len(axis)
        on_s, on_p = forces
        for k in range(self.horizon, 0, -1):  # and s_k and p_k, from the end
            on_s += 2 * weighed[k - 1] + pushed[k - 1]
            slopes[k] += follow * on_s
            slopes[k - 1] += push * on_s
            if self.inertial:
                slopes[k] += after * on_p
                slopes[k - 1] += add * on_p
                on_p += drift * on_s
        return value, slopes

    def _turning(self, rotations: list[Vector]) -> tuple[Fraction, list[Vector]]:
        """Return the cost of inputs and of the last attitude, with its gradient."""
        value, width = Fraction(0), range(self.width)
        slopes = [[Fraction(0)] * self.width for _ in rotations]
        stencil = (-1, 1) if self.order == 1 else (1, -2, 1)
        weight = self.r / self.h ** (2 * self.order)
        for k in range(len(rotations) - self.order if weight else 0):
            for i in width:
                change = sum(c * rotations[k + j][i] for j, c in enumerate(stencil))
                force = weight * change
                value += force * change
                for j, c in enumerate(stencil):
                    slopes[k + j][i] += 2 * c * force
        for i in width if self.attitude else ():
            off = rotations[-1][i] - self.wanted[i]
            value += self.attitude * off * off
            slopes[-1][i] += 2 * self.attitude * off
        return value, slopes

    def _least(self, k: int, slope: Vector, bend: Fraction, region: Region) -> Fraction:
        """Return the least slope . z + l |z| - bend |z|^2 / 2 over what z_{k+1} can be."""
        length = self.length[k + 1]
        if k == 0 and self.order == 2:
            return self._least_decided(slope, length, bend)
        face, sector = region.faces[k], region.sectors[k]
        if face is not None:
            if bend or length:
                raise Refused('bends and lengths beyond faces are beyond this format')
            return self._least_beyond(slope, face)
        steepest = -_size_above(slope) if sector is None else _least_within(slope, sector)
        if sector is not None and self.faces and not bend and not length:
            return self._least_reached(slope, sector, steepest)
        steepest = max([steepest, *(_least_towards(slope, cone) for cone in self.cones[k])])
        # Where cones end, it is flat. What is linear is least around that.
        slowest = self.floor if bend or length else self.least[k]
        return _least_along(steepest + length, bend, slowest)  # which a polygon is beyond, too

    def _least_decided(self, slope: Vector, length: Fraction, bend: Fraction) -> Fraction:
        """Return the least where a body rate decides the first rotation, but for its length."""
        if bend:
            raise Refused('what is decided bends')
        if self.coasted is None:
            size = sum((x * x for x in self.second[: self.n]), Fraction(0))
            return _dot(slope, self.second) + length * _root_below(size)
        size = sum((x * x for x in self.coasted[: self.n]), Fraction(0))
        return min(Fraction(0), _dot(slope, self.coasted) + length * _root_below(size))

    def _least_beyond(self, slope: Vector, face: int) -> Fraction:
        """Return the least slope . x over the part of the disk beyond a face n . x >= floor."""
        x, y = _direction(2 * PI * face / self.faces)
        inward, across = slope[0] * x + slope[1] * y, abs(slope[1] * x - slope[0] * y)
        size = _size_above(slope)
        if -inward >= self.floor * size - 4 * TINY * (1 + size):
            return -size
        corner = self.floor * inward - _root_above(1 - self.floor * self.floor) * across
        return max(-size, corner - 4 * TINY * (1 + size))

    def _least_reached(self, slope: Vector, sector: Sector, rim: Fraction) -> Fraction:
        """Return the least slope . x over a sector, from a polygonal floor to the rim.

        Given the least at the rim, what is left is the floor: straight between the ends and its
        corners. Where these are downhill of the middle, the rim is lower.
        """
        if sector.high - sector.low >= PI - Fraction(1, 10**9):
            return _least_along(rim, Fraction(0), self.floor)
        share, angles = 2 * PI / self.faces, [sector.low, sector.high]
        first, last = (each / share - Fraction(1, 2) for each in (sector.low, sector.high))
        corners = range(math.ceil(first), math.floor(last) + 1)
        angles += [(i + Fraction(1, 2)) * share for i in corners]
        best, off = rim, 4 * TINY * (1 + _size_above(slope))
        for angle in angles:
            (x, y), nearest = _direction(angle), round(angle / share)
            nx, ny = _direction(nearest * share)
            along = slope[0] * x + slope[1] * y - off
            if along > 0:
                best = min(best, along * self.floor / (nx * x + ny * y + 4 * TINY))
        return best

    @staticmethod
    def _least_over_orbitope(slope: Vector, top: Fraction) -> Fraction:
        """Return the least <G, R> over conv SO(3): -top, where top I + K(G) is semidefinite."""
        g11, g21, g31, g12, g22, g32, g13, g23, g33 = slope
        matrix = [
            [top + g11 + g22 + g33, g32 - g23, g13 - g31, g21 - g12],
            [g32 - g23, top + g11 - g22 - g33, g21 + g12, g13 + g31],
            [g13 - g31, g21 + g12, top - g11 + g22 - g33, g32 + g23],
            [g21 - g12, g13 + g31, g32 + g23, top - g11 - g22 + g33],
        ]
        return -top - _lacking(matrix)


class Wall:
    """A body that positions are outside of, which may move and grow from step to step.

    Args:
        body: as stated: where it moves, its ``shifts`` by the ends of steps 0..N, and by how much
            it is ``grown`` in each; ``shared`` says whether the ends of a step are outside of it
            on one side.
        n: dimension.
        horizon: N.
    """

    shape: tuple[str, str]

    def __init__(self, body: Any, n: int, horizon: int) -> None:
        _fields(body, 'a wall', (*self.shape, 'shared'), ('shifts', 'grown'))
        self.shared = body['shared'] is True
        still = [[0.0] * n] * (horizon + 1), [0.0] * horizon
        self._shifts = _rows(body.get('shifts', still[0]), 'shifts', horizon + 1, n)
        self._grown = _vector(body.get('grown', still[1]), 'grown', horizon)

    def _ends(self, k: int) -> range:
        """Return which positions are on its sides in a step: s_{k+1}, and s_k where shared."""
        return range(max(k - 1, 0) if self.shared else k, k + 1)


class BoxWall(Wall):
    """A wall with corners ``min`` and ``max``."""

    shape = 'min', 'max'

    def __init__(self, body: Any, n: int, horizon: int) -> None:
        super().__init__(body, n, horizon)
        self._low, self._high = (_vector(body[name], name, n) for name in self.shape)

    def side(self, i: int, k: int) -> list[Side]:
        """Return what is known of s_{k+1}, and s_k where shared, below (i < n) or above axis i."""
        n = len(self._low)
        axis, sign = i % n, -1 if i < n else 1
        face = self._low[axis] if i < n else self._high[axis]
        normal = [Fraction(sign * (j == axis)) for j in range(n)]
        return [
            Side(j, normal, sign * (face + self._shifts[j + 1][axis]) + self._grown[k])
            for j in self._ends(k)
        ]


class DiscWall(Wall):
    """A wall in the plane with ``centre`` and ``radius``.

    Where the ends of a step are shared, so is the line between them: it is outside.

    Attributes:
        spread: how far the ends of each step are apart at most, as seen from the disc.
    """

    shape = 'centre', 'radius'

    def __init__(self, body: Any, n: int, horizon: int) -> None:
        super().__init__(body, n, horizon)
        if n != 2:
            raise Refused('balls in space are beyond this format')
        self._centre, self._radius = _vector(body['centre'], 'centre', 2), body['radius']
        self._radius = _weight(self._radius, 'radius')
        self.spread = [Fraction(0)] * horizon

    def moved(self, k: int) -> Vector:
        """Return how far it moves in step k."""
        return _less(self._shifts[k + 1], self._shifts[k])

    def place(self, end: int, k: int) -> tuple[Vector, Fraction]:
        """Return its centre by the end of a step, and its radius in step k."""
        both = zip(self._centre, self._shifts[end], strict=True)
        return [x + y for x, y in both], self._radius + self._grown[k]

    def side(self, sector: Sector, k: int) -> list[Side]:
        """Return what is known where the nearest point Q of a step is in such a direction.

        With unit vectors u of the sector and any c, let c . u >= m > 0. Then c . Q >= m |Q|; other
        points P have u . (P - Q) >= 0, and what c has across u is at most sqrt(|c|^2 - m^2).
        """
        radius = self.place(k, k)[1]
        if sector.high - sector.low > PI - Fraction(1, 10**9) or radius <= 0:
            return []
        c = list(_direction((sector.low + sector.high) / 2))
        edges = (_direction(each) for each in sector)
        m = min(c[0] * x + c[1] * y for x, y in edges) - 4 * TINY
        if m <= 0:
            return []
        least = m * radius - self.spread[k] * _root_above(max(Fraction(0), _dot(c, c) - m * m))
        return [Side(j, c, least + _dot(c, self.place(j + 1, k)[0])) for j in self._ends(k)]


def _dot(x: Vector, y: Vector) -> Fraction:
    return sum((a * b for a, b in zip(x, y, strict=True)), Fraction(0))


def _less(x: Vector, y: Vector) -> Vector:
    """Return x less y, which may be shorter."""
    return [*(a - b for a, b in zip(x, y, strict=False)), *x[len(y) :]]


def _least_along(slope: Fraction, bend: Fraction, least: Fraction) -> Fraction:
    """Return the least slope s - bend s^2 / 2 over speeds s from the least to 1."""
    ends = min(slope * s - bend * s * s / 2 for s in (least, Fraction(1)))
    if bend < 0 and least * bend > slope > bend:  # convex, and least where it is level
        return slope * slope / (2 * bend)
    return ends


def _least_towards(slope: Vector, cone: Cone) -> Fraction:
    """Return the least slope . u over unit vectors u within a cone."""
    size, square = _size_above(slope), _dot(cone.axis, cone.axis)
    along = _dot(slope, cone.axis)
    if -along >= cone.least * size - 4 * TINY * (1 + size):
        return -size
    across = _root_above(max(Fraction(0), _dot(slope, slope) - along * along / square))
    aside = _root_above(max(Fraction(0), 1 - cone.least * cone.least / square))
    return max(-size, along * cone.least / square - across * aside)


def _least_within(slope: Vector, sector: Sector) -> Fraction:
    """Return the least slope . (cos, sin) over the directions of a sector."""
    size = _size_above(slope)
    width = sector.high - sector.low
    if width >= 2 * PI - 1 / Fraction(10**9):
        return -size
    (ax, ay), (bx, by) = _direction(sector.low), _direction(sector.high)
    off = 4 * TINY * (1 + size)
    from_low = ay * slope[0] - ax * slope[1]  # how far -slope is to the left of the lower edge
    to_high = bx * slope[1] - by * slope[0]
    inside = from_low > -off and to_high > -off
    if width > PI - Fraction(1, 10**9):  # what is outside is narrower
        inside = from_low > -off or to_high > -off
    if inside:
        return -size
    return min(slope[0] * ax + slope[1] * ay, slope[0] * bx + slope[1] * by) - off


def main() -> int:
    """Verify the certificate that is named on the command line."""
    try:
        verdict = verified(read(sys.argv[1]))
    except (Refused, IndexError) as error:
        print(f'refused: {error}', file=sys.stderr)
        return 2
    print(
        f'claimed {verdict.claimed!r}, proved {verdict.proved!r} by {verdict.leaves} leaves:',
        'holds' if verdict.holds else 'DOES NOT HOLD',
    )
    return 0 if verdict.holds else 1


if __name__ == '__main__':
    sys.exit(main())
