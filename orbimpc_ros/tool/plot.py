# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc plot``: the path of a bag's flight, its numbers over time, and an animation."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from pathlib import Path

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool.arguments import add_namespace
from orbimpc_ros.tool.files import WRITABLE, require_writable, shown, why, writing_to

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
    """Draw a flight; nothing is written unless everything can be."""
    from orbimpc_ros.tool import animation, figures, history
    from orbimpc_ros.tool.style import save

    flight = history.of_bag(Path(args.bag), args.namespace)
    if len(flight.times) < 2:
        raise BadInput.stating(args.bag, 'a single odometry message', 'two or more are needed')
    pictures: dict[str, Callable[[Path], None]] = {
        name: lambda file, figure=figure: save(figure, file, args.dark)  # type: ignore[misc]
        for name, figure in figures.of_runs({'': flight}, args.dark).items()
    }
    if not args.no_animation:
        pictures[ANIMATION] = lambda file: animation.write_gif(flight, file, args.dark)
    folder = _folder(Path(args.out).resolve(), pictures)
    with writing_to(folder):
        for name, write in pictures.items():
            write(folder / name)
    print(f'written: {", ".join(pictures)} in {shown(folder)}')
    return 0


def _folder(folder: Path, names: Iterable[str]) -> Path:
    """Create a folder for pictures, and see to it that none of somebody else's is replaced.

    Raises:
        BadInput: it cannot be created, or has a file of such a name that we have not made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput.stating(f'--out {folder}', why(error), WRITABLE) from None
    for file in (folder / name for name in names):
        if file.exists() and not made_here(file):
            raise BadInput.stating(f'--out {file}', 'not made by orbimpc', 'give another folder')
        require_writable('--out', file)
    return folder


def made_here(file: Path) -> bool:
    """Return whether a picture's metadata name orbimpc as its maker."""
    from PIL import Image, UnidentifiedImageError

    from orbimpc_ros.tool.style import MAKER

    try:
        with Image.open(file) as image:
            notes = (image.info.get('Software'), image.info.get('comment'))
    except (OSError, UnidentifiedImageError):
        return False
    return MAKER in notes or MAKER.encode() in notes
