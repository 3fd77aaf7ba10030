# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc demo``: planner and simulator as processes over DDS, a bag, a summary, a picture."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool.files import new_folder, writing_to

if TYPE_CHECKING:
    from orbimpc_ros.tool.history import History
    from orbimpc_ros.tool.settings import Values

SCENARIOS = (
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
    'fleet',
    'crossing',
)
# Flights of a demo, by name. The paper shows the Dubins car with and without minimum speed; its
# retrieval, which follows the rope as last seen, has beside it one that intercepts it.
VARIANTS: dict[str, dict[str, tuple[str, ...]]] = {
    'retrieval': {'': (), 'first_pass': ('objective=intercept', 'goal_prediction=harmonic')},
    'dubins': {'none': ('floor.shape=none',), 'polygon': ('floor.shape=polygon',)},
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument('scenario', nargs='?', default='retrieval', choices=SCENARIOS)
    parser.add_argument(
        '--vehicles', type=int, metavar='K', help='size of the fleet (default: 4) or crossing (8)'
    )
    parser.add_argument(
        '--out', default='out', metavar='DIR', help='takes the results (default: %(default)s)'
    )
    parser.add_argument(
        '--set',
        action='append',
        default=[],
        metavar='NAME=VALUE',
        help='override a parameter of planner or simulator; may be repeated',
    )


def run(args: argparse.Namespace) -> int:
    """Fly, record, sum up, draw; 0 only if the job was done."""
    if args.scenario in ('fleet', 'crossing'):
        from orbimpc_ros.tool.demo import fleet

        return fleet.run(args)
    if args.vehicles is not None:
        raise BadInput.stating('--vehicles', 'no fleet', 'give the scenario fleet or crossing')
    return _run_alone(args)


def _run_alone(args: argparse.Namespace) -> int:
    from orbimpc_ros.tool.run.flying import fly

    flights = _flights(args.scenario, args.set)
    for values in flights.values():
        _require_engine(values['vehicle'])
    folder = new_folder(args.out, args.scenario)
    places = {name: folder / name if name else folder for name in flights}
    with writing_to(folder):
        for name, values in flights.items():
            places[name].mkdir(exist_ok=True)
            fly(values, places[name])
        return report(folder, places)


def _require_engine(vehicle: str) -> None:
    """Refuse a vehicle whose engine is not installed, before anything is started."""
    from orbimpc_ros.sim.engine_vehicle import ENGINES, class_of

    if vehicle in ENGINES:
        class_of(vehicle)


def _flights(scenario: str, changes: list[str]) -> dict[str, Values]:
    """Return the parameters of each flight of a demo, by name; a single one has none.

    Where what tells flights apart is set for all of them, there is one; so is a retrieval with any
    parameter of its own, which is no longer the paper's.

    Raises:
        BadInput: an unknown name, or a value or combination that is not allowed.
    """
    from orbimpc_ros.tool import settings
    from orbimpc_ros.tool.settings import config

    variants = VARIANTS.get(scenario, {'': ()})
    if any(scenario == 'retrieval' or each.startswith('floor.shape=') for each in changes):
        variants = {'': ()}
    file = config(f'{scenario}.yaml')
    return {
        name: settings.resolve(file, [*changes, *variant]) for name, variant in variants.items()
    }


def report(folder: Path, places: Mapping[str, Path]) -> int:
    """Sum up the flights of a demo from their bags, draw pictures, and return the exit code.

    Args:
        folder: takes the pictures.
        places: of the flights' bags, by name.
    """
    from orbimpc_ros.sim.engine_vehicle import ENGINES
    from orbimpc_ros.tool import figures, history
    from orbimpc_ros.tool.demo import summary

    flown = {name: history.of_bag(place / 'bag') for name, place in places.items()}
    for name, each in flown.items():
        print(f'{name}:\n{summary.text(each)}' if name else summary.text(each))
    for place in places.values():
        print(f'bag           {place / "bag"}')
    if all(each.in_time for each in flown.values()):
        print(_arrivals(flown))
    for name, figure in figures.of_runs(flown).items():
        figures.save(figure, folder / name)
        label = 'picture' if name == figures.TRAJECTORY else Path(name).stem
        print(f'{label:<14}{folder / name}')
    if any(each.values['vehicle'] in ENGINES for each in flown.values()):
        _render(folder, places.values())
    return 0 if all(each.captured for each in flown.values()) else 1


def _render(folder: Path, places: Iterable[Path]) -> None:
    """Have the engine of a flight draw it, if it can here; the flight is none the worse if not."""
    from orbimpc_ros.tool.demo.rendering import render

    for place in places:
        try:
            rendered = render(place / 'bag', folder)
        except Exception as error:  # of what kind depends on the graphics that are missing
            print(f'rendered      not here: {error}'.splitlines()[0])
            continue
        if rendered is not None:
            print(f'rendered      {rendered}')


def _arrivals(flown: Mapping[str, History]) -> str:
    """Return a table of errors at arrival: of the flights and, unflown, under the true floor."""
    from orbimpc_ros.tool.demo import arrivals

    columns = {
        arrivals.title(run.values): arrivals.column(run.values, run) for run in flown.values()
    }
    if len(flown) > 1:
        values = next(iter(flown.values())).values | {'floor.shape': 'circle'}
        columns[arrivals.title(values)] = arrivals.column(values)
    return arrivals.table(columns)
