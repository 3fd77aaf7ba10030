# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc plot``: the path of a bag's flight, its numbers over time, and an animation."""

from __future__ import annotations

import argparse
from pathlib import Path

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool.arguments import add_namespace
from orbimpc_ros.tool.files import folder_at, shown

ANIMATION = 'animation.gif'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument('bag', metavar='BAG', help='a recorded flight')
    parser.add_argument(
        '-o', '--out', required=True, metavar='DIR', help='takes the pictures; made if missing'
    )
    add_namespace(parser)
    parser.add_argument('--dark', action='store_true', help='for dark pages, not for print')
    parser.add_argument('--no-animation', action='store_true', help='only still pictures')


def run(args: argparse.Namespace) -> int:
    """Draw a flight."""
    from orbimpc_ros.tool import animation, figures, history
    from orbimpc_ros.tool.style import save

    flight = history.of_bag(Path(args.bag), args.namespace)
    if len(flight.times) < 2:
        raise BadInput.stating(args.bag, 'a single odometry message', 'two or more are needed')
    folder = folder_at(Path(args.out).resolve())
    pictures = figures.of_runs({'': flight}, args.dark)
    for name, figure in pictures.items():
        save(figure, folder / name, args.dark)
    names = [*pictures]
    if not args.no_animation:
        animation.write_gif(flight, folder / ANIMATION, args.dark)
        names.append(ANIMATION)
    print(f'written: {", ".join(names)} in {shown(folder)}')
    return 0
