"""``orbimpc demo fleet``: vehicles in namespaces, in real time, each after a rope of its own."""

from __future__ import annotations

import argparse
import itertools
import math
from collections import defaultdict
from pathlib import Path

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.ros.vehicles import vehicles
from orbimpc_ros.tool.io import bag, settings
from orbimpc_ros.tool.io.files import new_folder, writing_to
from orbimpc_ros.tool.io.settings import Values
from orbimpc_ros.tool.io.share import config

VEHICLES = 4


def run(args: argparse.Namespace) -> int:
    """Fly, record, sum up, draw; 0 only if every rope was caught."""
    from orbimpc_ros.tool.run.flying import fly

    values, own = resolve(VEHICLES if args.vehicles is None else args.vehicles, args.set)
    folder = new_folder(args.out, 'fleet')
    with writing_to(folder):
        fly(values, folder, own)
        return report(folder, tuple(own))


def resolve(count: int, changes: list[str]) -> tuple[Values, dict[str, Values]]:
    """Return the values that a fleet shares, and by namespace those that differ.

    Args:
        count: of the vehicles.
        changes: ``name=value``, for every vehicle; ``seed`` is that of the whole fleet.

    Raises:
        BadInput: too many vehicles, an unknown name, or a value that is not allowed.
    """
    values = settings.resolve(config('fleet.yaml'), changes)
    if values['clock'] != 'wall':
        raise BadInput('clock', values['clock'], 'wall: a fleet cannot share one simulated clock')
    given = {change.partition('=')[0] for change in changes} - {'seed'}
    drawn = vehicles(count, values['seed'])
    own = {
        namespace: {name: value for name, value in each.items() if name not in given}
        for namespace, each in drawn.items()
    }
    return values, own


def report(folder: Path, namespaces: tuple[str, ...]) -> int:
    """Sum up a fleet's flights from their bag, draw them, and return the exit code."""
    from orbimpc_ros.tool import figures
    from orbimpc_ros.tool.demo import summary
    from orbimpc_ros.tool.figures.fleet import fleet
    from orbimpc_ros.tool.figures.style import look
    from orbimpc_ros.tool.io import history

    path, picture = folder / 'bag', folder / figures.TRAJECTORY
    flown = {name: history.of_bag(path, name) for name in namespaces}
    print(summary.of_fleet(flown, late(path)))
    print(f'bag           {path}')
    with look():
        figures.save(fleet(flown), picture)
    print(f'picture       {picture}')
    return 0 if all(each.captured for each in flown.values()) else 1


def late(path: Path) -> dict[str, int]:
    """Return how many odometry messages were not answered before the next one, by namespace.

    What comes before a vehicle's first command does not count.

    Args:
        path: of the bag.
    """
    asked: defaultdict[str, dict[int, int]] = defaultdict(dict)
    answered: defaultdict[str, dict[int, int]] = defaultdict(dict)
    for message in bag.raw(path):
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
