# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A study: how many runs from which seed, who flies them, what each of them draws."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from orbimpc_ros.lab.study.controllers import CONTROLLERS
from orbimpc_ros.lab.study.settings import SETTINGS, Drawn, Values, problem_of, setting_named
from orbimpc_ros.mpc.arrays import whole
from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.mpc.geometry.rotations import exp
from orbimpc_ros.mpc.loop.forecast import FORECASTS
from orbimpc_ros.mpc.problem import Problem
from orbimpc_ros.world.faults import Faults
from orbimpc_ros.world.rope import Rope
from orbimpc_ros.world.scenario import Scenario
from orbimpc_ros.world.vehicle import launched, model_of

TRUTH = 'truth'
FORECAST_KINDS = ('harmonic', *(kind for kind in FORECASTS if kind != 'harmonic'), TRUTH)
MOST_RUNS, LARGEST_SEED = 10_000_000, 2**63 - 1


@dataclass(frozen=True)
class Study:
    """Everything that the results of a study depend on.

    Attributes:
        runs: how many; each flown by every controller.
        seed: of all draws.
        controllers: names in :data:`CONTROLLERS`.
        forecast: how the goal is predicted, for everyone alike; ``truth`` knows the rope.
        settings: by name, a word or the range that runs draw from.
    """

    runs: int
    seed: int
    controllers: tuple[str, ...]
    forecast: str
    settings: Values

    def __post_init__(self) -> None:
        whole(self.runs, '--runs', 1, MOST_RUNS)
        whole(self.seed, '--seed', 0, LARGEST_SEED)
        if self.forecast not in FORECAST_KINDS:
            raise BadInput('--forecast', self.forecast, ' | '.join(FORECAST_KINDS))
        for name in self.controllers:
            if name not in CONTROLLERS or self.controllers.count(name) > 1:
                allowed = f'each of {",".join(CONTROLLERS)} at most once'
                raise BadInput('--controllers', ','.join(self.controllers), allowed)

    def as_json(self) -> dict[str, Any]:
        """Return the study as plain values; :func:`study_of` reads them."""
        return {**vars(self), 'settings': dict(self.settings)}


def study_of(content: Any, name: str) -> Study:
    """Return the study that plain values describe.

    Args:
        content: as :meth:`Study.as_json` gives it.
        name: where it comes from, for messages.

    Raises:
        BadInput: not a study.
    """
    wanted = [each.name for each in fields(Study)]
    if not isinstance(content, dict) or sorted(content) != sorted(wanted):
        raise BadInput(name, 'not a study', f'fields {", ".join(wanted)}')
    settings, controllers = content['settings'], content['controllers']
    if not isinstance(settings, dict) or list(settings) != [each.name for each in SETTINGS]:
        raise BadInput(name, 'of another version', 'the settings of this version')
    if not isinstance(controllers, list):
        raise BadInput(name, controllers, 'a list of controllers')
    values = {key: setting_named(key).checked(value) for key, value in settings.items()}
    return Study(content['runs'], content['seed'], tuple(controllers), content['forecast'], values)


def differences(one: Study, other: Study) -> list[str]:
    """Return the names of the fields and settings in which two studies differ."""
    a, b = ({**s.as_json(), **s.as_json()['settings']} for s in (one, other))
    return [name for name in a if name != 'settings' and a[name] != b[name]]


class Run(NamedTuple):
    """One draw.

    Attributes:
        number: in 0..runs-1.
        drawn: its settings.
        problem: what the controllers solve.
        scenario: what is flown.
        faults: the noise.
        noise_seed: of the faults.
    """

    number: int
    drawn: Drawn
    problem: Problem
    scenario: Scenario
    faults: Faults
    noise_seed: int


def run_of(study: Study, number: int) -> Run:
    """Return a run of a study; it depends on the seed and its number alone.

    Every setting has a draw of its own, used or not: fixing one setting changes no other.
    """
    sequence = np.random.SeedSequence(study.seed, spawn_key=(number,))
    shares = np.random.default_rng(sequence).uniform(size=len(SETTINGS))
    drawn: Drawn = {
        setting.name: setting.drawn(study.settings[setting.name], float(share))
        for setting, share in zip(SETTINGS, shares, strict=True)
    }
    problem = problem_of(drawn)
    noise = Faults(
        position_noise=drawn['faults.position_noise'], attitude_noise=drawn['faults.attitude_noise']
    )
    noise_seed = int(sequence.spawn(1)[0].generate_state(1)[0])
    return Run(number, drawn, problem, _scenario(problem, drawn), noise, noise_seed)


def _scenario(problem: Problem, drawn: Drawn) -> Scenario:
    def point(name: str) -> np.ndarray:
        return np.array([drawn[f'{name}.x'], drawn[f'{name}.y']])

    model = model_of(problem)
    start = launched(
        model,
        point('start'),
        exp(np.array([drawn['start.heading']])),
        fraction=drawn['start.speed_fraction'],
    )
    rope = Rope(
        point('rope.center'), point('rope.amplitude'), drawn['rope.frequency'], point('rope.phase')
    )
    return Scenario(model, start, rope, drawn['capture_radius'], drawn['max_ticks'])
