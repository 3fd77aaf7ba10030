# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc demo``: planner and simulator as processes over DDS, a bag, a summary, pictures."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool.arguments import add_set
from orbimpc_ros.tool.files import new_folder, shown, writing_to

if TYPE_CHECKING:
    from orbimpc_ros.tool.history import History
    from orbimpc_ros.tool.settings import Values

ALONE = (
    'retrieval',
    'retrieval3d',
    'dubins',
    'spacecraft',
    'fixed_wing',
    'cessna',
    'rope',
    'servicer',
    'multirotor',
    'lander',
)
FLEETS = {'fleet': 4, 'crossing': 8}  # scenario: how many vehicles
# The clock of a fleet waits for the slowest answer, which makes nothing stale.
PACED = ('clock=shared', 'odom_timeout=60.0')
# Flights of a demo, by name. The paper shows the Dubins car with and without minimum speed; its
# retrieval, which follows the rope as last seen, has beside it one that intercepts it.
VARIANTS: dict[str, dict[str, tuple[str, ...]]] = {
    'retrieval': {'': (), 'first_pass': ('objective=intercept', 'goal_prediction=harmonic')},
    'dubins': {'no_floor': ('floor.shape=none',), 'floor': ('floor.shape=polygon',)},
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    scenarios = (*ALONE, *FLEETS)
    parser.add_argument(
        'scenario',
        nargs='?',
        default='retrieval',
        choices=scenarios,
        metavar='SCENARIO',
        help=f'one of {", ".join(scenarios)} (default: %(default)s)',
    )
    parser.add_argument(
        '--vehicles', type=int, metavar='K', help='size of the fleet (default: 4) or crossing (8)'
    )
    parser.add_argument(
        '--out', default='out', metavar='DIR', help='takes the results (default: %(default)s)'
    )
    add_set(parser, 'override a parameter of planner or simulator')


def run(args: argparse.Namespace) -> int:
    """Fly, record, sum up, draw; 0 only if the job was done."""
    from orbimpc_ros.tool import history
    from orbimpc_ros.tool.run.flying import fly

    if args.scenario in FLEETS:
        count = FLEETS[args.scenario] if args.vehicles is None else args.vehicles
        values, own = fleet(count, args.set, args.scenario)
        flights = {'': values}
    else:
        if args.vehicles is not None:
            raise BadInput.stating('--vehicles', 'no fleet', 'give the scenario fleet or crossing')
        flights, own = variants(args.scenario, args.set), {}
        for values in flights.values():
            _require_engine(values['vehicle'])
    folder = new_folder(args.out, args.scenario)
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
    from orbimpc_ros.tool import settings

    found = VARIANTS.get(scenario, {'': ()})
    if any(scenario == 'retrieval' or each.startswith('floor.shape=') for each in changes):
        found = {'': ()}
    file = settings.config(f'{scenario}.yaml')
    return {name: settings.resolve(file, [*changes, *variant]) for name, variant in found.items()}


def fleet(
    count: int, changes: Sequence[str], scenario: str = 'fleet'
) -> tuple[Values, dict[str, Values]]:
    """Return the values that a fleet shares, and by namespace those that differ.

    Args:
        count: of the vehicles.
        changes: ``name=value``, for every vehicle; ``seed`` is that of the whole fleet.
        scenario: ``fleet`` or ``crossing``.

    Raises:
        BadInput: too many vehicles, an unknown name, or a value that is not allowed.
    """
    from orbimpc_ros.sim.fleet import crossers, vehicles
    from orbimpc_ros.tool import settings

    file = settings.config(f'{scenario}.yaml')
    values = settings.resolve(file, [*PACED, *changes])
    if values['clock'] == 'lockstep':
        raise BadInput('clock', values['clock'], 'shared or wall: a fleet has one /clock')
    given = {change.partition('=')[0] for change in changes} - {'seed'}
    drawn = (crossers if scenario == 'crossing' else vehicles)(count, values['seed'])
    if values['avoid']:
        values['avoid'] = tuple(f'{namespace}/plan' for namespace in drawn)
    own = {
        namespace: {name: value for name, value in each.items() if name not in given}
        for namespace, each in drawn.items()
    }
    return values, own


def _require_engine(vehicle: str) -> None:
    """Refuse a vehicle whose engine is not installed, before anything is started."""
    from orbimpc_ros.sim.engine_vehicle import ENGINES, class_of

    if vehicle in ENGINES:
        class_of(vehicle)


def report(folder: Path, paths: Sequence[Path], flown: Mapping[str, History]) -> int:
    """Sum up the flights of a demo, draw pictures, and return the exit code.

    Args:
        folder: takes the pictures.
        paths: of the bags.
        flown: the flights, by name; those of a fleet by namespace.
    """
    from orbimpc_ros.tool import figures, summary
    from orbimpc_ros.tool.style import save

    clear = True
    if any(name.startswith('/') for name in flown):
        print(summary.of_fleet(flown))
        clear = clearance(flown)
    else:
        for name, each in flown.items():
            print(f'{name}:\n{summary.text(each)}' if name else summary.text(each))
    for path in paths:
        print(f'bag           {shown(path)}')
    for name, figure in figures.of_runs(flown).items():
        save(figure, folder / name)
        label = 'picture' if name == figures.PATH else Path(name).stem
        print(f'{label:<14}{shown(folder / name)}')
    return 0 if clear and all(each.captured for each in flown.values()) else 1


def clearance(flown: Mapping[str, History]) -> bool:
    """Print how close vehicles that avoid each other came; return whether that is far enough."""
    from orbimpc_ros.sim.fleet import separations

    radius = next(iter(flown.values())).values['avoid_radius']
    if not radius:
        return True
    found = separations({name: (each.times, each.positions) for name, each in flown.items()})
    for pair, least in found.items():
        if least < radius:
            print(f'COLLISION     {" and ".join(pair)} within {least:.3f} m of each other')
    least = min(found.values(), default=math.inf)
    print(f'apart         at least {least:.3f} m, {radius:g} m asked for')
    return least >= radius
