# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""What the flights of a study have in common, and what each of them draws.

A study file names a parameter file, and has a rule for each parameter that is drawn:

- a range ``[low, high]``; ``{x: range, y: range}`` for a vector; ``{towards: range, length:
  range}`` for one in the plane by its angle [rad] and length; ``{turned: distance}`` for one in any
  direction, ``{heading: range}`` for an attitude in the plane, ``{turned: any}`` for any in space;
  ``{whole: n}`` for a whole number below n.
- ``{bodies: n, at: vector, when: range, speed: range, radius: range, clear: distance}``: n discs
  that move evenly in any direction, through places where they are at a drawn time, and start clear
  of the origin.
- ``{gates: [x, ...], radius: [r, ...], middle: range, gap: range}``: walls of four standing discs
  each, across the x axis, with a gap about a middle.

Instead of a parameter file (``config``: a name in ``config/``, or a path from the study file such
as ``./boat.yaml``) it may name another study that it is ``like`` and give what
differs. ``margin`` is by how much larger than they are the discs are reported [m]: the vehicle is
no point, and it is blown off its plans.

A parameter file without rules is studied as it is: every flight draws the direction of the goal,
the phase of its swing, the heading at the start and the seed of the noise. A planner that allows
for lags flies a vehicle that has them.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool import files, settings
from orbimpc_ros.tool.settings import config

Values = dict[str, Any]
Rule = Any
FIELDS, OPTIONAL = {'about', 'set', 'draw'}, {'config', 'like', 'margin'}
TURN = [-math.pi, math.pi]
LARGEST_SEED = 2**31 - 1


@dataclass(frozen=True)
class Draws:
    """What is flown."""

    name: str  # of the file
    about: str  # the task, in one line
    values: Values  # the parameters that all flights have in common
    rules: Mapping[str, Rule]  # how a flight draws a parameter, by its name
    margin: float = 0.0  # by how much larger than they are bodies in the traffic are reported [m]

    def of(self, seed: int, index: int) -> Values:
        """Return all parameters of a flight; each drawn one has a random stream of its own."""
        streams = {name: _stream(seed, index, name) for name in self.rules}
        return self.values | {name: _drawn(self.rules[name], rng) for name, rng in streams.items()}

    @property
    def limit(self) -> float:
        """Return how long a flight is at most [s]."""
        return float(self.values['max_ticks'] * self.values['step'])


def draws_of(name: str, changes: Sequence[str] = ()) -> Draws:
    """Return the draws of a study file or a parameter file.

    Args:
        name: a path, or the name of a file in ``config/studies`` or ``config``, without its ending.
        changes: ``name=value``; what they set is not drawn.

    Raises:
        BadInput: there is no such file, it is malformed, or a change is not allowed.
    """
    content = _content(_file(name))
    values = settings.resolve(content['config'], [*content['set'], *changes])
    fixed = {change.partition('=')[0] for change in changes}
    rules = content['draw'] if content['draw'] is not None else _default_rules(values)
    free = {
        parameter: rule
        for parameter, rule in rules.items()
        if not {parameter, parameter.removeprefix(settings.OF_SIM)} & fixed
    }
    title = Path(name).stem if name.endswith('.yaml') else name
    draws = Draws(title, content['about'], values, free, content.get('margin', 0.0))
    _require_sound(draws, name)
    return draws


def _require_sound(draws: Draws, name: str) -> None:
    known = settings.ROWS.keys() | settings.ROWS_OF_SIM.keys()
    for parameter in draws.rules:
        if parameter not in known:
            raise BadInput.unknown('parameter', parameter, known, f'{name}: draw')
    try:
        settings.changed(draws.of(0, 0), ())
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        rules = 'the rules of docs/recording.md'
        raise BadInput(f'{name}: draw', f'{type(error).__name__}: {error}', rules) from None


def _file(name: str) -> Path:
    if Path(name).is_file():
        return Path(name)
    studies = config('studies/fixed_wing.yaml').parent
    for folder in (studies, studies.parent):
        if (folder / f'{name}.yaml').is_file():
            return folder / f'{name}.yaml'
    known = ', '.join(sorted(file.stem for file in studies.glob('*.yaml')))
    raise BadInput('FILE', name, f'a parameter file, or one of {known}')


