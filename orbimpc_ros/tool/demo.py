# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc demo``: planner and simulator as processes over DDS, a bag, a summary, pictures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.sim.engine_vehicle import ENGINES, class_of
from orbimpc_ros.sim.fleet import FLEETS, separations
from orbimpc_ros.tool import history, settings
from orbimpc_ros.tool.files import new_folder, shown, writing_to
from orbimpc_ros.tool.history import History
from orbimpc_ros.tool.run.flying import fly
from orbimpc_ros.tool.settings import Values

# The clock of a fleet waits for the slowest answer, which makes nothing stale.
PACED = ('clock=shared', 'odom_timeout=60.0')
# Flights of a demo, by name. The paper shows the Dubins car with and without minimum speed; its
# retrieval, which follows the rope as last seen, has beside it one that intercepts it.
VARIANTS: dict[str, dict[str, tuple[str, ...]]] = {
    'retrieval': {'': (), 'first_pass': ('objective=intercept', 'goal_prediction=harmonic')},
    'dubins': {'no_floor': ('floor.shape=none',), 'floor': ('floor.shape=polygon',)},
}


def run(scenario: str, vehicles: int | None, out: str, changes: Sequence[str]) -> int:
    """Fly, record, sum up, draw; 0 only if the job was done."""
    if scenario in FLEETS:
        values, own = fleet(vehicles, changes, scenario)
        flights = {'': values}
    else:
        if vehicles is not None:
            raise BadInput.stating('--vehicles', 'no fleet', 'give the scenario fleet or crossing')
        flights, own = variants(scenario, changes), {}
        for values in flights.values():
            if values['vehicle'] in ENGINES:
                class_of(values['vehicle'])  # raises, before anything is started
    folder = new_folder(out, scenario)
    bags = {}
    with writing_to(folder):
        for name, values in flights.items():
            place = folder / name
            place.mkdir(exist_ok=True)
            fly(values, place, own)
            bags[name] = place / 'bag'
        if own:
            flown = {name: history.of_bag(bags[''], name) for name in own}
        else:
            flown = {name: history.of_bag(bag) for name, bag in bags.items()}
        return report(folder, [*bags.values()], flown)


def variants(scenario: str, changes: Sequence[str]) -> dict[str, Values]:
    """Return the parameters of each flight of a demo, by name; a single one has none.

    Where what tells flights apart is set for all of them, there is one; so is a retrieval with any
    parameter of its own, which is no longer the paper's.

    Raises:
        BadInput: an unknown name, or a value or combination that is not allowed.
    """
    found = VARIANTS.get(scenario, {'': ()})
    if any(scenario == 'retrieval' or each.startswith('floor.shape=') for each in changes):
        found = {'': ()}
    file = settings.config(f'{scenario}.yaml')
    return {name: settings.resolve(file, [*changes, *variant]) for name, variant in found.items()}


def fleet(
    count: int | None, changes: Sequence[str], scenario: str = 'fleet'
) -> tuple[Values, dict[str, Values]]:
    """Return the values that a fleet shares, and by namespace those that differ.

    Args:
        count: of the vehicles; None for as many as the scenario is made for.
        changes: ``name=value``, for every vehicle; ``seed`` is that of the whole fleet.
        scenario: ``fleet`` or ``crossing``.

    Raises:
        BadInput: too many vehicles, an unknown name, or a value that is not allowed.
    """
    file = settings.config(f'{scenario}.yaml')
    values = settings.resolve(file, [*PACED, *changes])
    if values['clock'] == 'lockstep':
        raise BadInput('clock', values['clock'], 'shared or wall: a fleet has one /clock')
    given = {change.partition('=')[0] for change in changes} - {'seed'}
    draw, usual = FLEETS[scenario]
    drawn = draw(usual if count is None else count, values['seed'])
    if values['avoid']:
        values['avoid'] = tuple(f'{namespace}/plan' for namespace in drawn)
    own = {
        namespace: {name: value for name, value in each.items() if name not in given}
        for namespace, each in drawn.items()
    }
    return values, own


def report(folder: Path, paths: Sequence[Path], flown: Mapping[str, History]) -> int:
    """Sum up the flights of a demo, draw pictures, and return the exit code.

    Args:
        folder: takes the pictures.
        paths: of the bags.
        flown: the flights, by name; those of a fleet by namespace.
    """
    from orbimpc_ros.tool import plot  # matplotlib takes time that the start of nodes has not

    clear = True
    if any(name.startswith('/') for name in flown):
        print(history.of_fleet(flown))
        clear = clearance(flown)
    else:
        for name, each in flown.items():
            print(f'{name}:\n{history.text(each)}' if name else history.text(each))
    for path in paths:
        print(f'bag           {shown(path)}')
    for name in plot.written(flown, folder):
        label = 'picture' if name == plot.PATH else Path(name).stem
        print(f'{label:<14}{shown(folder / name)}')
    return 0 if clear and all(each.captured for each in flown.values()) else 1


def clearance(flown: Mapping[str, History]) -> bool:
    """Print how close vehicles that avoid each other came; return whether that is far enough."""
    radius = next(iter(flown.values())).values['avoid_radius']
    if not radius:
        return True
    _, found = separations({name: (each.times, each.positions) for name, each in flown.items()})
    for pair, apart in found.items():
        if min(apart) < radius:
            print(f'COLLISION     {" and ".join(pair)} within {min(apart):.3f} m of each other')
    least = min(map(min, found.values()), default=math.inf)
    print(f'apart         at least {least:.3f} m, {radius:g} m asked for')
    return least >= radius
