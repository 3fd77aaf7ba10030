# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""Flies the demos and draws the pictures of their flights, light and dark: python docs/flights.py.

Names of demos as arguments draw only these. What has been flown into the folder of ``--flights``
before is drawn without another flight.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from orbimpc_ros.sim.fleet import FLEETS, vehicles
from orbimpc_ros.tool import cli, history
from orbimpc_ros.tool.plot import in_both_looks, look, paths, write_gif

DOCS = Path(__file__).resolve().parent
COUNT = 8  # vehicles of a fleet
OBSTACLES = {  # for plans larger by 0.1 m than they are
    'obstacles': '[1.4, -1.1, 2.6, 0.7, 3.9, 0.1, 5.1, 3.1, 6.4, -2.1, 7.1, 1.1]',
    'sim.obstacles': '[1.5, -1.0, 2.5, 0.6, 4.0, 0.2, 5.0, 3.0, 6.5, -2.0, 7.0, 1.0]',
    'rope.center': '[9.0, 0.0, 0.0]',
    'no_corner_cutting': 'true',
    'goal_prediction': 'harmonic',
    'horizon': '8',
    'objective': 'intercept',
}
DEMOS = ('retrieval', 'obstacles', 'dubins', 'spacecraft', 'multirotor', 'lander', 'cessna', 'rope')
FOLDED = (*FLEETS, 'cessna', 'rope')  # pictures in docs/pictures


def fly(name: str, folder: Path) -> Path:
    """Fly a demo, unless it has been flown; return where its results are."""
    demo, words = name, []
    if name in FLEETS:
        words = ['--vehicles', str(COUNT)]
    if name == 'obstacles':
        demo, folder = 'retrieval', folder / name
        words = [word for each in OBSTACLES.items() for word in ('--set', '='.join(each))]
    if not (folder / demo).exists() and cli.main(['demo', demo, '--out', str(folder), *words]):
        sys.exit(f'{name}: the demo has failed')
    return folder / demo


def draw(name: str, place: Path) -> None:
    """Draw the flights of a demo."""
    if name in FLEETS:
        flown = {each: history.of_bag(place / 'bag', each) for each in vehicles(name, COUNT)}
    else:
        bags = sorted(place.glob('**/bag'))
        flown = {bag.parent.name if len(bags) > 1 else '': history.of_bag(bag) for bag in bags}
    pictures = DOCS / 'pictures' if name in FOLDED else DOCS
    if name == 'rope':
        from rendering import render  # takes MuJoCo and OpenGL

        render(place / 'bag', pictures / 'rope.gif')
    else:
        for file in in_both_looks(pictures / f'{name}.png'):
            paths(flown).savefig(file)
    if name == 'retrieval':
        with look():
            write_gif(flown['retrieval'], DOCS / 'retrieval.gif')


def main() -> None:
    """Draw every flight, or those of some demos."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('names', nargs='*', metavar='DEMO', default=[*DEMOS, *FLEETS])
    parser.add_argument('--flights', type=Path, metavar='DIR')
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for name in args.names:
            draw(name, fly(name, args.flights or Path(folder)))


if __name__ == '__main__':
    main()
