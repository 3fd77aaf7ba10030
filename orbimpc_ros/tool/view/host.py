"""Becomes another program, and keeps what is arranged for this process: to end with its parent."""

from __future__ import annotations

import os
import sys

if __name__ == '__main__':
    os.execv(sys.argv[1], sys.argv[1:])
