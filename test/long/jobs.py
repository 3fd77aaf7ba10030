# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The missions: a configuration, what its planner is told on top, and what is drawn at random.

A value is for planner and simulator alike; under ``sim.`` it is the simulator's alone, and the
planner has to find out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from orbimpc_ros.tool import settings
from orbimpc_ros.tool.settings import config

Values = dict[str, Any]
MARGIN = 0.4  # [m] by which boxes are larger for the planner, as in config/multirotor.yaml


@dataclass(frozen=True)
class Mission:
    """A job, and whoever is to do it.

    Attributes:
        file: the configuration, by name.
        told: what is changed in it, ``name=value``, for planner and simulator.
        drawn: what differs from flight to flight, given a generator and the values so far.
    """

    file: str
    told: tuple[str, ...]
    drawn: Callable[[np.random.Generator, Values], Values]


def drawn(name: str, seed: int, index: int, changes: Sequence[str] = ()) -> tuple[Values, Values]:
    """Return the values of a mission's flight, and of these what was drawn.

    Args:
        name: of the mission.
        seed: with ``index``, of everything that is drawn.
        index: of the flight.
        changes: ``name=value``, of the configuration; what they name is not drawn.
    """
    mission = MISSIONS[name]
    values = settings.resolve(config(f'{mission.file}.yaml'), [*mission.told, *changes])
    fixed = {change.partition('=')[0] for change in changes}
    found = {
        parameter: value
        for parameter, value in mission.drawn(np.random.default_rng([seed, index]), values).items()
        if parameter not in fixed and parameter.removeprefix(settings.OF_SIM) not in fixed
    }
    return values | found, found


def _fixed_wing(rng: np.random.Generator, values: Values) -> Values:
    """A goal 80 m away in any direction, that drifts and swings, in wind of up to 5 m/s."""
    coming, bearing, course = rng.uniform(-math.pi, math.pi, size=3)
    return {
        'sim.wind': (*_towards(coming, rng.uniform(0.0, 5.0)), 0.0),
        'gust': rng.uniform(0.0, 1.0),
        'rope.center': (*_towards(bearing, 80.0), 0.0),
        'rope.velocity': (*_towards(course, rng.uniform(0.0, 2.0)), 0.0),
        'rope.amplitude': (*rng.uniform(0.0, 3.0, size=2).tolist(), 0.0),
        'rope.frequency': rng.uniform(0.02, 0.1),
        'rope.phase': tuple(rng.uniform(0.0, 2.0 * math.pi, size=3).tolist()),
        'seed': int(rng.integers(2**31)),
    }


def _tracking(rng: np.random.Generator, values: Values) -> Values:
    """A goal 40 m away that flies as fast as the wing can in the wind, of 1 to 4 m/s."""
    coming, bearing, course = rng.uniform(-math.pi, math.pi, size=3)
    wind = np.array(_towards(coming, rng.uniform(1.0, 4.0)))
    cruise = 0.5 * (1.0 + values['floor.fraction']) * values['forward']
    return {
        'sim.wind': (*wind.tolist(), 0.0),
        'gust': 0.0,
        'rope.center': (*_towards(bearing, 40.0), 0.0),
        'rope.velocity': (*(wind + _towards(course, cruise)).tolist(), 0.0),
        'rope.amplitude': (0.0, 0.0, 0.0),
    }


def _multirotor(rng: np.random.Generator, values: Values) -> Values:
    """Eight boxes on the way to a goal 10 m away, in a wind of up to 2 m/s^2, and gusts."""
    goal = (10.0, *rng.uniform(-2.0, 2.0, size=2).tolist())
    wind, gust = _in_space(rng, rng.uniform(0.0, 2.0)), rng.uniform(0.0, 0.3)
    boxes = _boxes(rng, np.array(goal), 8)
    return {
        'sim.wind': wind,
        'gust': gust,
        'rope.center': goal,
        'obstacles': _larger(boxes, MARGIN),
        'sim.obstacles': boxes,
        'seed': int(rng.integers(2**31)),
    }


def _in_space(rng: np.random.Generator, length: float) -> tuple[float, ...]:
    way = rng.normal(size=3)
    return tuple((way * length / np.linalg.norm(way)).tolist())


def _boxes(rng: np.random.Generator, goal: np.ndarray, count: int) -> tuple[float, ...]:
    """Boxes about the way to the goal, a metre and more from either end of it."""
    numbers: list[float] = []
    while len(numbers) < 6 * count:
        middle = rng.uniform(0.15, 0.85) * goal + rng.uniform(-2.5, 2.5, size=3)
        half = rng.uniform(0.2, 0.9, size=3)
        ends = np.array([np.zeros(3), goal])
        if (np.abs(ends - middle) - half).max(axis=1).min() > 1.0:
            numbers += [*(middle - half).tolist(), *(middle + half).tolist()]
    return tuple(numbers)


