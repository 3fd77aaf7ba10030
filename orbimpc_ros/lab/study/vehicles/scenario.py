# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A scenario: a configuration, what is changed in it, and what every flight draws.

A file names a configuration, lists changes ``name=value``, and has a rule for each parameter that
is drawn:

- a range ``[low, high]``; ``{x: range, y: range}`` for a vector; ``{towards: range, length:
  range}`` for one in the plane by its angle [rad] and length; ``{heading: range}`` for an
  attitude in the plane, ``{turned: any}`` for any in space; ``{whole: n}`` for a whole number
  below n.
- ``{bodies: n, at: vector, when: range, speed: range, radius: range, clear: distance}``: n discs
  that move evenly, any way, through places that they are at then, and start clear of the origin.
- ``{gates: [x, ...], radius: [r, ...], middle: range, gap: range}``: walls of four standing discs
  each, across the x axis, with a gap about a middle.

It may name another scenario that it is ``like`` instead of a configuration; then it gives what it
has beside or instead of that. A ``margin`` is by how much larger than they are bodies are told to
be, as whoever publishes them would: a vehicle is no point, and it is blown off its plans.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool.io import document, settings
from orbimpc_ros.tool.io.share import config

Values = dict[str, Any]
FOLDER = Path(__file__).with_name('scenarios')
FIELDS, OPTIONAL = ('about', 'set', 'draw'), ('config', 'like', 'margin')
CONE, TRAFFIC = 'cone', 'traffic'
NAMES = tuple(sorted(file.stem for file in FOLDER.glob('*.yaml')))


@dataclass(frozen=True)
class Mission:
    """What is flown, and how often something else.

    Attributes:
        name: of its file.
        about: in a line.
        values: of every parameter that all flights have alike.
        rules: by parameter, how a flight draws it.
        margin: by which pilots are told that bodies in the traffic are larger than they are [m].
    """

    name: str
    about: str
    values: Values
    rules: Mapping[str, Any]
    margin: float = 0.0

    def drawn(self, seed: int, index: int) -> Values:
        """Return what a flight draws; each parameter has a stream of its own."""
        return {name: _drawn(rule, _stream(seed, index, name)) for name, rule in self.rules.items()}

    @property
    def has(self) -> set[str]:
        """Return what there is that not all scenarios have."""
        found = {CONE: self.values['approach.cone'], TRAFFIC: 'traffic' in self.rules}
        return {name for name, there in found.items() if there}

    @property
    def limit(self) -> float:
        """Return how long a flight is at most [s]."""
        return float(self.values['max_ticks'] * self.values['step'])


def scenario_named(name: str, changes: Sequence[str] = ()) -> Mission:
    """Return a scenario with changes ``name=value``; what they name is not drawn.

    Raises:
        BadInput: there is none of that name, or a change is not allowed.
    """
    if name not in NAMES:
        raise BadInput.choice('--scenario', name, NAMES)
    content = _content(FOLDER / f'{name}.yaml')
    values = settings.resolve(config(content['config']), [*content['set'], *changes])
    fixed = {change.partition('=')[0] for change in changes}
    rules = {
        parameter: rule
        for parameter, rule in content['draw'].items()
        if not {parameter, parameter.removeprefix(settings.OF_SIM)} & fixed
    }
    return Mission(name, content['about'], values, rules, content.get('margin', 0.0))


def _content(file: Path) -> Values:
    """Return the fields of a scenario's file, with what it takes from the one that it is like.

    Raises:
        BadInput: a field is missing or unknown.
    """
    content = document.read(str(file))
    wanted = f'{", ".join(FIELDS)}, config or like, and perhaps margin'
    if not isinstance(content, dict) or not set(FIELDS) <= set(content) <= {*FIELDS, *OPTIONAL}:
        raise BadInput(str(file), 'not a scenario', wanted)
    if ('config' in content) == ('like' in content):
        raise BadInput(str(file), sorted(content), wanted)
    if 'config' in content:
        return content
    base = _content(FOLDER / f'{content["like"]}.yaml')
    both = {'set': [*base['set'], *content['set']], 'draw': base['draw'] | content['draw']}
    return base | content | both


def _stream(seed: int, index: int, name: str) -> np.random.Generator:
    key = (index, zlib.crc32(name.encode()))
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def _drawn(rule: Any, rng: np.random.Generator) -> Any:
    if isinstance(rule, dict):
        return next(drawn for name, drawn in RULES.items() if name in rule)(rule, rng)
    return float(rng.uniform(*rule))


def _vector(rule: Mapping[str, Any], rng: np.random.Generator) -> tuple[float, ...]:
    return tuple(float(rng.uniform(*rule.get(axis, (0.0, 0.0)))) for axis in 'xyz')


def _polar(rule: Mapping[str, Any], rng: np.random.Generator) -> tuple[float, ...]:
    angle, length = rng.uniform(*rule['towards']), rng.uniform(*rule['length'])
    return length * math.cos(angle), length * math.sin(angle), 0.0


def _heading(rule: Mapping[str, Any], rng: np.random.Generator) -> tuple[float, ...]:
    half = 0.5 * rng.uniform(*rule['heading'])
    return 0.0, 0.0, math.sin(half), math.cos(half)


def _turned(rule: Mapping[str, Any], rng: np.random.Generator) -> tuple[float, ...]:
    quaternion = rng.normal(size=4)
    return tuple((quaternion / np.linalg.norm(quaternion)).tolist())


def _whole(rule: Mapping[str, Any], rng: np.random.Generator) -> int:
    return int(rng.integers(rule['whole']))


def _gates(rule: Mapping[str, Any], rng: np.random.Generator) -> tuple[float, ...]:
    numbers: list[float] = []
    for x, radius in zip(rule['gates'], rule['radius'], strict=True):
        middle, half = rng.uniform(*rule['middle']), 0.5 * rng.uniform(*rule['gap'])
        for side in (-1.0, 1.0):
            for away in (half + radius, half + 3.0 * radius):
                numbers += [float(x), float(middle + side * away), 0.0, 0.0, radius]
    return tuple(numbers)


def _bodies(rule: Mapping[str, Any], rng: np.random.Generator) -> tuple[float, ...]:
    numbers: list[float] = []
    while len(numbers) < 5 * rule['bodies']:
        x, y, _ = _vector(rule['at'], rng)
        when, way = rng.uniform(*rule['when']), rng.uniform(-math.pi, math.pi)
        speed, radius = rng.uniform(*rule['speed']), float(rng.uniform(*rule['radius']))
        u, v = speed * math.cos(way), speed * math.sin(way)
        begin = float(x - when * u), float(y - when * v)
        if math.hypot(*begin) > rule['clear'] + radius:
            numbers += [*begin, float(u), float(v), radius]
    return tuple(numbers)


RULES: dict[str, Callable[[Mapping[str, Any], np.random.Generator], Any]] = {
    'bodies': _bodies,
    'gates': _gates,
    'towards': _polar,
    'length': _polar,
    'heading': _heading,
    'turned': _turned,
    'whole': _whole,
    'x': _vector,
    'y': _vector,
    'z': _vector,
}
