# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Flies the demos and draws the pictures of their flights, light and dark: python docs/flights.py.

Names of demos as arguments draw only these.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

from matplotlib.figure import Figure

from orbimpc_ros.sim.fleet import vehicles
from orbimpc_ros.tool import cli, figures, history
from orbimpc_ros.tool.history import History
from orbimpc_ros.tool.style import in_both_looks

DOCS = Path(__file__).resolve().parent
FLEET = 8  # vehicles
OBSTACLES = {  # as on the page that shows it, docs/recording.md
    'obstacles': '[1.5, -1.0, 2.5, 0.6, 4.0, 0.2, 5.0, 3.0, 6.5, -2.0, 7.0, 1.0]',
    'rope.center': '[9.0, 0.0, 0.0]',
    'no_corner_cutting': 'true',
    'goal_prediction': 'harmonic',
    'horizon': '8',
}
DEMOS = ('retrieval', 'obstacles', 'dubins', 'spacecraft', 'multirotor', 'lander', 'fleet')


def drawn(flown: Mapping[str, History]) -> Callable[[bool], Figure]:
    """Return what draws the paths of flights, for dark pages or not."""
    return lambda dark: figures.of_runs(flown, dark)[figures.PATH]


def fly(name: str, folder: Path) -> None:
    """Fly a demo and draw it."""
    demo, words = name, []
    if name == 'fleet':
        words = ['--vehicles', str(FLEET)]
    if name == 'obstacles':
        demo = 'retrieval'
        words = [word for each in OBSTACLES.items() for word in ('--set', '='.join(each))]
    if cli.main(['demo', demo, '--out', str(folder), *words]):
        sys.exit(f'{name}: the demo has failed')
    place = folder / demo
    if name == 'fleet':
        flown = {each: history.of_bag(place / 'bag', each) for each in vehicles(FLEET, 0)}
        in_both_looks(drawn(flown), DOCS / 'pictures' / 'fleet.png')
        return
    bags = sorted(place.glob('**/bag'))
    flown = {bag.parent.name if len(bags) > 1 else '': history.of_bag(bag) for bag in bags}
    in_both_looks(drawn(flown), DOCS / f'{name}.png')


def main(names: list[str]) -> None:
    """Draw every flight, or those of some demos."""
    for name in names or DEMOS:
        with tempfile.TemporaryDirectory() as folder:
            fly(name, Path(folder))


if __name__ == '__main__':
    main(sys.argv[1:])
