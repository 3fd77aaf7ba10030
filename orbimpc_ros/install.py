# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The installed copy: where it is, and how to install what is missing without breaking ROS.

An extra is named by the packages in it: this distribution is on no index, so that
``orbimpc_ros[view]`` would be looked for in vain. Where NumPy 1 is installed, as ROS 2 Jazzy's
messages on Ubuntu 24.04 need it, the command keeps to ``requirements-jazzy.txt``.
"""

from __future__ import annotations

import shlex
import sys
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

NAME, CONSTRAINTS = 'orbimpc_ros', 'requirements-jazzy.txt'


def command(*packages: str) -> str:
    """Return the command that installs packages for this Python."""
    arguments = [sys.executable, '-m', 'pip', 'install']
    if version('numpy').startswith('1.'):
        file = shared(CONSTRAINTS)
        arguments += ['numpy<2'] if file is None else ['--constraint', str(file)]
    return shlex.join([*arguments, *packages])


def command_for_extra(extra: str) -> str:
    """Return the command that installs the packages of an extra, by its name in ``setup.py``."""
    # Imported here: it comes with matplotlib, which the nodes do without.
    from packaging.requirements import Requirement

    try:
        declared = [Requirement(each) for each in requires(NAME) or []]
    except PackageNotFoundError:  # a folder that was put on the path, not installed
        return f'see the extra {extra!r} in setup.py'
    wanted = [each for each in declared if each.marker and each.marker.evaluate({'extra': extra})]
    return command(*(str(each).partition(';')[0] for each in wanted))


def shared(name: str) -> Path | None:
    """Return the path of a file that is installed with the package, such as ``package.xml``.

    Every way of installing puts ``share/orbimpc_ros`` beside some parent of the package; in a
    clone the parent itself holds the file.
    """
    for folder in Path(__file__).resolve().parents:
        for root in (folder / 'share' / NAME, folder):
            if (root / 'package.xml').is_file() and (root / name).is_file():
                return root / name
    return None
