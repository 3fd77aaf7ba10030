# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The machine of a measurement: processor, versions, and the load of its processes."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from orbimpc_ros.mpc.errors import BadInput
from orbimpc_ros.tool.files import WRITABLE, why

PACKAGES = (
    *('orbimpc_ros', 'numpy', 'scipy', 'cvxpy', 'clarabel', 'numba', 'rclpy'),
    *('gurobipy', 'pyscipopt', 'casadi'),
)


def machine() -> dict[str, str | int | float]:
    """Return processor, cores that this process may use, system, and the load before the run."""
    file = Path('/proc/cpuinfo')
    lines = file.read_text().splitlines() if file.exists() else []
    names = [line.partition(':')[2].strip() for line in lines if line.startswith('model name')]
    return {
        'processor': names[0] if names else platform.processor(),
        'cores': len(os.sched_getaffinity(0)),
        'system': f'{platform.system()} {platform.machine()}',
        'load_1min': os.getloadavg()[0],
    }


def versions() -> dict[str, str | None]:
    """Return versions by package, None for packages that are not installed."""
    return {'python': platform.python_version(), **{name: _version(name) for name in PACKAGES}}


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def require_known(only: Sequence[str] | None, names: Sequence[str]) -> None:
    """Require that the names given to ``--only`` exist.

    Raises:
        BadInput: one does not exist.
    """
    for name in only or ():
        if name not in names:
            raise BadInput('--only', name, ' | '.join(names))


def writable(file: str | None) -> Path | None:
    """Create the file of ``--json`` before the work, so that no results are lost.

    Raises:
        BadInput: it cannot be written; its content is kept until there are results.
    """
    if file is None:
        return None
    path = Path(file).resolve()
    try:
        path.open('a').close()
    except OSError as error:
        raise BadInput.stating(f'--json {path}', why(error), WRITABLE) from None
    return path


def write(file: Path | None, head: Mapping[str, Any], rows: Sequence[Any]) -> None:
    """Write the values in ``head`` and the rows as JSON into the file, if there is one."""
    if file is not None:
        content = {**head, 'rows': [row.as_json() for row in rows]}
        file.write_text(json.dumps(content, indent=1, allow_nan=False) + '\n')


def resident(pid: int) -> int:
    """Return the resident memory of a process [bytes]."""
    pages = int(Path(f'/proc/{pid}/statm').read_text().split()[1])
    return pages * os.sysconf('SC_PAGE_SIZE')


def busy(pid: int) -> float:
    """Return the processor time of all threads of a process so far [s]."""
    fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    return sum(map(int, fields[11:13])) / os.sysconf('SC_CLK_TCK')
