# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc demo fleet`` and ``crossing``: vehicles in namespaces, which share a clock.

In a fleet each is after a rope of its own; in a crossing each is to get to the other side, clear of
all others.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.sim.fleet import crossers, plans, separations, vehicles
from orbimpc_ros.tool import bags, settings
from orbimpc_ros.tool.files import new_folder, writing_to
from orbimpc_ros.tool.settings import Values, config

if TYPE_CHECKING:
    from orbimpc_ros.tool.history import History
VEHICLES = {'fleet': 4, 'crossing': 8}
DRAWN = {'fleet': vehicles, 'crossing': crossers}


def run(args: argparse.Namespace) -> int:
    """Fly, record, sum up, draw; 0 only if every vehicle did its job, clear of all others."""
    from orbimpc_ros.tool.run.flying import fly

    kind = args.scenario
    count = VEHICLES[kind] if args.vehicles is None else args.vehicles
    values, own = resolve(count, args.set, kind)
    folder = new_folder(args.out, kind)
    with writing_to(folder):
        fly(values, folder, own)
        return report(folder, tuple(own))


def resolve(
    count: int, changes: list[str], kind: str = 'fleet'
) -> tuple[Values, dict[str, Values]]:
    """Return the values that a fleet shares, and by namespace those that differ.

    Args:
        count: of the vehicles.
        kind: ``fleet`` or ``crossing``.
        changes: ``name=value``, for every vehicle; ``seed`` is that of the whole fleet.

    Raises:
        BadInput: too many vehicles, an unknown name, or a value that is not allowed.
    """
    values = settings.resolve(config(f'{kind}.yaml'), ['clock=shared', *changes])
    if values['clock'] == 'lockstep':
        raise BadInput('clock', values['clock'], 'shared or wall: a fleet has one /clock')
    given = {change.partition('=')[0] for change in changes} - {'seed'}
    drawn = DRAWN[kind](count, values['seed'])
    if values['avoid']:
        values['avoid'] = plans(drawn)
    own = {
        namespace: {name: value for name, value in each.items() if name not in given}
        for namespace, each in drawn.items()
    }
    return values, own


def report(folder: Path, namespaces: tuple[str, ...]) -> int:
    """Sum up a fleet's flights from their bag, draw them, and return the exit code."""
    from orbimpc_ros.tool import figures, history
    from orbimpc_ros.tool.demo import summary
    from orbimpc_ros.tool.figures.fleet import fleet
    from orbimpc_ros.tool.style import look

    path, picture = folder / 'bag', folder / figures.TRAJECTORY
    flown = {name: history.of_bag(path, name) for name in namespaces}
    print(summary.of_fleet(flown, late(path)))
    clear = _clear(flown)
    print(f'bag           {path}')
    with look():
        figures.save(fleet(flown), picture)
    print(f'picture       {picture}')
    return 0 if clear and all(each.captured for each in flown.values()) else 1


def _clear(flown: Mapping[str, History]) -> bool:
    """Say how close vehicles that avoid each other came, and return whether that is far enough."""
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


def late(path: Path) -> dict[str, int]:
    """Return how many odometry messages were not answered before the next one, by namespace.

    What comes before a vehicle's first command does not count.

    Args:
        path: of the bag.
    """
    asked: defaultdict[str, dict[int, int]] = defaultdict(dict)
    answered: defaultdict[str, dict[int, int]] = defaultdict(dict)
    for message in bags.raw(path):
        namespace, _, topic = message.topic.rpartition('/')
        if topic == 'odom':
            asked[namespace][message.stamp] = message.sent
        elif topic == 'cmd_vel':
            answered[namespace].setdefault(message.stamp, message.sent)
    return {name: _late(each, answered[name]) for name, each in asked.items()}


def _late(asked: dict[int, int], answered: dict[int, int]) -> int:
    """Count questions not answered before the next, given when each stamp's was sent [ns]."""
    begun = min(answered, default=math.inf)
    flown = [stamp for stamp in sorted(asked) if stamp >= begun]
    return sum(
        answered.get(stamp, math.inf) > asked[after] for stamp, after in itertools.pairwise(flown)
    )
