# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The settings of a study: default and range of each; numbers may be ranges to draw from."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from orbimpc_ros.mpc.arrays import number, whole
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.problem import Floor, Problem, Weights
from orbimpc_ros.mpc.problem.floor import SHAPES
from orbimpc_ros.tool.io import document

Number = int | float
Span = tuple[Number, Number]  # drawn evenly from; both ends alike: always that number
Values = Mapping[str, str | Span]
Drawn = Mapping[str, Any]  # one run's: a word or a number each


@dataclass(frozen=True)
class Setting:
    """One setting.

    Attributes:
        name: as nodes' parameters are called, where there is one.
        default: a word, or the range that a run draws from.
        text: what it is.
        unit: of the number; empty for none.
        low: least number allowed.
        high: greatest.
        choices: words allowed.
    """

    name: str
    default: str | Span
    text: str
    unit: str = ''
    low: float = -1e6
    high: float = 1e6
    choices: tuple[str, ...] = ()

    @property
    def is_whole(self) -> bool:
        """Return whether its numbers are integers."""
        return isinstance(self.default[0], int)

    def checked(self, value: Any) -> str | Span:
        """Return a value as this setting takes it: a word, a number or ``[low, high]``.

        Raises:
            BadInput: anything else, or out of range.
        """
        if self.choices:
            if value not in self.choices:
                raise BadInput(self.name, value, ' | '.join(self.choices))
            return value
        ends = value if isinstance(value, (list, tuple)) else (value, value)
        if len(ends) != 2:
            raise BadInput(self.name, value, 'a number, or [low, high] to draw from')
        low, high = (self._number(end) for end in ends)
        if low > high:
            raise BadInput(self.name, value, 'a number, or [low, high] with low <= high')
        return low, high

    def _number(self, value: Any) -> Number:
        if self.is_whole:
            return whole(value, self.name, int(self.low), int(self.high))
        return number(value, self.name, self.low, self.high)

    def drawn(self, value: str | Span, share: float) -> str | Number:
        """Return the value of a run whose draw, uniform in [0, 1), is a share of the range."""
        if isinstance(value, str):
            return value
        low, high = value
        if self.is_whole:
            return int(low + math.floor(share * (high - low + 1)))
        return low + share * (high - low)


ALWAYS, TURN = (0.0, 0.0), (0.0, 2.0 * math.pi)

SETTINGS: tuple[Setting, ...] = (
    Setting('horizon', (5, 5), 'steps planned ahead', low=1, high=30),
    Setting('step', (1.0, 1.0), 'time between ticks', 's', 1e-3, 1e3),
    Setting('forward', (1.0, 1.0), 'full speed', 'm/s', 1e-3, 1e3),
    Setting('weights.position', (1.0, 1.0), 'on squared distance at every step', '1/m^2', 0.0),
    Setting('weights.input', (0.05, 0.05), 'on squared inputs', 's^2', 1e-6),
    Setting('weights.terminal', (10.0, 10.0), 'on squared distance at the end', '1/m^2', 0.0),
    Setting('floor.shape', 'circle', 'minimum speed', choices=tuple(SHAPES)),
    Setting('floor.faces', (4, 4), 'of a polygonal floor', low=3, high=64),
    Setting('floor.fraction', (0.3**0.5, 0.3**0.5), 'least share of full speed', '', 1e-6, 1.0),
    Setting('max_rate', ALWAYS, 'limit of the turn rate; 0 for none', 'rad/s', 0.0),
    Setting('capture_radius', (0.15, 0.15), 'near enough to catch', 'm', 1e-9),
    Setting('max_ticks', (60, 60), 'given up after', low=1, high=10_000),
    Setting('rope.center.x', (4.0, 6.0), 'middle of the swing', 'm'),
    Setting('rope.center.y', (-1.0, 1.0), 'middle of the swing', 'm'),
    Setting('rope.amplitude.x', (0.3, 0.7), 'of the swing along x', 'm', 0.0),
    Setting('rope.amplitude.y', (0.3, 0.7), 'of the swing along y', 'm', 0.0),
    Setting('rope.frequency', (0.02, 0.3), 'of the swing', 'Hz', 0.0, 1e3),
    Setting('rope.phase.x', TURN, 'of the swing along x at the start', 'rad'),
    Setting('rope.phase.y', TURN, 'of the swing along y at the start', 'rad'),
    Setting('start.x', (-2.0, 2.0), 'where the vehicle starts', 'm'),
    Setting('start.y', (-2.0, 2.0), 'where the vehicle starts', 'm'),
    Setting('start.heading', (-math.pi, math.pi), 'at the start', 'rad'),
    Setting('start.speed_fraction', (1.0, 1.0), 'at the start', '', 0.0, 1.0),
    Setting('faults.position_noise', ALWAYS, 'of odometry and sightings, each axis', 'm', 0.0, 1e3),
    Setting('faults.attitude_noise', ALWAYS, 'of odometry', 'rad', 0.0, math.pi),
)  # fmt: skip
BY_NAME = {setting.name: setting for setting in SETTINGS}


def resolved(changes: Sequence[str] = ()) -> Values:
    """Return every setting: the defaults with changes ``name=value`` on top.

    Raises:
        BadInput: an unknown name, or a value or combination that is not allowed.
    """
    values: dict[str, str | Span] = {setting.name: setting.default for setting in SETTINGS}
    for text in changes:
        name, given, word = text.partition('=')
        if not given:
            raise BadInput('--set', text, 'name=value')
        values[name] = setting_named(name).checked(document.parse(word, f'--set {name}'))
    require_sound(values)
    return values


def setting_named(name: str) -> Setting:
    """Return a setting.

    Raises:
        BadInput: there is none of that name.
    """
    if name not in BY_NAME:
        raise BadInput.unknown('setting', name, BY_NAME, '--set')
    return BY_NAME[name]


def require_sound(values: Values) -> None:
    """Raise BadInput where a run could draw a problem that there is not.

    The limits that depend on each other are hardest on few faces and else on large numbers.
    """
    lows, highs = (
        {name: value if isinstance(value, str) else value[end] for name, value in values.items()}
        for end in (0, 1)
    )
    problem_of(lows)
    problem_of({**highs, 'floor.faces': lows['floor.faces']})


def problem_of(drawn: Drawn) -> Problem:
    """Return the problem of one run."""
    return Problem(
        horizon=drawn['horizon'],
        step=drawn['step'],
        forward=drawn['forward'],
        weights=Weights(
            drawn['weights.position'], drawn['weights.input'], 0.0, drawn['weights.terminal']
        ),
        floor=Floor(drawn['floor.shape'], drawn['floor.faces'], drawn['floor.fraction']),
        max_rate=drawn['max_rate'],
    )
