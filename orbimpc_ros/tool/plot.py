# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""``orbimpc plot``: the paper's figures of a bag, its numbers, and an animation."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool.files import WRITABLE, require_writable, why, writing_to

if TYPE_CHECKING:
    from orbimpc_ros.mpc.arrays import Array
    from orbimpc_ros.tool.history import History

ANIMATION = 'animation.gif'
FRAME, LAST = 80, 2500  # [ms] that frames are shown
COLORS = 128  # of an animation


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the command."""
    parser.add_argument('bag', metavar='BAG', help='a recorded flight')
    parser.add_argument(
        '-o', '--out', required=True, metavar='DIR', help='takes the pictures; made if missing'
    )
    parser.add_argument(
        '--namespace', default='', metavar='NS', help='of the vehicle, such as /uav1'
    )
    parser.add_argument('--dark', action='store_true', help='for dark pages, not for print')
    parser.add_argument('--no-animation', action='store_true', help='only still pictures')


def run(args: argparse.Namespace) -> int:
    """Draw a flight; nothing is written unless everything can be."""
    from orbimpc_ros.tool import history

    flight = history.of_bag(Path(args.bag), args.namespace)
    if len(flight.times) < 2:
        raise BadInput.stating(args.bag, 'a single odometry message', 'two or more are needed')
    pictures = _pictures(flight, args.dark, not args.no_animation)
    folder = _folder(Path(args.out).resolve(), pictures)
    require_writable('--out', folder / next(iter(pictures)))
    with writing_to(folder):
        for name, write in pictures.items():
            write(folder / name)
    print(f'written: {", ".join(pictures)} in {folder}')
    return 0


def _pictures(flight: History, dark: bool, animated: bool) -> dict[str, Callable[[Path], None]]:
    """Return what writes each picture, by file name."""
    from orbimpc_ros.tool import figures
    from orbimpc_ros.tool.figures.animation import animation

    pictures: dict[str, Callable[[Path], None]] = {
        name: lambda file, figure=figure: figures.save(figure, file, dark)  # type: ignore[misc]
        for name, figure in figures.of_flight(flight, dark).items()
    }
    if animated:
        pictures[ANIMATION] = lambda file: write_gif(list(animation(flight, dark)), file)
    return pictures


def _folder(folder: Path, names: Sequence[str] | dict) -> Path:
    """Create a folder for pictures, and see to it that none of somebody else's is replaced.

    Raises:
        BadInput: it cannot be created, or has a file of such a name that we have not made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput.stating(f'--out {folder}', why(error), WRITABLE) from None
    for name in names:
        if (folder / name).exists() and not made_here(folder / name):
            raise BadInput.stating(
                f'--out {folder / name}', 'not made by orbimpc', 'give another folder'
            )
    return folder


def made_here(file: Path) -> bool:
    """Return whether a picture says that orbimpc has made it."""
    from PIL import Image, UnidentifiedImageError

    from orbimpc_ros.tool.style import MAKER

    try:
        with Image.open(file) as image:
            notes = (image.info.get('Software'), image.info.get('comment'))
    except (OSError, UnidentifiedImageError):
        return False
    return MAKER in notes or MAKER.encode() in notes


def write_gif(frames: Sequence[Array], file: Path) -> None:
    """Write frames, shape (height, width, 3), as an animation that repeats for ever."""
    import numpy as np
    from PIL import Image

    from orbimpc_ros.tool.files import write_whole
    from orbimpc_ros.tool.style import MAKER

    # One palette for all frames: colours must not flicker.
    palette = Image.new('P', (1, 1))
    some = np.concatenate([frames[0], frames[len(frames) // 2], frames[-1]])
    palette.putpalette(frequent(some, COLORS).astype(np.uint8).tobytes())
    images = [
        Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE)
        for frame in frames
    ]
    how: Any = {
        'format': 'GIF',
        'save_all': True,
        'append_images': images[1:],
        'duration': [FRAME] * (len(images) - 1) + [LAST],
        'loop': 0,
        'comment': MAKER.encode(),
    }
    write_whole(file, lambda new: images[0].save(new, **how))


def frequent(picture: Array, count: int) -> Array:
    """Return the most frequent colours, shape (count or less, 3), of a picture, shape (m, n, 3).

    In a drawing these are its very colours; those that are mixed at edges are few of a kind.
    """
    import numpy as np

    # As one number each: to sort rows of three takes ten times as long.
    packed = picture.reshape(-1, 3).astype(np.int64) @ np.array([1 << 16, 1 << 8, 1])
    found, counts = np.unique(packed, return_counts=True)
    chosen = found[np.argsort(counts)[::-1][:count]]
    return np.stack(np.unravel_index(chosen, (256, 256, 256)), axis=1)
