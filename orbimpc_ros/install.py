# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The installed copy: where it is, and how to install what is missing without breaking ROS.

An extra is named by the packages in it: this distribution is on no index, so that
``orbimpc_ros[view]`` would be looked for in vain. Where NumPy 1 is installed, as ROS 2 Jazzy's
messages on Ubuntu 24.04 need it, the command keeps to ``requirements-jazzy.txt``. Where pip may not
change the system's Python, the command makes an environment on top of it, and in a workspace builds
the package anew, so that its nodes run there.
"""

from __future__ import annotations

import os
import shlex
import sys
import sysconfig
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from shutil import which

NAME, CONSTRAINTS = 'orbimpc_ros', 'requirements-jazzy.txt'
# Where an extra wants NumPy 2 without need: its packages, and what they need besides.
BESIDE_NUMPY_1 = {
    'view': ('--no-deps', 'rerun-sdk>=0.39,<0.42', 'pyarrow>=18,<22', 'attrs', 'psutil')
}
NEW = 'python3 -m venv --system-site-packages .venv && . .venv/bin/activate'


def command(*packages: str) -> str:
    """Return the command that installs packages where this copy finds them."""
    if _is_managed():
        built = ' && python -m colcon build' if 'COLCON_PREFIX_PATH' in os.environ else ''
        return f'{NEW} && {_command(["pip"], packages)}{built}'
    own = Path(sys.executable).parent
    found = which('pip')
    is_ours = found is not None and Path(found).parent == own
    return _command(['pip'] if is_ours else [sys.executable, '-m', 'pip'], packages)


def _is_managed() -> bool:
    """Return whether this Python is the system's, which pip refuses to change (PEP 668)."""
    marker = Path(sysconfig.get_path('stdlib')) / 'EXTERNALLY-MANAGED'
    return sys.prefix == sys.base_prefix and marker.exists()


def _command(pip: Sequence[str], packages: Sequence[str]) -> str:
    words = [*pip, 'install']
    if _has_numpy_1():
        file = shared(CONSTRAINTS)
        words += ['numpy<2'] if file is None else ['--constraint', str(file)]
    return shlex.join([*words, *packages])


def _has_numpy_1() -> bool:
    return version('numpy').startswith('1.')


def command_for_extra(extra: str) -> str:
    """Return the command that installs the packages of an extra, by its name in ``setup.py``."""
    if extra in BESIDE_NUMPY_1 and _has_numpy_1():
        return command(*BESIDE_NUMPY_1[extra])
    # Imported here: it comes with matplotlib, which the nodes do without.
    from packaging.requirements import Requirement

    try:
        declared = [Requirement(each) for each in requires(NAME) or []]
    except PackageNotFoundError:  # a folder that was put on the path, not installed
        return f'see the extra {extra!r} in setup.py'
    wanted = [
        each
        for each in declared
        if each.marker is not None
        and each.marker.evaluate({'extra': extra})
        and not each.marker.evaluate({'extra': ''})
    ]
    for each in wanted:
        each.marker = None
    return command(*map(str, wanted))


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
