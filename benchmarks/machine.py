# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The machine that measures: processor, versions, and what its processes take."""

from __future__ import annotations

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = (
    *('orbimpc_ros', 'numpy', 'scipy', 'cvxpy', 'clarabel', 'numba', 'rclpy'),
    *('gurobipy', 'pyscipopt', 'casadi'),
)


def machine() -> dict[str, str | int | float]:
    """Return processor, cores that this process may use, system, and the load before the run."""
    return {
        'processor': _processor(),
        'cores': len(os.sched_getaffinity(0)),
        'system': f'{platform.system()} {platform.machine()}',
        'load_1min': os.getloadavg()[0],
    }


def versions() -> dict[str, str | None]:
    """Return versions by package, None for what is not installed."""
    return {'python': platform.python_version(), **{name: _version(name) for name in PACKAGES}}


def resident(pid: int) -> int:
    """Return the memory that a process holds [bytes]."""
    status = Path(f'/proc/{pid}/status').read_text()
    line = next(line for line in status.splitlines() if line.startswith('VmRSS'))
    return 1024 * int(line.split()[1])


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _processor() -> str:
    try:
        lines = Path('/proc/cpuinfo').read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((v.partition(':')[2].strip() for v in lines if v.startswith('model name')), '')


def busy(pid: int) -> float:
    """Return the processor time that a process has taken so far, all threads together [s]."""
    fields = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()
    return sum(map(int, fields[11:13])) / os.sysconf('SC_CLK_TCK')
