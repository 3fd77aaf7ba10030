# Copyright 2026 orbimpc_ros developers. SPDX-License-Identifier: Apache-2.0
"""A progress bar in plain text: redrawn in a terminal, a few lines elsewhere."""

from __future__ import annotations

import shutil
import sys

WIDTH = 20
LINES = 5  # where there is no terminal


class ProgressLine:
    """Shows how much of something is done.

    Args:
        total: what there is to do.
    """

    def __init__(self, total: int) -> None:
        self._total = max(1, total)
        self._stream = sys.stderr
        self._live = self._stream.isatty()
        self._shown: tuple[int, str] | None = None

    def show(self, done: int, text: str) -> None:
        """Draw ``done`` with a text beside it, unless nothing has changed that is worth it."""
        share = min(1.0, done / self._total)
        shown = (done, text) if self._live else (int(share * LINES), '')
        if shown == self._shown:
            return
        self._shown = shown
        filled = int(share * WIDTH)
        line = f'[{"#" * filled}{"." * (WIDTH - filled)}] {text}'
        line = line[: shutil.get_terminal_size().columns - 1]  # a second line would stay
        self._stream.write(f'\r{line}\x1b[K' if self._live else f'{line}\n')
        self._stream.flush()

    def close(self) -> None:
        """Leave the bar behind."""
        if self._live and self._shown is not None:
            self._stream.write('\n')
            self._stream.flush()