def _larger(numbers: Sequence[float], margin: float) -> tuple[float, ...]:
    """Boxes with so much more on each side [m]: those of the planner."""
    sides = np.array([-margin] * 3 + [margin] * 3)
    return tuple((np.reshape(numbers, (-1, 6)) + sides).ravel().tolist())


def _hover(rng: np.random.Generator, values: Values) -> Values:
    """A place within 3 m, and a steady push of 1 to 3 m/s^2 from any side."""
    push = rng.normal(size=3)
    push *= rng.uniform(1.0, 3.0) / np.linalg.norm(push)
    place = rng.uniform(-3.0, 3.0, size=3)
    return {'sim.wind': tuple(push.tolist()), 'rope.center': tuple(place.tolist())}


def _spacecraft(rng: np.random.Generator, values: Values) -> Values:
    """A goal within 2 m of (5, 10, 25), a gain off by up to 3 %."""
    return {
        'gain': rng.uniform(0.97, 1.03),
        'rope.center': tuple((np.array([5.0, 10.0, 25.0]) + rng.uniform(-2.0, 2.0, 3)).tolist()),
    }


def _car(rng: np.random.Generator, values: Values) -> Values:
    """A start in any direction, with or without a round minimum speed, lags of 0.1 to 0.3 s."""
    return {
        'start.orientation': _turned(rng.uniform(-math.pi, math.pi)),
        'floor.shape': str(rng.choice(['none', 'circle'])),
        'response.speed': rng.uniform(0.1, 0.3),
        'response.rate': rng.uniform(0.1, 0.3),
    }


def _retrieval(rng: np.random.Generator, values: Values) -> Values:
    """A rope some 5 s away that swings by half a second's flight, half a minute to catch it."""
    full, step = values['forward'], values['step']
    along, across = rng.uniform(-1.0, 1.0, size=2)
    return {
        'start.orientation': _turned(rng.uniform(-math.pi, math.pi)),
        'rope.center': ((5.0 + along) * full, across * full, 0.0),
        'rope.amplitude': (0.5 * full, 0.5 * full, 0.0),
        'rope.frequency': rng.uniform(0.07, 0.15),
        'rope.phase': (*rng.uniform(0.0, 2.0 * math.pi, size=2).tolist(), 0.0),
        'capture_radius': 0.2 * full,
        'goal_path_steps': values['horizon'],
        'max_ticks': round(30.0 * (values['odom_rate'] or 1.0 / step)),
    }


def _towards(angle: float, length: float) -> tuple[float, float]:
    return length * math.cos(angle), length * math.sin(angle)


def _turned(heading: float) -> tuple[float, float, float, float]:
    return 0.0, 0.0, math.sin(0.5 * heading), math.cos(0.5 * heading)


CONTINUOUS = ('vehicle=continuous', 'discretisation=exact')
LEARNING = (*CONTINUOUS, 'disturbance=estimated')
HELD = ('finish=arrival', 'weights.scaling=time', 'weights.position=1.0', 'weights.terminal=10.0')
TRACKING = ('discretisation=exact', 'objective=track', 'finish=arrival', 'max_ticks=240')
MULTIROTOR = (
    *('rotation_order=1', 'thrust_axis=z', 'gravity=9.81', 'forward=20.0', 'step=0.2'),
    *('horizon=20', 'horizon_mode=receding', 'terminal=penalty', 'max_ticks=100'),
    *(
        'weights.input=1.0',
        'weights.length=0.0',
        'max_rate=4.0',
        'start.orientation=[0.0, 0.0, 0.0, 1.0]',
    ),
    *('response.speed=0.1', 'response.rate=0.1'),
)
MISSIONS = {
    'fixed_wing': Mission('fixed_wing', (), _fixed_wing),
    'tracking': Mission('fixed_wing', TRACKING, _tracking),
    'hover': Mission('spacecraft', (*LEARNING, *HELD, *MULTIROTOR), _hover),
    'multirotor': Mission('multirotor', (), _multirotor),
    'spacecraft': Mission(
        'spacecraft',
        (*LEARNING, 'rotation_order=1', 'response.speed=0.2', 'response.rate=0.3'),
        _spacecraft,
    ),
    'car': Mission('dubins', (*CONTINUOUS, 'arrival_radius=0.05'), _car),
    'retrieval': Mission('retrieval', (*CONTINUOUS, 'weights.scaling=time'), _retrieval),
}
