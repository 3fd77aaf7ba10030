# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The folder of the configuration: in a checkout, a workspace or where pip installed it."""

from __future__ import annotations

from pathlib import Path

from orbimpc_ros.mpc.errors import BadInput


def config(name: str) -> Path:
    """Return the path of a file under ``config/``.

    Every way of installing puts ``share/orbimpc_ros`` beside some parent of the package; in a
    checkout the parent itself holds ``config``.

    Raises:
        BadInput: no such file.
    """
    parents = Path(__file__).resolve().parents
    roots = [root for p in parents for root in (p / 'share' / 'orbimpc_ros', p)]
    found = next((r for r in roots if (r / 'package.xml').is_file()), None)
    if found is None or not (found / 'config' / name).is_file():
        raise BadInput.stating(
            f'configuration {name}', f'not in {found}', 'install it under config/'
        )
    return found / 'config' / name