def _content(file: Path) -> Values:
    """Return the fields of a study file; those of a parameter file without rules."""
    content = files.read(str(file))
    if isinstance(content, dict) and 'draw' not in content:
        names = {name for name, _ in settings.sections(content, str(file))}
        lags = any(name.startswith('response.') for name in names)
        vehicle = ['vehicle=continuous'] if lags and 'vehicle' not in names else []
        about = f'goals all around, as in {file.name}'
        return {'about': about, 'config': file, 'set': vehicle, 'draw': None}
    wanted = f'{", ".join(sorted(FIELDS))}, and config or like'
    fields = set(content) if isinstance(content, dict) else set()
    if not FIELDS <= fields <= FIELDS | OPTIONAL or ('config' in fields) == ('like' in fields):
        raise BadInput(str(file), sorted(fields), wanted)
    if 'config' in content:
        named = str(content['config'])
        return content | {'config': file.parent / named if '/' in named else config(named)}
    base = _content(file.with_name(f'{content["like"]}.yaml'))
    both = {'set': [*base['set'], *content['set']], 'draw': base['draw'] | content['draw']}
    return base | content | both


def _default_rules(values: Values) -> dict[str, Rule]:
    """Return what a flight draws of a parameter file; among obstacles the goal stays in place."""
    flat, swing = values['dimension'] == 2, {axis: [0.0, 2.0 * math.pi] for axis in 'xyz'}
    rules: dict[str, Rule] = {'rope.phase': swing, 'seed': {'whole': LARGEST_SEED}}
    if not (values['obstacles'] or values['traffic']):
        distance = math.dist(values['rope.center'], values['start.position'])
        sphere = {'towards': TURN, 'length': [distance, distance]} if flat else {'turned': distance}
        rules['rope.center'] = {'from': values['start.position'], **sphere}
    if not values['gravity']:
        rules['start.orientation'] = {'heading': TURN} if flat else {'turned': 'any'}
    return rules


def _stream(seed: int, index: int, name: str) -> np.random.Generator:
    key = (index, zlib.crc32(name.encode()))
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def _drawn(rule: Rule, rng: np.random.Generator) -> Any:
    """Return a value drawn by a rule.

    Raises:
        ValueError: it is none.
    """
    match rule:
        case [low, high]:
            return float(rng.uniform(low, high))
        case {'from': begin, **rest}:
            return tuple(np.add(begin, _drawn(rest, rng)).tolist())
        case {'whole': count}:
            return int(rng.integers(count))
        case {'towards': angles, 'length': lengths}:
            angle, length = rng.uniform(*angles), rng.uniform(*lengths)
            return length * math.cos(angle), length * math.sin(angle), 0.0
        case {'heading': angles}:
            half = 0.5 * rng.uniform(*angles)
            return 0.0, 0.0, math.sin(half), math.cos(half)
        case {'turned': length}:
            drawn = rng.normal(size=4 if length == 'any' else 3)
            unit = drawn / np.linalg.norm(drawn)
            return tuple((unit if length == 'any' else length * unit).tolist())
        case {'gates': places, 'radius': radii}:
            walls = zip(places, radii, strict=True)
            return tuple(number for x, radius in walls for number in _wall(rule, x, radius, rng))
        case {'bodies': count}:
            return tuple(number for _ in range(count) for number in _body(rule, rng))
        case dict() if rule and {*rule} <= {*'xyz'}:
            return tuple(float(rng.uniform(*rule.get(axis, (0.0, 0.0)))) for axis in 'xyz')
    raise ValueError(f'unknown rule {rule}')


def _wall(
    rule: Mapping[str, Any], x: float, radius: float, rng: np.random.Generator
) -> Iterator[float]:
    """Yield place, velocity and radius of the four discs of a wall."""
    middle, half = rng.uniform(*rule['middle']), 0.5 * rng.uniform(*rule['gap'])
    for side in (-1.0, 1.0):
        for away in (half + radius, half + 3.0 * radius):
            yield from (float(x), float(middle + side * away), 0.0, 0.0, radius)


def _body(rule: Mapping[str, Any], rng: np.random.Generator) -> list[float]:
    """Return place, velocity and radius of a disc that starts clear of the origin."""
    while True:
        x, y, _ = _drawn(rule['at'], rng)
        when, way = rng.uniform(*rule['when']), rng.uniform(-math.pi, math.pi)
        speed, radius = rng.uniform(*rule['speed']), float(rng.uniform(*rule['radius']))
        u, v = speed * math.cos(way), speed * math.sin(way)
        begin = float(x - when * u), float(y - when * v)
        if math.hypot(*begin) > rule['clear'] + radius:
            return [*begin, float(u), float(v), radius]
