"""A scenario: a configuration, what is changed in it, and what every flight draws.

A file names a configuration, lists changes ``name=value``, and has a rule for each parameter that
is drawn: a range ``[low, high]``; ``{x: range, y: range}`` for a vector; ``{towards: range,
length: range}`` for one in the plane by its angle [rad] and length; ``{heading: range}`` for an
attitude; ``{whole: n}`` for a whole number below n.
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
FIELDS = ('about', 'config', 'set', 'draw')
NAMES = tuple(sorted(file.stem for file in FOLDER.glob('*.yaml')))


@dataclass(frozen=True)
class Mission:
    """What is flown, and how often something else.

    Attributes:
        name: of its file.
        about: in a line.
        values: of every parameter that all flights have alike.
        rules: by parameter, how a flight draws it.
    """

    name: str
    about: str
    values: Values
    rules: Mapping[str, Any]

    def drawn(self, seed: int, index: int) -> Values:
        """Return what a flight draws; each parameter has a stream of its own."""
        return {name: _drawn(rule, _stream(seed, index, name)) for name, rule in self.rules.items()}

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
    file = FOLDER / f'{name}.yaml'
    content = document.read(str(file))
    if not isinstance(content, dict) or sorted(content) != sorted(FIELDS):
        raise BadInput(str(file), 'not a scenario', f'fields {", ".join(FIELDS)}')
    values = settings.resolve(config(content['config']), [*content['set'], *changes])
    fixed = {change.partition('=')[0] for change in changes}
    rules = {
        parameter: rule
        for parameter, rule in content['draw'].items()
        if not {parameter, parameter.removeprefix(settings.OF_SIM)} & fixed
    }
    return Mission(name, content['about'], values, rules)


def _stream(seed: int, index: int, name: str) -> np.random.Generator:
    key = (index, zlib.crc32(name.encode()))
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def _drawn(rule: Any, rng: np.random.Generator) -> Any:
    if isinstance(rule, dict):
        return RULES[min(rule, key=list(RULES).index)](rule, rng)
    return float(rng.uniform(*rule))


def _vector(rule: Mapping[str, Any], rng: np.random.Generator) -> tuple[float, ...]:
    return tuple(float(rng.uniform(*rule.get(axis, (0.0, 0.0)))) for axis in 'xyz')


def _polar(rule: Mapping[str, Any], rng: np.random.Generator) -> tuple[float, ...]:
    angle, length = rng.uniform(*rule['towards']), rng.uniform(*rule['length'])
    return length * math.cos(angle), length * math.sin(angle), 0.0


def _heading(rule: Mapping[str, Any], rng: np.random.Generator) -> tuple[float, ...]:
    half = 0.5 * rng.uniform(*rule['heading'])
    return 0.0, 0.0, math.sin(half), math.cos(half)


def _whole(rule: Mapping[str, Any], rng: np.random.Generator) -> int:
    return int(rng.integers(rule['whole']))


RULES: dict[str, Callable[[Mapping[str, Any], np.random.Generator], Any]] = {
    'towards': _polar,
    'length': _polar,
    'heading': _heading,
    'whole': _whole,
    'x': _vector,
    'y': _vector,
    'z': _vector,
}
