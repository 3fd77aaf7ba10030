# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""The garbage collector, whose pauses would be taken for those of what is measured."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def paused() -> Iterator[None]:
    """Collect now, and then not until this ends."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
